# SPDX-License-Identifier: GPL-3.0-or-later
"""Shadows that fall on the objects from what nobody modelled: which pixels one lamp lights, and from where it shines.

Beside a sun the light of which reaches some pixels and others not, there is light that reaches all. With R the image of
a beam from d of irradiance 1, made by itself with the objects' own shadows, and s in {0, 1} of each pixel,

    b = A x + E s R,

where x is smooth light of a low order with a Gaussian prior. With s known, x and E are linear; with these known, a pixel
is lit where that explains it and those around it better. Both are found by turns, of many directions d at once, each
from the same start: what is brighter than a light that reaches all of it explains is lit. As mixtures of two regressions
are found by classification (Celeux and Govaert 1992), with neighbours that go together.
"""

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from btfsep_engine import sh
from btfsep_engine.linear_algebra import product

ORDER = 5  # of the light that reaches all
EVEN, FALLS = 10.0, 1.2  # standard deviation of its mean over that of order 1; the others' fall by this power of theirs
NOISE = 0.02  # of the photo's mean: what a pixel may differ by, for the prior
TURNS = 15
AROUND, FARTHEST = 1.2, 3.0  # pixels' spacings: deviation of neighbours that go together, and how far they reach
FINE, FINEST = 0.6, 1.8  # the same where how much of the lamp a pixel sees is told
HOLDS = 0.01  # of a lamp's own power: what is not explained by other light has to be as much


def neighbours(pixels, *, deviation: float = AROUND, farthest: float = FARTHEST) -> sparse.csr_array:
    """(p, p), the mean over what lies around each of the pixels (p, 2), in units of their spacing."""
    pixels = np.asarray(pixels, np.float64)
    spacing = np.sqrt(max(float(np.ptp(pixels, axis=0).prod()), 1.0) / len(pixels))
    tree = cKDTree(pixels)
    near = tree.sparse_distance_matrix(tree, farthest * spacing, output_type="coo_matrix")
    weight = np.exp(-0.5 * np.square(near.data / (deviation * spacing)))
    out = sparse.csr_array((weight, (near.row, near.col)), shape=near.shape) + sparse.eye_array(len(pixels))
    return sparse.csr_array(sparse.diags_array(1 / np.asarray(out.sum(axis=1)).ravel()) @ out)


class ShadowSearch:
    """A photograph's pixels, made ready for any number of lamps.

    Parameters
    ----------
    basis : (p, terms, 3), A
    radiance : (p, 3), b
    weights : (p, 3) >= 0
    around : `neighbours` of the pixels
    """

    def __init__(self, basis, radiance, weights, around):
        terms = min(sh.term_count(ORDER), basis.shape[1])
        degree = np.repeat(np.arange(ORDER + 1), 2 * np.arange(ORDER + 1) + 1)[:terms]
        prior = np.where(degree == 0, EVEN, np.maximum(degree, 1.0) ** -FALLS)
        self._root, self._around = np.sqrt(weights), around
        self._unit = np.maximum(np.average(radiance, axis=0, weights=np.maximum(weights, 1e-12)), 1e-300)
        self._b = self._root * radiance / self._unit
        self._axes = []
        for c in range(3):
            rows = np.asarray(basis[:, :terms, c], np.float64)
            rows = rows * (self._root[:, c, None] * prior / max(float(rows[:, 0].mean()), 1e-300))
            u, size, _ = np.linalg.svd(rows, full_matrices=False)
            self._axes.append((u, size**2 / (size**2 + NOISE**2 * len(rows))))
        self._left = np.stack([self._beside(c, self._b[:, c]) for c in range(3)], 1)

    @property
    def brighter(self) -> np.ndarray:
        """(p,), how much brighter pixels are, with those around them, than light makes them that reaches all."""
        return self._around @ self._left.sum(1)

    @property
    def left(self) -> float:
        """What light that reaches all leaves over, relative."""
        return float(np.sqrt(np.square(self._left).sum() / max(np.square(self._b).sum(), 1e-300)))

    def _beside(self, c: int, values):
        """What is left of values (p, …) of a channel beside the light that reaches all."""
        u, part = self._axes[c]
        along = product(u.T, values)
        return values - product(u, part[:, None] * along if along.ndim > 1 else part * along)

    def lit(self, images, start=None, *, turns: int = TURNS):
        """Which pixels each lamp lights, beside light that reaches all.

        Parameters
        ----------
        images : (p, n, 3), R of each lamp
        start : (p,) or (p, n) bool; None: what is `brighter`

        Returns
        -------
        lit (p, n) bool; irradiance (n, 3) >= 0; left (n,), what is left over then, relative
        """
        start = self.brighter > 0 if start is None else start
        lit = np.broadcast_to(np.reshape(start, (len(self._b), -1)), images.shape[:2])
        images = [self._root[:, c, None] * images[:, :, c] / self._unit[c] for c in range(3)]
        for _ in range(turns):
            irradiance, gain, left = [], 0.0, 0.0
            for c, image in enumerate(images):
                column = lit * image
                beside = self._beside(c, column)
                power = np.square(beside).sum(0) + HOLDS * np.square(column).sum(0)
                e = np.maximum((beside * self._left[:, c, None]).sum(0) / np.maximum(power, 1e-300), 0)
                rest = self._left[:, c, None] - e * beside
                own = e * image
                gain += own * (2 * (rest + lit * own) - own)
                left += np.square(rest).sum(0)
                irradiance.append(e)
            now = self._around @ gain > 0
            if np.array_equal(now, lit):
                break
            lit = now
        left = np.sqrt(left / max(np.square(self._b).sum(), 1e-300))
        return lit, np.stack(irradiance, 1), left


def seen_of_lamp(rest, image, weights, around) -> np.ndarray:
    """(p,) in [0, 1], how much of a lamp each pixel sees: of its ``image`` (p, 3), in what is left for it (p, 3)."""
    power = (weights * np.square(image)).sum(1)
    whole = around @ power
    return np.clip((around @ (weights * image * rest).sum(1)) / np.maximum(whole, 1e-12 * power.max()), 0, 1)
