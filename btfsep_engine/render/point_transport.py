# SPDX-License-Identifier: GPL-3.0-or-later
"""Transport of lights without extent: one shadow ray for each point and light, and the BTF there.

The integral of eq. 1 has one direction only: L = BTF(x, omega_l, omega_o) V(x, omega_l) cos(theta_l) E_l, with E_l the
light's irradiance at right angles to it.
"""

import numpy as np

from btfsep_engine.btf.model import Material
from btfsep_engine.light.point_lights import DirectionalLights, PointLights
from btfsep_engine.render.appearance import LightTables, to_local
from btfsep_engine.render.arrays import dr, mi, vector
from btfsep_engine.render.surface import SurfacePoints
from btfsep_engine.render.tracer import OFFSET, Tracer

PIXELS = 8192  # whose tables are held at once: 15 MB of 151 lights


def point_radiance(
    tracer: Tracer,
    points: SurfacePoints,
    material: Material,
    lights: PointLights | DirectionalLights,
    *,
    millimetres_per_unit: float,
) -> np.ndarray:
    """Radiance towards the camera by light that comes straight from the lights.

    Parameters
    ----------
    tracer : Tracer
    points : SurfacePoints, with tangents
    material : Material; a mirror shows nothing of lights without extent
    lights : M of them
    millimetres_per_unit : millimetres in a world unit

    Returns
    -------
    (p, M, 3) float32
    """
    out = np.zeros((len(points), lights.count, 3), np.float32)
    if material.mirror_reflectance is not None:
        return out
    look_up = LightTables(material.table) if material.matte_albedo is None else None
    for start in range(0, len(points), PIXELS):
        part = points.take(slice(start, start + PIXELS))
        tables = look_up and look_up.tables_at(part, millimetres_per_unit=millimetres_per_unit)
        for number in range(lights.count):
            direction, distance, irradiance = lights.arriving(number, part.position)
            local = to_local(part, direction)
            lit = (local[:, 2] > 0) & _unblocked(tracer, part, direction, distance)
            if look_up is None:
                value = material.matte_albedo / np.pi
            else:
                lane = dr.arange(mi.UInt32, len(part))
                rgb = look_up.value(tables, lane, vector(local), mi.Bool(lit))
                value = np.array(rgb).T[:, :3]
            shaded = value * (np.maximum(local[:, 2:], 0) * irradiance)
            out[start : start + len(part), number] = np.where(lit[:, None], shaded, 0)
    return out


def _unblocked(tracer: Tracer, points: SurfacePoints, direction, distance) -> np.ndarray:
    """Whether nothing stands between each point and its light: (n,) bool."""
    starts = points.position + OFFSET * tracer.radius * points.flat_normal
    above = (points.flat_normal * direction).sum(1) > 0
    return above & (tracer.nearest(starts, direction).distance >= distance * (1 - 1e-5))
