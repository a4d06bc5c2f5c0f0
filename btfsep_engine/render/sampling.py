# SPDX-License-Identifier: GPL-3.0-or-later
"""Which pixels enter the fit, chosen before a ray is traced.

The rule (docs/sampling.md has the figures behind it):

1. Away from silhouettes: a pixel near the edge of the object's region, or near a jump of depth inside it, mixes two
   surfaces, and the true (displaced) outline is not the mesh's. Such pixels are left out while enough others remain.
2. Stratified over position and normal: a balanced k-d tree cuts the visible surface into as many equal parts as pixels
   are wanted, by halves along the widest of six coordinates (place in the scene, normal); each part gives one pixel,
   at a random place in it.
3. By expected information: parts are equal in a sum of weights, half of which is even and half the pixel's leverage
   (its share in what all pixels together tell, the D-optimal design's sensitivity; Kiefer and Wolfowitz 1960) on
   coefficients of low order. Leverage comes from the closed form of unshadowed transport: a diffuse part about the
   normal and a lobe about the mirror direction (Ramamoorthi and Hanrahan 2001). Nothing is traced for it.
"""

import numpy as np
from scipy.ndimage import distance_transform_edt

from btfsep_engine import sh
from btfsep_engine.light.natural import natural_prior

MARGIN = 2.0  # pixels kept away from silhouettes; 1 is what a photo's own filter reaches
LEAST_LEFT = 0.5  # of the region: so much is left, or the margin shrinks
JUMP = 3.0  # pixels: how far a surface may be off the plane through its neighbours
NORMAL_WEIGHT = 0.5  # of a normal's difference against a distance in scene radii
CANDIDATES = 8  # per pixel wanted: more cannot be told apart, and a large photo has millions
LEVERAGE_SHARE = 0.5
LEVERAGE_ORDER = 5
LOBE_SHARE = 0.3  # of the reflected light; what the lobe's width is matters little
LOBE_WIDTH = 0.35  # radians
MISFIT = 0.1  # of the photo, as good fits have it: what leverage is measured against


def spread(points, count: int, *, seed: int = 0) -> np.ndarray:
    """Indices of about ``count`` points spread evenly over the picture.

    Stratified along the Hilbert-like order of a space-filling (Morton) curve: every stretch of the curve gives
    one pixel, at a random place in it.
    """
    n = len(points)
    if count >= n:
        return np.arange(n)
    order = np.argsort(_morton(points.pixels[:, 0], points.pixels[:, 1]), kind="stable")
    return systematic(order, np.ones(n), count, seed=seed)


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
    candidates = spread(points, CANDIDATES * count, seed=seed)
    if count >= len(candidates):
        return candidates
    some = points.take(candidates)
    size = np.linalg.norm(some.position - some.position.mean(0), axis=1).max()
    coordinates = np.concatenate([some.position / max(size, 1e-300), some.normal * NORMAL_WEIGHT], 1)
    weight = np.ones(len(some))
    if leverage_share > 0:
        weight = (1 - leverage_share) + leverage_share * leverage(some.normal, some.to_eye)
    return candidates[systematic(tree_order(coordinates, count), weight, count, seed=seed)]


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


def tree_order(coordinates, leaves: int) -> np.ndarray:
    """An order (n,) in which neighbours are near in all coordinates (n, d): the leaves of a balanced k-d tree.

    Every part is halved at the median of its widest coordinate, all parts of a level at once.
    """
    n = len(coordinates)
    order, bounds = np.arange(n), np.array([0, n])
    while len(bounds) - 1 < leaves:
        inside = coordinates[order]
        low, high = (f.reduceat(inside, bounds[:-1], axis=0) for f in (np.minimum, np.maximum))
        widest = (high - low).argmax(1)
        part = np.repeat(np.arange(len(bounds) - 1), np.diff(bounds))
        order = order[np.lexsort((inside[np.arange(n), widest[part]], part))]
        bounds = np.unique(np.concatenate([bounds, (bounds[:-1] + bounds[1:]) // 2]))
    return order


def leverage(normal, to_eye) -> np.ndarray:
    """What each pixel adds to what all together tell of the light, (n,), mean 1.

    a^T (A^T A / s^2 + P^-1)^-1 a for its row a of cheap basis images, with natural light as the prior P.

    Parameters
    ----------
    normal, to_eye : (n, 3) float, unit
    """
    rows = cheap_basis(normal, to_eye) * natural_prior(LEVERAGE_ORDER).deviation
    noise = MISFIT * np.sqrt((rows[:, 0] ** 2).mean()) / natural_prior(LEVERAGE_ORDER).deviation[0]
    gram = rows.T @ rows / max(noise, 1e-300) ** 2 / len(rows) * 100 + np.eye(rows.shape[1])
    found = np.square(np.linalg.solve(np.linalg.cholesky(gram), rows.T)).sum(0)
    return found / max(found.mean(), 1e-300)


def cheap_basis(normal, to_eye) -> np.ndarray:
    """Unshadowed basis images of a diffuse surface with a lobe: (n, terms) float64, first column 1."""
    order = LEVERAGE_ORDER
    l = np.arange(order + 1)
    diffuse = np.array([1, 2 / 3, 1 / 4, 0, -1 / 24, 0, 1 / 64, 0, -1 / 128, 0])[: order + 1]
    lobe = np.exp(-0.5 * l * (l + 1) * LOBE_WIDTH**2)
    mirrored = 2 * (normal * to_eye).sum(1, keepdims=True) * normal - to_eye
    terms = np.repeat(l, 2 * l + 1)
    return np.sqrt(4 * np.pi) * (
        (1 - LOBE_SHARE) * diffuse[terms] * sh.evaluate(order, normal)
        + LOBE_SHARE * lobe[terms] * sh.evaluate(order, mirrored)
    )


def away_from_edges(region, depth, focal: float, *, margin: float = MARGIN) -> np.ndarray:
    """The pixels (h, w) bool of ``region`` that are ``margin`` pixels or more from its edge and from depth's jumps.

    Parameters
    ----------
    region : (h, w) bool
    depth : (h, w) float, along the camera's axis; only read inside the region
    focal : the camera's focal length in pixels
    margin : pixels; it is halved as long as less than `LEAST_LEFT` of the region would be left
    """
    smooth = region & ~depth_jumps(region, depth, focal)
    far = distance_transform_edt(np.pad(smooth, 1))[1:-1, 1:-1]
    while margin >= 1:
        inner = far > margin
        if inner.sum() >= LEAST_LEFT * region.sum():
            return inner
        margin /= 2
    return region


def depth_jumps(region, depth, focal: float) -> np.ndarray:
    """Pixels (h, w) bool where the surface is not smooth.

    1 / depth is an affine function of the pixel on any plane, however slanted: its second difference, in pixels' own
    size at that depth, says how far the surface is off the plane through the two neighbours.
    """
    inverse = np.where(region, 1 / np.maximum(np.where(region, depth, 1), 1e-300), np.nan)
    out = np.zeros(region.shape, bool)
    for axis in (0, 1):
        x, jump = np.moveaxis(inverse, axis, 0), np.moveaxis(out, axis, 0)
        bend = np.abs(x[:-2] - 2 * x[1:-1] + x[2:]) / x[1:-1] * focal
        jump[1:-1] |= np.nan_to_num(bend, nan=0.0) > JUMP  # beside the region: its edge is seen to already
    return out


def _morton(row, column):
    """Interleaved bits of two 16-bit coordinates."""
    code = np.zeros(len(row), np.int64)
    for bit in range(16):
        code |= ((column.astype(np.int64) >> bit) & 1) << (2 * bit)
        code |= ((row.astype(np.int64) >> bit) & 1) << (2 * bit + 1)
    return code
