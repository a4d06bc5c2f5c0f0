# SPDX-License-Identifier: GPL-3.0-or-later
"""Takes photographs with Cycles and writes their jobs: ``python -m scripts.cycles.shoot``, told what on standard input.

A process of its own, because Blender and the renderer each bring their own libraries. The input is JSON: "resolution",
"samples", "threads" (0: all), "noise" (of a pixel, where Cycles stops; null: the studio's), "denoise" (see
`studio.denoise`) and "shots", a list of the fields of :class:`scripts.studies.photos.Shot`. What is there already is
not made again.
"""

import json
import os
import sys
from itertools import groupby
from pathlib import Path

import bpy
import numpy as np
from tqdm import tqdm

from blender_btfsep.scene.export import export_job
from btfsep_engine.btf import procedural
from btfsep_engine.btf.texture_maps import read_maps
from btfsep_engine.errors import InputError
from scripts.cycles import COVERAGE, materials, objects, plain, studio

# the same of all that one scene shows
STANDING = ("object", "material", "seed", "variation", "thickness", "fill", "maps")


def shoot(shots, *, resolution: int, samples: int, threads: int = 0, noise=None, denoise=False) -> None:
    """Renders each shot, and writes each folder's job (photo, base mesh, camera) after its first one."""
    for kind, known in (("object", objects.NAMES), ("material", ("white", *procedural.NAMES, *plain.NAMES))):
        asked = {shot[kind] for shot in shots if kind == "object" or not shot["maps"]}
        if unknown := asked - {*known}:  # said before the first picture is taken
            got = f"no {kind} of the studio is called {' or '.join(sorted(unknown))}"
            raise InputError("the photographs", got, f"choose from {', '.join(known)}")
    missing = [s for s in shots if not (Path(s["folder"]) / s["name"]).exists() or not _job(s).exists()]
    bar = tqdm(total=len(missing), desc="photographs", disable=not missing)
    for key, group in groupby(missing, lambda s: [s[k] for k in STANDING]):
        told = dict(zip(STANDING, key, strict=True))
        name, material = told.pop("object"), told.pop("material")
        if told["maps"]:
            how = told["maps"] | {"name": material, "resolution": materials.MAP_RESOLUTION}
            told["maps"] = read_maps(Path(how.pop("folder")), **how).maps
        with studio.quiet():
            scene, _, base, _ = studio.make_scene(name, material, None, resolution=resolution, **told)
            scene.render.use_persistent_data = True  # the displaced mesh is the same in all photographs
            if threads:
                scene.render.threads_mode, scene.render.threads = "FIXED", threads
            if noise:
                scene.cycles.adaptive_threshold = noise
            if denoise:
                studio.denoise(scene)
        for shot in group:
            folder = Path(shot["folder"])
            folder.mkdir(parents=True, exist_ok=True)
            with studio.quiet():
                added, table = _beside(shot, base)
                _photograph(scene, shot, folder / shot["name"], samples)
                for obj in added:
                    bpy.data.objects.remove(obj)
                if not _job(shot).exists():
                    export_job(scene, folder, image_path=folder / shot["name"], objects=[base], occluders=table)
                for obj in table:
                    bpy.data.objects.remove(obj)
                if not (folder / COVERAGE).exists():
                    np.save(folder / COVERAGE, studio.object_mask(scene))
            bar.update()


def _job(shot) -> Path:
    return Path(shot["folder"]) / "job.json"


def _beside(shot, base) -> tuple[list, list]:
    """Puts what a shot adds beside the object; gives what the job does not know of, and what it does: the table."""
    radius = 0.5 * float(np.linalg.norm(np.ptp([v.co for v in base.data.vertices], axis=0)))
    added, table = [], []
    if sun := shot["sun"]:
        added.append(studio.add_sun(sun["direction"], sun["irradiance"], degrees=sun["degrees"]))
    if ball := shot["ball"]:
        added.append(studio.add_ball(np.array(ball["place"]) * radius, ball["radius"] * radius, ball["radiance"]))
    if wall := shot["wall"]:
        added.append(studio.add_wall(np.array(wall["place"]) * radius, wall["edge"] * radius, wall["colour"]))
    if top := shot["table"]:
        lowest = min(v.co.z for v in base.data.vertices)
        table.append(studio.add_table(lowest, top["edge"] * radius, top["colour"], checks=top["checks"]))
    return added, table


def _photograph(scene, shot, path: Path, samples: int) -> None:
    scene.world = studio.make_world(shot["light"])
    partial = path.with_name(f"partial-{os.getpid()}.exr")
    studio.render_photo(scene, partial, samples)
    os.replace(partial, path)


if __name__ == "__main__":
    os.nice(15)
    shoot(**json.load(sys.stdin))
