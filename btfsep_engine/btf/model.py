# SPDX-License-Identifier: GPL-3.0-or-later
"""A material in memory.

One rule for the cosine: what is held here is **without** cos(theta_i), in 1/sr; the transport multiplies it
in, once. One model for all tabulated materials, linear in both factors:

    BTF(x, omega_i, omega_o)[c] = sum_k texels[x, k] * angular[view, light, c, k]
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from btfsep_engine.btf.directions import cosine_weights, interpolator, light_projection
from btfsep_engine.sh import evaluate


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
    laid_mean : (k,) float32, the mean texel over the surface on which the texels are laid once and in their own places
        (an image by a mesh's own UVs); None: they are a pattern that repeats, of which nobody knows where it starts
    """

    name: str
    material_class: str
    texels: np.ndarray
    angular: np.ndarray
    views: np.ndarray
    lights: np.ndarray
    texel_mm: float
    laid_mean: np.ndarray | None = None

    @property
    def has_texture(self) -> bool:
        """Whether it differs from place to place."""
        return self.texels.shape[:2] != (1, 1)

    @property
    def lines_up(self) -> bool:
        """Whether its texture is known to lie where the photo's does."""
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

    def light_coefficients(self, order: int) -> np.ndarray:
        """The light side projected onto real spherical harmonics, per view.

        Under a light of coefficients L in the local frame, a texel t seen from view v sends
        ``sum_jk result[v, c, k, j] texels[t, k] L[j, c]`` (nothing blocks the light, which comes from above).

        Returns
        -------
        (views, 3, k, (order + 1)^2) float32: the integrals of angular(view, omega) cos(theta) Y_j(omega)
        """
        q = light_projection(self.lights, lambda nodes: evaluate(order, nodes)).astype(np.float32)
        return np.einsum("vlck,lj->vckj", self.angular, q, optimize=True)

    def abrdf(self, position_mm, to_light, to_eye) -> np.ndarray:
        """Values at points: 3 x 3 directions and 2 x 2 texels are blended.

        Parameters
        ----------
        position_mm : (n, 2) float, along the tangent and the bitangent; the texture is periodic
        to_light, to_eye : (n, 3) float, unit, local, upper hemisphere

        Returns
        -------
        (n, 3) float32, 1/sr, without the cosine
        """
        h, w, _ = self.texels.shape
        x, y = (np.asarray(position_mm, np.float64) / self.texel_mm - 0.5).T
        column, row = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
        fx, fy = (x - column).astype(np.float32)[:, None], (y - row).astype(np.float32)[:, None]
        low, high = (
            self.texels[r % h, column % w] * (1 - fx) + self.texels[r % h, (column + 1) % w] * fx
            for r in (row, row + 1)
        )
        texel = low * (1 - fy) + high * fy
        views, view_share = interpolator(self.views).weights(to_eye)
        lights, light_share = interpolator(self.lights).weights(to_light)
        total = np.zeros((len(texel), 3), np.float32)
        for i in range(3):
            for j in range(3):
                value = np.einsum("nck,nk->nc", self.angular[views[:, i], lights[:, j]], texel)
                total += (view_share[:, i] * light_share[:, j]).astype(np.float32)[:, None] * value
        return total

    def albedo(self) -> np.ndarray:
        """(views, 3) float64: directional-hemispherical reflectance of the mean ABRDF; below 1 for what can exist."""
        return np.einsum("vlc,l->vc", self.mean_abrdf.astype(np.float64), cosine_weights(self.lights))

    def diffuse_albedo(self) -> np.ndarray:
        """(3,) float64: the share of light from all sides alike that the mean ABRDF reflects (bihemispherical)."""
        return cosine_weights(self.views) @ self.albedo() / np.pi

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


class _Analytic:
    """What materials without tables share with :class:`Tabulated`."""

    has_texture = lines_up = False

    def mean_material(self):
        """Itself."""
        return self


@dataclass(frozen=True)
class Lambertian(_Analytic):
    """A perfectly diffuse reference material: albedo : (3,) linear RGB in [0, 1]."""

    name: str
    albedo: np.ndarray
    material_class: str = "reference"

    def diffuse_albedo(self) -> np.ndarray:
        """(3,) float64, as :meth:`Tabulated.diffuse_albedo`."""
        return np.asarray(self.albedo, np.float64)


@dataclass(frozen=True)
class Mirror(_Analytic):
    """A perfect mirror: reflectance : (3,) linear RGB in [0, 1]."""

    name: str
    reflectance: np.ndarray
    material_class: str = "reference"

    def diffuse_albedo(self) -> np.ndarray:
        """(3,) float64, as :meth:`Tabulated.diffuse_albedo`."""
        return np.asarray(self.reflectance, np.float64)


Material = Tabulated | Lambertian | Mirror

REFERENCE = {
    "reference/white-diffuse": Lambertian("reference/white-diffuse", np.full(3, 0.8)),
    "reference/grey18": Lambertian("reference/grey18", np.full(3, 0.18)),
    "reference/chrome": Mirror("reference/chrome", np.array([0.55, 0.556, 0.554])),
}
