# SPDX-License-Identifier: GPL-3.0-or-later
"""Lights for the tests, and what they are looked at with."""

import bpy
import numpy as np

from blender_btfsep.basics import harmonics
from btfsep_engine import sh
from scripts.cycles import materials

LIGHTING = {
    "format": "btfsep-lighting",
    "version": 1,
    "basis": "real-sh",
    "order": 1,
    "coefficients": [[1, 2, 3], [0.5, -0.5, 0], [0.25, 0, 1], [0, 0, -1]],
}
"""What `lighting.json` holds, of few numbers."""


def lighting(coefficients):
    coefficients = np.asarray(coefficients, float)
    return {"order": harmonics.order_of(len(coefficients)), "coefficients": coefficients.tolist()}


def random_coefficients(order, seed=0):
    return np.random.default_rng(seed).normal(size=((order + 1) ** 2, 3))


def positive_coefficients(order, seed=0):
    """Random, with enough of Y_00 that the light is nowhere negative."""
    c = random_coefficients(order, seed)
    c[0] = 0
    c[0] = (0.05 - sh.to_map(c, 64, 128).min(axis=(0, 1))) * np.sqrt(4 * np.pi)
    assert sh.to_map(c, 64, 128).min() > 0
    return c


def look_around(scene):
    """A panoramic camera whose picture is the environment map itself."""
    data = bpy.data.cameras.new("Panorama")
    camera = bpy.data.objects.new("Panorama", data)
    scene.collection.objects.link(camera)
    data.type = "PANO"
    owner = data if hasattr(data, "panorama_type") else data.cycles  # Blender 5 moved it
    owner.panorama_type = "EQUIRECTANGULAR"
    camera.rotation_euler = (np.pi / 2, 0, -np.pi / 2)  # the middle of the picture is +X
    scene.camera = camera
    scene.render.resolution_x, scene.render.resolution_y = 128, 64
    scene.cycles.samples = 1
    scene.cycles.filter_width = 0.01


def white_ball(scene, add_camera, *, colour=1.0, size=40, samples=128):
    """A white matte ball of radius 1 in an orthographic picture 2.2 wide; gives its normals (h, w, 3), and inside."""
    bpy.ops.mesh.primitive_uv_sphere_add(segments=128, ring_count=64, radius=1)
    ball = bpy.context.object
    ball.data.shade_smooth()
    ball.data.materials.append(materials.white(colour))
    scene.render.resolution_x = scene.render.resolution_y = size
    camera = add_camera(scene, (3.0, -5.0, 2.5))
    camera.data.type, camera.data.ortho_scale = "ORTHO", 2.2
    scene.cycles.samples, scene.cycles.max_bounces = samples, 0
    x = ((np.arange(size) + 0.5) / size - 0.5) * 2.2
    px, py = np.meshgrid(x, -x)
    local = np.stack([px, py, np.sqrt(np.maximum(1 - px**2 - py**2, 0))], -1)
    return local @ np.array(camera.matrix_world)[:3, :3].T, px**2 + py**2 < 0.9**2
