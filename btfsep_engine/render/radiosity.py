# SPDX-License-Identifier: GPL-3.0-or-later
"""Interreflection between surfaces: the light that a pixel receives from the scene itself.

Only the receiving pixel needs the full BTF; what other surfaces send is smooth, so they are treated as diffuse
with their material's albedo (radiosity; Goral et al. 1984). The radiosity of a few thousand surface samples is
found under all M lightings at once; it is linear in the light, as everything else.
"""

from functools import cached_property

import numpy as np
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree

from btfsep_engine.btf.directions import interpolator
from btfsep_engine.btf.model import Lambertian, Material, Mirror
from btfsep_engine.conventions import fibonacci_sphere
from btfsep_engine.render.tracer import OFFSET, Tracer

SAMPLES = 3000  # surface samples over the whole scene, each with two sides
DIRECTIONS = 256  # directions of a sample's gathering
NEIGHBOURS = 3
NORMAL_SCALE = 0.5  # weight of a normal's difference against a distance in scene radii, in the neighbour search


def diffuse_albedo(material: Material) -> np.ndarray:
    """Fraction of diffuse light that a material reflects: (3,), bihemispherical, in [0, 1]."""
    if isinstance(material, Lambertian):
        return np.asarray(material.albedo, np.float64)
    if isinstance(material, Mirror):
        return np.asarray(material.reflectance, np.float64)
    d = fibonacci_sphere(1024)
    d = d[d[:, 2] > 0]
    cosine = d[:, 2] / d[:, 2].sum()

    def mean_over(directions):
        taps, weights = interpolator(directions).weights(d)
        return np.bincount(taps.ravel(), (weights * cosine[:, None]).ravel(), len(directions))

    # (1 / pi) int int f cos_i cos_o = pi * mean over cosine-weighted directions of both sides
    albedo = np.pi * np.einsum("v,l,vlc->c", mean_over(material.views), mean_over(material.lights), material.mean_abrdf)
    return np.clip(albedo, 0, 0.98)


class Indirect:
    """Radiosity of a scene's surfaces under M lightings.

    Parameters
    ----------
    tracer : Tracer
    albedos : one (3,) per mesh of the tracer; zeros for what reflects nothing or is not known
    lightings : light.lightings.Lightings
    bounces : number of reflections between surfaces that are followed, >= 1
    """

    def __init__(self, tracer: Tracer, albedos, lightings, *, bounces: int, seed: int = 0):
        self.tracer, self.albedos, self.lightings = tracer, np.asarray(albedos, np.float64), lightings
        self.bounces, self.seed = bounces, seed

    @cached_property
    def _solution(self):
        """Search tree of the samples and their radiosity (s, M, 3); found when it is first needed."""
        tracer = self.tracer
        position, normal, mesh = self._samples(np.random.default_rng(self.seed))
        tree = cKDTree(self._feature(position, normal))
        directions = fibonacci_sphere(DIRECTIONS)
        light = np.asarray(self.lightings.cell_averages(directions), np.float64)
        light = np.broadcast_to(light, (*light.shape[:2], 3))
        cosine = np.maximum(normal @ directions.T, 0) * (4 * np.pi / DIRECTIONS)
        seen = tracer.visible(position, normal, directions)
        direct = np.einsum("sd,dmc->smc", cosine * seen, light, optimize=True)
        albedo = self.albedos[mesh][:, None, :]
        radiosity = albedo * direct
        if self.bounces > 1:
            # the inside of a closed object sees no sky and is seen by nobody: no rays are spent on it
            outside = seen.any(1)[:, None]
            rows, columns, weights = self._gather(tree, position, normal, directions, outside & (cosine > 0) & ~seen)
            n = len(position)
            gather = csr_matrix((weights * cosine.ravel()[rows] / np.pi, (rows // DIRECTIONS, columns)), (n, n))
            for _ in range(self.bounces - 1):
                received = (gather @ radiosity.reshape(n, -1)).reshape(direct.shape)
                radiosity = albedo * (direct + received)
        return tree, radiosity

    def _samples(self, random):
        """Points on all triangles by area, each with both sides: positions, normals, mesh numbers."""
        meshes = self.tracer.meshes
        corners = np.concatenate([m.vertices[m.faces] for m in meshes])
        owner = np.repeat(np.arange(len(meshes)), [len(m.faces) for m in meshes])
        cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        area = np.linalg.norm(cross, axis=1)
        cumulative = np.cumsum(area) / area.sum()
        face = np.searchsorted(cumulative, (np.arange(SAMPLES) + random.random(SAMPLES)) / SAMPLES)
        face = np.minimum(face, len(area) - 1)
        a, b = random.random((2, SAMPLES))
        a, b = np.where(a + b > 1, 1 - a, a), np.where(a + b > 1, 1 - b, b)
        chosen = corners[face]
        position = (
            chosen[:, 0] + a[:, None] * (chosen[:, 1] - chosen[:, 0]) + b[:, None] * (chosen[:, 2] - chosen[:, 0])
        )
        normal = cross[face] / np.maximum(area[face], 1e-300)[:, None]
        return np.concatenate([position] * 2), np.concatenate([normal, -normal]), np.concatenate([owner[face]] * 2)

    def _feature(self, position, normal):
        return np.concatenate([(position - self.tracer.centre) / self.tracer.radius, normal * NORMAL_SCALE], 1)

    def _gather(self, tree, position, normal, directions, wanted):
        """Where the wanted (point, direction) rays arrive, as taps of the samples.

        Returns
        -------
        rows : (t,) flat (point, direction) numbers
        columns : (t,) sample numbers
        weights : (t,) sum to 1 over the taps of a ray that arrives; rays that leave the scene have none
        """
        flat = np.flatnonzero(wanted)
        point, direction = flat // len(directions), flat % len(directions)
        ray, sample, weights = self._arrivals(tree, position[point], normal[point], directions[direction])
        return flat[ray], sample, weights

    def _arrivals(self, tree, position, normal, omega):
        """Where rays (n, 3) arrive: ray numbers, sample numbers and weights of the taps."""
        starts = position + OFFSET * self.tracer.radius * normal
        hits = self.tracer.nearest(starts, omega)
        arrived = np.flatnonzero(hits.mesh >= 0)
        arrival = starts[arrived] + hits.distance[arrived, None] * omega[arrived]
        facing = np.empty_like(arrival)
        for number, mesh in enumerate(self.tracer.meshes):
            mine = hits.mesh[arrived] == number
            corners = mesh.vertices[mesh.faces[hits.face[arrived][mine]]]
            facing[mine] = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        facing /= np.maximum(np.linalg.norm(facing, axis=1, keepdims=True), 1e-300)
        facing *= -np.sign((facing * omega[arrived]).sum(1, keepdims=True))
        distance, sample = tree.query(self._feature(arrival, facing), k=NEIGHBOURS)
        weights = 1 / (distance + 1e-3)
        weights /= weights.sum(1, keepdims=True)
        return np.repeat(arrived, NEIGHBOURS), sample.ravel(), weights.ravel()

    def reflected(self, transport, material) -> np.ndarray:
        """Radiance (p, M, 3) float32 of a `Transport`'s points by the light that other surfaces send them.

        A mirror shows the surfaces themselves: what its reflected ray meets.
        """
        if isinstance(material, Mirror):
            return self._mirrored(transport, material)
        points, directions = transport.points, transport.directions
        above = (points.flat_normal @ directions.T > 0) & (points.normal @ directions.T > 0)
        blocked = above & ~transport.visible
        out = np.zeros((len(points), self.lightings.count, 3), np.float32)
        if not blocked.any():
            return out
        tree, radiosity = self._solution
        weights = transport.weights(material)
        step = max(1, (1 << 20) // len(directions))
        for start in range(0, len(points), step):
            part = slice(start, min(len(points), start + step))
            rows, columns, taps = self._gather(
                tree, points.position[part], points.flat_normal[part], directions, blocked[part]
            )
            some = np.flatnonzero(blocked[part])
            pairs = weights.of_pairs(points.take(part), some // len(directions), some % len(directions))
            dense = np.zeros((3, (part.stop - start) * len(directions)), np.float32)
            dense[:, some] = np.stack(pairs) * weights.colour[:, None]
            shape = (part.stop - start, len(radiosity))
            for c in range(3):
                values = dense[c][rows] * taps / np.pi
                matrix = csr_matrix((values, (rows // len(directions), columns)), shape)
                out[part, :, c] = matrix @ radiosity[:, :, c]
        return out

    def _mirrored(self, transport, material) -> np.ndarray:
        points = transport.points
        tree, radiosity = self._solution
        rows, columns, taps = self._arrivals(
            tree, points.position, points.flat_normal, transport.reflected_directions()
        )
        matrix = csr_matrix((taps / np.pi, (rows, columns)), (len(points), len(radiosity)))
        out = (matrix @ radiosity.reshape(len(radiosity), -1)).reshape(len(points), *radiosity.shape[1:])
        return (out * np.asarray(material.reflectance)).astype(np.float32)
