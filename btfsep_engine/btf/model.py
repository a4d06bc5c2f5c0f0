# SPDX-License-Identifier: GPL-3.0-or-later
"""A material in memory: what every kind of it answers, and the kinds.

One rule for the cosine: what is held here is **without** cos(theta_i), in 1/sr; the transport multiplies it
in, once. One model for all tabulated materials, linear in both factors:

    BTF(x, omega_i, omega_o)[c] = sum_k texels[x, k] * angular[view, light, c, k]
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from btfsep_engine.btf.directions import cosine_weights, interpolator, ubo2014_directions
from btfsep_engine.btf.surfaces import Surface
from btfsep_engine.conventions import grey


class Material(ABC):
    """What all others ask of a material. A new kind gives its names and :meth:`abrdf`; the rest follows from its table.

    Attributes
    ----------
    name : "class/name"
    material_class : one of the classes of UBO2014, "reference" or "surface"
    has_texture : whether it differs from place to place
    lines_up : whether its texture is known to lie where the photo's does
    dye : (2,) the tint (`fit.colour.tint_of`) of a base colour that was taken from the photo; None: it is known
    matte_albedo : (3,) of a perfectly diffuse material, which is as bright from everywhere; None: of no other
    mirror_reflectance : (3,) of a perfect mirror, which shows nothing of a beam without extent; None: of no other
    """

    has_texture = lines_up = False
    dye = None
    matte_albedo = mirror_reflectance = None

    @abstractmethod
    def abrdf(self, position_mm, to_light, to_eye) -> np.ndarray:
        """Values at points, a mirror's own direction left out.

        Parameters
        ----------
        position_mm : (n, 2) float, along the tangent and the bitangent; a texture is periodic
        to_light, to_eye : (n, 3) float, unit, local, upper hemisphere

        Returns
        -------
        (n, 3) float, 1/sr, without the cosine
        """

    def without_colours(self) -> "Material":
        """The same material as a black-and-white photo shows it: of the luminance of what it reflects."""
        return self.table.without_colours()

    @cached_property
    def table(self) -> "Tabulated":
        """Its :meth:`abrdf` at the directions of UBO2014, for what looks materials up."""
        d = ubo2014_directions()
        n = len(d)
        values = self.abrdf(np.zeros((n * n, 2)), np.tile(d, (n, 1)), np.repeat(d, n, 0)).reshape(n, n, 3, 1)
        texel = np.ones((1, 1, 1), np.float32)
        return Tabulated(self.name, self.material_class, texel, values.astype(np.float32), d, d, 1.0)

    def mean_material(self) -> "Material":
        """The same material without its texture (the paper's regulariser, section 3.3)."""
        return self

    def truncated(self, components: int | None) -> "Material":
        """The same material with no more than so many factors; None: with all."""
        return self

    def directional_albedo(self) -> np.ndarray:
        """(views, 3) float64: the share of light from all sides that the mean sends each way; < 1 for what can exist.

        The directional-hemispherical reflectance, of a reciprocal material seen from the light's side.
        """
        return np.einsum("vlc,l->vc", self.table.mean_abrdf.astype(np.float64), cosine_weights(self.table.lights))

    def diffuse_albedo(self) -> np.ndarray:
        """(3,) float64: the share of light from all sides alike that its mean reflects (bihemispherical)."""
        return cosine_weights(self.table.views) @ self.directional_albedo() / np.pi


@dataclass(frozen=True)
class Tabulated(Material):
    """A factorised BTF over texel x view x light.

    Attributes
    ----------
    name : "class/material"
    material_class : one of the classes of UBO2014, or "reference"
    texels : (h, w, k) float32, spatial factor; row 0 is the smallest +v, the texture is periodic
    angular : (views, lights, 3, k) float32, linear RGB, 1/sr, without cos(theta_i)
    views, lights : (n, 3) float64, unit, local frame (tangent, bitangent, normal)
    texel_mm : edge of a texel, millimetres
    laid_mean : (k,) float32, the mean texel over the surface on which the texels are laid once and in their own places
        (an image by a mesh's own UVs); None: they are a pattern that repeats, of which nobody knows where it starts
    surface : the numbers that all of it was made from, which say more than the table does; None: nobody knows such
    """

    name: str
    material_class: str
    texels: np.ndarray
    angular: np.ndarray
    views: np.ndarray
    lights: np.ndarray
    texel_mm: float
    laid_mean: np.ndarray | None = None
    dye: tuple | None = None
    surface: Surface | None = None

    @property
    def table(self) -> "Tabulated":
        return self

    @property
    def has_texture(self) -> bool:
        return self.texels.shape[:2] != (1, 1)

    @property
    def lines_up(self) -> bool:
        return self.laid_mean is not None

    @cached_property
    def pyramid(self) -> list[np.ndarray]:
        """Mip levels of the texels. The BTF is linear in them: the mean of texels is exact."""
        levels = [np.asarray(self.texels, np.float32)]
        while max(levels[-1].shape[:2]) > 1:
            level = levels[-1]
            h, w = (max(1, s // 2) for s in level.shape[:2])
            rows = np.linspace(0, level.shape[0], h + 1).astype(int)
            columns = np.linspace(0, level.shape[1], w + 1).astype(int)
            summed = np.add.reduceat(np.add.reduceat(level, rows[:-1], 0), columns[:-1], 1)
            levels.append(summed / (np.diff(rows)[:, None, None] * np.diff(columns)[None, :, None]))
        return levels

    @cached_property
    def mean_texel(self) -> np.ndarray:
        """(k,) float32; the mean ABRDF is ``angular @ mean_texel``."""
        return self.texels.mean((0, 1)) if self.laid_mean is None else self.laid_mean

    @cached_property
    def mean_abrdf(self) -> np.ndarray:
        """(views, lights, 3) float32, the ABRDF averaged over all texels."""
        return self.angular @ self.mean_texel

    def abrdf(self, position_mm, to_light, to_eye) -> np.ndarray:
        """3 x 3 directions and 2 x 2 texels are blended: (n, 3) float32."""
        texel = blended(self.texels, *(np.asarray(position_mm, np.float64) / self.texel_mm - 0.5).T)
        views, view_share = interpolator(self.views).weights(to_eye)
        lights, light_share = interpolator(self.lights).weights(to_light)
        total = np.zeros((len(texel), 3), np.float32)
        for i in range(3):
            for j in range(3):
                value = np.einsum("nck,nk->nc", self.angular[views[:, i], lights[:, j]], texel)
                total += (view_share[:, i] * light_share[:, j]).astype(np.float32)[:, None] * value
        return total

    def mean_material(self) -> "Tabulated":
        """The same material with one texel: its mean ABRDF."""
        return Tabulated(
            self.name,
            self.material_class,
            np.ones((1, 1, 1), np.float32),
            self.mean_abrdf[..., None],
            self.views,
            self.lights,
            self.texel_mm * max(self.texels.shape[:2]),
            surface=self.surface,
        )

    def without_colours(self) -> "Tabulated":
        surface = self.surface and self.surface.without_colours()
        return replace(self, angular=grey(self.angular, axis=2), dye=None, surface=surface)

    def truncated(self, components: int | None) -> "Tabulated":
        return replace(self, texels=self.texels[..., :components], angular=self.angular[..., :components])


def blended(texels, x, y) -> np.ndarray:
    """Periodic bilinear look-up of texels (h, w, k) at places x, y (n,) between their centres: (n, k)."""
    h, w = texels.shape[:2]
    x0, y0 = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
    fx, fy = (x - x0).astype(np.float32)[:, None], (y - y0).astype(np.float32)[:, None]
    low, high = (texels[r % h, x0 % w] * (1 - fx) + texels[r % h, (x0 + 1) % w] * fx for r in (y0, y0 + 1))
    return low * (1 - fy) + high * fy


@dataclass(frozen=True)
class Lambertian(Material):
    """A perfectly diffuse reference material: albedo : (3,) linear RGB in [0, 1]."""

    name: str
    albedo: np.ndarray
    material_class: str = "reference"

    @property
    def matte_albedo(self) -> np.ndarray:
        return np.asarray(self.albedo, np.float64)

    def abrdf(self, position_mm, to_light, to_eye) -> np.ndarray:
        return np.broadcast_to(self.matte_albedo / np.pi, (len(position_mm), 3))

    def without_colours(self) -> "Lambertian":
        return replace(self, albedo=grey(self.albedo))

    def directional_albedo(self) -> np.ndarray:
        return self.matte_albedo[None]

    def diffuse_albedo(self) -> np.ndarray:
        return self.matte_albedo


@dataclass(frozen=True)
class Mirror(Material):
    """A perfect mirror: reflectance : (3,) linear RGB in [0, 1]."""

    name: str
    reflectance: np.ndarray
    material_class: str = "reference"

    @property
    def mirror_reflectance(self) -> np.ndarray:
        return np.asarray(self.reflectance, np.float64)

    def abrdf(self, position_mm, to_light, to_eye) -> np.ndarray:
        return np.zeros((len(position_mm), 3))

    def without_colours(self) -> "Mirror":
        return replace(self, reflectance=grey(self.reflectance))

    def directional_albedo(self) -> np.ndarray:
        return self.mirror_reflectance[None]

    def diffuse_albedo(self) -> np.ndarray:
        return self.mirror_reflectance
