# SPDX-License-Identifier: GPL-3.0-or-later
"""A tabulated material at surface points: texel look-up and view interpolation.

The view and the texel of a pixel are fixed, so both are interpolated once per pixel, into the pixel's own
table over the light list; a light direction then costs three taps, whatever the number of components.
"""

import numpy as np

from btfsep_engine.btf.directions import interpolator
from btfsep_engine.btf.model import Tabulated, blended
from btfsep_engine.linear_algebra import product
from btfsep_engine.render.arrays import DirectionTaps, aligned, dr, mi
from btfsep_engine.render.surface import SurfacePoints
from btfsep_engine.threads import one_thread

PROBE_TEXELS = 1.5  # between look-ups within a pixel: with one for all of it, single pixels are 5 to 15 % wrong
PROBES = 12  # in a pixel, about
CHUNK = 1 << 14  # pixels averaged at once


def _bilinear(level, uv):
    """Periodic bilinear look-up of (h, w, k) at texture coordinates (n, 2), 1 being the whole tile."""
    h, w = level.shape[:2]
    return blended(level, uv[:, 0] * w - 0.5, uv[:, 1] * h - 0.5)


def _trilinear(levels, at, level) -> np.ndarray:
    """Look-ups of a pyramid at texture coordinates (n, 2) and levels (n,): (n, k) float32."""
    level = np.clip(level, 0, len(levels) - 1)
    low = np.minimum(np.floor(level).astype(int), max(len(levels) - 2, 0))
    fraction = (level - low).astype(np.float32)[:, None]
    out = np.empty((len(at), levels[0].shape[2]), np.float32)
    for number in np.unique(low):
        chosen = np.flatnonzero(low == number)
        f, below = fraction[chosen], _bilinear(levels[number], at[chosen])
        if f.any():
            below = below * (1 - f) + _bilinear(levels[min(number + 1, len(levels) - 1)], at[chosen]) * f
        out[chosen] = below
    return out


def pixel_edges(points: SurfacePoints) -> np.ndarray:
    """Edges of the patches of surface that pixels cover, along and across the slant, in texture coordinates.

    A square pixel seen at a slant covers a rectangle that is 1 / cos(slant) longer along it. How the pixel is turned
    about its ray is left out: it does not change the rectangle's second moments.

    Gives (n, 2, 2) float64, world units: edge, axis of the texture.
    """
    slant = np.clip((points.flat_normal * points.to_eye).sum(1), 0.05, 1)  # as in surface.surface_points
    across = np.cross(points.flat_normal, points.to_eye)
    length = np.linalg.norm(across, axis=1, keepdims=True)
    across = np.where(length > 1e-6, across / np.maximum(length, 1e-300), points.tangent)
    along = np.cross(points.flat_normal, across)
    edges = np.stack(
        [along * (points.footprint / np.sqrt(slant))[:, None], across * (points.footprint * np.sqrt(slant))[:, None]], 1
    )
    return np.stack([(edges * axis[:, None]).sum(-1) for axis in (points.tangent, points.bitangent)], -1)


def spatial_factors(material: Tabulated, uv, edges) -> np.ndarray:
    """Spatial factors averaged over pixels: the mean of bilinear texels in each pixel's parallelogram.

    Probes lie in the parallelogram at most `PROBE_TEXELS` apart (further where that would take more than about
    `PROBES`). Each is looked up at the level whose spread is that of its part of the pixel: a box of s texels under a
    bilinear tent has the variance s^2 / 12 + 1 / 6, level l has 4^l / 4 - 1 / 12, so that 4^l = 1 + s^2 / 3. One
    isotropic look-up at l = log2(s) has up to three times the spread that it should have.

    Parameters
    ----------
    material : Tabulated
    uv : (n, 2) float, millimetres
    edges : (n, 2, 2) float, millimetres: the two edges of what a pixel covers, in texture coordinates

    Returns
    -------
    (n, k) float32
    """
    height, width = material.texels.shape[:2]
    tile = np.array([width, height]) * material.texel_mm
    levels = material.pyramid
    out = np.empty((len(uv), material.texels.shape[2]), np.float32)
    for start in range(0, len(uv), CHUNK):
        at, edge = uv[start : start + CHUNK], edges[start : start + CHUNK]
        lengths = np.linalg.norm(edge, axis=2) / material.texel_mm
        apart = np.maximum(PROBE_TEXELS, np.sqrt(lengths.prod(1) / PROBES))
        counts = np.clip(np.ceil(lengths / apart[:, None] - 1e-6), 1, PROBES).astype(int)
        share = (lengths / counts).max(1)
        total = counts.prod(1)
        pixel, first = np.repeat(np.arange(len(at)), total), np.cumsum(total) - total
        number = np.arange(len(pixel)) - first[pixel]
        steps = np.stack([number // counts[pixel, 1], number % counts[pixel, 1]], -1)
        steps = (steps + 0.5) / counts[pixel] - 0.5
        places = at[pixel] + (steps[:, :, None] * edge[pixel]).sum(1)
        values = _trilinear(levels, places / tile, 0.5 * np.log2(1 + share**2 / 3)[pixel])
        out[start : start + CHUNK] = np.add.reduceat(values, first, axis=0) / total[:, None]
    return out


def to_local(points: SurfacePoints, directions) -> np.ndarray:
    """World directions (n, 3), one for each point, in the points' local frames."""
    return np.stack([(directions * axis).sum(-1) for axis in (points.tangent, points.bitangent, points.normal)], -1)


class LightTables:
    """Each point's ABRDF over the light list at its own texel and view, held where the rays are traced.

    ``material`` : Tabulated
    """

    def __init__(self, material: Tabulated):
        self.material = material
        views, lights = material.angular.shape[:2]
        self.views, self.lights = views, lights
        self._taps = DirectionTaps(material.lights)
        padded = np.zeros((views, material.texels.shape[2], lights, 4), np.float32)
        padded[..., :3] = np.moveaxis(material.angular, 3, 1)
        self._angular = padded.reshape(views, -1, lights * 4)

    @one_thread()  # they are kept, for others that may share their products out among more threads
    def tables_at(self, points: SurfacePoints, *, millimetres_per_unit: float):
        """The tables of points.

        Gives mitsuba Float of n * lights * 4 lanes: RGB and a zero, 1/sr, without the cosine.
        """
        taps, weights = self._view_taps(points)
        factors = np.broadcast_to(self._factors(points, millimetres_per_unit), (len(points), self._angular.shape[1]))
        rows = (weights[:, :, None] * factors[:, None, :]).reshape(len(points), -1)
        # points that lie in one triangle of views share one product
        triangle = (taps[:, 0].astype(np.int64) * self.views + taps[:, 1]) * self.views + taps[:, 2]
        order = np.argsort(triangle, kind="stable")
        ends = np.flatnonzero(np.diff(triangle[order], append=-1)) + 1
        tables = aligned((len(points), self.lights * 4), np.float32)  # of a report's points 100 MB: not copied again
        for some in np.split(order, ends[:-1]):
            if len(some):
                tables[some] = product(rows[some], self._angular[taps[some[0]]].reshape(rows.shape[1], -1))
        return mi.Float(tables.ravel())

    def _view_taps(self, points):
        """Three views and their weights for each point: (n, 3) int and (n, 3) float32."""
        eye = to_local(points, points.to_eye)
        eye[:, 2] = np.maximum(eye[:, 2], 1e-3)  # shading normals can face away where the surface does not
        eye /= np.linalg.norm(eye, axis=1, keepdims=True)
        taps, weights = interpolator(self.material.views).weights(eye)
        return taps, weights.astype(np.float32)

    def _factors(self, points, millimetres_per_unit):
        """Spatial factors (n, k) float32, or (1, k) of a material with one texel."""
        if not self.material.has_texture:
            return self.material.texels[0]
        return spatial_factors(self.material, points.uv, pixel_edges(points) * millimetres_per_unit)

    def value(self, tables, point, omega, active):
        """Look-up of ``tables`` (of :meth:`tables_at`) for points' light directions.

        Parameters
        ----------
        point : mitsuba UInt32, numbers of points
        omega : mitsuba Vector3f, unit, local
        active : mitsuba Bool; others are not looked up, their value is meaningless

        Returns
        -------
        mitsuba Vector4f : RGB, 1/sr
        """
        base = point * dr.opaque(mi.UInt32, self.lights)
        values, total = mi.Vector4f(0), mi.Float(0)
        for number, weight in self._taps(omega, active):
            total += weight
            values += weight * dr.gather(mi.Vector4f, tables, base + number, active)
        return values / total
