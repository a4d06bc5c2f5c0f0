# SPDX-License-Identifier: GPL-3.0-or-later
"""Interreflection between surfaces: the light that a pixel receives from the scene itself.

Only the receiving pixel needs the full BTF; what other surfaces send is smooth, so they are treated as diffuse
with their material's albedo (radiosity; Goral et al. 1984). The radiosity of a few thousand surface samples is
found under all M lightings at once; it is linear in the light, as everything else.

Where something stands beside the objects, samples lie the closer to each other the nearer to the objects they are, as
large as what an object sees of them: the shadow on a table is resolved, however large the table.
"""

from functools import cached_property

import numpy as np
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree

from btfsep_engine.btf.model import Material
from btfsep_engine.conventions import fibonacci_sphere
from btfsep_engine.render.arrays import dr
from btfsep_engine.render.sampling import NORMAL_WEIGHT
from btfsep_engine.render.tracer import Tracer
from btfsep_engine.storage import kept

SAMPLES = 3000  # surface samples where none are named
DIRECTIONS = 64  # directions of a sample's gathering; 256 change nothing, more samples would
LANES = 1 << 20  # pairs of pixel and direction that are followed at once
NEIGHBOURS = 3
MOST = 0.98  # of an albedo: light in a closed room ends
LITTLE = 1e-3  # of the light that goes between surfaces: a reflection that adds less is the last one
COARSE = 0.5  # longest edge of a face from which samples are drawn, over its distance
SPLITS = 40  # the most times that a face is cut into four


def diffuse_albedo(material: Material) -> np.ndarray:
    """Fraction of diffuse light that a material reflects: (3,), bihemispherical, in [0, 1]."""
    return np.clip(material.diffuse_albedo(), 0, MOST)


class Network:
    """The surface samples of a scene and the light that goes between them: geometry alone, whatever the light.

    Attributes
    ----------
    directions : (DIRECTIONS, 3) float64, of the samples' gathering
    mesh : (s,) int, the mesh of each sample
    sky : (s, DIRECTIONS) float32, cos(theta) d_omega where the sky is seen
    gather : (s, s) sparse float32, radiosity to irradiance
    """

    def __init__(self, tracer: Tracer, *, samples: int, seed: int):
        self.tracer = tracer
        position, normal, mesh, face, weights, outer = self._samples(np.random.default_rng(seed), samples)
        self.directions = fibonacci_sphere(DIRECTIONS)
        seen = tracer.visible(position, normal, self.directions)
        # the inside of what is closed is seen by nobody, and must not be taken for the outside of a thin wall
        kept = seen.any(1) | outer
        position, normal, seen = position[kept], normal[kept], seen[kept]
        self.mesh, self._face, self._weights = mesh[kept], face[kept], weights[kept]
        self._tree = cKDTree(self._feature(position, normal))
        cosine = np.maximum(normal @ self.directions.T, 0).astype(np.float32) * np.float32(4 * np.pi / DIRECTIONS)
        self.sky = cosine * seen
        # no rays are spent on what sees no sky
        sample, direction = np.nonzero(seen.any(1)[:, None] & (cosine > 0) & ~seen)
        arrived, taps, weights = self.arrivals(position[sample], normal[sample], self.directions[direction])
        weights *= cosine[sample, direction][arrived, None] / np.float32(np.pi)
        self.gather = self.sparse(sample[arrived], taps, weights, len(position))

    def sparse(self, rows, taps, weights, count: int) -> csr_matrix:
        """(count, s): ``weights`` (t, k) of the samples ``taps`` (t, k), summed into ascending ``rows`` (t,)."""
        starts = np.searchsorted(rows, np.arange(count + 1)) * taps.shape[1]
        return csr_matrix((weights.ravel(), taps.ravel(), starts), (count, len(self.mesh)))

    def _samples(self, random, count: int):
        """Points on all triangles, each with both sides: ``count`` on the objects, and as many on what is beside them.

        Gives positions, normals, mesh numbers, faces' numbers, their corners' weights, whether it is the outer side.
        """
        meshes = self.tracer.meshes
        corners = np.concatenate([m.vertices[m.faces] for m in meshes])
        owner = np.repeat(np.arange(len(meshes)), [len(m.faces) for m in meshes])
        beside = np.isin(owner, self.tracer.occluders)
        own = np.flatnonzero(~beside)
        drawn = [_drawn(random, count, corners[own], own, np.broadcast_to(np.eye(3), (len(own), 3, 3)), 1.0)]
        if beside.any():
            pieces, face, within, wanted = _seen_from(self.tracer.centre, self.tracer.radius, corners[beside])
            drawn.append(_drawn(random, count, pieces, np.flatnonzero(beside)[face], within, wanted))
        position, normal, face, weights = (np.concatenate(each) for each in zip(*drawn, strict=True))
        outwards = np.array([is_wound_outwards(m) for m in meshes])[owner[face]]
        twice = [np.concatenate([each] * 2) for each in (position, owner[face], face, weights)]
        outer = np.concatenate([outwards, ~outwards])
        return twice[0], np.concatenate([normal, -normal]), *twice[1:], outer

    def _feature(self, position, normal):
        return np.concatenate([(position - self.tracer.centre) / self.tracer.radius, normal * NORMAL_WEIGHT], 1)

    def albedos(self, of_meshes) -> np.ndarray:
        """(s, 3) float32, of each sample; ``of_meshes`` : (3,) or an image (n, n, 3) by its UVs, of each mesh."""
        out, first = np.empty((len(self.mesh), 3), np.float32), 0
        for number, albedo in enumerate(of_meshes):
            mesh, mine = self.tracer.meshes[number], self.mesh == number
            if np.ndim(albedo) > 1:
                n, uv = len(albedo), mesh.corner_uv[self._face[mine] - first]
                uv = (self._weights[mine][..., None] * uv).sum(1)
                column, row = np.floor(uv * n).astype(np.int64).T % n
                albedo = albedo[n - 1 - row, column]
            out[mine] = albedo
            first += len(mesh.faces)
        return out

    def arrivals(self, position, normal, omega):
        """Where rays arrive that are sent light from there.

        Parameters
        ----------
        position, normal, omega : (n, 3) float, where they start, the normals that they start along, unit directions

        Returns
        -------
        arrived : (t,) numbers of the rays that meet a surface, ascending
        taps : (t, NEIGHBOURS) samples around, weights : (t, NEIGHBOURS) float32, summing to 1
        """
        arrived, places, facing = self.tracer.arrivals(position, normal, omega)
        feature = self._feature(places, facing)
        distance, taps = self._tree.query(feature, k=NEIGHBOURS, workers=dr.thread_count())
        weights = (1 / (distance + 1e-3)).astype(np.float32)
        return arrived, taps, weights / weights.sum(1, keepdims=True)


def is_wound_outwards(mesh) -> bool:
    """Whether a closed mesh's faces turn counter-clockwise, seen from outside; of an open one either."""
    a, b, c = np.moveaxis((mesh.vertices - mesh.vertices.mean(0))[mesh.faces], 1, 0)
    return bool((a * np.cross(b, c)).sum() >= 0)


def _drawn(random, count: int, corners, face, within, wanted):
    """Points on pieces ``corners : (n, 3, 3)`` of faces, by area times ``wanted``, stratified.

    Gives positions, normals (count, 3), faces' numbers (count,), their corners' weights (count, 3).
    """
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(cross, axis=1)
    cumulative = np.cumsum(wanted * area) / (wanted * area).sum()
    piece = np.searchsorted(cumulative, (np.arange(count) + random.random(count)) / count)
    piece = np.minimum(piece, len(area) - 1)
    a, b = random.random((2, count))
    a, b = np.where(a + b > 1, 1 - a, a), np.where(a + b > 1, 1 - b, b)
    weights = np.stack([1 - a - b, a, b], -1)[..., None]
    normal = cross[piece] / np.maximum(area[piece], 1e-300)[:, None]
    return (weights * corners[piece]).sum(1), normal, face[piece], (weights * within[piece]).sum(1)


def _seen_from(centre, radius: float, corners):
    """Faces ``corners : (n, 3, 3)`` cut until each is small for its distance from ``centre``.

    Returns
    -------
    corners (m, 3, 3) of the pieces; of which face each is (m,); its corners' weights in that (m, 3, 3); how dense
    samples are to be on it (m,): as solid angle has it, but for the cosine, and even within ``radius``
    """
    done, whole, within = [], np.arange(len(corners)), np.broadcast_to(np.eye(3), corners.shape)
    for _ in range(SPLITS):
        edge = np.linalg.norm(corners - np.roll(corners, 1, 1), axis=2).max(1)
        far = np.maximum(np.linalg.norm(corners.mean(1) - centre, axis=1) - edge, radius)
        large = edge > COARSE * far
        done.append([a[~large] for a in (corners, whole, within)])
        if not large.any():
            break
        whole, corners, within = np.tile(whole[large], 4), _in_four(corners[large]), _in_four(within[large])
    corners, whole, within = (np.concatenate(a) for a in zip(*done, strict=True))
    return corners, whole, within, np.maximum(np.linalg.norm(corners.mean(1) - centre, axis=1), radius) ** -2


def _in_four(corners) -> np.ndarray:
    """Triangles (n, 3, 3) as the four that their edges' middles make: (4 n, 3, 3), all of the same turn."""
    a, b, c = np.moveaxis(corners, 1, 0)
    ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
    return np.concatenate([np.stack(t, 1) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))])


def _little(more, light) -> bool:
    """Whether ``more`` is next to nothing beside the ``light`` (s, M) of surfaces, in all of its columns together."""
    return bool(np.linalg.norm(more) <= LITTLE * np.linalg.norm(light))


def network(tracer: Tracer, *, samples: int, seed: int) -> Network:
    """The :class:`Network` of a scene, made when it is first asked for."""
    parts = [tracer.key, samples, seed]
    return kept.recalled("network", parts, lambda: Network(tracer, samples=samples, seed=seed))


class Indirect:
    """Radiosity of a scene's surfaces under M lightings.

    Parameters
    ----------
    tracer : Tracer
    albedos : one (3,) per mesh of the tracer, zeros for what reflects nothing or is not known; or an image (n, n, 3) of
        them by the mesh's UVs, one unit wide, row 0 at the top
    lightings : light.lightings.Lightings
    bounces : number of reflections between surfaces that are followed, >= 1
    samples : surface samples over the whole scene, each with two sides
    seed : of their places
    """

    def __init__(self, tracer: Tracer, albedos, lightings, *, bounces: int, samples: int | None = None, seed: int = 0):
        self.tracer, self.albedos, self.lightings = tracer, albedos, lightings
        self.bounces, self.samples, self.seed = bounces, samples or SAMPLES, seed
        self._lit: dict = {}  # how often light was sent on -> what the samples get of it

    @cached_property
    def _network(self) -> Network:
        return network(self.tracer, samples=self.samples, seed=self.seed)

    @cached_property
    def _radiosity(self) -> list[np.ndarray]:
        """Radiosity of the samples, 1 or 3 channels of (s, M) float32; found when it is first needed."""
        net = self._network
        albedos = net.albedos(self.albedos)
        alike = (albedos == albedos[:1]).all()
        straight = self._irradiance(0)
        grey = (albedos == albedos[:, :1]).all()
        found = []
        for c in range(1 if grey and len(straight) == 1 else 3):
            channel = min(c, len(straight) - 1)
            more = radiosity = albedos[:, c, None] * straight[channel]
            for k in range(1, self.bounces):
                if _little(more, radiosity):
                    break
                if alike:
                    more = albedos[0, c] ** (k + 1) * self._irradiance(k)[channel]
                else:
                    more = albedos[:, c, None] * (net.gather @ more)
                radiosity = radiosity + more
            found.append(radiosity)
        return found

    def _irradiance(self, times: int) -> list[np.ndarray]:
        """Of samples by light that surfaces, all white, have sent on ``times`` times: 1 or 3 channels of (s, M)."""

        def found():
            net = self._network
            if times:
                return [net.gather @ light for light in self._irradiance(times - 1)]
            light = np.moveaxis(np.asarray(self.lightings.cell_averages(net.directions), np.float32), 2, 0)
            return [net.sky @ np.ascontiguousarray(channel) for channel in light]

        if times not in self._lit:
            parts = [self.tracer.key, self.samples, self.seed, self.lightings, times]  # whatever the material
            again = self.lightings.returns
            self._lit[times] = kept.recalled("irradiance", parts, found) if again else found()
        return self._lit[times]

    def reflected(self, transport, material) -> np.ndarray:
        """Radiance (p, M, 3) float32 of a `Transport`'s points by the light that other surfaces send them.

        A mirror shows the surfaces themselves: what its reflected ray meets.
        """
        if not self.lightings.returns:
            return self._reflected(transport, material)
        how = [list(self.albedos), self.bounces, self.samples, self.seed, self.lightings]
        parts = [transport.key, material, *how]
        return kept.recalled("reflected basis", parts, lambda: self._reflected(transport, material))

    def _reflected(self, transport, material) -> np.ndarray:
        points = transport.points
        out = np.zeros((3, len(points), self.lightings.count), np.float32)
        if material.mirror_reflectance is not None:
            self._put(out, self._mirrored(transport), material.mirror_reflectance.astype(np.float32))
            return out.transpose(1, 2, 0)
        weights = transport.weights(material)
        step = max(1, LANES // len(transport.directions))
        for start in range(0, len(points), step):
            rows = slice(start, min(len(points), start + step))
            parts = [transport.key, material, start, self.samples, self.seed]
            received = kept.recalled("received", parts, lambda rows=rows: self._received(transport, weights, rows))
            if received:
                self._put(out[:, rows], received, weights.colour / np.float32(np.pi))
        return out.transpose(1, 2, 0)

    def _received(self, transport, weights, rows: slice) -> list[csr_matrix]:
        """What some of the points receive of each sample, 1 or 3 channels of (p, s), whatever the light; none: []."""
        some = transport.points.take(rows)
        parts = [transport.key, rows.start, self.samples, self.seed]
        point, direction, taps, shares = kept.recalled("arrivals", parts, lambda: self._arrivals(transport, some, rows))
        if len(point) == 0:
            return []
        pairs = weights.of_pairs(some, point, direction)
        return [self._network.sparse(point, taps, shares * w[:, None], len(some)) for w in pairs]

    def _arrivals(self, transport, some, rows: slice):
        """Points and directions (t,) that look at a surface; the samples there (t, NEIGHBOURS), and their weights."""
        directions = transport.directions
        above = (some.flat_normal @ directions.T > 0) & (some.normal @ directions.T > 0)
        point, direction = np.nonzero(above & ~transport.visible[rows])
        if len(point) == 0:
            return point, direction, np.zeros((0, NEIGHBOURS), int), np.zeros((0, NEIGHBOURS), np.float32)
        starts = some.position[point], some.flat_normal[point], directions[direction]
        arrived, taps, shares = self._network.arrivals(*starts)
        return point[arrived], direction[arrived], taps, shares

    def _put(self, out, received, colour) -> None:
        """Fills out (3, p, M) with what ``received`` (1 or 3 channels of (p, s)) makes of the radiosity."""
        count = max(len(received), len(self._radiosity))
        products = [
            received[min(c, len(received) - 1)] @ self._radiosity[min(c, len(self._radiosity) - 1)]
            for c in range(count)
        ]
        for c in range(3):
            np.multiply(products[min(c, count - 1)], colour[c], out=out[c])

    def _mirrored(self, transport) -> list[csr_matrix]:
        points, net = transport.points, self._network
        arrived, taps, shares = net.arrivals(points.position, points.flat_normal, transport.reflected_directions())
        return [net.sparse(arrived, taps, shares / np.float32(np.pi), len(points))]
