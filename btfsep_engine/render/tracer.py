# SPDX-License-Identifier: GPL-3.0-or-later
"""Rays against a job's triangles: nearest hits and visibility, by Mitsuba's ray tracer.

The scene is moved to its objects' centre and scaled to their radius, so that single precision serves any scene, however
far the ground goes on; positions and distances that leave this module are in world units again.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from btfsep_engine.errors import InputError
from btfsep_engine.render.arrays import divided, dr, mi, packets, vector
from btfsep_engine.storage import kept

MISS = np.int32(-1)
LANES = 1 << 22  # rays traced at once: bounds the memory of a pass to a few hundred MB
FACE_BYTES = 300  # that a triangle takes in the ray tracer, about
OFFSET = 2e-4  # start of a secondary ray off its surface, in the objects' radii


@dataclass(frozen=True)
class Hits:
    """Nearest hits of n rays.

    Attributes
    ----------
    mesh : (n,) int32, index of the mesh, -1 where nothing is hit
    face : (n,) int32
    barycentric : (n, 3) float32, weights of the face's corners
    distance : (n,) float64, world units
    """

    mesh: np.ndarray
    face: np.ndarray
    barycentric: np.ndarray
    distance: np.ndarray


class Tracer:
    """Ray queries against a list of triangle meshes (objects first, then occluders, then unseen sides).

    Parameters
    ----------
    meshes : sequence of job.model.TriangleMesh
    occluders : numbers of those that may reach far beyond what is looked at

    Attributes
    ----------
    centre, radius : of all but the occluders
    """

    def __init__(self, meshes, occluders=()):
        self.meshes, self.occluders = tuple(meshes), tuple(occluders)
        if not self.meshes:
            raise InputError("the job", "no geometry", "export at least one object with faces")
        objects = [m for i, m in enumerate(self.meshes) if i not in self.occluders]
        used = [m.vertices[np.unique(m.faces)] for m in objects]
        low = np.min([v.min(0) for v in used], 0)
        high = np.max([v.max(0) for v in used], 0)
        self.centre = (low + high) / 2
        self.radius = float(np.linalg.norm(high - low) / 2) or 1.0
        shapes = {f"mesh{i:04d}": self._mitsuba_mesh(i, mesh) for i, mesh in enumerate(self.meshes)}
        self.scene = mi.load_dict({"type": "scene", **shapes})
        # a hit names its shape by registry id: the table back to our mesh numbers
        registry = np.array(dr.reinterpret_array(mi.UInt32, self.scene.shapes_dr()))
        self._numbers = np.zeros(int(registry.max()) + 1, np.int32)
        self._numbers[registry] = [self._shape_number(shape) for shape in self.scene.shapes()]

    @cached_property
    def key(self) -> str:
        """Of all that the rays' answers depend on (`kept.content`)."""
        return kept.content([list(self.meshes), list(self.occluders)])

    def _mitsuba_mesh(self, number, mesh):
        shape = mi.Mesh(f"mesh{number:04d}", len(mesh.vertices), len(mesh.faces), has_vertex_normals=False)
        params = mi.traverse(shape)
        params["vertex_positions"] = mi.Float(self.to_local(mesh.vertices).astype(np.float32).ravel())
        params["faces"] = mi.UInt32(np.ascontiguousarray(mesh.faces, np.uint32).ravel())
        params.update()
        return shape

    @staticmethod
    def _shape_number(shape) -> int:
        return int(shape.id()[4:])

    def to_local(self, points):
        """World positions in the tracer's own, centred and scaled, space."""
        return (np.asarray(points, np.float64) - self.centre) / self.radius

    def nearest(self, origins, directions) -> Hits:
        """Nearest hits of rays ``origins, directions : (n, 3) float``, world space, directions unit."""
        n = len(origins)
        mesh = np.full(n, MISS)
        face = np.zeros(n, np.int32)
        barycentric = np.zeros((n, 3), np.float32)
        distance = np.full(n, np.inf)
        for start in range(0, n, LANES):
            part = slice(start, min(n, start + LANES))
            ray = mi.Ray3f(mi.Point3f(vector(self.to_local(origins[part]))), vector(directions[part]))
            hit = self.scene.ray_intersect_preliminary(ray, coherent=False)
            found = [hit.is_valid(), dr.reinterpret_array(mi.UInt32, hit.shape), hit.prim_index]
            found += [hit.prim_uv.x, hit.prim_uv.y, hit.t]
            dr.eval(found)  # together: one by one, each would trace its rays again
            valid, shape, index, u, v, t = (np.array(a) for a in found)
            mesh[part] = np.where(valid, self._numbers[np.where(valid, shape, 0)], MISS)
            face[part] = np.where(valid, index.astype(np.int32), 0)
            u, v = np.where(valid, u, 0), np.where(valid, v, 0)  # of a miss they are anything
            barycentric[part] = np.stack([1 - u - v, u, v], -1)
            distance[part] = np.where(valid, t.astype(np.float64) * self.radius, np.inf)
        return Hits(mesh, face, barycentric, distance)

    def visible(self, positions, offset_normals, directions) -> np.ndarray:
        """Which of the shared directions each point sees.

        Parameters
        ----------
        positions : (p, 3) float, world
        offset_normals : (p, 3) float, unit; rays start a little along them
        directions : (n, 3) float, unit, world, the same for all points

        Returns
        -------
        (p, n) bool, true where the ray leaves the scene; false below the horizon of ``offset_normals``
        """
        p, n = len(positions), len(directions)
        out = np.empty((p, n), bool)
        step = max(1, LANES // n)
        for start in range(0, p, step):
            part = slice(start, min(p, start + step))
            out[part] = np.array(self.visible_lanes(positions[part], offset_normals[part], directions)).reshape(-1, n)
        return out

    def visible_lanes(self, positions, offset_normals, directions):
        """As :meth:`visible`, left where it was traced: a Mitsuba Bool of p * n lanes, evaluated."""
        p, n = len(positions), len(directions)
        starts = self.to_local(positions) + OFFSET * np.asarray(offset_normals, np.float64)
        starts, normals, shared = (packets(a) for a in (starts, offset_normals, directions))
        lane = dr.arange(mi.UInt32, p * n)
        point = divided(lane, n)
        origin, normal = (dr.gather(mi.Vector4f, a, point).xyz for a in (starts, normals))
        omega = dr.gather(mi.Vector4f, shared, lane - point * dr.opaque(mi.UInt32, n)).xyz
        above = dr.dot(normal, omega) > 0
        seen = above & ~self.scene.ray_test(mi.Ray3f(origin, omega), coherent=False, active=above)
        dr.eval(seen)
        return seen

    def arrivals(self, positions, offset_normals, directions):
        """Where rays of their own directions (n, 3) from points (n, 3) meet a surface.

        Returns
        -------
        arrived : (m,) numbers of those that do, ascending
        places : (m, 3) float64, world; facing : (m, 3), unit, the normals of the faces there, on the rays' side
        """
        starts = np.asarray(positions, np.float64) + OFFSET * self.radius * np.asarray(offset_normals, np.float64)
        hits = self.nearest(starts, directions)
        arrived = np.flatnonzero(hits.mesh != MISS)
        places = starts[arrived] + hits.distance[arrived, None] * directions[arrived]
        facing = np.empty_like(places)
        for number, mesh in enumerate(self.meshes):
            mine = hits.mesh[arrived] == number
            corners = mesh.vertices[mesh.faces[hits.face[arrived][mine]]]
            facing[mine] = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        facing /= np.maximum(np.linalg.norm(facing, axis=1, keepdims=True), 1e-300)
        facing *= -np.sign((facing * directions[arrived]).sum(1, keepdims=True))
        return arrived, places, facing

    def sees_sky(self, positions, offset_normals, directions) -> np.ndarray:
        """Whether each point (n, 3) sees the sky in its own direction (n, 3): (n,) bool."""
        starts = np.asarray(positions, np.float64) + OFFSET * self.radius * np.asarray(offset_normals, np.float64)
        above = (np.asarray(offset_normals) * directions).sum(1) > 0
        return above & (self.nearest(starts, directions).mesh == MISS)


def tracer_of(meshes, occluders=()) -> Tracer:
    """The :class:`Tracer` of these meshes: one that is kept, or a new one."""
    meshes, occluders = list(meshes), list(occluders)
    size = FACE_BYTES * sum(len(m.faces) for m in meshes)
    return kept.recalled("tracer", [meshes, occluders], lambda: Tracer(meshes, occluders), size=size)
