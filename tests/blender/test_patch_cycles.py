# SPDX-License-Identifier: GPL-3.0-or-later
"""The virtual gonioreflectometer against Cycles: the same displaced patch, sun and view, mean radiance.

Cycles sees an orthographic image of exactly one tile in the middle of three by three.
"""

import math

import bpy
import numpy as np
import pytest

from btfsep_engine.btf.procedural import Maps, maps
from btfsep_engine.conventions import local_direction
from btfsep_engine.render.patch import Patch

VIEWS = [(0, 0), (45, 0), (45, 180), (67.5, 0)]  # degrees; phi along the image's edges, so that a tile is a rectangle
LIGHTS = [(0, 0), (30, 90), (45, 180), (60, 30), (67.5, 255)]


def waves(base, f0):
    n = 96
    x = (np.arange(n) + 0.5) / n
    height = 0.8 * np.sin(4 * np.pi * x) + 0.2 * np.sin(8 * np.pi * x)
    colour = np.broadcast_to(np.asarray(base, np.float32), (n, n, 3))
    height = np.tile(height.astype(np.float32), (n, 1))
    return Maps("test/waves", colour, height, np.full((n, n), 0.5, np.float32), 10.0, f0)


def build_scene(m):
    """Three by three tiles as a flat-shaded mesh, colour and roughness as point attributes, one sun, one camera."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.cycles.device = "CPU"
    scene.cycles.use_denoising = False
    scene.cycles.use_adaptive_sampling = False
    scene.cycles.max_bounces = 2  # three surface vertices
    scene.cycles.filter_width = 0.01
    scene.view_settings.view_transform = "Raw"
    n, edge = len(m.height_mm), 3 * len(m.height_mm)
    c = (np.arange(edge) + 0.5) * (m.size_mm / n) - 1.5 * m.size_mm
    x, y = np.meshgrid(c, c)
    points = np.stack([x, y, np.tile(m.height_mm, (3, 3))], -1).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(edge - 1), np.arange(edge - 1))
    a = (j * edge + i).ravel()
    faces = np.concatenate([np.stack([a, a + 1, a + edge + 1], 1), np.stack([a, a + edge + 1, a + edge], 1)])
    mesh = bpy.data.meshes.new("patch")
    mesh.vertices.add(len(points))
    mesh.loops.add(faces.size)
    mesh.polygons.add(len(faces))
    mesh.vertices.foreach_set("co", points.astype(np.float32).ravel())
    mesh.loops.foreach_set("vertex_index", faces.astype(np.int32).ravel())
    mesh.polygons.foreach_set("loop_start", np.arange(0, faces.size, 3, dtype=np.int32))
    mesh.polygons.foreach_set("use_smooth", np.zeros(len(faces), bool))
    colour = mesh.attributes.new("base", "FLOAT_COLOR", "POINT")
    rgba = np.ones((edge, edge, 4), np.float32)
    rgba[..., :3] = np.tile(m.base_colour, (3, 3, 1))
    colour.data.foreach_set("color", rgba.ravel())
    rough = mesh.attributes.new("rough", "FLOAT", "POINT")
    rough.data.foreach_set("value", np.tile(m.roughness, (3, 3)).ravel())
    mesh.update(calc_edges=True)
    material = bpy.data.materials.new("micro")
    material.use_nodes = True
    nodes, links = material.node_tree.nodes, material.node_tree.links
    shader = nodes["Principled BSDF"]
    shader.distribution = "GGX"
    root = math.sqrt(m.f0)
    shader.inputs["IOR"].default_value = (1 + root) / (1 - root)
    if m.f0 == 0:
        shader.inputs["Specular IOR Level"].default_value = 0
    for attribute, output, target in (("base", "Color", "Base Color"), ("rough", "Fac", "Roughness")):
        node = nodes.new("ShaderNodeAttribute")
        node.attribute_name = attribute
        links.new(node.outputs[output], shader.inputs[target])
    mesh.materials.append(material)
    scene.collection.objects.link(bpy.data.objects.new("patch", mesh))
    sun = bpy.data.lights.new("sun", "SUN")
    sun.energy, sun.angle = 1.0, 0.0
    scene.collection.objects.link(bpy.data.objects.new("sun", sun))
    camera = bpy.data.cameras.new("camera")
    camera.type, camera.ortho_scale, camera.sensor_fit = "ORTHO", m.size_mm, "HORIZONTAL"
    camera.clip_end = 1000
    scene.camera = bpy.data.objects.new("camera", camera)
    scene.collection.objects.link(scene.camera)


def cycles_mean(view, light, path, samples):
    """Mean radiance (3,) of the tile seen from ``view`` under a sun of unit irradiance at ``light`` (degrees)."""
    from mathutils import Vector

    scene = bpy.context.scene
    to_eye, to_light = (local_direction(*np.radians(d)) for d in (view, light))
    sun = bpy.data.objects["sun"]
    sun.rotation_mode = scene.camera.rotation_mode = "QUATERNION"
    sun.rotation_quaternion = Vector(to_light).to_track_quat("Z", "Y")
    theta, phi = np.radians(view)
    # the camera's right is across the plane of view; its up is in it
    backward, right = Vector(to_eye), Vector((-math.sin(phi), math.cos(phi), 0))
    up = backward.cross(right)
    from mathutils import Matrix

    scene.camera.rotation_quaternion = Matrix((right, up, backward)).transposed().to_quaternion()
    scene.camera.location = Vector(to_eye) * 300
    scene.render.resolution_x = scene.render.resolution_y = 64
    scene.render.resolution_percentage = 100
    scene.render.pixel_aspect_x, scene.render.pixel_aspect_y = 1 / math.cos(theta), 1
    scene.cycles.samples = samples
    scene.render.image_settings.file_format = "OPEN_EXR"
    scene.render.image_settings.color_depth = "32"
    scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(str(path))
    pixels = np.array(image.pixels[:]).reshape(64, 64, -1)[..., :3]
    bpy.data.images.remove(image)
    return pixels.mean((0, 1))


def compare(m, tmp_path, *, samples, views=VIEWS, lights=LIGHTS):
    """Mean radiances of both, (views, lights, 3)."""
    build_scene(m)
    ours = Patch(m, local_direction(*np.radians(lights).T))
    ours = np.stack([b.mean(1).T for b in ours.views(local_direction(*np.radians(views).T), texels=64, samples=4)])
    theirs = [[cycles_mean(v, l, tmp_path / "image.exr", samples) for l in lights] for v in views]
    return ours, np.array(theirs)


@pytest.mark.parametrize(("base", "f0", "limit"), [((0.7, 0.4, 0.1), 0.0, 0.01), ((0.5, 0.2, 0.05), 0.04, 0.03)])
def test_waves(base, f0, limit, tmp_path):
    ours, theirs = compare(waves(base, f0), tmp_path, samples=32)
    error = np.abs(ours / theirs - 1)
    assert np.median(error) < limit, error
    assert error.max() < 12 * limit


@pytest.mark.parametrize("name", ["leather/brown-grain", "carpet/cut-wine"])
def test_materials_of_the_library(name, tmp_path):
    ours, theirs = compare(maps(name, 192), tmp_path, samples=32, views=VIEWS[1:3], lights=LIGHTS[1:4])
    assert np.median(np.abs(ours / theirs - 1)) < 0.03
