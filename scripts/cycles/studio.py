# SPDX-License-Identifier: GPL-3.0-or-later
"""The photographer's studio: an object, a camera, one of Blender's own studio lights, and Cycles.

What is photographed is the displaced object; what is *known* (and exported in a job) is the base object, its
undisplaced macro geometry. Scene unit: metre. Nothing is clamped, filtered or, unless a study asks for it (`denoise`),
denoised: radiance is as rendered.
"""

import contextlib
import math
import os
import sys
import tempfile
from pathlib import Path

import bpy
import numpy as np
from mathutils import Quaternion, Vector

from blender_btfsep.basics import pixels
from scripts.cycles import materials, objects, plain
from scripts.cycles.lights import light_path

LENS_MM, SENSOR_MM = 85.0, 36.0
FRAME_FILL = 0.84  # the object's larger extent over the frame's edge: about 60 % of the frame for a round object
VIEW_FROM = (0.45, -1.0, 0.42)  # from the front, a little from the right and above
BOUNCES = 8
SAMPLED = 4096  # columns of a map, at most, among which Cycles samples light
COVER_AWAY, FINGER, LEAF = 0.11, 0.008, 0.018  # metres: how far before the object's middle what covers it is; radii
SHADE, SHADE_AWAY = 0.6, 1.5  # metres: the edge of what casts a shadow, and how far away it is


@contextlib.contextmanager
def quiet():
    """Sends what Blender itself writes to standard output into nowhere (Python's own prints too)."""
    sys.stdout.flush()
    kept = os.dup(1)
    with open(os.devnull, "w") as nowhere:
        os.dup2(nowhere.fileno(), 1)
    try:
        yield
    finally:
        sys.stdout.flush()
        os.dup2(kept, 1)
        os.close(kept)


def read_image(path) -> np.ndarray:
    """(h, w, 3) float32 linear, row 0 at the top, of an EXR or HDR, as Blender reads it."""
    image = bpy.data.images.load(str(path), check_existing=False)
    try:
        return pixels.read(image)[::-1, :, :3].copy()
    finally:
        bpy.data.images.remove(image)


def make_world(light, *, rotation_euler=(0.0, 0.0, 0.0)) -> bpy.types.World:
    """A World with the map of ``light``, turned by ``rotation_euler`` (XYZ, radians): light from d comes from R d.

    None: a dark one.
    """
    world = bpy.data.worlds.new("true light")
    tree = materials.node_tree(world)
    add, link = tree.nodes.new, tree.links.new
    background, output = add("ShaderNodeBackground"), add("ShaderNodeOutputWorld")
    link(background.outputs["Background"], output.inputs["Surface"])
    if light is None:
        background.inputs["Color"].default_value = (0, 0, 0, 1)
        return world
    coordinates, mapping = add("ShaderNodeTexCoord"), add("ShaderNodeMapping")
    texture = add("ShaderNodeTexEnvironment")
    mapping.vector_type = "TEXTURE"  # looks up at R^-1 d
    mapping.inputs["Rotation"].default_value = rotation_euler
    texture.image = bpy.data.images.load(str(light_path(light)), check_existing=True)
    # four times as fine as the map; by itself Cycles takes as many places of a small one that is turned
    finer = min(4 * texture.image.size[0], SAMPLED)
    world.cycles.sampling_method, world.cycles.sample_map_resolution = "MANUAL", finer
    link(coordinates.outputs["Generated"], mapping.inputs["Vector"])
    link(mapping.outputs["Vector"], texture.inputs["Vector"])
    link(texture.outputs["Color"], background.inputs["Color"])
    return world


def cut_off(camera: bpy.types.Camera, *, fill: float, way: str, beyond: float) -> np.ndarray:
    """Lets an edge of the picture cut what fills ``fill`` of it; ``beyond`` : the share of its extent that is cut off.

    Returns the shift (2,), right and down, of the picture's content, in its edges.
    """
    off = (1 - fill) / 2 + beyond * fill
    right, down = {"left": (-off, 0), "right": (off, 0), "up": (0, -off), "down": (0, off)}[way]
    camera.shift_x, camera.shift_y = -right, down
    return np.array([right, down])


def aim(camera: bpy.types.Object, positions, *, fill: float = FRAME_FILL) -> None:
    """Puts ``camera`` so that ``positions : (n, 3)``, world, fill this part of a square frame."""
    back = np.array(Vector(VIEW_FROM).normalized())
    rotation = Vector(-back).to_track_quat("-Z", "Y").to_matrix()
    local = np.asarray(positions) @ np.array(rotation)  # rows times R = R^T p
    slope = 0.5 * fill * SENSOR_MM / LENS_MM
    # in each axis the object spans [min(x - s(c - z)), max(x + s(c - z))] at camera height c: widest axis decides
    centre, height = np.zeros(2), 0.0
    for axis in (0, 1):
        right = (local[:, axis] + slope * local[:, 2]).max()
        left = (local[:, axis] - slope * local[:, 2]).min()
        centre[axis], height = (right + left) / 2, max(height, (right - left) / (2 * slope))
    camera.matrix_world = rotation.to_4x4()
    camera.location = np.array(rotation) @ np.array([*centre, height])


def add_camera(scene, positions, *, resolution: int, fill: float = FRAME_FILL) -> bpy.types.Object:
    """The scene's camera, aimed at ``positions`` (see `aim`), for square pictures of ``resolution`` pixels."""
    data = bpy.data.cameras.new("camera")
    data.lens, data.sensor_width, data.clip_start = LENS_MM, SENSOR_MM, 0.01
    camera = scene.camera = bpy.data.objects.new("camera", data)
    scene.collection.objects.link(camera)
    scene.render.resolution_x = scene.render.resolution_y = resolution
    aim(camera, positions, fill=fill)
    bpy.context.view_layer.update()
    return camera


def clear() -> bpy.types.Scene:
    """An empty file. Returns the scene, with Cycles set up for plain physical light transport."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.unit_settings.system, scene.unit_settings.scale_length = "METRIC", 1.0
    scene.render.engine = "CYCLES"
    cycles = scene.cycles
    cycles.device = "CPU"
    cycles.use_denoising = False
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = 0.0
    cycles.blur_glossy = 0.0
    cycles.light_sampling_threshold = 0.0
    cycles.max_bounces = cycles.diffuse_bounces = cycles.glossy_bounces = BOUNCES
    cycles.caustics_reflective = True
    cycles.use_adaptive_sampling = True
    cycles.adaptive_threshold = 0.05
    scene.render.use_persistent_data = False
    scene.view_settings.view_transform = "Standard"
    settings = scene.render.image_settings
    settings.file_format, settings.color_mode, settings.color_depth = "OPEN_EXR", "RGB", "32"
    return scene


def make_scene(
    object_name,
    material_name,
    light,
    *,
    resolution,
    seed=0,
    variation=None,
    thickness=1.0,
    maps=None,
    face_mm=materials.FACE_MM,
    fill=FRAME_FILL,
):
    """A studio with one object.

    Parameters
    ----------
    object_name : one of ``objects.NAMES``
    material_name : "white", one of ``plain.NAMES``, or a material of the library ("class/material")
    light : the path of a map, or a name of :func:`scripts.cycles.lights.studio_lights`; None: dark
    resolution : edge of the square photo, pixels
    seed : of the object's shape
    variation : of the material's texels; None: ``seed + 1`` (the library's is 0)
    thickness : factor on the object's extent along the view
    maps : the material's maps, if not ``procedural.maps``' own
    face_mm : edge of a face of the displaced mesh, about
    fill : the object's larger extent over the frame's edge

    Returns
    -------
    scene, camera, base_object (undisplaced, hidden in renders), photo_object (displaced)
    """
    scene = clear()
    scene.world = make_world(light)
    base = objects.build(object_name, seed=seed, thickness=thickness, view=VIEW_FROM)
    if material_name == "white" or material_name in plain.NAMES:
        photo = bpy.data.objects.new(f"{object_name} in {material_name}", base.data.copy())
        alike = materials.white() if material_name == "white" else materials.principled(plain.named(material_name))
        photo.data.materials.append(alike)
        scene.collection.objects.link(photo)
    else:
        maps = maps or materials.load_maps(material_name, variation=seed + 1 if variation is None else variation)
        photo = materials.displaced(base, material_name, maps, face_mm=face_mm)
        objects.set_corner_uv(base.data, objects.corner_uv(base.data) * (1e3 / maps.size_mm))
    base.hide_render = True
    camera = add_camera(scene, objects.vertex_positions(base.data), resolution=resolution, fill=fill)
    return scene, camera, base, photo


def add_sun(direction, irradiance, *, degrees: float) -> bpy.types.Object:
    """A Sun lamp so wide that lights from ``direction``; ``irradiance : (3,)`` on what faces it."""
    sun = bpy.data.objects.new("sun", bpy.data.lights.new("sun", "SUN"))
    strongest = max(irradiance)
    sun.data.energy, sun.data.angle, sun.data.color = strongest, math.radians(degrees), np.array(irradiance) / strongest
    sun.rotation_euler = Vector(direction).to_track_quat("Z", "Y").to_euler()
    bpy.context.scene.collection.objects.link(sun)
    return sun


def add_ball(place, radius: float, radiance: float) -> bpy.types.Object:
    """A ball at ``place`` that shines, unseen by the camera."""
    bpy.ops.mesh.primitive_uv_sphere_add(segments=64, ring_count=32, radius=radius, location=place)
    return _unseen(bpy.context.object, materials.shaded("lamp", "ShaderNodeEmission", Strength=radiance)[0])


def add_box(corners, radiance) -> bpy.types.Object:
    """A square of ``corners`` (4, 3), in turn, that shines with ``radiance`` (3,), unseen by the camera."""
    mesh, strongest = bpy.data.meshes.new("softbox"), max(radiance)
    mesh.from_pydata(np.asarray(corners).tolist(), [], [(0, 1, 2, 3)])
    box = bpy.data.objects.new("softbox", mesh)
    bpy.context.collection.objects.link(box)
    colour = (*(np.array(radiance) / strongest), 1)
    return _unseen(box, materials.shaded("lamp", "ShaderNodeEmission", Strength=strongest, Color=colour)[0])


def add_wall(place, edge: float, colour) -> bpy.types.Object:
    """A matte square at ``place`` that faces the origin, unseen by the camera."""
    turn = (-Vector(place)).to_track_quat("Z", "Y").to_euler()
    bpy.ops.mesh.primitive_plane_add(size=edge, location=place, rotation=turn)
    return _unseen(bpy.context.object, materials.white(colour))


def add_shade(towards, kind: str, *, turn: float, much: float, seed: int) -> bpy.types.Object:
    """Something that keeps light from ``towards`` off a part of what lies at the origin, unseen by the camera.

    ``kind`` : "edge", a straight one past the middle, or "leaves", which leave gaps; ``turn`` : about the light's
    way, radians; ``much`` : 0 to 1, how much of the light is kept off
    """
    bpy.ops.mesh.primitive_plane_add(size=SHADE)
    card, towards = bpy.context.object, Vector(towards).normalized()
    material, bsdf = materials.shaded("shade", "ShaderNodeBsdfDiffuse", Color=(0.04, 0.05, 0.03, 1))
    aside = 0.0
    if kind == "edge":
        aside = SHADE / 2 + (0.5 - much) * objects.LARGEST_SIDE / 2
    else:
        tree = material.node_tree
        noise, place, gap, mix, clear = (
            tree.nodes.new(f"ShaderNode{name}")
            for name in ("TexNoise", "TexCoord", "Math", "MixShader", "BsdfTransparent")
        )
        noise.noise_dimensions = "4D"
        for name, value in {"W": seed, "Scale": 1.5 / objects.LARGEST_SIDE, "Detail": 2}.items():
            noise.inputs[name].default_value = value
        gap.operation, gap.inputs[1].default_value = "GREATER_THAN", 0.42 + 0.16 * much
        tree.links.new(place.outputs["Object"], noise.inputs["Vector"])
        tree.links.new(noise.outputs["Fac"], gap.inputs[0])
        for source, socket in ((gap.outputs[0], 0), (bsdf.outputs[0], 1), (clear.outputs[0], 2)):
            tree.links.new(source, mix.inputs[socket])
        tree.links.new(mix.outputs[0], next(n for n in tree.nodes if n.type == "OUTPUT_MATERIAL").inputs["Surface"])
    turned = towards.to_track_quat("Z", "Y") @ Quaternion((0, 0, 1), turn)
    card.rotation_euler = turned.to_euler()
    card.location = SHADE_AWAY * towards + turned @ Vector((aside, 0, 0))
    return _unseen(card, material)


def add_cover(kind: str, *, turn: float, much: float, seed: int, colour) -> None:
    """Something between the camera and a part of what lies at the origin: matte, and in the light as all else.

    ``kind`` : "fingers", side by side from outside, or "leaves"; ``turn`` : from where, radians in the picture;
    ``much`` : 0 to 1, how far they reach, or how many they are
    """
    random, radius = np.random.default_rng(seed), objects.LARGEST_SIDE / 2
    towards = Vector(VIEW_FROM).normalized()
    facing, middle = towards.to_track_quat("Z", "Y"), COVER_AWAY * towards
    skin = materials.principled({"colour": colour, "roughness": 0.6, "metallic": 0})
    inward = np.array([-math.cos(turn), -math.sin(turn)])
    for i in range(3) if kind == "fingers" else range(3 + round(5 * much)):
        if kind == "fingers":
            at = -1.4 * radius * inward + (i - 1) * 2.4 * FINGER * np.array([-inward[1], inward[0]])
            reach = radius * (0.7 + 0.9 * much + 0.2 * random.uniform(-1, 1))
            curve = bpy.data.curves.new("finger", "CURVE")
            curve.dimensions, curve.bevel_depth, curve.use_fill_caps = "3D", FINGER, True
            spline = curve.splines.new("NURBS")
            spline.points.add(4)
            for k, point in enumerate(spline.points):
                x, y = at + k / 4 * reach * inward
                bend = 0.012 * math.sin(2.5 * k / 4)
                point.co, point.radius = (x, y, bend, 1), (1, 1, 1, 0.9, 0.4)[k]
            spline.use_endpoint_u, spline.order_u = True, 3
            thing = bpy.data.objects.new("finger", curve)
            bpy.context.collection.objects.link(thing)
            thing.rotation_euler, thing.location = facing.to_euler(), middle
        else:
            bpy.ops.mesh.primitive_uv_sphere_add(segments=24, ring_count=12)
            thing = bpy.context.object
            thing.data.shade_smooth()
            way, far = random.uniform(0, 2 * math.pi), radius * math.sqrt(random.uniform(0, 0.8))
            thing.location = middle + facing @ Vector((far * math.cos(way), far * math.sin(way), 0))
            tilt = Quaternion((0, 0, 1), random.uniform(0, 2 * math.pi)) @ Quaternion(
                (1, 0, 0), random.uniform(-0.6, 0.6)
            )
            thing.scale, thing.rotation_euler = (LEAF, LEAF / 2, LEAF / 15), (facing @ tilt).to_euler()
        thing.data.materials.append(skin)


def add_table(height: float, edge: float, colour, *, checks: int = 0, roughness=None) -> bpy.types.Object:
    """A square under the object, its top at ``height``; ``checks``: a side, of it and of a quarter of it.

    ``roughness`` : of a dielectric of that colour; None: it is matte
    """
    bpy.ops.mesh.primitive_plane_add(size=edge, location=(0, 0, height))
    table = bpy.context.object
    table.name = "table"
    finish = {"colour": colour, "roughness": roughness, "metallic": 0}
    material = materials.white(colour) if roughness is None else materials.principled(finish)
    if checks:
        odd = np.indices((checks, checks)).sum(0) % 2
        paint = material.node_tree.nodes.new("ShaderNodeTexImage")
        paint.image = pixels.new("checks", np.asarray(colour) * np.where(odd, 1.0, 0.25)[..., None])
        paint.interpolation = "Closest"
        bsdf = next(n for n in material.node_tree.nodes if n.type == "BSDF_DIFFUSE")
        material.node_tree.links.new(paint.outputs["Color"], bsdf.inputs["Color"])
    table.data.materials.append(material)
    return table


def add_sweep(height: float, edge: float, colour, *, behind: float, bend: float) -> bpy.types.Object:
    """A matte floor at ``height`` that rises ``behind`` the origin, as the camera sees it, in a bend of this radius."""
    angle = np.linspace(0, np.pi / 2, 17)
    away = np.concatenate(([-edge / 2], behind + bend * np.sin(angle), [behind + bend]))
    up = height + np.concatenate(([0], bend * (1 - np.cos(angle)), [edge / 2]))
    mesh, side, n = bpy.data.meshes.new("sweep"), edge / 2, len(away)
    points = [(x, y, z) for x in (-side, side) for y, z in zip(away, up, strict=True)]
    mesh.from_pydata(points, [], [(i, n + i, n + i + 1, i + 1) for i in range(n - 1)])
    mesh.shade_smooth()
    sweep = bpy.data.objects.new("table", mesh)
    sweep.rotation_euler = (0, 0, math.atan2(VIEW_FROM[0], -VIEW_FROM[1]))
    bpy.context.collection.objects.link(sweep)
    bpy.context.view_layer.update()
    mesh.materials.append(materials.white(colour))
    return sweep


def add_flash(place, irradiance) -> bpy.types.Object:
    """A small lamp at ``place``; ``irradiance`` (3,) on what faces it at the origin."""
    lamp = bpy.data.objects.new("flash", bpy.data.lights.new("flash", "POINT"))
    strongest = max(irradiance)
    lamp.data.color, lamp.data.shadow_soft_size = np.array(irradiance) / strongest, 0.005
    lamp.data.energy = strongest * 4 * math.pi * float(np.dot(place, place))
    lamp.location = place.tolist()
    bpy.context.collection.objects.link(lamp)
    return lamp


def _unseen(obj, material):
    obj.data.materials.append(material)
    obj.visible_camera = False
    return obj


def denoise(scene) -> None:
    """A photograph with a camera's noise instead of a path tracer's: Intel's denoiser, led by albedo and normals.

    On linen under a sun, 64 samples: the contrast of the finest octave is 0.025, with 512 samples and no denoiser
    0.023, with 64 and none 0.034; the coarser ones agree (0.016, 0.013, 0.025).
    """
    cycles = scene.cycles
    cycles.use_denoising, cycles.denoiser = True, "OPENIMAGEDENOISE"
    cycles.denoising_input_passes, cycles.denoising_prefilter = "RGB_ALBEDO_NORMAL", "ACCURATE"


def render_photo(scene, path_exr, samples: int = 64) -> np.ndarray:
    """Renders ``scene`` to a linear 32-bit EXR and returns it, (h, w, 3) float32, row 0 at the top."""
    scene.cycles.samples = samples
    scene.render.filepath = str(path_exr)
    bpy.ops.render.render(write_still=True, scene=scene.name)
    return read_image(path_exr)


def object_mask(scene) -> np.ndarray:
    """(h, w) float32 in [0, 1], how much of each pixel is object rather than World."""
    render, cycles, settings = scene.render, scene.cycles, scene.render.image_settings
    names = "max_bounces", "use_adaptive_sampling", "use_denoising", "samples"
    kept = [getattr(cycles, name) for name in names]
    for name, value in zip(names, (0, False, False, 16), strict=True):
        setattr(cycles, name, value)
    transparent, render.film_transparent = render.film_transparent, True
    settings.color_mode = "RGBA"
    try:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "mask.exr"
            scene.render.filepath = str(path)
            bpy.ops.render.render(write_still=True, scene=scene.name)
            image = bpy.data.images.load(str(path))
            covered = pixels.read(image)[::-1, :, 3].copy()
            bpy.data.images.remove(image)
    finally:
        settings.color_mode = "RGB"
        render.film_transparent = transparent
        for name, value in zip(names, kept, strict=True):
            setattr(cycles, name, value)
    return covered
