# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenes that the tests make: simple shapes, cameras, jobs in memory."""

from pathlib import Path

import numpy as np

from btfsep_engine import sh
from btfsep_engine.conventions import fibonacci_sphere
from btfsep_engine.job.model import Camera, Job, JobObject, Occluder, Photo, TriangleMesh


def as_mesh(shape, *, flat=False) -> TriangleMesh:
    """A trimesh shape as a TriangleMesh with smooth (or flat) normals."""
    faces = np.asarray(shape.faces, np.int32)
    normals = np.repeat(shape.face_normals[:, None], 3, 1) if flat else shape.vertex_normals[faces]
    return TriangleMesh(np.asarray(shape.vertices, np.float64), faces, np.asarray(normals, np.float32))


def looking_down(size=96, focal=200.0, height=4.0) -> Camera:
    """A square camera on the +z axis that looks down at the origin."""
    to_world = np.eye(4)
    to_world[2, 3] = height
    return Camera(size, size, focal, focal, size / 2, size / 2, to_world)


def job_of(meshes, camera, *, occluders=(), metres_per_unit=0.05) -> Job:
    """A job in memory, its photo black; ``occluders`` as of a job, or meshes of which nothing is known."""
    photo = Photo(
        np.zeros((camera.height, camera.width, 3), np.float32), np.ones((camera.height, camera.width), bool), 0
    )
    objects = tuple(JobObject(f"object {i}", mesh) for i, mesh in enumerate(meshes))
    beside = tuple(o if isinstance(o, Occluder) else Occluder(o) for o in occluders)
    return Job(Path("."), photo, camera, objects, beside, metres_per_unit, 0.0, "")


def off_as_seen(x, truth) -> float:
    """Relative error of what faces a camera above receives from a light (terms, 3) against the true one's.

    What does not face it, the photo does not show: lights that differ in that alone are the same to it.
    """
    up = fibonacci_sphere(400)
    up = up[up[:, 2] > 0.3]
    found, right = (sh.irradiance(np.asarray(each)[:9], up) for each in (x, truth))
    return float(np.linalg.norm(found - right) / np.linalg.norm(right))


def positive_light(order, seed=0) -> np.ndarray:
    """Coefficients ((order + 1)^2, 3) of a light that is positive everywhere."""
    x = np.random.default_rng(seed).normal(size=(sh.term_count(order), 3)) * 0.12
    x[0] = 3.0
    assert sh.to_map(x, 32, 64).min() > 0
    return x
