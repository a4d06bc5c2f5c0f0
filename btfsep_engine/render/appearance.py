# SPDX-License-Identifier: GPL-3.0-or-later
"""A tabulated material at surface points: texel look-up and view interpolation.

The view and the texel of a pixel are fixed, so both are interpolated once per pixel, into the pixel's own
table over the light list; a light direction then costs three taps, whatever the number of components.
"""

import numpy as np

from btfsep_engine.btf.directions import interpolator
from btfsep_engine.btf.model import Tabulated
from btfsep_engine.render.surface import SurfacePoints


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


def light_tables(material: Tabulated, points: SurfacePoints, *, millimetres_per_unit: float) -> np.ndarray:
    """Each pixel's ABRDF over the light list, at its own texel and view.

    Returns
    -------
    (n, lights, 3) float32, 1/sr, without the cosine
    """
    n, (views, lights) = len(points), material.angular.shape[:2]
    eye = to_local(points, points.to_eye)
    eye[:, 2] = np.maximum(eye[:, 2], 1e-3)  # shading normals can face away where the surface does not
    eye /= np.linalg.norm(eye, axis=1, keepdims=True)
    taps, weights = interpolator(material.views).weights(eye)
    if material.texels.shape[:2] == (1, 1):
        factors = np.broadcast_to(material.texels[0, 0], (n, material.texels.shape[2]))
    else:
        factors = spatial_factors(material, points.uv, points.footprint * millimetres_per_unit)
    tables = np.zeros((n, lights * 3), np.float32)
    flat = material.angular.reshape(views, lights * 3, -1)
    for tap in range(3):
        order = np.argsort(taps[:, tap], kind="stable")
        starts = np.searchsorted(taps[order, tap], np.arange(views + 1))
        for view in np.flatnonzero(np.diff(starts)):
            chosen = order[starts[view] : starts[view + 1]]
            scaled = factors[chosen] * weights[chosen, tap, None].astype(np.float32)
            tables[chosen] += scaled @ flat[view].T
    return tables.reshape(n, lights, 3)
