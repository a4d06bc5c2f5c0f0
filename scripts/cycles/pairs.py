# SPDX-License-Identifier: GPL-3.0-or-later
"""Photographs by Cycles of two objects side by side, and their jobs: ``python -m scripts.cycles.pairs``.

A process of its own, because Blender and the renderer each bring their own libraries. The input is JSON: "folder" and
"pairs", a list of what `scripts.studies.pairs.drawn` gives. What is there already is not made again.
"""

import json
import math
import os
import sys
from pathlib import Path

import numpy as np
from tqdm import tqdm

from blender_btfsep.scene import own_surface
from blender_btfsep.scene.export import export_job
from scripts.cycles import materials, objects, studio
from scripts.cycles.untold import unlike

RESOLUTION, SAMPLES, FILL = 320, 96, 0.92
APART = 0.6  # of an object's largest side, from the middle


def take(pair, folder: Path) -> None:
    """One photograph: things as they are, and a job that has them as a user says they are."""
    folder.mkdir(parents=True, exist_ok=True)
    scene = studio.clear()
    scene.world = studio.make_world(pair["light"], rotation_euler=(0, 0, math.radians(pair["turn"])))
    things = []
    for side, told in zip((-1, 1), pair["things"], strict=True):
        thing = objects.build(told["object"], seed=pair["seed"], view=studio.VIEW_FROM)
        aside = np.array([side * APART * objects.LARGEST_SIDE, 0, 0])
        objects.move(thing.data, objects.vertex_positions(thing.data) + aside)
        thing.data.materials.append(materials.principled(told["surface"]))
        if told["thing"]:
            unlike(thing, told["thing"], told["much"], paint=told["paint"])
        things.append(thing)
    positions = np.concatenate([objects.vertex_positions(thing.data) for thing in things])
    studio.add_camera(scene, positions, resolution=RESOLUTION, fill=FILL)
    studio.denoise(scene)
    studio.render_photo(scene, folder / "photo.exr", SAMPLES)
    for thing, told in zip(things, pair["things"], strict=True):
        thing.data.materials[0] = materials.principled(told["told"])
    surfaces = {thing.name: own_surface.BLENDER for thing in things}
    export_job(scene, folder, image_path=folder / "photo.exr", objects=things, occluders=[], surfaces=surfaces)


if __name__ == "__main__":
    os.nice(15)
    given = json.load(sys.stdin)
    for pair in tqdm(given["pairs"], desc="pairs"):
        where = Path(given["folder"]) / pair["name"]
        if not (where / "job.json").exists():
            with studio.quiet():
                take(pair, where)
