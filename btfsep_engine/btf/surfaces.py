# SPDX-License-Identifier: GPL-3.0-or-later
"""Surfaces of one kind all over, given by numbers, those of Blender's Principled BSDF: a family beside the library."""

from dataclasses import dataclass

import numpy as np

CLASS = "surface"
GIVEN = "surface/given"  # the material that is made from the numbers of a job


@dataclass(frozen=True)
class Surface:
    """A dielectric (a diffuse base under a GGX layer), a GGX conductor, or a mixture of both.

    Attributes
    ----------
    base_color : (3,) floats in [0, 1], linear Rec.709
    roughness : [0, 1]; GGX's alpha is its square
    metallic : [0, 1], the conductor's share
    specular : [0, 1], Principled's *Specular IOR Level* at its index 1.5: 0.5 is a reflectance of 0.04 straight on
    emission : (3,) radiance, linear Rec.709, >= 0
    image : (n, n, 3) float32, linear, in [0, 1], row 0 at the top, or None: base colours by the mesh's UVs, a period
        of 1; ``base_color`` then says nothing
    """

    base_color: tuple = (0.8, 0.8, 0.8)
    roughness: float = 0.5
    metallic: float = 0.0
    specular: float = 0.5
    emission: tuple = (0.0, 0.0, 0.0)
    image: np.ndarray | None = None

    @property
    def f0(self) -> float:
        """Reflectance of the dielectric straight on, as Principled makes it: 0.08 times ``specular``."""
        return 0.08 * self.specular

    def numbers(self) -> dict:
        """The numbers, for JSON."""
        colour = {"base_color": list(self.base_color)} if self.image is None else {}
        return colour | {"roughness": self.roughness, "metallic": self.metallic, "specular": self.specular}


SURFACES = {
    "surface/matte": Surface((0.5, 0.5, 0.5), roughness=1.0, specular=0.0),
    "surface/plastic": Surface((0.5, 0.5, 0.5), roughness=0.4),
    "surface/metal": Surface((0.6, 0.6, 0.6), roughness=0.3, metallic=1.0),
}
