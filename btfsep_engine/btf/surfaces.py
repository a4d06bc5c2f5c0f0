# SPDX-License-Identifier: GPL-3.0-or-later
"""Surfaces by the numbers of Blender's Principled BSDF, alike all over or by images: a family beside the library."""

from dataclasses import dataclass, replace

import numpy as np

from btfsep_engine.conventions import grey

CLASS = "surface"
COLOURED = 0.01  # difference between the channels of a colour: of less, nothing is seen
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
    coat : [0, 1], the share under a clear coat of the index 1.5; coat_roughness : [0, 1]
    sheen : (3,) in [0, 1], weight times tint of Principled's microfibres; sheen_roughness : [0, 1]
    left_out : what else there is to the material, in words: the numbers say nothing of it
    image : (n, n, 3) float32, linear, in [0, 1], row 0 at the top, or None: base colours by the mesh's UVs, a period
        of 1; ``base_color`` then says nothing
    finish : (n, n, 3) float32 like ``image``: roughness, metallic and specular of each place, of few kinds; or None
    """

    base_color: tuple = (0.8, 0.8, 0.8)
    roughness: float = 0.5
    metallic: float = 0.0
    specular: float = 0.5
    emission: tuple = (0.0, 0.0, 0.0)
    coat: float = 0.0
    coat_roughness: float = 0.03
    sheen: tuple = (0.0, 0.0, 0.0)
    sheen_roughness: float = 0.5
    left_out: tuple = ()
    image: np.ndarray | None = None
    finish: np.ndarray | None = None

    @property
    def f0(self) -> float:
        """Reflectance of the dielectric straight on, as Principled makes it: 0.08 times ``specular``."""
        return 0.08 * self.specular

    @property
    def plain(self) -> bool:
        """Whether it is one dielectric all over, without a layer above."""
        return self.image is None and self.finish is None and not (self.metallic or self.coat or any(self.sheen))

    @property
    def coloured(self) -> bool:
        """Whether any of its numbers, or its image, has a colour that is seen."""
        each = (self.base_color if self.image is None else self.image, self.sheen, self.emission)
        return any(np.ptp(values, axis=-1).max() > COLOURED for values in each)

    def without_colours(self) -> "Surface":
        """The same of a luminance alone."""
        colours = {name: tuple(grey(getattr(self, name)).tolist()) for name in ("base_color", "emission", "sheen")}
        return replace(self, **colours, image=None if self.image is None else grey(self.image))

    def kinds(self) -> list:
        """Pairs (share, surface): of each kind of finish where it is, (n, n) float32, and a surface without images.

        Without ``finish`` one pair, whose share is 1.
        """
        plain = replace(self, image=None, finish=None)
        if self.finish is None:
            return [(1.0, plain)]
        distinct, number = np.unique(self.finish.reshape(-1, 3).round(3), axis=0, return_inverse=True)
        number = number.reshape(self.finish.shape[:2])
        names = ("roughness", "metallic", "specular")
        return [
            ((number == i).astype(np.float32), replace(plain, **dict(zip(names, map(float, values), strict=True))))
            for i, values in enumerate(distinct)
        ]

    def numbers(self) -> dict:
        """The numbers, for JSON; those of each finish, where there are several."""
        if self.finish is not None:
            return {"finishes": [{k: v for k, v in s.numbers().items() if k != "base_color"} for _, s in self.kinds()]}
        colour = {"base_color": list(self.base_color)} if self.image is None else {}
        layers = {"coat": self.coat, "coat_roughness": self.coat_roughness} if self.coat else {}
        layers |= {"sheen": list(self.sheen), "sheen_roughness": self.sheen_roughness} if any(self.sheen) else {}
        return colour | {"roughness": self.roughness, "metallic": self.metallic, "specular": self.specular} | layers


SURFACES = {
    "surface/matte": Surface((0.5, 0.5, 0.5), roughness=1.0, specular=0.0),
    "surface/plastic": Surface((0.5, 0.5, 0.5), roughness=0.4),
    "surface/metal": Surface((0.6, 0.6, 0.6), roughness=0.3, metallic=1.0),
}
