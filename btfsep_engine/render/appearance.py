# SPDX-License-Identifier: GPL-3.0-or-later
"""A tabulated material at surface points: texel look-up and view interpolation.

The view and the texel of a pixel are fixed, so both are interpolated once per pixel, into the pixel's own
table over the light list; a light direction then costs three taps, whatever the number of components.
"""

import numpy as np

from btfsep_engine.btf.directions import GRID, interpolator
from btfsep_engine.btf.model import Tabulated
from btfsep_engine.render.surface import SurfacePoints
from btfsep_engine.render.tracer import Tracer


def texel_pyramid(texels) -> list[np.ndarray]:
    """Mip levels of a periodic (h, w, k) spatial factor. The BTF is linear in it: the mean of texels is exact."""
    levels = [np.asarray(texels, np.float32)]
    while max(levels[-1].shape[:2]) > 1:
        level = levels[-1]
        h, w = (max(1, s // 2) for s in level.shape[:2])
        rows = np.linspace(0, level.shape[0], h + 1).astype(int)
        columns = np.linspace(0, level.shape[1], w + 1).astype(int)
        summed = np.add.reduceat(np.add.reduceat(level, rows[:-1], 0), columns[:-1], 1)
        levels.append(summed / (np.diff(rows)[:, None, None] * np.diff(columns)[None, :, None]))
    return levels


def _bilinear(level, uv):
    """Periodic bilinear look-up of (h, w, k) at texture coordinates (n, 2), 1 being the whole tile."""
    h, w = level.shape[:2]
    x, y = uv[:, 0] * w - 0.5, uv[:, 1] * h - 0.5
    x0, y0 = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
    fx, fy = (x - x0).astype(np.float32)[:, None], (y - y0).astype(np.float32)[:, None]
    x0, y0, x1, y1 = x0 % w, y0 % h, (x0 + 1) % w, (y0 + 1) % h
    return (level[y0, x0] * (1 - fx) + level[y0, x1] * fx) * (1 - fy) + (
        level[y1, x0] * (1 - fx) + level[y1, x1] * fx
    ) * fy


def spatial_factors(material: Tabulated, uv, footprint) -> np.ndarray:
    """Filtered spatial factors.

    Parameters
    ----------
    material : Tabulated
    uv : (n, 2) float, millimetres
    footprint : (n,) float, millimetres that a pixel covers

    Returns
    -------
    (n, k) float32
    """
    height, width = material.texels.shape[:2]
    tile = np.array([width, height]) * material.texel_mm
    levels = texel_pyramid(material.texels)
    level = np.clip(np.log2(np.maximum(footprint, 1e-9) / material.texel_mm), 0, len(levels) - 1)
    low = np.minimum(np.floor(level).astype(int), max(len(levels) - 2, 0))
    fraction = (level - low).astype(np.float32)[:, None]
    out = np.empty((len(uv), material.texels.shape[2]), np.float32)
    for number in np.unique(low):
        chosen = low == number
        at, f = uv[chosen] / tile, fraction[chosen]
        upper = levels[min(number + 1, len(levels) - 1)]
        out[chosen] = _bilinear(levels[number], at) * (1 - f) + _bilinear(upper, at) * f
    return out


def to_local(points: SurfacePoints, directions) -> np.ndarray:
    """World directions (n, 3), one for each point, in the points' local frames."""
    return np.stack([(directions * axis).sum(-1) for axis in (points.tangent, points.bitangent, points.normal)], -1)


class LightTables:
    """Each point's ABRDF over the light list at its own texel and view, held where the rays are traced.

    Parameters
    ----------
    tracer : Tracer, for its Mitsuba and Dr.Jit modules
    material : Tabulated
    """

    def __init__(self, tracer: Tracer, material: Tabulated):
        self._tracer, self.mi, self.dr, self.material = tracer, tracer.mi, tracer.dr, material
        views, lights = material.angular.shape[:2]
        self.views, self.lights = views, lights
        taps = interpolator(material.lights)
        self._grid = tracer.integers(taps.grid)
        # a corner of a triangle in one packet: its row of the affine map, and which light it is
        corners = np.concatenate([taps.affine, taps.triangles[..., None]], -1)
        self._corners = tracer.floats(corners)
        padded = np.zeros((views, material.texels.shape[2], lights, 4), np.float32)
        padded[..., :3] = np.moveaxis(material.angular, 3, 1)
        self._angular = padded.reshape(views, -1, lights * 4)

    def at(self, points: SurfacePoints, *, millimetres_per_unit: float):
        """The tables of points.

        Returns
        -------
        mitsuba Float of n * lights * 4 lanes: RGB and a zero, 1/sr, without the cosine
        """
        taps, weights = self._view_taps(points)
        factors = np.broadcast_to(self._factors(points, millimetres_per_unit), (len(points), self._angular.shape[1]))
        rows = (weights[:, :, None] * factors[:, None, :]).reshape(len(points), -1)
        # points that lie in one triangle of views share one product
        triangle = (taps[:, 0].astype(np.int64) * self.views + taps[:, 1]) * self.views + taps[:, 2]
        order = np.argsort(triangle, kind="stable")
        ends = np.flatnonzero(np.diff(triangle[order], append=-1)) + 1
        tables = np.empty((len(points), self.lights * 4), np.float32)
        for some in np.split(order, ends[:-1]):
            if len(some):
                tables[some] = rows[some] @ self._angular[taps[some[0]]].reshape(rows.shape[1], -1)
        return self._tracer.floats(tables)

    def _view_taps(self, points):
        """Three views and their weights for each point: (n, 3) int and (n, 3) float32."""
        eye = to_local(points, points.to_eye)
        eye[:, 2] = np.maximum(eye[:, 2], 1e-3)  # shading normals can face away where the surface does not
        eye /= np.linalg.norm(eye, axis=1, keepdims=True)
        taps, weights = interpolator(self.material.views).weights(eye)
        return taps, weights.astype(np.float32)

    def _factors(self, points, millimetres_per_unit):
        """Spatial factors (n, k) float32, or (1, k) of a material with one texel."""
        if self.material.texels.shape[:2] == (1, 1):
            return self.material.texels[0]
        return spatial_factors(self.material, points.uv, points.footprint * millimetres_per_unit)

    def value(self, tables, point, omega, active):
        """Look-up of ``tables`` (of :meth:`at`) for points' light directions.

        Parameters
        ----------
        point : mitsuba UInt32, numbers of points
        omega : mitsuba Vector3f, unit, local
        active : mitsuba Bool; others are not looked up, their value is meaningless

        Returns
        -------
        mitsuba Vector4f : RGB, 1/sr
        """
        mi, dr = self.mi, self.dr
        u, v = omega.x / (1 + omega.z), omega.y / (1 + omega.z)  # the parabolic map
        column = mi.UInt32(dr.clip((u + 1) * (GRID / 2), 0, GRID - 1))
        row = mi.UInt32(dr.clip((v + 1) * (GRID / 2), 0, GRID - 1))
        triangle = dr.gather(mi.UInt32, self._grid, row * GRID + column, active)
        base = point * dr.opaque(mi.UInt32, self.lights)
        values, total = mi.Vector4f(0), mi.Float(0)
        for corner in range(3):
            affine = dr.gather(mi.Vector4f, self._corners, triangle * 3 + corner, active)
            weight = dr.maximum(affine.x * u + affine.y * v + affine.z, 0)
            total += weight
            values += weight * dr.gather(mi.Vector4f, tables, base + mi.UInt32(affine.w), active)
        return values / total
