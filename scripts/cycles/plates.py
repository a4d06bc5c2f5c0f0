# SPDX-License-Identifier: GPL-3.0-or-later
"""Takes plates as users have them, with Cycles: ``python -m scripts.cycles.plates`` with {"plates", "folder"} as JSON.

Each plate of `scripts.studies.plates` leaves a folder with a job as the add-on exports it, the camera a little off if
it is to be, and ``linear.exr``, what the camera saw before it was coded. What is there already stays.
"""

import json
import math
import sys
from pathlib import Path

import bpy
import cv2
import numpy as np
from tqdm import tqdm

from blender_btfsep.scene import own_surface
from blender_btfsep.scene.export import export_job
from btfsep_engine.imaging import images
from btfsep_engine.imaging.srgb import linear_to_srgb
from scripts.cycles import angular, materials, neighbours, objects, scans, studio
from scripts.cycles.lights import AROUND
from scripts.cycles.untold import through, unlike

RESOLUTION, SAMPLES, FILL, TABLE = 256, 64, 0.7, 1.2  # pixels; a pixel; of the frame; metres
BRIGHT, AT = 98, 0.9  # percentile of the pixels that is exposed so bright
JPEG = 92


def coded(scene, linear, folder: Path, curve: str) -> Path:
    """The photo as the user has it: floats, or a JPEG by sRGB or by AgX, exposed for its bright parts."""
    if curve == "floats":
        return folder / "linear.exr"
    stops = math.log2(AT / np.percentile(linear.max(-1), BRIGHT))
    path, image = folder / "photo.jpg", linear * 2.0**stops
    if curve == "srgb":
        codes = np.round(255 * np.clip(linear_to_srgb(np.clip(image, 0, 1)), 0, 1)).astype(np.uint8)
        cv2.imwrite(str(path), codes[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, JPEG])
        return path
    view, settings = scene.view_settings, scene.render.image_settings
    kept = bpy.data.images.load(str(folder / "linear.exr"))
    view.view_transform, view.exposure = "AgX", stops
    settings.file_format, settings.quality = "JPEG", JPEG
    kept.save_render(str(path), scene=scene)
    return path


def dress(mesh: bpy.types.Mesh) -> None:
    """Gives each face one of the mesh's materials, by its height and its place across."""
    positions = objects.vertex_positions(mesh)
    low, high = positions.min(0), positions.max(0)
    for face in mesh.polygons:
        x, _, z = (positions[list(face.vertices)].mean(0) - low) / (high - low)
        face.material_index = min(int(len(mesh.materials) * (0.4 * x + 0.6 * z)), len(mesh.materials) - 1)
    mesh.update()


def take(plate, folder: Path) -> None:
    """One plate."""
    folder.mkdir(parents=True, exist_ok=True)
    scene = studio.clear()
    scene.world = studio.make_world(plate["light"], rotation_euler=(0, 0, math.radians(plate["turn"])))
    scene.world.node_tree.nodes["Background"].inputs["Strength"].default_value = plate.get("dimmed", 1)
    if plate["object"] in angular.NAMES:
        thing = angular.build(plate["object"], seed=plate["seed"])
    else:
        thing = objects.build(plate["object"], seed=plate["seed"], view=studio.VIEW_FROM)
    for surface in (plate["surface"], *plate.get("more", ())):
        thing.data.materials.append(materials.principled(surface))
    if "more" in plate:
        dress(thing.data)
    if "told" in plate or "scan" in plate:
        unlike(thing, plate["thing"], plate["much"], paint=plate.get("paint"))
    if "scan" in plate:
        world = scene.world
        scans.unwrapped(thing)
        clean, lit = scans.textures(scene, thing, plate)
        scene.world, thing.data.materials[0] = world, scans.textured(plate["surface"], clean, "clean")
    for lamp in [plate["sun"]] * bool(plate["sun"]) + plate.get("lamps", []):
        studio.add_sun(lamp["direction"], lamp["irradiance"], degrees=0.53)
    if "shade" in plate:
        studio.add_shade(plate["sun"]["direction"], **plate["shade"])
    if "cover" in plate:
        studio.add_cover(**plate["cover"])
    positions = objects.vertex_positions(thing.data)
    middle = (positions.min(0) + positions.max(0)) / 2
    if "neighbour" in plate:
        neighbours.add(middle, plate["neighbour"]["quads"], plate["neighbour"]["colour"])
    for box in plate.get("boxes", ()):
        studio.add_box(middle + np.array(box["corners"]), box["radiance"])
    table, roughness = [], plate.get("table_roughness")
    if "sweep" in plate:
        table.append(studio.add_sweep(positions[:, 2].min(), TABLE, plate["table"], **plate["sweep"]))
    elif plate["table"]:
        table.append(studio.add_table(positions[:, 2].min(), TABLE, plate["table"], roughness=roughness))
        if "pattern" in plate:
            pattern = plate["pattern"]
            table[0].data.materials[0] = materials.patterned(
                pattern["kind"], (plate["table"], pattern["other"]), pattern["size"], turn=pattern["turn"]
            )
    cut = plate.get("cut")
    lens = studio.add_camera(scene, positions, resolution=RESOLUTION, fill=cut["fill"] if cut else FILL).data
    shift = studio.cut_off(lens, **cut) if cut else np.zeros(2)
    if "flash" in plate:
        studio.add_flash(np.array(plate["flash"]["place"]), plate["flash"]["irradiance"])
    studio.denoise(scene)
    linear = studio.render_photo(scene, folder / "linear.exr", SAMPLES)
    if "neighbour" in plate:
        neighbours.photograph_around(scene, middle, [thing, *table], folder / AROUND)
    if "told" in plate:
        linear = through(linear, plate["camera"], plate["much"], plate["seed"]).astype(np.float32)
        images.write_exr(folder / "linear.exr", linear)
        thing.data.materials[0] = materials.principled(plate["told"])
    if "pattern" in plate:
        table[0].data.materials[0] = materials.white(plate["pattern"]["told"])
    photo = coded(scene, linear, folder, plate["curve"])
    if "mesh" in plate:
        scans.remeshed(thing, **plate["mesh"])
    told = {"image_path": photo, "objects": [thing], "occluders": table}
    told |= {"surfaces": {thing.name: own_surface.BLENDER}, "curve": "agx" if plate["curve"] == "agx" else "auto"}
    folders = [("in line", (0, 0)), ("job", plate["off"])]
    if "scan" in plate:
        folders.insert(0, ("clean", plate["off"]))
    for name, (right, down) in folders:
        lens.shift_x, lens.shift_y = -right / RESOLUTION - shift[0], down / RESOLUTION + shift[1]
        export_job(scene, folder / name, **told)
        if name == "clean":
            thing.data.materials[0] = scans.textured(plate["surface"], lit, "with light")


if __name__ == "__main__":
    given = json.load(sys.stdin)
    for plate in tqdm(given["plates"], desc="plates"):
        where = Path(given["folder"]) / plate["name"]
        if not (where / "job" / "job.json").exists():
            with studio.quiet():
                take(plate, where)
