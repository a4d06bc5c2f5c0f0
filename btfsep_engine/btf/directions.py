# SPDX-License-Identifier: GPL-3.0-or-later
"""Direction lists of the databases, and interpolation between tabulated directions.

Interpolation is that of Bonn: a parabolic map of the hemisphere to the disk, Delaunay triangles, barycentric
weights. Beyond the outermost ring (75 degrees) the nearest tabulated value is held; since the tables are
without the cosine, the transport's own cos(theta_i) takes the band smoothly to zero at the horizon.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.spatial import Delaunay

from btfsep_engine.conventions import fibonacci_sphere, local_direction

UBO2014_RINGS = (
    (0, 11, 23.5, 30, 37.5, 45, 52.5, 60, 67.5, 75),
    (1, 6, 12, 12, 12, 18, 18, 24, 24, 24),
    (0, 15, 0, 15, 0, 0, 7.5, 0, 7.5, 0),
)
GRID = 512  # cells of the look-up grid over the parabolic square [-1, 1]^2


def ubo2014_angles() -> np.ndarray:
    """The 151 directions of UBO2014: (151, 2) float64, theta and phi in radians, phi wrapped to (-pi, pi]."""
    angles = []
    for theta, count, offset in zip(*UBO2014_RINGS, strict=True):
        for i in range(count):
            phi = offset + 360.0 * i / count
            angles.append((theta, phi - 360.0 if phi > 180.0 else phi))
    return np.radians(np.array(angles))


def ubo2014_directions() -> np.ndarray:
    """The 151 directions of UBO2014 as (151, 3) float64 unit vectors."""
    theta, phi = ubo2014_angles().T
    return local_direction(theta, phi)


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
    grid : (GRID, GRID) int32, triangle at each cell centre, [row y, column x]; outside the hull the nearest
    """

    triangles: np.ndarray
    affine: np.ndarray
    grid: np.ndarray

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


@lru_cache(maxsize=16)
def _interpolator(key: bytes, count: int) -> Interpolator:
    points = parabolic(np.frombuffer(key, np.float64).reshape(count, 3))
    if count < 3:  # one direction: constant
        affine = np.array([[[0, 0, 1.0], [0, 0, 0], [0, 0, 0]]])
        return Interpolator(np.zeros((1, 3), np.int32), affine, np.zeros((GRID, GRID), np.int32))
    mesh = Delaunay(points)
    corners = np.concatenate([points[mesh.simplices], np.ones((len(mesh.simplices), 3, 1))], -1)
    regular = np.abs(np.linalg.det(corners)) > 1e-9  # slivers on the hull
    triangles = mesh.simplices[regular].astype(np.int32)
    affine = np.linalg.inv(corners[regular]).transpose(0, 2, 1)
    centres = (np.arange(GRID) + 0.5) * (2 / GRID) - 1
    x, y = np.meshgrid(centres, centres)
    # the triangle whose smallest barycentric weight is largest: the containing one, or the nearest outside
    best = np.full((GRID, GRID), -np.inf)
    grid = np.zeros((GRID, GRID), np.int32)
    for number, a in enumerate(affine):
        smallest = (a[:, 0, None, None] * x + a[:, 1, None, None] * y + a[:, 2, None, None]).min(0)
        better = smallest > best
        best[better] = smallest[better]
        grid[better] = number
    return Interpolator(triangles, affine, grid)


def interpolator(directions) -> Interpolator:
    """The :class:`Interpolator` of a direction list (n, 3); made once per list."""
    d = np.ascontiguousarray(directions, np.float64)
    return _interpolator(d.tobytes(), len(d))


def cosine_weights(directions, count: int = 20000) -> np.ndarray:
    """(n,) float64: sum(w * f) is the integral of f(omega) cos(theta) over the hemisphere, for f interpolated from
    ``directions : (n, 3)`` as :func:`interpolator` does (and held beyond the outermost ring). The sum is pi.
    """
    sphere = fibonacci_sphere(2 * count)
    upper = sphere[sphere[:, 2] > 0]
    index, w = interpolator(directions).weights(upper)
    total = np.zeros(len(directions))
    np.add.at(total, index, w * (upper[:, 2:] * (2 * np.pi / len(upper))))
    return total * (np.pi / total.sum())
