# SPDX-License-Identifier: GPL-3.0-or-later
"""The micro-BRDF of the displaced patches: a Lambertian base under a GGX dielectric layer, or a GGX conductor.

    f = (1 - m) (base / pi * (1 - E(n.l)) (1 - E(n.v)) / (1 - E_mean)  +  D V F)  +  m D V F_m

D: GGX with alpha = roughness^2; V: Smith, height-correlated (Heitz 2014); F: Fresnel's, of a dielectric; m: metallic;
F_m: Schlick's (1994), the base colour at normal incidence, as Principled's metal. E is the layer's own directional
albedo, E_mean its cosine-weighted mean (Kelemen and Szirmay-Kalos 2001): reciprocal, and with base = 1 the albedo is 1
up to the layer's own loss between facets (which a rough conductor has, too: nothing is scattered twice by the
microfacets). Blender's Principled BSDF weights its base by 1 - E(n.v) alone; both agree for light from all sides.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from btfsep_engine.render.arrays import dr, floats, mi

TABLE = 32  # nodes along n.v and along roughness
R2 = (0.7548776662466927, 0.5698402909980532)  # Roberts' sequence: the steps from one of them to the next


def _index(f0: float) -> float:
    """The refractive index whose reflectance at normal incidence is ``f0``."""
    return (1 + np.sqrt(f0)) / (1 - np.sqrt(f0))


def _fresnel(c, index, sqrt):
    """Unpolarised reflectance at the cosine ``c`` in [0, 1], from outside (Cook and Torrance 1982)."""
    g = sqrt(index * index - 1 + c * c)
    a, b = (g - c) / (g + c), (c * (g + c) - 1) / (c * (g - c) + 1)
    return 0.5 * a * a * (1 + b * b)


@lru_cache(maxsize=16)
def layer_albedo(f0: float) -> np.ndarray:
    """E[roughness, n.v] on nodes i / (TABLE - 1), (TABLE, TABLE) float64, by sampling D with 32 x 32 strata."""
    s = (np.arange(32) + 0.5) / 32
    u1, u2 = (a.ravel() for a in np.meshgrid(s, s))
    nv = np.maximum(np.linspace(0, 1, TABLE), 1e-3)[:, None]
    across = np.cos(2 * np.pi * u2)
    table = np.empty((TABLE, TABLE))
    for row, roughness in enumerate(np.linspace(0, 1, TABLE)):
        alpha2 = max(roughness, 0.05) ** 4
        nh = np.sqrt((1 - u1) / (1 + (alpha2 - 1) * u1))
        sh = np.sqrt(1 - nh * nh)
        vh = np.maximum(np.sqrt(1 - nv * nv) * sh * across + nv * nh, 0)
        nl = 2 * vh * nh - nv
        up = (nl > 0) & (vh > 0)
        nl = np.where(up, nl, 1.0)
        visible = 0.5 / (nl * np.sqrt(alpha2 + (1 - alpha2) * nv**2) + nv * np.sqrt(alpha2 + (1 - alpha2) * nl**2))
        # f cos / pdf with pdf = D n.h / (4 v.h)
        table[row] = (up * _fresnel(vh, _index(f0), np.sqrt) * visible * 4 * vh * nl / nh).mean(1)
    return np.minimum(table, 0.999)


@dataclass
class Facet:
    """Places of a surface and the eye, with all that does not depend on the light; Dr.Jit arrays of one width.

    Attributes
    ----------
    normal, view : Vector3f, unit
    cosine : Float, n.v, at least 0.001: places seen from behind are taken as seen at grazing angle
    diffuse : Color3f, what the base sends to the eye but for (1 - E(n.l)), 1/sr
    alpha2 : Float, alpha^2; masked : Float, Smith's root of the eye; row : Float, where E is in its table
    metallic : Float and metal_colour : Color3f, or None where nothing is metal
    """

    normal: object
    view: object
    cosine: object
    diffuse: object
    alpha2: object = None
    masked: object = None
    row: object = None
    metallic: object = None
    metal_colour: object = None

    def gathered(self, index) -> "Facet":
        """The facets of the numbers ``index : UInt32``."""
        return Facet(**{k: None if v is None else dr.gather(type(v), v, index) for k, v in vars(self).items()})

    def arrays(self) -> list:
        """What there is, for ``dr.eval``."""
        return [v for v in vars(self).values() if v is not None]


class Microfacets:
    """Evaluates and samples the micro-BRDF in Dr.Jit.

    Parameters
    ----------
    f0 : specular reflectance of the dielectric at normal incidence; 0 leaves its layer out (a pure Lambertian)
    metal : whether anything is metal
    as_principled : whether the base is weighted by 1 - E(n.v) alone, as in Blender: brighter than a reciprocal one
        under light that only grazes it
    """

    def __init__(self, f0: float, *, metal: bool = False, as_principled: bool = False):
        self.layered, self.metal, self.reciprocal = f0 > 0, metal, not as_principled
        self.glossy = self.layered or metal
        if self.layered:
            self.index = dr.opaque(mi.Float, _index(f0))  # opaque: one compiled kernel serves all materials
            table = layer_albedo(float(f0))
            mu = np.linspace(0, 1, TABLE)
            mean = ((table * 2 * mu)[:, 1:] + (table * 2 * mu)[:, :-1]).sum(1) / (2 * (TABLE - 1))
            self.table, self.mean = floats(table), floats(mean)

    def facet(self, base, roughness, normal, view, metallic=None) -> Facet:
        """A surface and an eye; ``base : Color3f``, ``roughness, metallic : Float``, unit ``normal, view``."""
        nv = dr.maximum(dr.dot(normal, view), 1e-3)
        diffuse = base * dr.inv_pi
        if not self.glossy:
            return Facet(normal, view, nv, diffuse)
        alpha2 = dr.square(dr.square(roughness))
        masked = dr.sqrt(alpha2 + (1 - alpha2) * nv * nv)
        row = dr.clip(roughness, 0, 1) * (TABLE - 1)
        if self.layered:
            diffuse = diffuse * (1 - self._albedo(row, nv))
            if self.reciprocal:
                r0, fr = self._floor(row)
                mean = dr.lerp(dr.gather(type(fr), self.mean, r0), dr.gather(type(fr), self.mean, r0 + 1), fr)
                diffuse = diffuse / (1 - mean)
        if not self.metal:
            return Facet(normal, view, nv, diffuse, alpha2, masked, row)
        return Facet(normal, view, nv, diffuse * (1 - metallic), alpha2, masked, row, metallic, base)

    @staticmethod
    def _floor(a):
        low = mi.UInt32(dr.minimum(dr.floor(a), TABLE - 2))
        return low, a - mi.Float(low)

    def _albedo(self, row, cosine):
        """E, linear between the nodes."""
        (r0, fr), (c0, fc) = self._floor(row), self._floor(dr.clip(cosine, 0, 1) * (TABLE - 1))
        at = r0 * TABLE + c0
        low = dr.lerp(dr.gather(mi.Float, self.table, at), dr.gather(mi.Float, self.table, at + 1), fc)
        high = dr.lerp(dr.gather(mi.Float, self.table, at + TABLE), dr.gather(mi.Float, self.table, at + TABLE + 1), fc)
        return dr.lerp(low, high, fr)

    def value_and_density(self, facet: Facet, light):
        """f, 1/sr, without the cosine, and the density of :meth:`lobe`, 1/sr; 0 for lights below the surface."""
        nl = dr.dot(facet.normal, light)
        lit = nl > 0
        nl = dr.maximum(nl, 1e-4)
        if not self.glossy:
            return dr.select(lit, facet.diffuse, 0), mi.Float(0)
        half = dr.normalize(facet.view + light)
        nh, vh = dr.clip(dr.dot(facet.normal, half), 0, 1), dr.clip(dr.dot(facet.view, half), 0, 1)
        a2 = facet.alpha2
        d = a2 * dr.inv_pi / dr.square(nh * nh * (a2 - 1) + 1)
        dv = d * 0.5 / (nl * facet.masked + facet.cosine * dr.sqrt(a2 + (1 - a2) * nl * nl))
        total = facet.diffuse
        if self.layered:
            layer = dv * _fresnel(vh, self.index, dr.sqrt)
            if self.reciprocal:
                total = total * (1 - self._albedo(facet.row, nl))
            total = total + layer * (1 - facet.metallic if self.metal else 1)
        if self.metal:
            grazing = dr.square(dr.square(1 - vh)) * (1 - vh)
            total = total + facet.metallic * dv * (facet.metal_colour + (1 - facet.metal_colour) * grazing)
        return dr.select(lit, total, 0), dr.select(lit, 0.5 * d / (facet.cosine + facet.masked), 0)

    def lobe(self, facet: Facet, u1, u2):
        """A direction that a facet visible to the eye reflects to it (Dupuy and Benyoub 2023), of the density
        D G1(n.v) / (4 n.v); it may lie below the surface. ``u1, u2`` : random numbers in [0, 1)."""
        frame, alpha = mi.Frame3f(facet.normal), dr.sqrt(facet.alpha2)
        eye = frame.to_local(facet.view)
        eye.z = facet.cosine
        stretched = dr.normalize(mi.Vector3f(eye.x * alpha, eye.y * alpha, eye.z))
        z = (1 - u2) * (1 + stretched.z) - stretched.z
        sine, (s, c) = dr.safe_sqrt(1 - z * z), dr.sincos(2 * dr.pi * u1)
        cap = mi.Vector3f(sine * c, sine * s, z) + stretched
        half = frame.to_world(dr.normalize(mi.Vector3f(cap.x * alpha, cap.y * alpha, cap.z)))
        return dr.normalize(2 * dr.dot(facet.view, half) * half - facet.view)

    def sample(self, facet: Facet, u1, u2, choice):
        """A direction onward, and f cos / pdf for it: half the time by the base's cosine, half by the lobe.

        ``u1``, ``u2``, ``choice`` : random numbers in [0, 1)
        """
        frame = mi.Frame3f(facet.normal)
        cosine = frame.to_world(mi.warp.square_to_cosine_hemisphere(mi.Point2f(u1, u2)))
        if not self.glossy:
            return cosine, facet.diffuse * dr.pi
        light = dr.select(choice < 0.5, cosine, self.lobe(facet, u1, u2))
        value, density = self.value_and_density(facet, light)
        nl = dr.maximum(dr.dot(facet.normal, light), 0)
        return light, value * nl / dr.maximum(0.5 * nl * dr.inv_pi + 0.5 * density, 1e-6)
