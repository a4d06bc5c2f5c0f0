# SPDX-License-Identifier: GPL-3.0-or-later
"""Light that is in a texture: what a scan's photographs had of it, base colour times irradiance.

The image of base colours that comes with a scan is put together of photographs, and few of them are de-lit. On the
surface it is a picture of the object from all sides under the light of that day, T = rho E. What paint does to it and
what light does are told apart as Retinex does (Land and McCann 1971), by differences between neighbours: those of paint
are large and seldom, or go with nothing; those of light are many and go by the normals and by what each place sees of
the sky, which the geometry says. So with i, j neighbours, A the images of the spherical harmonics,

    log T_i - log T_j = log (A x)_i - log (A x)_j + what is paint's,

and x is found by weights that fall off as Cauchy's law has it. Places that do not see the sky see the object itself.
Whether there is any light in it, others than the neighbours that it was found by say: the texture is cut into pieces.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from btfsep_engine import sh
from btfsep_engine.conventions import REC709_LUMINANCE, luminance
from btfsep_engine.fit.robust import NORMAL
from btfsep_engine.linear_algebra import product

NEIGHBOURS = 6
ASIDE = 0.05  # a normal's difference over that of places, as a part of the object's size
PAINT = 0.1  # difference of the colours' logarithms, brightness left out, that halves what neighbours count
DARKEST, BRIGHTEST = 0.004, 0.98  # of base colours: below and above, codes are clipped
PIECES, FOLDS = 16, 4  # of the surface
OF_DEGREE = 0.1  # times its degree squared: the prior's precision of a coefficient, over the first
# Standard errors. Of the clean textures of 48 plates all have -0.2 and less; of 84 on six meshes (noise, stripes,
# pieces, five measured ones) one has 3.0, the others 0.6 and less; but what goes by the shape as light does (dirt in
# hollows, a colour from light to dark over something round) up to 40. Of 64 scans with light 61 have 2.5 and more
SURELY = 2.5
STEPS, SETTLED, LONGEST = 20, 1e-3, 0.3  # of a coefficient
LEAST = 0.05  # of even light: of irradiance, and (logarithms) of what neighbours differ by
FINEST = 1e-2  # logarithm: what base colours of 8 bits, averaged, differ by
ONE_COLOUR = 1e-6  # of what pairs may count that differ by rounding alone


@dataclass(frozen=True)
class TextureLight:
    """What a texture has of light at n places.

    Attributes
    ----------
    logarithm : (n, 3), of the irradiance of each channel, whose mean is 1
    surely : how many standard errors of it neighbours explain by it that it was not found by
    share : how much of what they vary
    """

    logarithm: np.ndarray
    surely: float
    share: float

    @property
    def contrast(self) -> float:
        """Standard deviation of the logarithm of its brightness."""
        return float((self.logarithm @ REC709_LUMINANCE).std())


@dataclass(frozen=True)
class Neighbours:
    """Pairs (m, 2) of places that lie side by side, what each counts (m,), and the piece of the first (m,)."""

    pairs: np.ndarray
    weight: np.ndarray
    piece: np.ndarray

    def between(self, values) -> np.ndarray:
        """(m, …), differences of values (n, …)."""
        return values[self.pairs[:, 0]] - values[self.pairs[:, 1]]


def neighbours(position, normal, base_color) -> Neighbours:
    """Pairs of places whose colours are not clipped, and nearly the same but for brightness.

    ``position``, ``normal`` : (n, 3); ``base_color`` : (n, 3), linear, in [0, 1]
    """
    size = max(float(np.linalg.norm(np.ptp(position, axis=0))), 1e-300)
    feature = np.concatenate([position / size, ASIDE * normal], 1)
    count = min(NEIGHBOURS + 1, len(feature))
    others = cKDTree(feature).query(feature, k=count)[1].reshape(len(feature), count)[:, 1:]
    each = np.stack([np.repeat(np.arange(len(feature)), count - 1), others.ravel()], 1)
    pairs = np.unique(np.sort(each, axis=1), axis=0)
    known = (base_color.min(1) > DARKEST) & (base_color.max(1) < BRIGHTEST)
    pairs = pairs[known[pairs].all(1) & (pairs[:, 0] != pairs[:, 1])]
    hue = np.log(np.maximum(base_color, DARKEST))
    hue -= hue.mean(1, keepdims=True)
    apart = np.linalg.norm(hue[pairs[:, 0]] - hue[pairs[:, 1]], axis=1)
    middles = position[np.random.default_rng(0).choice(len(position), min(PIECES, len(position)), replace=False)]
    return Neighbours(pairs, 1 / (1 + np.square(apart / PAINT)), cKDTree(middles).query(position)[1][pairs[:, 0]])


def texture_light(base_color, images, closed, beside: Neighbours) -> TextureLight | None:
    """The light in a texture; None where its neighbours do not say that there is any.

    Parameters
    ----------
    base_color : (n, 3), linear, in [0, 1]
    images : (n, terms), the irradiance by each spherical harmonic
    closed : (n,), how much of what a place looks at, by the cosine, is the object itself
    """
    brightness = luminance(base_color)
    usual = np.median(images[:, 0])
    if not usual > 0:  # most places see nothing of the sky, as those of walls within walls
        return None
    a = images / usual
    a[:, 0] += float(np.mean(brightness)) * closed  # the object is lit as places are in the mean
    if len(beside.pairs) < 2 * a.shape[1]:
        return None
    grey = np.log(np.maximum(brightness, DARKEST))
    share, surely = _explained(grey, a, beside)
    if surely < SURELY:
        return None
    x = _fitted(grey, a, beside)
    channels = np.log(np.maximum(base_color, DARKEST)).T
    each = np.stack([_logarithm(a, _fitted(channel, a, beside, start=x)) for channel in channels], 1)
    return TextureLight(each - np.log(np.exp(each).mean(0)), surely, share)


def _explained(grey, a, beside: Neighbours) -> tuple[float, float]:
    """How much of what neighbours vary light explains that was found by others, and that over its standard error.

    The error by leaving out one piece of the surface after the other (the jackknife).
    """
    before, after = np.zeros(PIECES), np.zeros(PIECES)
    told = beside.between(grey)
    for k in range(FOLDS):
        mine = beside.piece % FOLDS == k
        lit = beside.between(_logarithm(a, _fitted(grey, a, beside, used=~mine)))
        spread = _spread(told[~mine])
        for out, left in ((before, told), (after, told - lit)):
            lost = beside.weight * np.log1p(np.square(left / spread))
            out += np.bincount(beside.piece[mine], lost[mine], PIECES)
    if before.sum() < ONE_COLOUR * beside.weight.sum():
        return 0.0, 0.0
    without = 1 - (after.sum() - after) / np.maximum(before.sum() - before, 1e-300)
    share = 1 - after.sum() / max(before.sum(), 1e-300)
    error = np.sqrt((PIECES - 1) * np.square(without - without.mean()).mean())
    return float(share), float(share / max(error, 1e-300))


def _spread(differences) -> float:
    return max(NORMAL * float(np.median(np.abs(differences))), FINEST)


def _logarithm(a, x) -> np.ndarray:
    """log (A x), (n,), of light that is never darker than `LEAST` of even light."""
    return np.log(np.maximum(a @ x, LEAST * np.maximum(a[:, 0], LEAST)))


def _fitted(seen, a, beside: Neighbours, *, used=None, start=None) -> np.ndarray:
    """x (terms,), its first 1, by Gauss and Newton with Cauchy's weights."""
    x = np.eye(1, a.shape[1])[0] if start is None else start.copy()
    prior = OF_DEGREE * np.square(sh.degrees(sh.order_of(a.shape[1]))[1:].astype(float))
    told = beside.between(seen)
    weight = beside.weight if used is None else beside.weight * used
    spread = _spread(told[weight > 0])
    for _ in range(STEPS):
        lit = np.maximum(a @ x, LEAST * np.maximum(a[:, 0], LEAST))
        slopes = beside.between(a[:, 1:] / lit[:, None]) / spread
        left = (told - beside.between(np.log(lit))) / spread
        own = weight / (1 + np.square(left))
        weighted = (slopes * own[:, None]).T
        gram, goal = product(weighted, slopes), weighted @ left
        step = np.linalg.solve(gram + np.diag(prior), goal - prior * x[1:])
        x[1:] += np.clip(step, -LONGEST, LONGEST)
        if np.abs(step).max() < SETTLED:
            break
    return x
