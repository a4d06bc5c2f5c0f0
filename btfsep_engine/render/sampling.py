# SPDX-License-Identifier: GPL-3.0-or-later
"""Which pixels enter the fit, chosen before a ray is traced.

The rule (figures behind it: docs/results/sampling.md), inside the object's region, whose edge is left out already:

1. Stratified over position and normal: along a space-filling (Morton) curve through six coordinates, place in the
   scene and normal; every stretch of it gives one pixel, at a random place in it.
2. By expected information: stretches are equal in a sum of weights, half of which is even and half the pixel's
   leverage, its share in what all pixels together tell (the sensitivity of a Bayesian D-optimal design; Kiefer and
   Wolfowitz 1960, Chaloner and Verdinelli 1995). Leverage comes from the closed form of unshadowed transport: a
   diffuse part about the normal and a lobe about the mirror direction (Ramamoorthi and Hanrahan 2001). Nothing is
   traced for it.

The fit needs no weights against the choice: it conditions on where the pixels are.
"""

import numpy as np

from btfsep_engine import sh
from btfsep_engine.light.maps import natural_amplitude
from btfsep_engine.linear_algebra import product

NORMAL_WEIGHT = 0.5  # of a normal's difference against a distance in scene radii
CANDIDATES = 1 << 16  # more pixels than these are thinned evenly first
REGION = 1 << 18  # of more pixels than these most are left out before anything is computed at them
LEVERAGE_SHARE = 0.5
LEVERAGE_ORDER = 4
NORMAL_CELLS = 24  # along an edge of the cube of normals, in whose cells leverage is taken to be one number
LOBE_SHARE, LOBE_WIDTH = 0.3, 0.35  # of the reflected light; radians. A mean material: the choice hardly feels them
MISFIT = 0.1  # of the photo, as in a good fit: what leverage is measured against
EVIDENCE = 100  # pixels' worth of independent evidence in a photo, misfit being structured


def spread(points, count: int, *, seed: int = 0) -> np.ndarray:
    """Indices of about ``count`` points spread evenly over the picture.

    Stratified along the Hilbert-like order of a space-filling (Morton) curve: every stretch of the curve gives
    one pixel, at a random place in it.
    """
    return evenly(points.pixels, count, seed=seed)


def evenly(pixels, count: int, *, seed: int = 0) -> np.ndarray:
    """The same of pixels (n, 2), rows and columns."""
    n = len(pixels)
    if count >= n:
        return np.arange(n)
    order = np.argsort(morton(pixels, bits=16), kind="stable")
    return systematic(order, np.ones(n), count, seed=seed)


def thinned(region, most: int, *, seed: int = 0) -> np.ndarray:
    """A region (h, w) bool with every pixel's chance the same and about ``most`` left; as it is if it has no more.

    Of each square of k x k pixels one is looked at, at a random place in it: large photographs cost no more memory
    than small ones in what follows.
    """
    edge = int(np.sqrt(region.sum() / max(most, 1)))
    if edge < 2:
        return region
    h, w = region.shape
    rows, columns = np.mgrid[0:h:edge, 0:w:edge]
    random = np.random.default_rng(seed)
    rows = rows + random.integers(0, edge, rows.shape)
    columns = columns + random.integers(0, edge, columns.shape)
    inside = (rows < h) & (columns < w)
    rows, columns = rows[inside], columns[inside]
    out = np.zeros_like(region)
    out[rows, columns] = region[rows, columns]
    return out if out.any() else region


def choose_pixels(points, count: int, *, seed: int = 0, leverage_share: float = LEVERAGE_SHARE) -> np.ndarray:
    """Indices of ``count`` points, chosen for what they tell of the light.

    Parameters
    ----------
    points : SurfacePoints, n of them
    count : how many, > 0; all of them where there are no more
    leverage_share : of a pixel's weight that is its expected information; 0: every surface patch counts by its pixels

    Returns
    -------
    (min(n, count),) int, ascending, without repetition
    """
    candidates = spread(points, max(CANDIDATES, 2 * count), seed=seed)
    if count >= len(candidates):
        return candidates
    some = points if len(candidates) == len(points) else points.take(candidates)
    weight = np.ones(len(some))
    if leverage_share > 0:
        weight = (1 - leverage_share) + leverage_share * leverage(some.normal, some.to_eye)
    return candidates[systematic(surface_order(some.position, some.normal), weight, count, seed=seed)]


def surface_order(position, normal) -> np.ndarray:
    """An order (n,) in which neighbours are near in place and normal, both (n, 3)."""
    size = max(float(np.ptp(position, axis=0).max()), 1e-300) / 2
    place = np.concatenate([(position - position.min(0)) / size, (normal + 1) * NORMAL_WEIGHT], 1)
    return np.argsort(morton(np.minimum(place * 128, 255).astype(np.int64), bits=8), kind="stable")


def systematic(order, weight, count: int, *, seed: int = 0) -> np.ndarray:
    """One item from each of ``count`` stretches of equal weight along ``order``; heavy items are taken once.

    Parameters
    ----------
    order : (n,) int, a permutation
    weight : (n,) float >= 0, by item: chances of being chosen are in proportion
    count : < n

    Returns
    -------
    (count,) int, ascending, without repetition
    """
    chance = capped_chances(np.asarray(weight, np.float64)[order], count)
    ends = np.cumsum(chance)
    ends *= count / ends[-1]
    at = np.arange(count) + np.random.default_rng(seed).random(count)
    chosen = np.minimum(np.searchsorted(ends, at, side="right"), len(order) - 1)
    # where two stretches meet in one item, the second takes the next that is free
    chosen = np.maximum.accumulate(chosen - np.arange(count)) + np.arange(count)
    over = np.minimum(chosen, len(order) - count + np.arange(count))
    return np.sort(order[over])


def capped_chances(weight, count: int) -> np.ndarray:
    """Chances in proportion to ``weight`` that sum to ``count``, none above 1."""
    chance = np.maximum(weight, 1e-12)
    chance = chance * (count / chance.sum())
    for _ in range(20):
        over = chance >= 1
        if not (chance > 1 + 1e-9).any():
            break
        chance[over] = 1
        rest = chance[~over].sum()
        if rest <= 0:
            break
        chance[~over] *= (count - over.sum()) / rest
    return chance


def leverage(normal, to_eye) -> np.ndarray:
    """What each pixel adds to what all together tell of the light, (n,), mean 1.

    a^T (A^T A / s^2 + P^-1)^-1 a for its row a of cheap basis images, with natural light as the prior P. Found for
    the mean pixel of each cell of normals.

    ``normal``, ``to_eye`` : (n, 3) float, unit
    """
    cell = np.minimum(((normal + 1) * (NORMAL_CELLS / 2)).astype(np.int64), NORMAL_CELLS - 1)
    _, cell, share = np.unique(
        (cell[:, 0] * NORMAL_CELLS + cell[:, 1]) * NORMAL_CELLS + cell[:, 2], return_inverse=True, return_counts=True
    )
    cell, share = cell.reshape(-1), share / len(normal)

    def mean(vectors):
        sums = np.stack([np.bincount(cell, vectors[:, i]) for i in range(3)], 1)
        return sums / np.maximum(np.linalg.norm(sums, axis=1, keepdims=True), 1e-300)

    rows = cheap_basis(mean(normal), mean(to_eye)) * natural_amplitude(LEVERAGE_ORDER)
    rows *= np.sqrt(EVIDENCE) / MISFIT / np.linalg.norm(rows[:, 0] * np.sqrt(share))
    gram = product((rows * share[:, None]).T, rows) + np.eye(rows.shape[1])
    found = np.square(np.linalg.solve(np.linalg.cholesky(gram), rows.T)).sum(0)
    return found[cell] / (found @ share)


def cheap_basis(normal, to_eye) -> np.ndarray:
    """Unshadowed basis images of a diffuse surface with a lobe: (n, terms) float64, first column 1."""
    order = LEVERAGE_ORDER
    l = np.arange(order + 1)
    diffuse = sh.cosine_lobe(order) / np.pi
    lobe = np.exp(-0.5 * l * (l + 1) * LOBE_WIDTH**2)
    mirrored = 2 * (normal * to_eye).sum(1, keepdims=True) * normal - to_eye
    terms = sh.degrees(order)
    return np.sqrt(4 * np.pi) * (
        (1 - LOBE_SHARE) * diffuse[terms] * sh.evaluate(order, normal)
        + LOBE_SHARE * lobe[terms] * sh.evaluate(order, mirrored)
    )


def morton(coordinates, *, bits: int) -> np.ndarray:
    """Interleaved bits of whole coordinates (n, d), each of ``bits`` bits: (n,) int64; d * bits <= 63."""
    columns = np.ascontiguousarray(coordinates.T, np.int64)
    code, d = np.zeros(columns.shape[1], np.int64), len(columns)
    for bit in range(bits):
        for i, column in enumerate(columns):
            code |= ((column >> bit) & 1) << (d * bit + d - 1 - i)
    return code
