# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenes that go through both transports, the kernel and the reference."""

from dataclasses import replace

import numpy as np
import trimesh

from btfsep_engine.job.model import TriangleMesh
from btfsep_engine.render.reference import Reference
from btfsep_engine.render.sampling import spread
from btfsep_engine.render.surface import camera_view, surface_points, with_any_tangent, with_texture
from btfsep_engine.render.tracer import Tracer
from btfsep_engine.render.transport import Transport
from tests.render.scenes import as_mesh, job_of, looking_down

MILLIMETRES = 50.0  # in a world unit: pixels are smaller than the texels of `btf_materials.textured`


class Prepared:
    """A scene of meshes, the first of which is looked at."""

    def __init__(self, meshes, material, *, count, use_texture, occluders=(), uv="xatlas", camera=None, others=()):
        self.material, self.textured = material, use_texture
        job = job_of(meshes, camera or looking_down(), occluders=occluders, metres_per_unit=MILLIMETRES / 1000)
        self.job = replace(job, objects=tuple(replace(o, uv=uv) for o in job.objects))
        beside = [o.mesh for o in job.occluders]
        self.tracer = Tracer([*meshes, *beside], range(len(meshes), len(meshes) + len(beside)))
        points = surface_points(camera_view(self.tracer, self.job), self.job, 0)
        points = points.take(spread(points, count))
        self.points = with_texture(points, self.job, 0) if use_texture else with_any_tangent(points)
        self.materials = [material, *others]

    def kernel(self, lights, *, directions=4096):
        transport = Transport(self.tracer, self.points, directions=directions, millimetres_per_unit=MILLIMETRES)
        return transport.radiance(self.material, lights)

    def reference(self, lights, *, samples=1024, bounces=1, seed=0):
        scene = Reference(self.job, self.tracer, self.materials, bounces=bounces, textured=self.textured)
        return scene.radiance(self.points.pixels, lights, samples=samples, seed=seed, jitter=False)


def sheet(*, mirrored=False, back=False, n=25):
    """A waved open sheet with its own UV, mirrored or not, its face or its back to the camera; n x n vertices."""
    x, y = np.meshgrid(np.linspace(-0.9, 0.9, n), np.linspace(-0.9, 0.9, n))
    vertices = np.stack([x, y, 0.15 * np.sin(3 * x + 2 * y)], -1).reshape(-1, 3)
    at = np.arange(n * n).reshape(n, n)
    a, b, c, d = (s.ravel() for s in (at[:-1, :-1], at[:-1, 1:], at[1:, 1:], at[1:, :-1]))
    faces = np.concatenate([np.stack([a, b, c], -1), np.stack([a, c, d], -1)])
    if back:
        faces = faces[:, ::-1]
    shape = trimesh.Trimesh(vertices, faces, process=False)
    u, v = 0.8 * vertices[:, 0] + 0.6 * vertices[:, 1], 0.8 * vertices[:, 1] - 0.6 * vertices[:, 0]
    uv = np.stack([-u if mirrored else u, v], -1).astype(np.float32)
    plain = as_mesh(shape)
    return TriangleMesh(plain.vertices, plain.faces, plain.corner_normals, uv[plain.faces])
