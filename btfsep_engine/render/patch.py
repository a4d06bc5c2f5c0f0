# SPDX-License-Identifier: GPL-3.0-or-later
"""The virtual gonioreflectometer: a BTF measured by path-tracing a displaced, periodic patch.

The patch is a height field, three by three tiles of it, with the micro-BRDF of
:mod:`btfsep_engine.render.microfacet`. For every view one path starts at each texel and sample; each of its vertices is
connected to **all** lights, so that the path is shared by them.

A measured value is not that of a point: it is the average over the hat of its light, as
:mod:`btfsep_engine.render.hats` states it. Every vertex looks at each light in one direction of its hat (another one at
each texel, so that all texels together take each equally often), and where it is glossy also along LOBES directions of
its own lobe, each of which counts for the three hats that reach it; the two are joined by the balance heuristic (Veach
1997), which makes lobes much narrower than the hats no noisier than wide ones.

Texels lie on the *reference plane*, the plane of the mean height: a view's ray goes through the texel's place on
that plane, so the parallax of higher and lower places is in the data, as in a rectified measurement.
"""

import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from btfsep_engine.btf.directions import ubo2014_directions
from btfsep_engine.btf.factorise import StreamingFactoriser
from btfsep_engine.btf.model import Tabulated
from btfsep_engine.btf.procedural import Maps
from btfsep_engine.progress import Reporter
from btfsep_engine.render.arrays import dr, floats, mi
from btfsep_engine.render.hats import Hats, sharpened
from btfsep_engine.render.microfacet import R2, Facet, Microfacets

BOUNCES = 3  # path vertices that are connected to the lights
INDIRECT_ROUGHNESS = 0.4  # least roughness of what is seen by reflection: its highlights would be fireflies
LOBES = 4  # directions of the lobe at the first vertex
SURE = 0.25  # paths of less weight go on with the probability weight / SURE, and count for the others
AT_ONCE = 40_000  # texels, of several views together: small ones cost little more than their launch


@dataclass(frozen=True)
class Measurement:
    """A measured material.

    Attributes
    ----------
    material : Tabulated
    relative_error : of the factors (see :class:`btfsep_engine.btf.factorise.Factors`)
    rays : int, shadow rays of this run (of views that were taken up from checkpoints there are none)
    seconds : float, of this run
    """

    material: Tabulated
    relative_error: float
    rays: int
    seconds: float

    def speed(self) -> dict:
        """seconds, rays, rays_per_second: plain numbers."""
        per_second = round(self.rays / max(self.seconds, 1e-9))
        return {"seconds": round(self.seconds, 2), "rays": self.rays, "rays_per_second": per_second}


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
    checkpoints : `storage.checkpoints.Checkpoints`, where finished views are kept, or None: nowhere.
        A run that takes them up gives the same material, bit by bit

    Returns
    -------
    Measurement
    """
    began = time.perf_counter()
    reporter = reporter or Reporter()
    lights, views = (ubo2014_directions() if d is None else np.asarray(d, np.float64) for d in (lights, views))
    factoriser = StreamingFactoriser(texels * texels, components, seed=seed)
    patch = Patch(maps, lights, seed=seed, averaged=True)
    for kept in checkpoints.load() if checkpoints else ():
        factoriser.restore(kept)
    saved = len(factoriser.means)
    first = saved // 3  # three blocks a view, one a channel

    def take(block):
        for channel in block:
            factoriser.add(channel)

    with ThreadPoolExecutor(1) as beside:  # the factoriser works on a view while the next one is traced
        pending = None
        for number, block in enumerate(patch.views(views, texels=texels, samples=samples, first=first), first):
            if pending:
                pending.result()
            pending = beside.submit(take, block)
            last = number == len(views) - 1
            if checkpoints and checkpoints.due(last=last):
                pending.result()
                checkpoints.save(factoriser.state(saved))
                saved = len(factoriser.means)
            reporter.progress("measure", (number + 1) / len(views), maps.name)
        if pending:
            pending.result()
    factors = factoriser.finish()
    angular = factors.angular.reshape(len(views), 3, len(lights), -1).transpose(0, 2, 1, 3)
    angular = angular / lights[None, :, 2, None, None].astype(np.float32)
    material = Tabulated(
        name=maps.name,
        material_class=maps.material_class,
        texels=factors.texels.reshape(texels, texels, -1),
        angular=sharpened(angular, lights),
        views=views,
        lights=lights,
        texel_mm=maps.size_mm / texels,
    )
    return Measurement(material, factors.relative_error, patch.rays, time.perf_counter() - began)


@dataclass
class Vertex:
    """The places that paths have reached, and what they send on from there; Dr.Jit arrays of one width.

    Attributes
    ----------
    path : UInt32, the number of the path
    weight : Color3f, of what goes to the eye
    start : Point3f, where shadow rays start, a little above the surface
    facet : Facet
    numbers : two Float, random
    """

    path: object
    weight: object
    start: object
    facet: Facet
    numbers: tuple


class Patch:
    """A displaced patch, ready to be looked at under a list of directional lights.

    Parameters
    ----------
    maps : the patch
    lights : (n, 3) float, unit, above the horizon
    seed : of all random numbers
    averaged : whether a light is its hat (see above), or a point

    Attributes
    ----------
    rays : int, shadow rays so far
    """

    def __init__(self, maps: Maps, lights, *, seed: int = 0, averaged: bool = False):
        self.maps, self.seed, self.rays = maps, seed, 0
        self.lights = np.ascontiguousarray(lights, np.float32)
        self.n = len(maps.height_mm)
        self.size = dr.opaque(mi.Float, maps.size_mm)  # opaque: one compiled kernel serves all materials
        self.top = float(maps.height_mm.max() + 0.01 * maps.size_mm)
        self.scene = mi.load_dict({"type": "scene", "patch": _mesh(maps)})
        metal = maps.metal()
        attributes = [maps.base_colour, *(a[..., None] for a in (maps.roughness, *metal))]
        self.stride = 4 + len(metal)
        self.attributes = floats(np.concatenate(attributes, -1))
        self.material = Microfacets(maps.f0, metal=bool(metal))
        self.hats = Hats(lights, averaged=averaged)
        self.lobes = LOBES if averaged and self.material.glossy else 0
        dr.eval(self.attributes)

    def views(self, views, *, texels: int, samples: int, first: int = 0) -> Iterator[np.ndarray]:
        """Looks at the patch from each view in turn, from number ``first`` on (each has its own random numbers).

        Yields
        ------
        (3, texels * texels, lights) float32, radiance under a directional light of unit irradiance (measured across
        its beam): the BTF **times cos(theta_i)**, 1/sr; texel = row * texels + column, row 0 at the smallest v
        """
        views = np.asarray(views, np.float64)
        count = texels * texels
        together = max(1, AT_ONCE // count)
        for start in range(first, len(views), together):
            some = views[start : start + together]
            light = self._looked_at(some, start, texels, samples)
            yield from light.reshape(len(some), 3, count, len(self.lights))

    def _looked_at(self, views, first: int, texels: int, samples: int) -> np.ndarray:
        """What all paths send to the eye under each light; the layout is that of (views, 3, texels^2, lights)."""
        count = texels * texels
        out = dr.zeros(mi.Float, len(views) * 3 * count * len(self.lights))
        for sample in range(samples):
            numbers = [np.random.default_rng([self.seed, first + i, sample]) for i in range(len(views))]
            seeds = np.array([r.integers(2**63, dtype=np.uint64) for r in numbers])
            # which entry of a hat's table a path takes: each equally often in a view, in another order at each light
            of_path = mi.UInt32(np.concatenate([r.permutation(count) for r in numbers]).astype(np.uint32))
            offsets = np.concatenate([r.integers(self.hats.drawn, size=len(self.lights)) for r in numbers])
            of_light = mi.UInt32(offsets.astype(np.uint32))
            for bounce, vertex in enumerate(self._paths(views, texels, seeds)):
                self._connect(out, vertex, bounce, count, 1 / samples, of_path, of_light)
        return out.numpy()

    def _paths(self, views, texels: int, seeds) -> Iterator[Vertex]:
        """One path a view and texel: its vertices one after the other; those that left the patch are taken out."""
        count = texels * texels
        path = dr.arange(mi.UInt32, len(views) * count)
        number = path // count
        texel = path - number * count
        rng = mi.PCG32(initstate=dr.gather(mi.UInt64, mi.UInt64(seeds), number), initseq=mi.UInt64(texel))
        x = (mi.Float(texel % texels) + rng.next_float32()) * (self.size / texels)
        y = (mi.Float(texel // texels) + rng.next_float32()) * (self.size / texels)
        to_eye = mi.Vector3f(*(dr.gather(mi.Float, mi.Float(c.astype(np.float32)), number) for c in views.T))
        # a steep view's ray starts above a far neighbour of the tile: bring the start back, the patch is periodic
        origin = self._wrapped(mi.Point3f(x, y, 0) + to_eye * (dr.opaque(mi.Float, self.top) / to_eye.z))
        ray = mi.Ray3f(origin, -to_eye)
        weight = dr.full(mi.Color3f, 1.0, len(views) * count)
        alive = dr.full(mi.Bool, True, len(views) * count)
        for bounce in range(BOUNCES):
            si = self.scene.ray_intersect(ray, mi.RayFlags.Minimal, bounce == 0, alive)
            facing = alive & si.is_valid() & (dr.dot(si.n, ray.d) < 0)
            dr.eval(facing, si.p, si.n, ray.d, path, weight, rng)  # at once: a gather evaluates its source
            kept = dr.compress(facing)
            if len(kept) == 0:
                return
            path, weight, rng = (dr.gather(type(a), a, kept) for a in (path, weight, rng))
            place = self._wrapped(dr.gather(mi.Point3f, si.p, kept))
            # the triangles' own normals: with smoothed ones the shading and the shadows disagree where the mesh is
            # coarse, and the mean ABRDF of felt is 10 % from reciprocal at 75 degrees instead of 1 %
            normal = mi.Vector3f(dr.gather(mi.Normal3f, si.n, kept))
            to_eye = dr.gather(mi.Vector3f, -ray.d, kept)
            base, roughness, *metallic = self._surface(place)
            if bounce:
                roughness = dr.maximum(roughness, INDIRECT_ROUGHNESS)
            facet = self.material.facet(base, roughness, normal, to_eye, *metallic)
            start = mi.Point3f(place + normal * (1e-4 * self.size))  # off the surface that the ray leaves
            numbers = rng.next_float32(), rng.next_float32()
            if bounce < BOUNCES - 1:
                onward, factor = self.material.sample(facet, *(rng.next_float32() for _ in range(3)))
                further = weight * factor
                surely = dr.clip(dr.max(further) * (1 / SURE), 0, 1)
                alive = rng.next_float32() < surely
                further = dr.select(alive, further / dr.maximum(surely, 1e-9), 0)
                ray = mi.Ray3f(start, onward)
                dr.eval(ray, further, alive, rng)
            dr.eval(path, weight, start, *facet.arrays(), numbers)
            yield Vertex(path, weight, start, facet, numbers)
            if bounce < BOUNCES - 1:
                weight = further

    def _wrapped(self, point):
        """The point moved by whole tiles into the middle tile."""
        x, y = (c - dr.floor(c / self.size) * self.size for c in (point.x, point.y))
        return mi.Point3f(x, y, point.z)

    def _surface(self, place):
        """Base colour, roughness and (where there is any) metallic at a place, bilinear between the cells' centres."""
        gx, gy = (c * (self.n / self.size) - 0.5 for c in (place.x, place.y))
        x0, y0 = dr.floor(gx), dr.floor(gy)
        fx, fy = gx - x0, gy - y0
        values = [mi.Float(0)] * self.stride
        for dx, dy in ((0, 0), (1, 0), (0, 1), (1, 1)):
            column = mi.UInt32((mi.Int32(x0) + dx + self.n) % self.n)
            row = mi.UInt32((mi.Int32(y0) + dy + self.n) % self.n)
            cell, w = row * self.n + column, (fx if dx else 1 - fx) * (fy if dy else 1 - fy)
            values = [
                a + w * dr.gather(mi.Float, self.attributes, cell * self.stride + i) for i, a in enumerate(values)
            ]
        return mi.Color3f(*values[:3]), *values[3:]

    def _aimed(self, vertex: Vertex, bounce: int, count: int, of_path, of_light):
        """One shadow ray from each vertex to each light, vertex by vertex (rays of one start are traced fastest).

        Returns
        -------
        which, light : UInt32, the numbers of the vertex and of the light
        ray : Ray3f; facing : Float, the cosine at the surface
        weigh : what :meth:`Hats.draw` gives beside the direction
        """
        n_lights = len(self.lights)
        entry, start_of = dr.gather(mi.UInt32, of_path, vertex.path), vertex.path // count * n_lights
        dr.eval(entry, start_of)
        index = dr.arange(mi.UInt32, dr.width(vertex.path) * n_lights)
        which = index // n_lights
        light = index - which * n_lights
        turn = dr.gather(mi.UInt32, of_light, dr.gather(mi.UInt32, start_of, which) + light)
        drawn = (dr.gather(mi.UInt32, entry, which) ^ (turn + 85 * bounce)) % self.hats.drawn
        direction, *weigh = self.hats.draw(light, drawn)
        facing = dr.dot(dr.gather(mi.Vector3f, vertex.facet.normal, which), direction)
        return which, light, mi.Ray3f(dr.gather(mi.Point3f, vertex.start, which), direction), facing, weigh

    def _connect(self, out, vertex: Vertex, bounce: int, count: int, share: float, of_path, of_light) -> None:
        """Adds what the vertices send on under each light to ``out`` (:meth:`_looked_at`), times ``share``."""
        lobes = 0 if bounce else self.lobes
        weight, row = vertex.weight * share, self._row(vertex.path, count)
        dr.eval(weight, row)
        which, light, ray, facing, (density, reach, scale) = self._aimed(vertex, bounce, count, of_path, of_light)
        shadow = self.scene.ray_test(ray, facing > 0)
        value, of_lobe = self.material.value_and_density(vertex.facet.gathered(which), ray.d)
        scale = scale * facing / (density + lobes * of_lobe * reach) if self.hats.averaged else facing
        value = dr.select((facing > 0) & ~shadow, value * dr.gather(mi.Color3f, weight, which) * scale, 0)
        target = dr.gather(mi.UInt32, row, which) + light
        for channel in range(3):  # one path a row: no two write to one place, and the order of sums is always the same
            at = target + channel * (count * len(self.lights))
            dr.scatter_add(out, value[channel], at, mode=dr.ReduceMode.NoConflicts)
        dr.eval(out)
        self.rays += dr.width(which) + lobes * dr.width(vertex.path)
        if lobes:
            self._connect_lobe(out, vertex, weight, row, count)

    def _connect_lobe(self, out, vertex: Vertex, weight, row, count: int) -> None:
        """As :meth:`_connect`, along directions of the vertices' own lobes."""
        for number in range(self.lobes):
            u1, u2 = (u + number * step for u, step in zip(vertex.numbers, R2, strict=True))
            direction = self.material.lobe(vertex.facet, u1 - dr.floor(u1), u2 - dr.floor(u2))
            facing = dr.dot(vertex.facet.normal, direction)
            lit = (facing > 0) & (direction.z > 0)
            shadow = self.scene.ray_test(mi.Ray3f(vertex.start, direction), lit)
            value, of_lobe = self.material.value_and_density(vertex.facet, direction)
            value = dr.select(lit & ~shadow, value * weight * facing, 0)
            for light, reach, density, scale in self.hats.hats_at(direction):
                part = dr.select(lit, reach * scale / (reach * density + self.lobes * of_lobe), 0)
                for channel in range(3):
                    target = row + light + channel * (count * len(self.lights))
                    dr.scatter_add(out, value[channel] * part, target, lit, mode=dr.ReduceMode.NoConflicts)
        dr.eval(out)

    def _row(self, path, count: int):
        """Where the first light of a path's red value is in :meth:`_looked_at`."""
        return (path + 2 * count * (path // count)) * len(self.lights)


def _mesh(maps: Maps):
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
