# SPDX-License-Identifier: GPL-3.0-or-later
"""The virtual gonioreflectometer: a BTF measured by path-tracing a displaced, periodic patch.

The patch is a height field, three by three tiles of it, with the micro-BRDF of
:class:`btfsep_engine.btf.procedural.Maps`: a Lambertian base under a GGX layer, coupled so that the sum is
reciprocal and keeps energy. For every view one path starts at each texel and sample; each of its vertices is
connected to **all** lights, so that the path is shared by them.

Texels lie on the *reference plane*, the plane of the mean height: a view's ray goes through the texel's place on
that plane, so the parallax of higher and lower places is in the data, as in a rectified measurement.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from btfsep_engine.btf.directions import ubo2014_directions
from btfsep_engine.btf.factorise import StreamingFactoriser
from btfsep_engine.btf.model import Tabulated
from btfsep_engine.btf.procedural import Maps
from btfsep_engine.progress import Reporter
from btfsep_engine.render.backend import import_mitsuba
from btfsep_engine.render.microfacet import Dielectric

BOUNCES = 3  # path vertices that are connected to the lights
INDIRECT_ROUGHNESS = 0.4  # least roughness of what is seen by reflection: its highlights would be fireflies


@dataclass(frozen=True)
class Measurement:
    """A material, and the ``relative_error`` of its factors (see :class:`btfsep_engine.btf.factorise.Factors`)."""

    material: Tabulated
    relative_error: float


def measure(
    maps: Maps,
    *,
    texels: int = 96,
    samples: int = 2,
    components: int = 14,
    lights=None,
    views=None,
    seed: int = 0,
    reporter: Reporter | None = None,
    checkpoints=None,
) -> Measurement:
    """Measures and factorises a patch, with cos(theta_i) as the weight of the fit.

    Parameters
    ----------
    maps : the patch; its resolution is that of the mesh of a tile
    texels : along an edge of the patch
    samples : paths a texel and view
    components : of the factorisation, the mean included
    lights, views : (n, 3) float, unit, local; None: the 151 directions of UBO2014
    seed : the same seed on the same machine gives the same material
    checkpoints : where finished views are kept (:class:`btfsep_engine.checkpoints.Checkpoints`), or None: nowhere.
        A run that takes them up gives the same material, bit by bit

    Returns
    -------
    Measurement
    """
    reporter = reporter or Reporter()
    lights, views = (ubo2014_directions() if d is None else np.asarray(d, np.float64) for d in (lights, views))
    factoriser = StreamingFactoriser(texels * texels, components, seed=seed)
    patch = Patch(maps, lights, seed=seed)
    for kept in checkpoints.load() if checkpoints else ():
        factoriser.take_back(kept)
    saved = len(factoriser.means)
    first = saved // 3  # three blocks a view, one a channel
    for number, block in enumerate(patch.views(views, texels=texels, samples=samples, first=first), first):
        for channel in block:
            factoriser.add(channel)
        if checkpoints and checkpoints.due(last=number == len(views) - 1):
            checkpoints.save(factoriser.taken(saved))
            saved = len(factoriser.means)
        reporter.progress("measure", (number + 1) / len(views), maps.name)
    factors = factoriser.finish()
    angular = factors.angular.reshape(len(views), 3, len(lights), -1).transpose(0, 2, 1, 3)
    angular = angular / lights[None, :, 2, None, None].astype(np.float32)
    material = Tabulated(
        name=maps.name,
        material_class=maps.material_class,
        texels=factors.texels.reshape(texels, texels, -1),
        angular=angular,
        views=views,
        lights=lights,
        texel_mm=maps.size_mm / texels,
    )
    return Measurement(material, factors.relative_error)


class Patch:
    """A displaced patch, ready to be looked at under a list of directional lights.

    Parameters
    ----------
    maps : the patch
    lights : (n, 3) float, unit, above the horizon
    seed : of all random numbers
    """

    def __init__(self, maps: Maps, lights, *, seed: int = 0):
        import_mitsuba()
        import drjit as dr
        import mitsuba as mi

        self.maps, self.seed = maps, seed
        self.lights = np.ascontiguousarray(lights, np.float32)
        self.n = len(maps.height_mm)
        self.size = dr.opaque(mi.Float, maps.size_mm)  # opaque: one compiled kernel serves all materials
        self.top = float(maps.height_mm.max() + 0.01 * maps.size_mm)
        self.scene = mi.load_dict({"type": "scene", "patch": _mesh(mi, maps)})
        attributes = np.concatenate([maps.base_colour, maps.roughness[..., None]], -1)
        self.attributes = mi.Float(np.ascontiguousarray(attributes, np.float32).ravel())
        self.material = Dielectric(maps.f0)
        self.light_x, self.light_y, self.light_z = (mi.Float(np.ascontiguousarray(c)) for c in self.lights.T)
        dr.eval(self.attributes, self.light_x, self.light_y, self.light_z)

    def _light(self, index):
        import drjit as dr
        import mitsuba as mi

        return mi.Vector3f(*(dr.gather(mi.Float, c, index) for c in (self.light_x, self.light_y, self.light_z)))

    def views(self, views, *, texels: int, samples: int, first: int = 0) -> Iterator[np.ndarray]:
        """Looks at the patch from each view in turn, from number ``first`` on (each has its own random numbers).

        Yields
        ------
        (3, texels * texels, lights) float32, radiance under a directional light of unit irradiance (measured across
        its beam): the BTF **times cos(theta_i)**, 1/sr; texel = row * texels + column, row 0 at the smallest v
        """
        for number, view in enumerate(np.asarray(views, np.float64)[first:], first):
            total = None
            for sample in range(samples):
                vertices = self._paths(view, texels, self.seed + 7919 * (number * samples + sample) + 2)
                light = self._connect(vertices, texels * texels)
                total = light if total is None else total + light
            yield (total / samples).reshape(3, texels * texels, len(self.lights))

    def _paths(self, view, texels: int, seed: int):
        """One path a texel: a list of vertices, dicts of Dr.Jit arrays, those that left the patch taken out."""
        import drjit as dr
        import mitsuba as mi

        count = texels * texels
        texel = dr.arange(mi.UInt32, count)
        rng = mi.PCG32(size=count, initstate=dr.opaque(mi.UInt64, seed))
        x = (mi.Float(texel % texels) + rng.next_float32()) * (self.size / texels)
        y = (mi.Float(texel // texels) + rng.next_float32()) * (self.size / texels)
        to_eye = mi.Vector3f(*(dr.opaque(mi.Float, float(c)) for c in view))
        shift = to_eye * dr.opaque(mi.Float, self.top / float(view[2]))
        # a steep view's ray starts above a far neighbour of the tile: bring the start back, the patch is periodic
        origin = self._wrapped(mi.Point3f(x, y, 0) + shift)
        ray = mi.Ray3f(origin, dr.repeat(-to_eye, count))
        weight = mi.Color3f(1.0)
        vertices = []
        for bounce in range(BOUNCES):
            si = self.scene.ray_intersect(ray, mi.RayFlags.Minimal, bounce == 0)
            facing = si.is_valid() & (dr.dot(si.n, ray.d) < 0)
            dr.eval(facing, si.p, si.n, ray.d, texel, weight, rng)  # at once: a gather evaluates its source
            alive = dr.compress(facing)
            if len(alive) == 0:
                break
            texel, weight, rng = (dr.gather(type(a), a, alive) for a in (texel, weight, rng))
            place = self._wrapped(dr.gather(mi.Point3f, si.p, alive))
            # the triangles' own normals: with smoothed ones the shading and the shadows disagree where the mesh is
            # coarse, and the mean ABRDF of felt is 10 % from reciprocal at 75 degrees instead of 1 %
            normal = mi.Vector3f(dr.gather(mi.Normal3f, si.n, alive))
            to_eye = dr.gather(mi.Vector3f, -ray.d, alive)
            base, roughness = self._surface(place)
            if bounce:
                roughness = dr.maximum(roughness, INDIRECT_ROUGHNESS)
            start = place + normal * (1e-4 * self.size)  # off the surface that the ray leaves
            dr.eval(texel, weight, start, to_eye, base, roughness, normal)
            vertices.append({
                "texel": texel, "weight": weight, "start": start, "to_eye": to_eye,
                "base": base, "roughness": roughness, "normal": normal,
            })  # fmt: skip
            if bounce == BOUNCES - 1:
                break
            numbers = (rng.next_float32() for _ in range(3))
            onward, factor = self.material.sample(base, roughness, normal, to_eye, *numbers)
            weight = weight * factor
            ray = mi.Ray3f(start, onward)
            dr.eval(ray, weight, rng)
        return vertices

    def _wrapped(self, point):
        """The point moved by whole tiles into the middle tile."""
        import drjit as dr
        import mitsuba as mi

        x, y = (c - dr.floor(c / self.size) * self.size for c in (point.x, point.y))
        return mi.Point3f(x, y, point.z)

    def _surface(self, place):
        """Base colour and roughness at a place, bilinear between the cells' centres."""
        import drjit as dr
        import mitsuba as mi

        gx, gy = (c * (self.n / self.size) - 0.5 for c in (place.x, place.y))
        x0, y0 = dr.floor(gx), dr.floor(gy)
        fx, fy = gx - x0, gy - y0
        values = [mi.Float(0)] * 4
        for dx, dy in ((0, 0), (1, 0), (0, 1), (1, 1)):
            column = mi.UInt32((mi.Int32(x0) + dx + self.n) % self.n)
            row = mi.UInt32((mi.Int32(y0) + dy + self.n) % self.n)
            cell, w = row * self.n + column, (fx if dx else 1 - fx) * (fy if dy else 1 - fy)
            values = [a + w * dr.gather(mi.Float, self.attributes, cell * 4 + i) for i, a in enumerate(values)]
        return mi.Color3f(*values[:3]), values[3]

    def _connect(self, vertices, count: int) -> np.ndarray:
        """(3, count * lights) float32, [texel * lights + light]: what all vertices send on, under each light."""
        import drjit as dr
        import mitsuba as mi

        n_lights = len(self.lights)
        out = [dr.zeros(mi.Float, count * n_lights) for _ in range(3)]
        for vertex in vertices:
            index = dr.arange(mi.UInt32, dr.width(vertex["texel"]) * n_lights)
            path, light = index // n_lights, index % n_lights
            at = {key: dr.gather(type(value), value, path) for key, value in vertex.items()}
            direction = self._light(light)
            facing = dr.dot(at["normal"], direction)
            shadow = self.scene.ray_test(mi.Ray3f(at["start"], direction), facing > 0)
            value = self.material.value(at["base"], at["roughness"], at["normal"], at["to_eye"], direction)
            value = dr.select((facing > 0) & ~shadow, value * at["weight"] * facing, 0)
            target = at["texel"] * n_lights + light
            for channel in range(3):
                dr.scatter_add(out[channel], value[channel], target)  # one path a texel: no two write to one place
            dr.eval(out)
        return np.stack([c.numpy() for c in out])


def _mesh(mi, maps: Maps):
    """Three by three tiles of the height field; the middle tile spans [0, size]^2; millimetres."""
    n = len(maps.height_mm)
    edge = 3 * n
    c = (np.arange(edge) + 0.5) * (maps.size_mm / n) - maps.size_mm
    x, y = np.meshgrid(c, c)
    vertices = np.stack([x, y, np.tile(maps.height_mm, (3, 3))], -1).reshape(-1, 3).astype(np.float32)
    i, j = np.meshgrid(np.arange(edge - 1), np.arange(edge - 1))
    a = (j * edge + i).ravel()
    faces = np.concatenate([np.stack([a, a + 1, a + edge + 1], 1), np.stack([a, a + edge + 1, a + edge], 1)])
    mesh = mi.Mesh("patch", len(vertices), len(faces))
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = vertices.ravel()
    parameters["faces"] = faces.astype(np.uint32).ravel()
    parameters.update()
    return mesh
