# SPDX-License-Identifier: GPL-3.0-or-later
"""Materials near a material: the same, rougher, glossier or duller. A piece is seldom just what was measured.

Each is an ordinary table over the library's views and lights, linear in what it is made of, so that the transport needs
to know nothing new:

- a diffuse material may be rough, as plaster and clay are (Oren and Nayar 1994, the qualitative model): it brightens
  towards grazing light and towards the lamp, and has a thin gloss, that of a rough dielectric (GGX, reflectance 0.04
  straight on), which lies on nothing smooth;
- a tabulated one may have that gloss more;
- a tabulated one may be duller: a part of it replaced by a diffuse one of the same albedo.
"""

from dataclasses import dataclass

import numpy as np

from btfsep_engine.btf.directions import ubo2014_directions
from btfsep_engine.btf.model import Material, Tabulated

ROUGHNESSES = (0.2, 0.3)  # sigma of Oren and Nayar's slopes, radians
GLOSS = 0.7  # roughness of the gloss that is added, and its alpha's root
F0 = 0.04
DULLER = 0.4  # of the material, replaced by a diffuse one
EACH = -3.0  # logarithm of the prior probability of a measured material's departure, against none; nothing is as
# Lambert has it, and that a matte surface is rough is as probable as that it is not
LEAST_COSINE = 1e-3


@dataclass(frozen=True)
class Departure:
    """``material`` in place of another, ``description`` : what it is; ``log_prior`` : against the other itself.

    ``further`` : it goes on where the one before it went, and where that is hopeless, so is this
    """

    description: str
    material: Material
    log_prior: float
    further: bool = False


def departures(material: Material) -> list[Departure]:
    """The materials that are tried beside ``material`` (one texel), the likeliest first; none for a mirror."""
    if material.mirror_reflectance is not None:
        return []
    gloss = gloss_lobe()
    if material.matte_albedo is not None:
        found = []
        for i, sigma in enumerate(ROUGHNESSES):
            rough = _diffuse(material, oren_nayar(sigma)[..., None])
            words = f"roughness (Oren and Nayar's sigma {sigma}) and a little gloss"
            found.append(Departure(words, _table(material, rough + gloss), 0.0, further=i > 0))
        return found
    mean = material.mean_material().table
    values = mean.angular[..., 0] * mean.texels[0, 0, 0] if mean.texels.shape[-1] == 1 else mean.mean_abrdf
    dull = (1 - DULLER) * values + DULLER * np.asarray(mean.diffuse_albedo()) / np.pi
    near = [Departure("less gloss", _table(material, dull), EACH)]
    if np.array_equal(mean.views, ubo2014_directions()) and np.array_equal(mean.lights, mean.views):
        near.append(Departure("a little more gloss", _table(material, values + gloss), EACH))
    return near


def _diffuse(material: Material, shape) -> np.ndarray:
    count = len(ubo2014_directions())
    return np.broadcast_to(material.matte_albedo / np.pi, (count, count, 3)) * shape


def _table(material: Material, values) -> Tabulated:
    """``values`` (views, lights, 3) over the directions of the material's own table."""
    table, texel = material.table, np.ones((1, 1, 1), np.float32)
    angular = np.asarray(values, np.float32)[..., None]
    return Tabulated(material.name, material.material_class, texel, angular, table.views, table.lights, 1.0)


def _pairs():
    """Directions to the eye (views, 1, 3) and to the light (1, lights, 3), and their cosines."""
    directions = ubo2014_directions()
    eye, light = directions[:, None], directions[None]
    return eye, light, np.maximum(eye[..., 2], LEAST_COSINE), np.maximum(light[..., 2], LEAST_COSINE)


def oren_nayar(sigma: float) -> np.ndarray:
    """Oren and Nayar's rough diffuse surface over Lambert's: (views, lights) float64."""
    eye, light, cos_o, cos_i = _pairs()
    s2 = sigma * sigma
    a, b = 1 - 0.5 * s2 / (s2 + 0.33), 0.45 * s2 / (s2 + 0.09)
    sin_o, sin_i = np.sqrt(np.maximum(1 - cos_o**2, 0)), np.sqrt(np.maximum(1 - cos_i**2, 0))
    together = (eye[..., :2] * light[..., :2]).sum(-1) / np.maximum(sin_o * sin_i, 1e-9)
    steepest = np.maximum(sin_o, sin_i) * np.minimum(sin_o, sin_i) / np.maximum(cos_o, cos_i)
    return a + b * np.maximum(together, 0) * steepest


def gloss_lobe() -> np.ndarray:
    """The lobe of a rough dielectric, GGX with Schlick's reflectance: (views, lights, 1) float64, 1/sr."""
    eye, light, cos_o, cos_i = _pairs()
    half = eye + light
    half = half / np.maximum(np.linalg.norm(half, axis=-1, keepdims=True), 1e-9)
    alpha2, cos_h = GLOSS**4, half[..., 2]
    d = alpha2 / (np.pi * (cos_h**2 * (alpha2 - 1) + 1) ** 2)
    v = 0.5 / (cos_i * np.sqrt(alpha2 + (1 - alpha2) * cos_o**2) + cos_o * np.sqrt(alpha2 + (1 - alpha2) * cos_i**2))
    fresnel = F0 + (1 - F0) * (1 - np.clip((light * half).sum(-1), 0, 1)) ** 5
    return (d * v * fresnel)[..., None]
