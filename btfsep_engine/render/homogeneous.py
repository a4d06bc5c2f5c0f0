# SPDX-License-Identifier: GPL-3.0-or-later
"""Materials made from numbers: the micro-BRDF of a flat surface as a table over the library's views and lights.

The micro-BRDF (:mod:`btfsep_engine.render.microfacet`) is linear in the base colour b, f = b A + B: the metal's
reflectance is b (1 - g) + g with Schlick's g. So one table of A and B serves all colours of a roughness and a specular:
a surface of one colour has one texel, one with an image of base colours the texels (r, g, b, 1).

A metal is brighter by what its microfacets scatter more than once, as Principled's default *Multiscatter GGX* has it in
Cycles (Turquin 2019): times 1 + F_ms (1 - E) / E, E the albedo of a white metal from that view, E_mean its
cosine-weighted mean, F_ms = F E_mean / (1 - F (1 - E_mean)), F the mean of Schlick's reflectance, b + (1 - b) / 21.
White stays white; it is not quite reciprocal. The texels of an image then have b F_ms and F_ms, too.

Over these may lie a clear coat, a dielectric's layer alone, and microfibres, Principled's sheen (Zeltner, Burley and
Chiang 2022): what is below each is seen by what it does not reflect itself towards the view, as in Cycles.

A value is the average over its light's hat, as the library's are (:mod:`btfsep_engine.render.hats`), but without noise:
a quadrature of the hemisphere and directions of the lobe, joined by the balance heuristic (Veach 1997). The nodes are
those with which tables are integrated (:func:`btfsep_engine.btf.directions.light_projection`): a diffuse base keeps its
energy exactly.
"""

from contextlib import suppress
from dataclasses import replace
from functools import lru_cache

import numpy as np

from btfsep_engine.btf.directions import cosine_weights, hemisphere_quadrature, interpolator, ubo2014_directions
from btfsep_engine.btf.model import Tabulated
from btfsep_engine.btf.surfaces import CLASS, Surface
from btfsep_engine.errors import InputError
from btfsep_engine.imaging.images import resized
from btfsep_engine.job.model import TriangleMesh
from btfsep_engine.render.appearance import spatial_factors
from btfsep_engine.render.arrays import dr, floats, mi, vector
from btfsep_engine.render.hats import sharpened
from btfsep_engine.render.microfacet import R2, Microfacets
from btfsep_engine.render.parametrise import mean_scale
from btfsep_engine.storage import cache

COAT_F0 = 0.04  # of the index 1.5
LEAST_ROUGHNESS = 0.05  # narrower lobes overflow single precision, and the table is much wider anyway
LOBE = 1024  # directions of the lobe for each view
PLACES = 1 << 14  # of a mesh, at which the image is looked at for its mean
IMAGE_SIDE = 64  # of an image of what a surface reflects


def homogeneous(surface: Surface, name: str) -> Tabulated:
    """The material of a surface of one colour: one texel."""
    texels, angular = _factors(surface, np.asarray(surface.base_color)[None, None])
    directions = ubo2014_directions()
    return Tabulated(name, CLASS, texels, angular, directions, directions, 1.0, surface=surface).mean_material()


def pictured(surface: Surface, name: str, mesh: TriangleMesh, *, millimetres_per_unit: float) -> Tabulated:
    """The material of a surface with an image of base colours, maybe of finishes, laid by the mesh's own UVs.

    Raises InputError when the UVs have no area.
    """
    parts = []
    for share, of_kind in surface.kinds():
        texels, angular = _factors(of_kind, surface.image)
        parts.append((texels * np.broadcast_to(share, texels.shape[:2])[..., None], angular))
    texels, angular = (np.concatenate(each, -1) for each in zip(*parts, strict=True))
    texels = np.ascontiguousarray(texels[::-1])  # row 0 is the smallest v
    directions = ubo2014_directions()
    edge = mean_scale(mesh, mesh.corner_uv) * millimetres_per_unit  # of the image, which is one unit of UV wide
    material = Tabulated(name, CLASS, texels, angular, directions, directions, edge / len(texels))
    return replace(material, laid_mean=_mean_over(material, mesh, edge))


def reflected_share(surface: Surface) -> np.ndarray:
    """How much of light from all sides a surface reflects: (3,), or (n, n, 3), n at most `IMAGE_SIDE`, of an image.

    Between black and white it is taken to be linear in the base colour, as it is of what is no metal.
    """
    if surface.image is None:
        return homogeneous(surface, CLASS).diffuse_albedo()
    side, total = min(IMAGE_SIDE, len(surface.image)), 0.0
    for share, of_kind in surface.kinds():
        black, white = (homogeneous(replace(of_kind, base_color=(c, c, c)), CLASS).diffuse_albedo() for c in (0.0, 1.0))
        reflected = black + surface.image * (white - black)
        total = total + resized((reflected * np.reshape(share, (*np.shape(share), 1))).astype(np.float32), side)
    return total


def under_beams(surface: Surface, normals, to_eye, directions) -> np.ndarray:
    """f cos of a `Surface.plain` one at points under beams, without shadows: (p, n, 3) float32, 1/sr.

    The micro-BRDF itself. A table's lobes are as wide as its directions lie apart, some 15 degrees, and at grazing
    angles it errs by half: what light from behind makes of a rim, and a lamp of gloss.

    Parameters
    ----------
    normals, to_eye : (p, 3) float, unit; directions : (n, 3) float, unit, to the light
    """
    lane, count = dr.arange(mi.UInt32, len(normals) * len(directions)), len(directions)
    point = lane // count
    normal, eye = (dr.gather(mi.Vector3f, vector(each), point) for each in (normals, to_eye))
    light = dr.gather(mi.Vector3f, vector(directions), lane - point * count)
    material = Microfacets(surface.f0, as_principled=True)
    roughness = dr.opaque(mi.Float, max(float(surface.roughness), LEAST_ROUGHNESS))
    base = mi.Color3f(*(dr.opaque(mi.Float, float(c)) for c in surface.base_color))
    value, _ = material.value_and_density(material.facet(base, roughness, normal, eye), light)
    value = value * dr.maximum(dr.dot(normal, light), 0)
    dr.eval(value)
    return np.stack([value[c].numpy() for c in range(3)], -1).reshape(len(normals), count, 3)


def _factors(surface: Surface, colours) -> tuple[np.ndarray, np.ndarray]:
    """Texels (h, w, k) and angular (views, lights, 3, k) of a surface of base colours (h, w, 3)."""
    roughness, m = max(surface.roughness, LEAST_ROUGHNESS), surface.metallic
    metal = m * flat_table(roughness, 0.0, metal=True) if m > 0 else np.zeros(1)
    table = metal + (1 - m) * flat_table(roughness, surface.f0, metal=False) if m < 1 else metal
    texels, parts = [colours, np.ones_like(colours[..., :1])], [table[..., :1], table[..., 1:]]
    if m > 0:
        weight = cosine_weights(ubo2014_directions())
        white = metal.sum(2) @ weight / m
        mean, once = weight @ white / np.pi, colours + (1 - colours) / 21
        again = once * mean / (1 - once * (1 - mean))
        texels += [colours * again, again]
        parts += [metal[..., i : i + 1] * ((1 - white) / white)[:, None, None] for i in (0, 1)]
    over, below = _layers(surface)
    parts = [part * below for part in parts]
    parts[1] = parts[1] + over
    widths = [t.shape[-1] for t in texels]
    angular = np.zeros((*table.shape[:2], 3, sum(widths)), np.float32)
    for part, width, end in zip(parts, widths, np.cumsum(widths), strict=True):
        channels = range(3)  # of one number for all channels, or one for each
        angular[:, :, channels, [end - width + (c if width == 3 else 0) for c in channels]] = part
    return np.concatenate(texels, -1).astype(np.float32), angular


def _layers(surface: Surface) -> tuple[np.ndarray, np.ndarray]:
    """What coat and sheen send themselves, (views, lights, 3), and how much below them is seen, (views, 1, 1)."""
    weight, over, below = cosine_weights(ubo2014_directions()), np.zeros((1, 1, 3)), np.ones((1, 1, 1))
    if surface.coat > 0:
        roughness = max(surface.coat_roughness, LEAST_ROUGHNESS)
        clear = surface.coat * flat_table(roughness, COAT_F0, metal=False)[..., 1:]
        over, below = over + clear, below * (1 - (clear[..., 0] @ weight))[:, None, None]
    if any(surface.sheen):
        fibres = sheen_table(surface.sheen_roughness)[..., None] * np.asarray(surface.sheen)
        through = (1 - (fibres.max(-1) @ weight))[:, None, None]
        over, below = fibres + through * over, through * below
    return over, below


@lru_cache(maxsize=16)
def sheen_table(roughness: float) -> np.ndarray:
    """Principled's microfibres, of weight and tint 1: (views, lights) float64, 1/sr, without the cosine.

    Linearly transformed cosines and an albedo for each view, by the rational fits of Zeltner, Burley and Chiang (2022).
    """
    directions = ubo2014_directions()
    x, y = np.clip(directions[:, 2], 1e-3, 1), np.clip(roughness, 0.01, 1)
    spread = y * (0.0206607 + 1.58491 * y) / (0.0379424 + y * (1.32227 + y))
    middle = y * (-0.193854 + y * (-1.14885 + y * (1.7932 - 0.95943 * y * y))) / (0.046391 + y)
    floor = y * (0.000654023 + (-0.0207818 + 0.119681 * y) * y) / (1.26264 + y * (-1.92021 + y))
    albedo = np.exp(-0.5 * ((x - middle) / spread) ** 2) / (spread * np.sqrt(2 * np.pi)) + floor
    a = (2.58126 * x + 0.813703 * y) * y / (1 + 0.310327 * x * x + 2.60994 * x * y)
    b = np.sqrt(1 - x) * (y - 1) * y**3 / (0.0000254053 + 1.71228 * x - 1.71506 * x * y + 1.34174 * y * y)
    flat = np.linalg.norm(directions[:, :2], axis=1)
    along = np.divide(directions[:, :2], flat[:, None], out=np.tile([1.0, 0.0], (len(x), 1)), where=flat[:, None] > 0)
    forward = along @ directions[:, :2].T
    aside = np.stack([-along[:, 1], along[:, 0]], -1) @ directions[:, :2].T
    up = directions[None, :, 2]
    a, b = a[:, None], b[:, None]
    table = np.square(a / (np.square(a * forward + b * up) + np.square(a * aside) + up * up)) / np.pi
    table *= (np.clip(albedo, 0, 1) / (table @ cosine_weights(directions)))[:, None]
    table.flags.writeable = False  # it is shared
    return table


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
    return spatial_factors(material, uv, np.zeros((PLACES, 2, 2))).mean(0, dtype=np.float64).astype(np.float32)


@lru_cache(maxsize=16)
def flat_table(roughness: float, f0: float, *, metal: bool) -> np.ndarray:
    """A and B (see above; microfacets scatter once) over UBO2014's views and lights, 1/sr, without the cosine.

    Parameters
    ----------
    roughness : [LEAST_ROUGHNESS, 1]
    f0 : reflectance of the dielectric straight on; 0 of a metal

    Returns
    -------
    (151, 151, 2) float32, not writable; [view, light]
    """
    key = cache.digest("flat table 2", roughness, f0, metal, LOBE)
    stored, count = cache.cache_folder() / "surfaces" / f"{key[:32]}.entry", len(ubo2014_directions())
    kept = cache.read(stored, {"table": (count, count, 2)})
    table = kept["table"] if kept else _quadrature(roughness, f0, metal=metal)
    if not kept:
        with suppress(InputError):
            cache.write(stored, {"table": table})
    table.flags.writeable = False  # it is shared
    return table


def _quadrature(roughness: float, f0: float, *, metal: bool) -> np.ndarray:
    """The table of :func:`flat_table`, integrated: 0.4 s of processor time."""
    directions = ubo2014_directions()
    count, (nodes, weights) = len(directions), hemisphere_quadrature()
    density = len(nodes) / (2 * np.pi)
    flat = _Flat(roughness, f0, metal=metal)
    hats = interpolator(directions).hats(nodes)
    values = flat.at_nodes(directions, nodes, density) * (density * weights)[None, :, None]
    total = hats @ values.transpose(1, 0, 2).reshape(len(nodes), -1)
    total = total.reshape(count, count, 2).transpose(1, 0, 2)
    if flat.material.glossy:
        lights, values = flat.at_lobes(directions, density)
        for view, (of_view, light) in enumerate(zip(values, lights, strict=True)):
            total[view] += interpolator(directions).hats(light) @ of_view
    table = np.ascontiguousarray(total / (hats @ (weights * nodes[:, 2]))[None, :, None])
    # each of the two for itself, so that a colour and an image of that colour are one material
    return np.stack(
        [sharpened(np.repeat(table[:, :, None, i : i + 1], 3, 2), directions)[:, :, 0, 0] for i in (0, 1)], -1
    )


class _Flat:
    """A flat surface of the micro-BRDF: A cos and B cos over the density with which lights are looked at."""

    def __init__(self, roughness: float, f0: float, *, metal: bool):
        self.roughness = roughness
        self.material = Microfacets(f0, metal=metal, as_principled=True)

    def _facet(self, views, number):
        """The surface seen from the views of these numbers: red has the base colour 0, green 1."""
        view = dr.gather(mi.Vector3f, vector(views), number)
        roughness = dr.opaque(mi.Float, float(self.roughness))  # opaque: one compiled kernel serves all surfaces
        return self.material.facet(mi.Color3f(0, 1, 1), roughness, mi.Vector3f(0, 0, 1), view, mi.Float(1))

    def _weighed(self, facet, light, density: float, shape) -> np.ndarray:
        value, of_lobe = self.material.value_and_density(facet, light)
        value *= light.z / (density + LOBE * of_lobe)
        dr.eval(value)
        none, whole = (value[i].numpy().reshape(shape) for i in (0, 1))
        return np.stack([whole - none, none], -1)

    def at_nodes(self, views, nodes, density: float) -> np.ndarray:
        """(views, nodes, 2) float32."""
        lane = dr.arange(mi.UInt32, len(views) * len(nodes))
        view = lane // len(nodes)
        light = dr.gather(mi.Vector3f, vector(nodes), lane - view * len(nodes))
        return self._weighed(self._facet(views, view), light, density, (len(views), len(nodes)))

    def at_lobes(self, views, density: float):
        """LOBE directions of each view's lobe (views, LOBE, 3) and the values there (views, LOBE, 2)."""
        lane = dr.arange(mi.UInt32, len(views) * LOBE)
        view = lane // LOBE
        facet = self._facet(views, view)
        u1, u2 = (np.modf((np.arange(LOBE) + 0.5) * step)[0] for step in R2)
        u1, u2 = (dr.gather(mi.Float, floats(u), lane - view * LOBE) for u in (u1, u2))
        light = self.material.lobe(facet, u1, u2)
        dr.eval(light)
        lights = np.stack([c.numpy() for c in light], -1).reshape(len(views), LOBE, 3)
        return lights, self._weighed(facet, light, density, (len(views), LOBE))
