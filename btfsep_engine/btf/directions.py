# SPDX-License-Identifier: GPL-3.0-or-later
"""Direction lists of the databases, and interpolation between tabulated directions.

Interpolation is that of Bonn: a parabolic map of the hemisphere to the disk, Delaunay triangles, barycentric
weights. Beyond the outermost ring (75 degrees) the ring's value is held outwards; since the tables
are without the cosine, the transport's own cos(theta_i) takes the band smoothly to zero at the horizon. The band is
26 % of the solid angle and 6.7 % of the projected one, and holding conserves a Lambertian surface's energy exactly
(fading to 0 at the horizon, as at Bonn, does not).
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.sparse import csr_array
from scipy.spatial import ConvexHull, Delaunay, QhullError, cKDTree

from btfsep_engine.conventions import local_direction

UBO2014_RINGS = (
    (0, 11, 23.5, 30, 37.5, 45, 52.5, 60, 67.5, 75),
    (1, 6, 12, 12, 12, 18, 18, 24, 24, 24),
    (0, 15, 0, 15, 0, 0, 7.5, 0, 7.5, 0),
)
UBO2003_RINGS = ((0, 15, 30, 45, 60, 75), (1, 6, 12, 18, 20, 24), (0, 0, 0, 0, 0, 0))  # ATRIUM's and UTIA's, too
GRID = 512  # cells of the look-up grid over the parabolic square [-1, 1]^2


def ring_angles(rings) -> np.ndarray:
    """(n, 2) float64, theta and phi in radians, ring by ring, phi ascending from the offset, wrapped to (-pi, pi]."""
    angles = []
    for theta, count, offset in zip(*rings, strict=True):
        for i in range(count):
            phi = offset + 360.0 * i / count
            angles.append((theta, phi - 360.0 if phi > 180.0 else phi))
    return np.radians(np.array(angles))


def ubo2014_angles() -> np.ndarray:
    """The 151 directions of UBO2014: (151, 2) float64, theta and phi in radians, phi wrapped to (-pi, pi]."""
    return ring_angles(UBO2014_RINGS)


def ubo2014_directions() -> np.ndarray:
    """The 151 directions of UBO2014 as (151, 3) float64 unit vectors."""
    return local_direction(*ubo2014_angles().T)


def ubo2003_directions() -> np.ndarray:
    """The 81 directions of UBO2003, ATRIUM and UTIA as (81, 3) float64 unit vectors."""
    return local_direction(*ring_angles(UBO2003_RINGS).T)


def parabolic(directions) -> np.ndarray:
    """(..., 2): the hemisphere mapped to the unit disk, (x, y) / (1 + z)."""
    d = np.asarray(directions, np.float64)
    return d[..., :2] / (1 + np.maximum(d[..., 2:3], 0))


@dataclass(frozen=True)
class Interpolator:
    """Barycentric interpolation on the hemisphere, by a grid of triangle numbers.

    Attributes
    ----------
    triangles : (t, 3) int32, indices into the direction list
    affine : (t, 3, 3) float64, weights = affine @ (x, y, 1) at parabolic (x, y)
    grid : (GRID, GRID) int32, triangle at each cell centre, [row y, column x]; they cover the whole disk
    count : of directions in the list
    """

    triangles: np.ndarray
    affine: np.ndarray
    grid: np.ndarray
    count: int

    def weights(self, directions):
        """Taps of ``directions : (n, 3) float, local, upper hemisphere``.

        Returns
        -------
        indices : (n, 3) int32
        weights : (n, 3) float64, >= 0, sum 1
        """
        xy = parabolic(directions)
        cell = np.clip(((xy + 1) * (GRID / 2)).astype(np.int64), 0, GRID - 1)
        triangle = self.grid[cell[..., 1], cell[..., 0]]
        affine = self.affine[triangle]
        w = affine[..., 0] * xy[..., None, 0] + affine[..., 1] * xy[..., None, 1] + affine[..., 2]
        w = np.maximum(w, 0)
        return self.triangles[triangle], w / w.sum(-1, keepdims=True)

    def hats(self, directions) -> csr_array:
        """(count, n) float64: the weight of each of the list's directions at each of ``directions``."""
        index, share = self.weights(directions)
        at = index.ravel(), np.repeat(np.arange(len(directions)), 3)
        return csr_array((share.ravel(), at), (self.count, len(directions)))


@lru_cache(maxsize=16)
def _interpolator(key: bytes, count: int) -> Interpolator:
    points = parabolic(np.frombuffer(key, np.float64).reshape(count, 3))
    centres = (np.arange(GRID) + 0.5) * (2 / GRID) - 1
    x, y = np.meshgrid(centres, centres)
    none = np.zeros((0, 3), np.int32)
    try:
        simplices, hull = (Delaunay(points).simplices, ConvexHull(points)) if count >= 3 else (none, None)
    except QhullError:  # all on a line
        simplices, hull = none, None
    corners = np.concatenate([points[simplices], np.ones((len(simplices), 3, 1))], -1)
    regular = np.abs(np.linalg.det(corners)) > 1e-9  # slivers on the hull
    if not regular.any():  # no triangle: the nearest direction
        affine = np.broadcast_to([[0, 0, 1.0], [0, 0, 0], [0, 0, 0]], (count, 3, 3))
        triangles = np.repeat(np.arange(count, dtype=np.int32)[:, None], 3, 1)
        nearest = cKDTree(points).query(np.stack([x, y], -1))[1]
        return Interpolator(triangles, affine, nearest.astype(np.int32), count)
    vertices, simplices, held = _with_band(points, simplices[regular], hull)
    corners = np.concatenate([vertices[simplices], np.ones((len(simplices), 3, 1))], -1)
    affine = np.linalg.inv(corners).transpose(0, 2, 1)
    # the triangle whose smallest barycentric weight is largest contains the cell's centre
    best = np.full((GRID, GRID), -np.inf)
    grid = np.zeros((GRID, GRID), np.int32)
    low = np.clip(np.floor((vertices[simplices].min(1) + 1) * (GRID / 2)).astype(int) - 1, 0, GRID)
    high = np.clip(np.ceil((vertices[simplices].max(1) + 1) * (GRID / 2)).astype(int) + 1, 0, GRID)
    for number, a in enumerate(affine):
        box = np.s_[low[number, 1] : high[number, 1], low[number, 0] : high[number, 0]]
        smallest = (a[:, 0, None, None] * x[box] + a[:, 1, None, None] * y[box] + a[:, 2, None, None]).min(0)
        better = smallest > best[box]
        best[box][better] = smallest[better]
        grid[box][better] = number
    return Interpolator(held[simplices].astype(np.int32), affine, grid, count)


def _with_band(points, simplices, hull):
    """Adds the band out to the rim of the disk: layers of the hull, blown up about its centre.

    A vertex of a layer stands for the vertex of the hull that it was; so the hull's values are held outwards.

    Gives vertices (m, 2), triangles (t, 3) of them, and (m,) which of ``points`` each vertex stands for.
    """
    ring = hull.vertices  # counter-clockwise
    centre = points[ring].mean(0)
    inside = -(hull.equations[:, :2] @ centre + hull.equations[:, 2]).max()  # distance to the nearest edge
    scale = max(1.01 * (1 + np.hypot(*centre)) / max(inside, 1e-3), 1.0)
    layers = int(np.clip(np.ceil(np.log(scale) / np.log(1.12)), 1, 24))  # thin ones: a quad is nearly symmetric
    vertices, held, triangles = [points], [np.arange(len(points))], [simplices]
    inner, n = ring, len(ring)
    for layer in range(1, layers + 1):
        vertices.append(centre + (points[ring] - centre) * scale ** (layer / layers))
        held.append(ring)
        outer = len(points) + (layer - 1) * n + np.arange(n)
        a, b, c, d = inner, np.roll(inner, -1), np.roll(outer, -1), outer
        split = [(a, b, c), (a, c, d)] if layer % 2 else [(a, b, d), (b, c, d)]
        triangles += [np.stack(t, 1) for t in split]
        inner = outer
    vertices, triangles = np.concatenate(vertices), np.concatenate(triangles)
    edges = vertices[triangles[:, 1:]] - vertices[triangles[:, :1]]
    return vertices, triangles[np.abs(np.linalg.det(edges)) > 1e-12], np.concatenate(held)


def interpolator(directions) -> Interpolator:
    """The :class:`Interpolator` of a direction list (n, 3); made once per list."""
    d = np.ascontiguousarray(directions, np.float64)
    return _interpolator(d.tobytes(), len(d))


def hemisphere_quadrature(rings: int = 96):
    """Nodes (n, 3) and weights (n,) of the upper hemisphere, n = 2 rings^2: Gauss and Legendre's in z, uniform in phi.

    Exact for spherical harmonics, and for their products with z, below order ``rings``.
    """
    x, w = np.polynomial.legendre.leggauss(rings)
    z, w = (x + 1) / 2, w / 2
    azimuth = (np.arange(2 * rings) + 0.5) * (np.pi / rings)
    r = np.sqrt(1 - z * z)[:, None]
    nodes = np.stack([r * np.cos(azimuth), r * np.sin(azimuth), np.repeat(z[:, None], 2 * rings, 1)], -1)
    return nodes.reshape(-1, 3), np.repeat(w * (np.pi / rings), 2 * rings)


def cosine_weights(directions) -> np.ndarray:
    """(n,) float64: sum(w * f) is the integral of f(omega) cos(theta) over the hemisphere, for f interpolated from
    ``directions : (n, 3)`` as :func:`interpolator` does (and held beyond the outermost ring). The sum is pi.
    """
    d = np.ascontiguousarray(directions, np.float64)
    return _cosine_weights(d.tobytes(), len(d)).copy()


@lru_cache(maxsize=16)
def _cosine_weights(key: bytes, count: int) -> np.ndarray:
    directions = np.frombuffer(key, np.float64).reshape(count, 3)
    return light_projection(directions, lambda nodes: np.ones((len(nodes), 1)))[:, 0]


def light_projection(directions, functions) -> np.ndarray:
    """(n, m) float64: ``q`` such that ``f @ q`` are the integrals of f(omega) g_j(omega) cos(theta) over the hemisphere
    for f interpolated from ``directions : (n, 3)``, held beyond the outermost ring.

    ``functions`` : of (p, 3) directions, gives (p, m)
    """
    nodes, weights = hemisphere_quadrature()
    return interpolator(directions).hats(nodes) @ (functions(nodes) * (weights * nodes[:, 2])[:, None])
