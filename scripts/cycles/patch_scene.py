# SPDX-License-Identifier: GPL-3.0-or-later
"""A displaced periodic patch in Cycles under a sun: what the virtual gonioreflectometer measures, in another way.

Three by three tiles as a flat-shaded mesh, colour, roughness and metallic as point attributes; an orthographic camera.
The mean radiance of exactly one tile, the middle one, is taken over the pixels whose centres lie in it.
"""

import math

import bpy
import numpy as np
from mathutils import Matrix, Vector

from blender_btfsep.basics import pixels
from scripts.cycles import studio

PIXELS = 5000  # about so many of an image lie in the tile
FAR = 300.0  # millimetres from the patch to the camera


def build(maps, *, layer=None) -> None:
    """Makes the scene anew; everything else is gone.

    Parameters
    ----------
    maps : btfsep_engine.btf.procedural.Maps
    layer : None: a Principled BSDF, as users have it, whose base is weighted by 1 - E(n.v). Else the layer's albedo E,
        (n, n) on [roughness, cosine] from 0 to 1: Principled's layer alone, and a diffuse base weighted by
        (1 - E(n.v)) (1 - E(n.l)) / (1 - E_mean) as the engine has it, l being the sun; what the sun is behind of has
        light from other places only, and 1 - E(n.v)
    """
    scene = studio.clear()
    scene.cycles.use_adaptive_sampling = False
    scene.cycles.max_bounces = 2  # three surface vertices
    scene.cycles.filter_width = 0.01
    scene.view_settings.view_transform = "Raw"
    scene.render.use_persistent_data = True  # the mesh stays as it is from image to image
    mesh = _mesh(maps)
    mesh.materials.append(_material(maps, layer))
    scene.collection.objects.link(bpy.data.objects.new("patch", mesh))
    sun = bpy.data.lights.new("sun", "SUN")
    sun.energy, sun.angle = 1.0, 0.0
    scene.collection.objects.link(bpy.data.objects.new("sun", sun))
    camera = bpy.data.cameras.new("camera")
    camera.type, camera.sensor_fit, camera.clip_end = "ORTHO", "HORIZONTAL", 10 * FAR
    scene.camera = bpy.data.objects.new("camera", camera)
    scene.collection.objects.link(scene.camera)


def _mesh(m):
    n, edge = len(m.height_mm), 3 * len(m.height_mm)
    c = (np.arange(edge) + 0.5) * (m.size_mm / n) - 1.5 * m.size_mm
    x, y = np.meshgrid(c, c)
    points = np.stack([x, y, np.tile(m.height_mm, (3, 3))], -1).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(edge - 1), np.arange(edge - 1))
    a = (j * edge + i).ravel()
    faces = np.concatenate([np.stack([a, a + 1, a + edge + 1], 1), np.stack([a, a + edge + 1, a + edge], 1)])
    mesh = bpy.data.meshes.new("patch")
    mesh.from_pydata(points, [], faces)
    mesh.shade_flat()
    colour = mesh.attributes.new("base", "FLOAT_COLOR", "POINT")
    rgba = np.ones((edge, edge, 4), np.float32)
    rgba[..., :3] = np.tile(m.base_colour, (3, 3, 1))
    colour.data.foreach_set("color", rgba.ravel())
    metallic = np.zeros_like(m.roughness) if m.metallic is None else m.metallic
    for name, values in (("rough", m.roughness), ("metallic", metallic)):
        attribute = mesh.attributes.new(name, "FLOAT", "POINT")
        attribute.data.foreach_set("value", np.tile(values, (3, 3)).astype(np.float32).ravel())
    return mesh


def _material(m, layer):
    material = bpy.data.materials.new("micro")
    material.use_nodes = True
    nodes, links = material.node_tree.nodes, material.node_tree.links
    shader = nodes["Principled BSDF"]
    shader.distribution = "GGX"
    root = math.sqrt(m.f0)
    shader.inputs["IOR"].default_value = (1 + root) / (1 - root)
    if m.f0 == 0:
        shader.inputs["Specular IOR Level"].default_value = 0

    def attribute(name, output):
        node = nodes.new("ShaderNodeAttribute")
        node.attribute_name = name
        return node.outputs[output]

    links.new(attribute("rough", "Fac"), shader.inputs["Roughness"])
    links.new(attribute("metallic", "Fac"), shader.inputs["Metallic"])
    if layer is None:
        links.new(attribute("base", "Color"), shader.inputs["Base Color"])
        return material
    shader.inputs["Base Color"].default_value = (0, 0, 0, 1)
    diffuse, both = nodes.new("ShaderNodeBsdfDiffuse"), nodes.new("ShaderNodeAddShader")
    diffuse.inputs["Roughness"].default_value = 0
    geometry, sun = nodes.new("ShaderNodeNewGeometry"), nodes.new("ShaderNodeCombineXYZ")
    sun.name = "to sun"

    def passed(direction, values):
        """A look-up in a table of [roughness, cosine], and the cosine."""
        cosine = nodes.new("ShaderNodeVectorMath")
        cosine.operation = "DOT_PRODUCT"
        links.new(geometry.outputs["True Normal"], cosine.inputs[0])
        links.new(direction, cosine.inputs[1])
        clamped = math_node("MINIMUM", math_node("MAXIMUM", cosine.outputs["Value"], 0.0), 1.0)
        return _table(values, nodes, links, math_node, clamped, attribute("rough", "Fac")), cosine.outputs["Value"]

    def math_node(operation, a, b):
        node = nodes.new("ShaderNodeMath")
        node.operation = operation
        for value, target in ((a, node.inputs[0]), (b, node.inputs[1])):
            if isinstance(value, float):
                target.default_value = value
            else:
                links.new(value, target)
        return node.outputs[0]

    mu = np.linspace(0, 1, layer.shape[1])
    weighted = layer * 2 * mu
    mean = (weighted[:, 1:] + weighted[:, :-1]).sum(1, keepdims=True) / (2 * (len(mu) - 1))
    of_eye, _ = passed(geometry.outputs["Incoming"], 1 - layer)
    of_sun, cosine = passed(sun.outputs[0], (1 - layer) / (1 - mean))
    lit = math_node("GREATER_THAN", cosine, 0.0)
    of_sun = math_node("ADD", math_node("MULTIPLY", math_node("SUBTRACT", of_sun, 1.0), lit), 1.0)
    factor = math_node("MULTIPLY", of_eye, of_sun)
    scaled = nodes.new("ShaderNodeVectorMath")
    scaled.operation = "SCALE"
    links.new(attribute("base", "Color"), scaled.inputs[0])
    links.new(factor, scaled.inputs["Scale"])
    links.new(scaled.outputs[0], diffuse.inputs["Color"])
    links.new(diffuse.outputs[0], both.inputs[0])
    links.new(shader.outputs[0], both.inputs[1])
    links.new(both.outputs[0], nodes["Material Output"].inputs["Surface"])
    return material


def _table(values, nodes, links, math_node, across, up):
    """Looks up ``values : (rows, columns)`` at (across, up) in [0, 1], linear between nodes i / (n - 1)."""
    rows, columns = values.shape
    place, node = nodes.new("ShaderNodeCombineXYZ"), nodes.new("ShaderNodeTexImage")
    node.image, node.interpolation, node.extension = pixels.new("table", values), "Linear", "EXTEND"
    for target, value, n in ((place.inputs[0], across, columns), (place.inputs[1], up, rows)):
        links.new(math_node("ADD", math_node("MULTIPLY", value, (n - 1.0) / n), 0.5 / n), target)
    links.new(place.outputs[0], node.inputs["Vector"])
    return node.outputs["Color"]


def mean_radiance(view, light, path, *, size_mm: float, samples: int, seed: int = 0) -> np.ndarray:
    """Mean radiance of the tile under a sun of unit irradiance across its beam.

    Parameters
    ----------
    view, light : (3,) float, unit, to the eye and to the light
    path : a file for the image
    samples : a pixel

    Returns
    -------
    (3,) float64
    """
    scene = bpy.context.scene
    to_eye, to_light = Vector(view), Vector(light)
    sun, camera = bpy.data.objects["sun"], scene.camera
    sun.rotation_mode = camera.rotation_mode = "QUATERNION"
    sun.rotation_quaternion = to_light.to_track_quat("Z", "Y")
    node = bpy.data.materials["micro"].node_tree.nodes.get("to sun")
    if node:
        for value, target in zip(light, node.inputs, strict=True):
            target.default_value = float(value)
    aside = Vector((-to_eye.y, to_eye.x, 0))
    right = aside.normalized() if aside.length > 1e-6 else Vector((0, 1, 0))
    up = to_eye.cross(right)
    camera.rotation_quaternion = Matrix((right, up, to_eye)).transposed().to_quaternion()
    camera.location = to_eye * FAR
    corners = np.array([(x, y, 0) for x in (-0.5, 0.5) for y in (-0.5, 0.5)]) * size_mm
    width, height = (np.ptp(corners @ np.array(axis)) for axis in (right, up))
    pitch = math.sqrt(size_mm**2 * to_eye.z / PIXELS)
    across, down = (max(4, math.ceil(extent / pitch)) for extent in (width, height))
    camera.data.ortho_scale = across * pitch
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = across, down, 100
    scene.cycles.seed = seed
    shown = studio.render_photo(scene, path, samples)[::-1].astype(np.float64)  # row 0 at the bottom
    x, y = np.meshgrid((np.arange(across) - across / 2 + 0.5) * pitch, (np.arange(down) - down / 2 + 0.5) * pitch)
    place = x[..., None] * np.array(right) + y[..., None] * np.array(up)
    place = place - place[..., 2:] / to_eye.z * np.array(to_eye)
    return shown[(np.abs(place[..., :2]) < size_mm / 2).all(-1)].mean(0)
