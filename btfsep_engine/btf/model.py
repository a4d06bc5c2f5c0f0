# SPDX-License-Identifier: GPL-3.0-or-later
"""A material in memory.

One rule for the cosine: what is held here is **without** cos(theta_i), in 1/sr; the transport multiplies it
in, once. One model for all tabulated materials, linear in both factors:

    BTF(x, omega_i, omega_o)[c] = sum_k texels[x, k] * angular[view, light, c, k]
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np


@dataclass(frozen=True)
class Tabulated:
    """A factorised BTF over texel x view x light.

    Attributes
    ----------
    name : "class/material"
    material_class : one of the classes of UBO2014, or "reference"
    texels : (h, w, k) float32, spatial factor; row 0 is the smallest +v, the texture is periodic
    angular : (views, lights, 3, k) float32, linear RGB, 1/sr, without cos(theta_i)
    views, lights : (n, 3) float64, unit, local frame (tangent, bitangent, normal)
    texel_mm : edge of a texel, millimetres
    """

    name: str
    material_class: str
    texels: np.ndarray
    angular: np.ndarray
    views: np.ndarray
    lights: np.ndarray
    texel_mm: float

    @cached_property
    def mean_texel(self) -> np.ndarray:
        """(k,) float32; the mean ABRDF is ``angular @ mean_texel``."""
        return self.texels.mean((0, 1))

    @cached_property
    def mean_abrdf(self) -> np.ndarray:
        """(views, lights, 3) float32, the ABRDF averaged over all texels."""
        return self.angular @ self.mean_texel

    def mean_material(self) -> "Tabulated":
        """The same material with one texel: its mean ABRDF (the paper's regulariser, section 3.3)."""
        return Tabulated(
            self.name,
            self.material_class,
            np.ones((1, 1, 1), np.float32),
            self.mean_abrdf[..., None],
            self.views,
            self.lights,
            self.texel_mm * max(self.texels.shape[:2]),
        )


@dataclass(frozen=True)
class Lambertian:
    """A perfectly diffuse reference material: albedo : (3,) linear RGB in [0, 1]."""

    name: str
    albedo: np.ndarray
    material_class: str = "reference"


@dataclass(frozen=True)
class Mirror:
    """A perfect mirror: reflectance : (3,) linear RGB in [0, 1]."""

    name: str
    reflectance: np.ndarray
    material_class: str = "reference"


Material = Tabulated | Lambertian | Mirror

REFERENCE = {
    "reference/white-diffuse": Lambertian("reference/white-diffuse", np.full(3, 0.8)),
    "reference/grey18": Lambertian("reference/grey18", np.full(3, 0.18)),
    "reference/chrome": Mirror("reference/chrome", np.array([0.55, 0.556, 0.554])),
}
