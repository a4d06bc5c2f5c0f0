# SPDX-License-Identifier: GPL-3.0-or-later
"""Radiance of surface points under beams of parallel light, many directions at once, and under a lamp that stands near,
each with its own shadows."""

import numpy as np

from btfsep_engine.btf.model import Material
from btfsep_engine.render.homogeneous import under_beams
from btfsep_engine.render.surface import SurfacePoints
from btfsep_engine.render.tracer import OFFSET, Tracer
from btfsep_engine.render.transport import LANES
from btfsep_engine.render.weights import Weights


def beam_radiance(
    tracer: Tracer, points: SurfacePoints, material: Material, directions, *, millimetres_per_unit: float
) -> np.ndarray:
    """BTF(x, omega_d, omega_o) V(x, omega_d) cos(theta_d): radiance per unit irradiance of the beam.

    Parameters
    ----------
    tracer : Tracer
    points : SurfacePoints, with tangents
    material : Material; a mirror shows nothing of light without extent
    directions : (n, 3) float, unit, world, to the light
    millimetres_per_unit : millimetres in a world unit

    Returns
    -------
    (p, n, 3) float32
    """
    directions = np.asarray(directions, np.float64)
    count = len(directions)
    out = np.zeros((3, len(points), count), np.float32)
    if material.mirror_reflectance is not None or count == 0:
        return out.transpose(1, 2, 0)
    step = max(1, LANES // count)
    if (surface := plain_surface(material)) is not None:
        out = np.empty((len(points), count, 3), np.float32)
        for start in range(0, len(points), step):
            part = points.take(slice(start, start + step))
            seen = tracer.visible(part.position, part.flat_normal, directions)
            values = under_beams(surface, part.normal, part.to_eye, directions)
            np.multiply(values, seen[..., None], out=out[start : start + len(part)])
        return out
    weights = Weights(material, directions, millimetres_per_unit=millimetres_per_unit)
    scale = weights.colour * np.float32(count / (4 * np.pi))  # Weights are of light from all over the sky
    for start in range(0, len(points), step):
        part = points.take(slice(start, start + step))
        seen = tracer.visible_lanes(part.position, part.flat_normal, directions)
        channels = weights.of_all(part, seen)
        for c in range(3):
            np.multiply(channels[min(c, len(channels) - 1)], scale[c], out=out[c, start : start + len(part)])
    return out.transpose(1, 2, 0)


def plain_surface(material: Material):
    """The numbers of a material that is made from such, where these say all (`Surface.plain`); else None."""
    surface = getattr(material, "surface", None)
    return surface if surface is not None and surface.plain else None


def lamp_radiance(
    tracer: Tracer, points: SurfacePoints, material: Material, place, *, millimetres_per_unit: float
) -> np.ndarray:
    """`beam_radiance` of a lamp that stands near, per unit irradiance at each point: (p, 3) float32.

    ``place`` : (3,) float, world
    """
    to_lamp = np.asarray(place, np.float64) - points.position
    away = np.linalg.norm(to_lamp, axis=1)
    directions, every = to_lamp / away[:, None], np.arange(len(points))
    starts = np.asarray(points.position, np.float64) + OFFSET * tracer.radius * np.asarray(points.flat_normal)
    seen = (points.flat_normal * directions).sum(1) > 0
    seen &= tracer.nearest(starts, directions).distance >= away  # what is beyond the lamp blocks nothing
    weights = Weights(material, directions, millimetres_per_unit=millimetres_per_unit)
    channels = weights.of_pairs(points, every, every)
    scale = weights.colour * np.float32(len(points) / (4 * np.pi))  # Weights are of light from all over the sky
    return np.stack([channels[min(c, len(channels) - 1)] * seen * scale[c] for c in range(3)], 1)
