# SPDX-License-Identifier: GPL-3.0-or-later
"""Scans as they come: textures with the light in them under which they were taken, meshes that are a little off."""

import math

import bpy
import numpy as np

from blender_btfsep.basics import pixels
from scripts.cycles import materials, objects, studio

SIDE, MARGIN = 512, 8  # of a texture, pixels
SAMPLES = 128  # a texel
BRIGHTEST = 0.95  # of base colours
ISLANDS = 0.01  # between charts, of the texture
# Of a mesh's waves: their length in shares of its largest side, and how high each of several that run any way
WAVE, WAVES = 0.3, ((1.0, 1.0), (2.0, 0.5))
DIRECTIONS = 6


def unwrapped(thing: bpy.types.Object) -> None:
    """Lays the object's charts side by side in one square."""
    bpy.context.view_layer.objects.active = thing
    for other in bpy.context.scene.objects:
        other.select_set(other == thing)
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.ops.uv.smart_project(island_margin=ISLANDS)
    bpy.ops.object.mode_set(mode="OBJECT")


def sky(ground: float, horizon: float) -> bpy.types.World:
    """An overcast sky: of radiance 1 above, ``horizon`` at the horizon, ``ground`` below."""
    world = bpy.data.worlds.new("sky")
    tree = materials.node_tree(world)
    names = ("Background", "OutputWorld", "TexCoord", "SeparateXYZ", "MapRange", "ValToRGB")
    background, output, place, apart, height, ramp = (tree.nodes.new(f"ShaderNode{name}") for name in names)
    height.inputs["From Min"].default_value = -1
    low, high = ramp.color_ramp.elements
    low.position, low.color = 0.48, (ground, ground, ground, 1)
    high.position, high.color = 0.52, (horizon, horizon, horizon, 1)
    ramp.color_ramp.elements.new(1.0).color = (1, 1, 1, 1)
    for a, b in (
        (place.outputs["Generated"], apart.inputs[0]),
        (apart.outputs["Z"], height.inputs["Value"]),
        (height.outputs["Result"], ramp.inputs["Fac"]),
        (ramp.outputs["Color"], background.inputs["Color"]),
        (background.outputs[0], output.inputs["Surface"]),
    ):
        tree.links.new(a, b)
    return world


def textures(scene, thing: bpy.types.Object, plate) -> tuple[np.ndarray, np.ndarray]:
    """The base colours of a thing alone in the scene, (n, n, 3) from the bottom up, and the same with light in them.

    The light is that of ``plate["scan"]``'s sky, or the plate's own. As bright in the mean.
    """
    clean = np.minimum(_baked(scene, thing, {"COLOR"}, samples=8), BRIGHTEST)  # mottled white may be brighter
    suns = []
    if plate["scan"]["sky"] is None:
        scene.world = studio.make_world(plate["light"], rotation_euler=(0, 0, math.radians(plate["turn"])))
        suns = [studio.add_sun(s["direction"], s["irradiance"], degrees=0.53) for s in [plate["sun"]] if s]
    else:
        scene.world = sky(*plate["scan"]["sky"])
    lit = _baked(scene, thing, {"DIRECT", "INDIRECT", "COLOR"}, samples=SAMPLES)
    for sun in suns:
        bpy.data.objects.remove(sun)
    laid = clean.max(-1) > 0
    return clean, np.clip(lit * (clean[laid].mean() / lit[laid].mean()), 0, BRIGHTEST)


def _baked(scene, thing: bpy.types.Object, passes: set, *, samples: int) -> np.ndarray:
    image = bpy.data.images.new("texture", SIDE, SIDE, float_buffer=True, alpha=False)
    tree = thing.data.materials[0].node_tree
    node = tree.nodes.new("ShaderNodeTexImage")
    node.image, tree.nodes.active = image, node
    scene.cycles.samples, scene.cycles.use_denoising = samples, False
    bpy.ops.object.bake(type="DIFFUSE", pass_filter=passes, margin=MARGIN)
    out = pixels.read(image)[..., :3].copy()
    tree.nodes.remove(node)
    bpy.data.images.remove(image)
    return out


def textured(surface, texture, name: str) -> bpy.types.Material:
    """A surface of `scripts.cycles.plain` with a texture of base colours, from the bottom up."""
    material = materials.principled(surface)
    bsdf = next(n for n in material.node_tree.nodes if n.type == "BSDF_PRINCIPLED")
    node = material.node_tree.nodes.new("ShaderNodeTexImage")
    node.image = pixels.new(name, texture)
    material.node_tree.links.new(node.outputs["Color"], bsdf.inputs["Base Color"])
    return material


def remeshed(thing: bpy.types.Object, *, face, smoothed, waves, noise, triangles, seed) -> None:
    """Gives a thing the mesh that a scan has of it.

    ``face`` : edge of its faces; ``waves``, ``noise`` : by how much it is off, smoothly and from vertex to vertex; in
    shares of the largest side; ``smoothed`` : how often; ``triangles`` : how many are left, 0: all
    """
    largest = float(np.ptp(objects.vertex_positions(thing.data), axis=0).max())
    own, random = list(thing.data.materials), np.random.default_rng(seed)
    cells = thing.modifiers.new("Cells", "REMESH")
    cells.mode, cells.voxel_size = "VOXEL", largest * face
    if smoothed:
        thing.modifiers.new("Smooth", "SMOOTH").iterations = smoothed
    _applied(thing)
    positions, normals = objects.vertex_positions(thing.data), np.empty((len(thing.data.vertices), 3), np.float32)
    thing.data.vertex_normals.foreach_get("vector", normals.reshape(-1))
    off = noise * random.normal(size=len(positions))
    for times, height in WAVES:
        for way in random.normal(size=(DIRECTIONS, 3)):
            way *= 2 * np.pi * times / (WAVE * largest) / np.linalg.norm(way)
            off += waves * height / np.sqrt(DIRECTIONS) * np.sin(positions @ way + random.uniform(0, 2 * np.pi))
    objects.move(thing.data, positions + largest * off[:, None] * normals)
    if triangles:
        thing.modifiers.new("Fewer", "DECIMATE").ratio = min(1.0, triangles / (2 * len(thing.data.polygons)))
        _applied(thing)
    thing.data.materials.clear()
    for material in own:
        thing.data.materials.append(material)
    thing.data.shade_smooth()


def _applied(thing: bpy.types.Object) -> None:
    """Makes the thing's mesh what its modifiers make of it."""
    graph = bpy.context.evaluated_depsgraph_get()
    thing.data = bpy.data.meshes.new_from_object(thing.evaluated_get(graph), depsgraph=graph)
    thing.modifiers.clear()
