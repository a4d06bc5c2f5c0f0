# SPDX-License-Identifier: GPL-3.0-or-later
"""Materials of the photographed objects: white matte, alike all over, or meso-structure as true geometry.

A displaced material is a dense mesh whose vertices stand at the height of the map, with the map's colour and
roughness on a Principled BSDF: what the engine's tables stand for, made in another way.
"""

import bpy
import numpy as np
from scipy.ndimage import fourier_gaussian, map_coordinates

from blender_btfsep.basics import pixels
from scripts.cycles import objects

FACE_MM = 0.16  # edge of a face of the displaced mesh, about: with 0.3 the grain of leather loses half of its slope ...
MOST_FACES = 6_000_000  # ... unless that takes more faces than this
WHITE_ALBEDO = 0.8
MAP_RESOLUTION = 512


def node_tree(owner):
    """The shader nodes of a material or a World, emptied. (Blender 5 has them always on.)"""
    if bpy.app.version < (5, 0, 0):
        owner.use_nodes = True
    owner.node_tree.nodes.clear()
    return owner.node_tree


def shaded(name: str, kind: str, **inputs):
    """A material of one shader node, such as ``ShaderNodeEmission``: the material, and the node.

    ``inputs`` : values of its sockets, "_" for a space
    """
    material = bpy.data.materials.new(name)
    tree = node_tree(material)
    shader, out = tree.nodes.new(kind), tree.nodes.new("ShaderNodeOutputMaterial")
    for socket, value in inputs.items():
        shader.inputs[socket.replace("_", " ")].default_value = value
    tree.links.new(shader.outputs[0], out.inputs["Surface"])
    return material, shader


def white(albedo=WHITE_ALBEDO) -> bpy.types.Material:
    """A perfectly diffuse material of an albedo, one number or three."""
    return shaded("white matte", "ShaderNodeBsdfDiffuse", Color=(*np.broadcast_to(albedo, 3), 1), Roughness=0)[0]


def patterned(kind: str, colours, size: float, *, turn: float) -> bpy.types.Material:
    """A perfectly diffuse material of two ``colours`` (2, 3), in a pattern of the object's own x and y.

    ``kind`` : "planks", "tiles", "checks", "marble" or "speckles"; ``size`` : a plank's width, a tile's or a check's
    side, a vein's distance, ten speckles'; metres; ``turn`` : of the pattern, radians
    """
    material, bsdf = shaded(kind, "ShaderNodeBsdfDiffuse", Roughness=0)
    nodes, links = material.node_tree.nodes, material.node_tree.links
    place, turned = nodes.new("ShaderNodeTexCoord"), nodes.new("ShaderNodeMapping")
    turned.inputs["Rotation"].default_value = (0, 0, turn)
    links.new(place.outputs["Object"], turned.inputs["Vector"])
    first, second = ((*colour, 1) for colour in colours)
    if kind in ("planks", "tiles"):
        node = nodes.new("ShaderNodeTexBrick")
        planks = kind == "planks"
        node.offset = 0.5 if planks else 0
        joint = tuple(0.3 * np.array(first[:3])) if planks else second[:3]
        long = size * (8 if planks else 1)
        numbers = {"Scale": 1, "Brick Width": long, "Row Height": size, "Mortar Size": 0.02 * size}
        shades = {"Color1": first, "Color2": second if planks else first, "Mortar": (*joint, 1)}
        for name, value in (numbers | shades).items():
            node.inputs[name].default_value = value
    elif kind == "checks":
        node = nodes.new("ShaderNodeTexChecker")
        for name, value in {"Scale": 1 / size, "Color1": first, "Color2": second}.items():
            node.inputs[name].default_value = value
        # the plane lies where the pattern changes from one side to the other
        turned.inputs["Location"].default_value = (0, 0, size / 2)
    else:
        noise, node = nodes.new("ShaderNodeTexNoise"), nodes.new("ShaderNodeValToRGB")
        veins = kind == "marble"
        noise.inputs["Scale"].default_value, noise.inputs["Detail"].default_value = (1 if veins else 10) / size, 3
        low, high = node.color_ramp.elements
        low.position, high.position = (0.35, 0.65) if veins else (0.47, 0.53)
        low.color, high.color = first, second
        links.new(turned.outputs["Vector"], noise.inputs["Vector"])
        links.new(noise.outputs["Fac"], node.inputs["Fac"])
    if "Vector" in node.inputs:
        links.new(turned.outputs["Vector"], node.inputs["Vector"])
    links.new(node.outputs["Color"], bsdf.inputs["Color"])
    return material


def principled(surface) -> bpy.types.Material:
    """A material alike all over, of the numbers of `scripts.cycles.plain`."""
    more = {"Roughness": surface["roughness"], "Metallic": surface["metallic"]}
    return shaded("own", "ShaderNodeBsdfPrincipled", Base_Color=(*surface["colour"], 1), **more)[0]


def surface(name: str, maps) -> bpy.types.Material:
    """Colour and roughness of ``maps`` by the mesh's UV (one unit a tile), on a Principled BSDF of the maps' f0."""
    root = np.sqrt(float(maps.f0))
    material, bsdf = shaded(name, "ShaderNodeBsdfPrincipled", IOR=(1 + root) / (1 - root))
    for field, socket in (("base_colour", "Base Color"), ("roughness", "Roughness")):
        node = material.node_tree.nodes.new("ShaderNodeTexImage")
        node.image = pixels.new(f"{name} {field}", getattr(maps, field))
        material.node_tree.links.new(node.outputs["Color"], bsdf.inputs[socket])
    return material


def smoothed(height, sigma_texels: float) -> np.ndarray:
    """A periodic map (n, m) under a Gaussian, so that a mesh can carry it without aliasing."""
    return np.fft.ifft2(fourier_gaussian(np.fft.fft2(height), sigma_texels)).real


def sample_periodic(values, uv) -> np.ndarray:
    """Bilinear look-up in a periodic map (h, w), row 0 at the smallest v; ``uv : (n, 2)``, one unit a tile."""
    return map_coordinates(values, (uv * values.shape[::-1] - 0.5).T[::-1], order=1, mode="grid-wrap")


def displaced(base: bpy.types.Object, name: str, maps, *, face_mm: float = FACE_MM) -> bpy.types.Object:
    """A copy of ``base`` that carries ``maps`` as geometry, linked to the current scene.

    The base is subdivided to faces of ``face_mm`` and its welded vertices move along their smooth normals by the
    map's height (its mean taken off). Where charts of the UV map meet, a vertex takes the mean of its corners'
    heights: the surface has no cracks.

    Parameters
    ----------
    base : its UV map in metres, scene units metres
    maps : base_colour (n, n, 3) linear, height_mm (n, n), roughness (n, n), size_mm, f0
    """
    vertex, _ = objects.triangles(base.data)
    area = objects.area(objects.vertex_positions(base.data)[vertex])
    faces = len(base.data.polygons)
    wanted = min(area / (face_mm * 1e-3) ** 2, MOST_FACES)
    levels = max(int(np.round(np.log(wanted / faces) / np.log(4))), 0)
    mesh = objects.subdivided(base.data, levels)
    uv = objects.corner_uv(mesh) * (1e3 / maps.size_mm)
    objects.set_corner_uv(mesh, uv)

    edge_mm = 1e3 * np.sqrt(area / (faces * 4**levels))
    height = np.asarray(maps.height_mm, np.float64)
    height = smoothed(height - height.mean(), 0.5 * edge_mm / maps.size_mm * len(height))
    vertex_of_corner = np.empty(len(mesh.loops), np.int32)
    mesh.loops.foreach_get("vertex_index", vertex_of_corner)
    count = np.bincount(vertex_of_corner, minlength=len(mesh.vertices))
    lift = np.bincount(vertex_of_corner, sample_periodic(height, uv), len(mesh.vertices)) / np.maximum(count, 1)
    normals = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertex_normals.foreach_get("vector", normals)
    objects.move(mesh, objects.vertex_positions(mesh) + 1e-3 * lift[:, None] * normals.reshape(-1, 3))

    mesh.shade_flat()  # the geometry is true: interpolated normals would darken slanting light (shadow terminator)
    mesh.name = f"{base.name} in {name}"
    mesh.materials.clear()
    mesh.materials.append(surface(name, maps))
    result = bpy.data.objects.new(mesh.name, mesh)
    bpy.context.scene.collection.objects.link(result)
    return result


def load_maps(material_name: str, *, variation: int):
    """The procedural maps of a library material; a ``variation`` other than the library's 0 gives other texels."""
    from btfsep_engine.btf import procedural

    return procedural.maps(material_name, MAP_RESOLUTION, variation=variation)
