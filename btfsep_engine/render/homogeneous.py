# SPDX-License-Identifier: GPL-3.0-or-later
"""Materials made from numbers: the micro-BRDF of a flat surface as a table over the library's views and lights.

The micro-BRDF (:mod:`btfsep_engine.render.microfacet`) is linear in the base colour b, f = b A + B: the metal's
reflectance is b (1 - g) + g with Schlick's g. So one table of A and B serves all colours of a roughness, a metallic and
a specular: a surface of one colour has one texel, one with an image of base colours the texels (r, g, b, 1).

A value is the average over its light's hat, as the library's are (:mod:`btfsep_engine.render.hats`), but without noise:
a quadrature of the hemisphere and directions of the lobe, joined by the balance heuristic (Veach 1997). The nodes are
those with which tables are integrated (:func:`btfsep_engine.btf.directions.light_projection`): a diffuse base keeps its
energy exactly.
"""

from dataclasses import replace
from functools import lru_cache

import numpy as np
from scipy.sparse import csr_array

from btfsep_engine.btf.directions import hemisphere_quadrature, interpolator, ubo2014_directions
from btfsep_engine.btf.model import Tabulated
from btfsep_engine.btf.surfaces import CLASS, Surface
from btfsep_engine.job.model import TriangleMesh
from btfsep_engine.render.appearance import spatial_factors
from btfsep_engine.render.backend import import_mitsuba
from btfsep_engine.render.hats import sharpened
from btfsep_engine.render.microfacet import Microfacets
from btfsep_engine.render.parametrise import mean_scale
from btfsep_engine.render.patch import R2

LEAST_ROUGHNESS = 0.05  # narrower lobes overflow single precision, and the table is much wider anyway
LOBE = 1024  # directions of the lobe for each view
PLACES = 1 << 14  # of a mesh, at which the image is looked at for its mean


def homogeneous(surface: Surface, name: str) -> Tabulated:
    """The material of a surface of one colour: one texel."""
    table = flat_table(max(surface.roughness, LEAST_ROUGHNESS), surface.metallic, surface.f0)
    angular = table[..., :1] * np.asarray(surface.base_color, np.float32) + table[..., 1:]
    directions = ubo2014_directions()
    return Tabulated(name, CLASS, np.ones((1, 1, 1), np.float32), angular[..., None], directions, directions, 1.0)


def pictured(surface: Surface, name: str, mesh: TriangleMesh, *, millimetres_per_unit: float) -> Tabulated:
    """The material of a surface with an image of base colours, laid by the mesh's own UVs.

    Raises
    ------
    InputError
        When the UVs have no area.
    """
    table = flat_table(max(surface.roughness, LEAST_ROUGHNESS), surface.metallic, surface.f0)
    angular = np.zeros((*table.shape[:2], 3, 4), np.float32)
    angular[:, :, range(3), range(3)] = table[..., :1]
    angular[..., 3] = table[..., 1:]
    side, directions = len(surface.image), ubo2014_directions()
    texels = np.ones((side, side, 4), np.float32)
    texels[..., :3] = surface.image[::-1]  # row 0 is the smallest v
    edge = mean_scale(mesh, mesh.corner_uv) * millimetres_per_unit  # of the image, which is one unit of UV wide
    everywhere = Tabulated(name, CLASS, texels, angular, directions, directions, edge / side)
    return replace(everywhere, laid_mean=_mean_over(everywhere, mesh, edge))


def _mean_over(material: Tabulated, mesh: TriangleMesh, edge: float) -> np.ndarray:
    """(k,) the mean texel over a mesh: an atlas has places that no face shows."""
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
    reached = np.cumsum(np.linalg.norm(np.cross(b - a, c - a), axis=1))
    number = np.arange(PLACES) + 0.5
    face = np.minimum(np.searchsorted(reached, number / PLACES * reached[-1]), len(reached) - 1)
    s, t = (np.modf(number * step)[0] for step in R2)
    s = np.sqrt(s)
    weights = np.stack([1 - s, s * (1 - t), s * t], -1)
    uv = (weights[..., None] * mesh.corner_uv[face]).sum(1) * edge
    return spatial_factors(material, uv, np.zeros((PLACES, 2, 2))).mean(0)


@lru_cache(maxsize=16)
def flat_table(roughness: float, metallic: float, f0: float) -> np.ndarray:
    """A and B (see above) over UBO2014's views and lights, 1/sr, without the cosine.

    Parameters
    ----------
    roughness, metallic : [0, 1]; f0 : reflectance of the dielectric straight on

    Returns
    -------
    (151, 151, 2) float32, not writable; [view, light]
    """
    directions = ubo2014_directions()
    count, (nodes, weights) = len(directions), hemisphere_quadrature()
    density = len(nodes) / (2 * np.pi)
    flat = _Flat(roughness, metallic, f0)
    hats = _hats(directions, nodes)
    values = flat.at_nodes(directions, nodes, density) * (density * weights)[None, :, None]
    total = hats @ values.transpose(1, 0, 2).reshape(len(nodes), -1)
    total = total.reshape(count, count, 2).transpose(1, 0, 2)
    if flat.material.glossy:
        lights, values = flat.at_lobes(directions, density)
        for view, (of_view, light) in enumerate(zip(values, lights, strict=True)):
            total[view] += _hats(directions, light) @ of_view
    table = np.ascontiguousarray(total / (hats @ (weights * nodes[:, 2]))[None, :, None])
    # each of the two for itself, so that a colour and an image of that colour are one material
    table = np.stack(
        [sharpened(np.repeat(table[:, :, None, i : i + 1], 3, 2), directions)[:, :, 0, 0] for i in (0, 1)], -1
    )
    table.flags.writeable = False  # it is shared
    return table


def _hats(directions, lights) -> csr_array:
    """(directions, lights): the weight of each direction's hat at each light."""
    index, share = interpolator(directions).weights(lights)
    return csr_array(
        (share.ravel(), (index.ravel(), np.repeat(np.arange(len(lights)), 3))), (len(directions), len(lights))
    )


class _Flat:
    """A flat surface of the micro-BRDF: A cos and B cos over the density with which lights are looked at."""

    def __init__(self, roughness: float, metallic: float, f0: float):
        self.mi = import_mitsuba()
        self.roughness, self.metallic = roughness, metallic
        self.material = Microfacets(f0, metal=metallic > 0)

    def _facet(self, views, number):
        """The surface seen from the views of these numbers: red has the base colour 0, green 1."""
        import drjit as dr

        mi = self.mi
        view = dr.gather(mi.Vector3f, mi.Vector3f(*views.T.astype(np.float32)), number)
        base, roughness, metallic = (
            mi.Color3f(0, 1, 1),
            *(dr.opaque(mi.Float, float(value)) for value in (self.roughness, self.metallic)),
        )  # opaque: one compiled kernel serves all surfaces
        return self.material.facet(base, roughness, mi.Vector3f(0, 0, 1), view, metallic)

    def _weighed(self, facet, light, density: float, shape) -> np.ndarray:
        import drjit as dr

        value, of_lobe = self.material.value_and_density(facet, light)
        value *= light.z / (density + LOBE * of_lobe)
        dr.eval(value)
        none, whole = (value[i].numpy().reshape(shape) for i in (0, 1))
        return np.stack([whole - none, none], -1)

    def at_nodes(self, views, nodes, density: float) -> np.ndarray:
        """(views, nodes, 2) float32."""
        import drjit as dr

        mi = self.mi
        lane = dr.arange(mi.UInt32, len(views) * len(nodes))
        view = lane // len(nodes)
        light = dr.gather(mi.Vector3f, mi.Vector3f(*nodes.T.astype(np.float32)), lane - view * len(nodes))
        return self._weighed(self._facet(views, view), light, density, (len(views), len(nodes)))

    def at_lobes(self, views, density: float):
        """LOBE directions of each view's lobe (views, LOBE, 3) and the values there (views, LOBE, 2)."""
        import drjit as dr

        mi = self.mi
        lane = dr.arange(mi.UInt32, len(views) * LOBE)
        view = lane // LOBE
        facet = self._facet(views, view)
        u1, u2 = (np.modf((np.arange(LOBE) + 0.5) * step)[0].astype(np.float32) for step in R2)
        u1, u2 = (dr.gather(mi.Float, mi.Float(u), lane - view * LOBE) for u in (u1, u2))
        light = self.material.lobe(facet, u1, u2)
        dr.eval(light)
        lights = np.stack([c.numpy() for c in light], -1).reshape(len(views), LOBE, 3)
        return lights, self._weighed(facet, light, density, (len(views), LOBE))
