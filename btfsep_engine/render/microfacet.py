# SPDX-License-Identifier: GPL-3.0-or-later
"""The micro-BRDF of the displaced patches: a Lambertian base under a GGX dielectric layer.

    f = base / pi * (1 - E(n.l)) (1 - E(n.v)) / (1 - E_mean)  +  D V F

D: GGX with alpha = roughness^2; V: Smith, height-correlated; F: Fresnel's, of a dielectric. E is the layer's own
directional albedo, E_mean its cosine-weighted mean (Kelemen and Szirmay-Kalos 2001): reciprocal, and with base = 1
the albedo is 1 up to the layer's own loss between facets. Blender's Principled BSDF weights its base by
1 - E(n.v) alone; both agree for light from all sides.
"""

from functools import lru_cache

import numpy as np

TABLE = 32  # nodes along n.v and along roughness
MAX_WEIGHT = 2.0  # of a sampled direction; beyond it are grazing views of facets, rare and noisy


def _index(f0: float) -> float:
    """The refractive index whose reflectance at normal incidence is ``f0``."""
    return (1 + np.sqrt(f0)) / (1 - np.sqrt(f0))


def _fresnel(c, index, sqrt):
    """Unpolarised reflectance at the cosine ``c`` in [0, 1], from outside (Cook and Torrance 1982)."""
    g = sqrt(index * index - 1 + c * c)
    a, b = (g - c) / (g + c), (c * (g + c) - 1) / (c * (g - c) + 1)
    return 0.5 * a * a * (1 + b * b)


@lru_cache(maxsize=8)
def layer_albedo(f0: float) -> np.ndarray:
    """E[roughness, n.v] on nodes i / (TABLE - 1), (TABLE, TABLE) float64, by sampling D with 32 x 32 strata."""
    s = (np.arange(32) + 0.5) / 32
    u1, u2 = (a.ravel() for a in np.meshgrid(s, s))
    table = np.empty((TABLE, TABLE))
    for row, roughness in enumerate(np.linspace(0, 1, TABLE)):
        alpha2 = max(roughness, 0.05) ** 4
        nh = np.sqrt((1 - u1) / (1 + (alpha2 - 1) * u1))
        sh = np.sqrt(1 - nh * nh)
        for column, nv in enumerate(np.linspace(0, 1, TABLE)):
            nv = max(nv, 1e-3)
            vh = np.maximum(np.sqrt(1 - nv * nv) * sh * np.cos(2 * np.pi * u2) + nv * nh, 0)
            nl = 2 * vh * nh - nv
            up = (nl > 0) & (vh > 0)
            nl = np.where(up, nl, 1.0)
            visible = 0.5 / (nl * np.sqrt(alpha2 + (1 - alpha2) * nv**2) + nv * np.sqrt(alpha2 + (1 - alpha2) * nl**2))
            fresnel = _fresnel(vh, _index(f0), np.sqrt)
            # f cos / pdf with pdf = D n.h / (4 v.h)
            table[row, column] = (up * fresnel * visible * 4 * vh * nl / nh).mean()
    return np.minimum(table, 0.999)


class Dielectric:
    """Evaluates the micro-BRDF in Dr.Jit. The renderer's variant has to be set before it is made.

    Parameters
    ----------
    f0 : specular reflectance at normal incidence; 0 leaves the layer out (a pure Lambertian)
    """

    def __init__(self, f0: float):
        import drjit as dr
        import mitsuba as mi

        self.layered = f0 > 0
        if self.layered:
            self.index = dr.opaque(mi.Float, _index(f0))  # opaque: one compiled kernel serves all materials
            table = layer_albedo(float(f0))
            mu = np.linspace(0, 1, TABLE)
            mean = (
                np.trapezoid(table * 2 * mu, mu, axis=1) if hasattr(np, "trapezoid") else np.trapz(table * 2 * mu, mu)
            )
            self.table, self.mean = mi.Float(table.ravel().astype(np.float32)), mi.Float(mean.astype(np.float32))

    def _albedo(self, roughness, cosine):
        """E(n.v) and E_mean, linear between the nodes."""
        import drjit as dr
        import mitsuba as mi

        r, c = (dr.clip(a, 0, 1) * (TABLE - 1) for a in (roughness, cosine))
        r0, c0 = (mi.UInt32(dr.minimum(dr.floor(a), TABLE - 2)) for a in (r, c))
        fr, fc = r - mi.Float(r0), c - mi.Float(c0)
        at = r0 * TABLE + c0
        low = dr.lerp(dr.gather(mi.Float, self.table, at), dr.gather(mi.Float, self.table, at + 1), fc)
        high = dr.lerp(dr.gather(mi.Float, self.table, at + TABLE), dr.gather(mi.Float, self.table, at + TABLE + 1), fc)
        mean = dr.lerp(dr.gather(mi.Float, self.mean, r0), dr.gather(mi.Float, self.mean, r0 + 1), fr)
        return dr.lerp(low, high, fr), mean

    def value(self, base, roughness, normal, view, light):
        """f, 1/sr, without the cosine; directions point away from the surface. 0 for lights below it.

        Places seen from behind their smoothed normal are taken as seen at grazing angle.
        """
        import drjit as dr

        nl, nv = dr.dot(normal, light), dr.maximum(dr.dot(normal, view), 1e-3)
        lit = nl > 0
        nl = dr.maximum(nl, 1e-4)
        if not self.layered:
            return dr.select(lit, base * dr.inv_pi, 0)
        alpha2 = dr.square(dr.square(roughness))
        half = dr.normalize(view + light)
        nh, vh = dr.clip(dr.dot(normal, half), 0, 1), dr.clip(dr.dot(view, half), 0, 1)
        d = alpha2 * dr.inv_pi / dr.square(nh * nh * (alpha2 - 1) + 1)
        v = 0.5 / (nl * dr.sqrt(alpha2 + (1 - alpha2) * nv * nv) + nv * dr.sqrt(alpha2 + (1 - alpha2) * nl * nl))
        (e_l, mean), (e_v, _) = self._albedo(roughness, nl), self._albedo(roughness, nv)
        diffuse = dr.inv_pi * (1 - e_l) * (1 - e_v) / (1 - mean)
        return dr.select(lit, base * diffuse + d * v * _fresnel(vh, self.index, dr.sqrt), 0)

    def sample(self, base, roughness, normal, view, u1, u2, choice):
        """A direction onward, and f cos / pdf for it: half the time by the base's cosine, half by the layer's D.

        Parameters
        ----------
        u1, u2, choice : random numbers in [0, 1)
        """
        import drjit as dr
        import mitsuba as mi

        frame = mi.Frame3f(normal)
        cosine = frame.to_world(mi.warp.square_to_cosine_hemisphere(mi.Point2f(u1, u2)))
        if not self.layered:
            return cosine, base
        alpha2 = dr.square(dr.square(roughness))
        c2 = (1 - u1) / (1 + (alpha2 - 1) * u1)
        s, (sin, cos) = dr.safe_sqrt(1 - c2), dr.sincos(2 * dr.pi * u2)
        half = frame.to_world(mi.Vector3f(s * cos, s * sin, dr.sqrt(c2)))
        light = dr.select(choice < 0.5, cosine, 2 * dr.dot(view, half) * half - view)
        half = dr.normalize(view + light)
        nh, vh, nl = dr.dot(normal, half), dr.dot(view, half), dr.dot(normal, light)
        d = alpha2 * dr.inv_pi / dr.square(nh * nh * (alpha2 - 1) + 1)
        pdf = 0.5 * dr.maximum(nl, 0) * dr.inv_pi + 0.5 * d * dr.abs(nh) / (4 * dr.maximum(vh, 1e-4))
        value = self.value(base, roughness, normal, view, light) * dr.maximum(nl, 0)
        return light, dr.minimum(value / dr.maximum(pdf, 1e-6), MAX_WEIGHT)
