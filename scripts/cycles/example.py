# SPDX-License-Identifier: GPL-3.0-or-later
"""Makes the example that the panel opens: ``python -m scripts.cycles.example`` writes blender_btfsep/example.blend.

A photograph by Cycles of Blender's own monkey, its leather displaced by this project's procedural maps, under one of
Blender's own studio lights (CC0). In the file are the photograph, the monkey as it is known (undisplaced), its camera,
the panel's settings, and a ball that was not there. No data of others are in it: the light is seen behind the monkey in
the photograph alone. Where it is run by the ``bpy`` of Blender 4.5, Blender 4.2 and later read the file.
"""

import os
import tempfile
from pathlib import Path

import bpy

import blender_btfsep
from blender_btfsep.window import example, use_photo
from scripts.cycles import materials, objects, studio

MATERIAL, LIGHT = "leather/brown-grain", "sunrise"
WIDTH, HEIGHT, SAMPLES = 384, 256, 256
LEFT = 0.16  # of the width: how far the monkey stands beside the middle
BALL = 0.02  # metres, its radius


def main() -> None:
    blender_btfsep.register()
    scene, camera, known, photographed = studio.make_scene("suzanne", MATERIAL, LIGHT, resolution=HEIGHT)
    camera.data.sensor_fit, camera.data.sensor_height = "VERTICAL", studio.SENSOR_MM
    camera.data.shift_x = LEFT * WIDTH / HEIGHT
    scene.render.resolution_x = WIDTH
    with tempfile.TemporaryDirectory() as scratch:
        shot = Path(scratch) / "full.exr"
        studio.render_photo(scene, shot, SAMPLES)
        photo = _half(scene, shot, Path(scratch) / "photo.exr")
    bpy.data.objects.remove(photographed)
    _coarse(known)
    _ball(scene)
    scene.btfsep.image = photo
    entry = scene.btfsep.objects.add()
    entry.object, entry.material = known, MATERIAL
    scene.btfsep.occluders = "NONE"  # the ball was not there
    use_photo.put_behind(scene, camera, photo, (WIDTH, HEIGHT))
    scene.world = bpy.data.worlds.new("Grey")
    scene.name, camera.name = example.SCENE, "Camera"
    scene.render.filepath = "//"
    partial = example.FILE.with_name(f"partial-{os.getpid()}.blend")
    bpy.data.libraries.write(str(partial), {scene}, compress=True)
    os.replace(partial, example.FILE)
    print(f"{example.FILE}: {example.FILE.stat().st_size} bytes")


def _half(scene, shot, path):
    """The photograph as a half-float EXR, packed."""
    image = bpy.data.images.load(str(shot))
    settings = scene.render.image_settings
    settings.color_depth, settings.exr_codec = "16", "ZIP"
    image.save_render(str(path), scene=scene)
    bpy.data.images.remove(image)
    photo = bpy.data.images.load(str(path))
    photo.pack()
    photo.filepath_raw = photo.packed_files[0].filepath = "//photo.exr"
    return photo


def _coarse(known) -> None:
    """Makes the monkey coarse, with a modifier that rounds it to the same surface, and of the leather's colour."""
    positions = objects.vertex_positions(known.data)
    bpy.ops.mesh.primitive_monkey_add()
    coarse = bpy.context.object.data
    bpy.data.objects.remove(bpy.context.object)
    fine = objects.vertex_positions(objects.subdivided(coarse.copy(), 3))
    scale = (positions.max(0) - positions.min(0)).max() / (fine.max(0) - fine.min(0)).max()
    middle = (fine.max(0) + fine.min(0)) / 2
    objects.move(coarse, (objects.vertex_positions(coarse) - middle) * scale)
    coarse.shade_smooth()
    known.data, known.name, known.hide_render = coarse, "Suzanne", False
    coarse.name = "Suzanne"
    modifier = known.modifiers.new("Subdivision", "SUBSURF")
    modifier.levels = modifier.render_levels = 2
    maps = materials.load_maps(MATERIAL, variation=0)
    coarse.materials.append(_plain("Leather", maps.base_colour.mean((0, 1)), float(maps.roughness.mean())))


def _ball(scene) -> None:
    bpy.ops.mesh.primitive_uv_sphere_add(segments=64, ring_count=32, radius=BALL)
    ball = bpy.context.object
    ball.name = "Ball (not in the photo)"
    ball.location = (0.079, 0.037, -0.05)  # below the ear, in the picture
    ball.data.shade_smooth()
    ball.data.materials.append(_plain("Grey", (0.25, 0.25, 0.25), 0.3))
    ball.select_set(False)
    scene.view_layers[0].objects.active = scene.objects["Suzanne"]


def _plain(name: str, colour, roughness: float):
    material, _ = materials.shaded(name, "ShaderNodeBsdfPrincipled", Base_Color=(*colour, 1), Roughness=roughness)
    material.diffuse_color = (*colour, 1)
    return material


if __name__ == "__main__":
    main()
