# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenes in memory that benchmarks and checks look at: shapes, cameras, jobs without a file."""

import json
from pathlib import Path

import numpy as np
import trimesh

from btfsep_engine import sh
from btfsep_engine.job.model import Camera, Job, JobObject, Occluder, Photo, TriangleMesh
from btfsep_engine.render import surface
from btfsep_engine.render.sampling import spread
from btfsep_engine.render.tracer import Tracer
from btfsep_engine.render.transport import Transport
from scripts.studies.measures import timed

MATERIALS = ("leather/brown-grain", "fabric/denim-twill", "wood/walnut-lacquered")
METRES = 0.01  # of a world unit: a texel is larger than a pixel, whichever way it is filtered
WARM = 4000  # pixels of an estimate


def as_mesh(shape, *, flat=False) -> TriangleMesh:
    """A trimesh shape with smooth (or flat) normals."""
    faces = np.asarray(shape.faces, np.int32)
    normals = np.repeat(shape.face_normals[:, None], 3, 1) if flat else shape.vertex_normals[faces]
    return TriangleMesh(np.asarray(shape.vertices, np.float64), faces, np.asarray(normals, np.float32))


def ball() -> TriangleMesh:
    """The unit ball at the origin."""
    return as_mesh(trimesh.creation.icosphere(4))


def bowl() -> TriangleMesh:
    """The lower half of that ball, seen from above: it lights itself."""
    shape = trimesh.creation.icosphere(4)
    shape.update_faces(shape.triangles_center[:, 2] < 0.1)
    shape.remove_unreferenced_vertices()
    return as_mesh(shape)


def plate(height: float = 1.5, half: float = 0.6) -> TriangleMesh:
    """A square above the scene, to one side of the camera's axis."""
    shape = trimesh.creation.box([2 * half, 2 * half, 0.02])
    return as_mesh(shape.apply_translation([1.3, 0.2, height]), flat=True)


def looking_down(size: int, focal: float) -> Camera:
    """A square camera on the +z axis, 4 above the origin, looking down."""
    to_world = np.eye(4)
    to_world[2, 3] = 4.0
    return Camera(size, size, focal, focal, size / 2, size / 2, to_world)


def job_of(meshes, camera, *, occluders=(), metres_per_unit=METRES, uv: str = "xatlas") -> Job:
    """A job in memory, its photo black; ``occluders`` as of a job, or meshes of which nothing is known."""
    shape = camera.height, camera.width
    photo = Photo(np.zeros((*shape, 3), np.float32), np.ones(shape, bool), 0)
    objects = tuple(JobObject(f"object {i}", mesh, uv=uv) for i, mesh in enumerate(meshes))
    beside = tuple(o if isinstance(o, Occluder) else Occluder(o) for o in occluders)
    return Job(Path("."), photo, camera, objects, beside, metres_per_unit, 0.0, "")


def seen_normals(camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Of the unit ball at the origin: normals (h, w, 3) where the camera's pixels see it, and where they do, (h, w)."""
    shape = camera.height, camera.width
    rows, columns = np.mgrid[: camera.height, : camera.width]
    origins, directions = camera.rays(columns.ravel() + 0.5, rows.ravel() + 0.5)
    b = (origins * directions).sum(1)
    discriminant = b * b - (origins**2).sum(1) + 1
    normals = origins + (-b - np.sqrt(np.maximum(discriminant, 0)))[:, None] * directions
    return normals.reshape(*shape, 3), (discriminant > 0).reshape(shape)


def shaded_ball(camera: Camera, light) -> np.ndarray:
    """(h, w, 3): a white unit ball (albedo 0.8) under a light ((L + 1)^2, 3), before a background of 0.1."""
    normals, there = seen_normals(camera)
    return np.where(there[..., None], 0.8 / np.pi * sh.irradiance(light, normals), 0.1)


def write_job(
    folder: Path, shape: trimesh.Trimesh, camera: Camera, *, image="photo.exr", mesh="object.ply", metres=METRES, **told
) -> None:
    """A job folder of one object, but for its photograph; ``told`` of it, as ``docs/formats.md`` has it."""
    folder.mkdir(parents=True, exist_ok=True)
    shape.export(folder / mesh)
    seen = {k: getattr(camera, k) for k in ("width", "height", "fx", "fy", "cx", "cy")}
    job = {"format": "btfsep-job", "version": 1, "image": image, "metres_per_unit": metres}
    job["camera"] = {**seen, "to_world": camera.to_world.tolist()}
    job["objects"] = [{"name": "object", "mesh": mesh, **told}]
    (folder / "job.json").write_text(json.dumps(job))


def positive_light(order: int, seed: int = 0) -> np.ndarray:
    """Coefficients ((order + 1)^2, 3) of a light that is positive everywhere."""
    x = np.random.default_rng(seed).normal(size=(sh.term_count(order), 3)) * 0.12
    x[0] = 3.0
    assert sh.to_map(x, 32, 64).min() > 0
    return x


def dented(level: int) -> trimesh.Trimesh:
    """A sphere with dents that shade one another, of 20 * 4^level triangles and about unit radius."""
    ball = trimesh.creation.icosphere(level)
    ball.vertices *= 0.85 + 0.22 * waves(ball.vertices)
    return ball


def waves(positions) -> np.ndarray:
    """(n, 1) in [-1, 1]."""
    return np.sin(5 * np.asarray(positions) + [1, 2, 0.5]).prod(1, keepdims=True)


class Stage:
    """The dented sphere before a camera of ``size`` x ``size`` pixels.

    ``built`` : (2,) seconds that loading the mesh and building its tree of boxes took, as :func:`timed` has them
    """

    def __init__(self, *, level: int = 5, size: int = 320, textured: bool = True):
        self.shape = dented(level)
        self.job = job_of([as_mesh(self.shape)], looking_down(size, 1.55 * size))
        self.built, self.tracer = timed(lambda: Tracer([self.job.objects[0].mesh]))
        points = surface.surface_points(surface.camera_view(self.tracer, self.job), self.job, 0)
        self.points = surface.with_texture(points, self.job, 0) if textured else surface.with_any_tangent(points)

    def sample(self, count: int = WARM):
        """About ``count`` of the points, spread over the picture."""
        return self.points.take(spread(self.points, count))

    def transport(self, points, directions: int) -> Transport:
        return Transport(self.tracer, points, directions=directions, millimetres_per_unit=1000 * METRES)
