# SPDX-License-Identifier: GPL-3.0-or-later
"""Pixels of two kinds: those that a lamp lights and those in a shadow of it; those of one paint and those of another;
those of the objects and those of something else.

With s in {0, 1} of each pixel, what a photograph shows is in each channel either of

    b = A x + E s R        R: the image of a beam of irradiance 1, made by itself, with the objects' own shadows
    b = (1 + (r - 1) s) A x                  r: how much more one paint reflects than the other

with x smooth light of a low order and a Gaussian prior. With s known, x is linear, and E and r follow from it; with
these known, a pixel is of the kind that explains it and those around it better. Both are found by turns, as mixtures of
regressions are by classification (Celeux and Govaert 1992): the first of many lamps at once. Of something else nothing
is known: pixels are of it where those around them, too, are far from what light makes of the others.
"""

import warnings
from functools import cached_property

import numpy as np
from scipy import sparse
from scipy.cluster.vq import kmeans2
from scipy.spatial import cKDTree

from btfsep_engine import sh
from btfsep_engine.linear_algebra import product

ORDER = 5  # of the light
NORMAL = 1.4826  # standard deviation over the median absolute deviation
EVEN, FALLS = 10.0, 1.2  # deviation of its mean over that of order 1; the others' fall by this power of the order
NOISE = 0.02  # of the photo's mean: what a pixel may differ by, for the prior
TURNS = 15
AROUND, FARTHEST = 1.2, 3.0  # pixels' spacings: deviation of neighbours that go together, and how far they reach
FINE, FINEST = 0.6, 1.8  # the same where parts of a pixel may be of either kind
HOLDS = 0.01  # of a lamp's own power: what other light does not explain has to be as much
# Of what one light of all leaves over: where two kinds leave more, they are none. Of 18 stained things that no shadow
# fell on a lamp leaves 0.74 to 0.83, of 32 in a shadow 20 that were rightly found 0.3 to 0.68.
HOPEFUL = 0.7
ROUNDING = 1e-6  # of a share
# Of the spread of what light explains: pixels farther off are apart; the same where that finds nothing, as among
# shadows of what is apart; and of the photo's mean.
OFF, NEARER_OFF, LEAST_OFF = 3.5, 2.5, 0.05
MOST = 0.5  # of the pixels, that are apart
GROUPS, FEW, MANY = (2, 3, 4), 0.01, 0.6  # of pixels that differ alike; the least and the most of them in one
DIM, NIGHT, UNLIKE = 1e-3, 0.05, 3.0  # least radiance and light, over their mean; most of a logarithm
DARKEST = 0.02  # of the other paint's reflectance


def neighbours(pixels, *, deviation: float = AROUND, farthest: float = FARTHEST) -> sparse.csr_array:
    """(p, p), the mean over what lies around each of the pixels (p, 2), in units of their spacing."""
    pixels = np.asarray(pixels, np.float64)
    tree = cKDTree(pixels)
    spacing = float(np.median(tree.query(pixels, [min(5, len(pixels))])[0])) or 1.0
    near = tree.sparse_distance_matrix(tree, farthest * spacing, output_type="coo_matrix")
    weight = np.exp(-0.5 * np.square(near.data / (deviation * spacing)))
    out = sparse.csr_array((weight, (near.row, near.col)), shape=near.shape) + sparse.eye_array(len(pixels))
    return sparse.csr_array(sparse.diags_array(1 / np.asarray(out.sum(axis=1)).ravel()) @ out)


class TwoKinds:
    """A photograph's pixels, made ready to be told apart.

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
        self._rows = []
        for c in range(3):
            rows = np.asarray(basis[:, :terms, c], np.float64)
            self._rows.append(rows * (self._root[:, c, None] * prior / max(float(rows[:, 0].mean()), 1e-300)))

    @cached_property
    def _axes(self) -> list:
        return [np.linalg.svd(rows, full_matrices=False)[:2] for rows in self._rows]

    @cached_property
    def _left(self) -> np.ndarray:
        return np.stack([self._beside(c, self._b[:, c]) for c in range(3)], 1)

    @property
    def brighter(self) -> np.ndarray:
        """(p,) bool, the pixels that are brighter, with those around them, than one light makes them all."""
        return self._around @ self._left.sum(1) > 0

    @property
    def left(self) -> float:
        """What one light of all leaves over, relative."""
        return float(self._share(np.square(self._left).sum()))

    def _beside(self, c: int, values):
        """What is left of values (p, …) of a channel beside one light of all."""
        u, size = self._axes[c]
        part = size**2 / (size**2 + NOISE**2 * len(u))
        along = product(u.T, values)
        return values - product(u, part[:, None] * along if along.ndim > 1 else part * along)

    def _share(self, left) -> np.ndarray:
        return np.sqrt(left / max(float(np.square(self._b).sum()), 1e-300))

    def lit(self, images, start, turns: int = TURNS):
        """Which pixels each of n lamps lights, beside light that reaches all.

        Parameters
        ----------
        images : (p, n, 3), R of each
        start : (p,) or (p, n) bool
        turns : the most of them

        Returns
        -------
        lit (p, n) bool; left (n,), what is left over then, relative
        """
        lit = np.broadcast_to(np.reshape(start, (len(self._b), -1)), images.shape[:2])
        images = [self._root[:, c, None] * images[:, :, c] / self._unit[c] for c in range(3)]
        for _ in range(turns):
            gain, left = 0.0, 0.0
            for c, image in enumerate(images):
                column = lit * image
                beside = self._beside(c, column)
                power = np.square(beside).sum(0) + HOLDS * np.square(column).sum(0)
                e = np.maximum((beside * self._left[:, c, None]).sum(0) / np.maximum(power, 1e-300), 0)
                rest, own = self._left[:, c, None] - e * beside, e * image
                gain += own * (2 * (rest + lit * own) - own)
                left += np.square(rest).sum(0)
            now = self._around @ gain > 0
            if np.array_equal(now, lit):
                break
            lit = now
        return lit, self._share(left)

    def painted(self, start):
        """Which pixels are of the other of two paints, (p,) bool, and what is left over then, relative.

        ``start`` : (p,) bool
        """
        other, best, least = start, start, np.inf
        more = np.ones(3)
        for _ in range(TURNS):
            light = np.stack([self._under(c, 1 + (more[c] - 1) * other) for c in range(3)], 1)
            mean = np.square(light[other]).sum(0)
            more = np.maximum((light * self._b)[other].sum(0) / np.maximum(mean, 1e-300), DARKEST)
            one, two = np.square(self._b - light).sum(1), np.square(self._b - more * light).sum(1)
            left = float(np.where(other, two, one).sum())
            if left < least:
                best, least = other, left
            now = self._around @ (one - two) > 0
            if np.array_equal(now, other) or now.all() or not now.any():
                break
            other = now
        return best, float(self._share(least))

    def unlike(self):
        """Pixels (p,) bool that differ alike, with those around them, from what one light makes of all: some groups."""
        light = np.stack([self._under(c, np.ones(len(self._b))) for c in range(3)], 1)
        seen = np.log(np.maximum(self._b, DIM))
        colour = seen - seen.mean(1, keepdims=True)
        unlike = np.clip(np.hstack([seen - np.log(np.maximum(light, NIGHT)), 2 * colour]), -UNLIKE, UNLIKE)
        unlike = self._around @ unlike
        for groups in GROUPS:
            if len(unlike) > groups:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")  # of an empty group, which is left out below
                    of = kmeans2(unlike, groups, minit="++", seed=0)[1]
                each = [of == i for i in range(groups)]
                yield from (group for group in each if FEW < group.mean() < MANY)

    def apart(self, start, off: float = OFF):
        """Which pixels show something else than what one light makes of the others, (p,) bool; and what that leaves
        over of these, relative: inf where too many are apart.

        ``start`` : (p,) bool; ``off`` : as `OFF`
        """
        apart = start
        for _ in range(TURNS):
            light = np.stack([self._under(c, ~apart) for c in range(3)], 1)
            left = np.square(self._b - light).sum(1)
            around = np.sqrt(np.maximum(self._around @ left, 0) / 3)
            if apart.all():
                return apart, np.inf
            now = around > max(off * NORMAL * float(np.median(around[~apart])), LEAST_OFF)
            if now.mean() > MOST:
                return now, np.inf
            if np.array_equal(now, apart):
                break
            apart = now
        return apart, float(self._share(left[~apart].sum()))

    def _under(self, c: int, factor) -> np.ndarray:
        """(p,), what light makes of a channel where pixels reflect ``factor`` (p,) times as much, less that factor."""
        rows = self._rows[c] * factor[:, None]
        gram = product(rows.T, rows) + NOISE**2 * len(rows) * np.eye(rows.shape[1])
        return product(self._rows[c], np.linalg.solve(gram, product(rows.T, self._b[:, c])))


def part_of(rest, image, weights, around) -> tuple[np.ndarray, np.ndarray]:
    """(p,) in [0, 1], how much of an ``image`` (p, 3) pixels have, with those around them, in what is left for it,
    ``rest`` (p, 3); and (p,), how much of the image they show."""
    power = (weights * np.square(image)).sum(1)
    own = (weights * image * rest).sum(1)
    return np.clip((around @ own) / np.maximum(around @ power, 1e-12 * max(float(power.max()), 1e-300)), 0, 1), power


def share_of(rest, image, weights, around) -> np.ndarray:
    """(p,) in [0, 1], how much of an ``image`` (p, 3) each pixel has in what is left for it, ``rest`` (p, 3).

    Away from edges all of it or nothing: a part of it everywhere would explain anything.
    """
    share, _ = part_of(rest, image, weights, around)
    whole = (around @ share > 0.5).astype(np.float64)
    return np.where(edges_of(whole, around) > ROUNDING, share, whole)


def in_between(rest, image, weights, around) -> float:
    """How far from all of it or nothing pixels away from edges are, if they may have any part: 0 to 0.5, a mean by how
    much of the image they show."""
    part, power = part_of(rest, image, weights, around)
    away = edges_of((around @ part > 0.5).astype(np.float64), around) <= ROUNDING
    shown = power * away
    return float((shown * np.minimum(part, 1 - part)).sum() / max(float(shown.sum()), 1e-300))


def edges_of(share, around) -> np.ndarray:
    """(p,) >= 0, how much a ``share`` (p,) differs around each pixel: a standard deviation."""
    mean = around @ share
    return np.sqrt(np.maximum(around @ np.square(share) - np.square(mean), 0))
