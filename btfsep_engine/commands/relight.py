# SPDX-License-Identifier: GPL-3.0-or-later
"""The job's objects under any lighting."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from btfsep_engine.btf.surfaces import GIVEN
from btfsep_engine.commands.record import run_record
from btfsep_engine.commands.report import exposure, render_objects
from btfsep_engine.errors import InputError
from btfsep_engine.imaging import images
from btfsep_engine.job.load import load_job
from btfsep_engine.light.files import read_lighting, seen_lighting
from btfsep_engine.light.lightings import EnvironmentMaps
from btfsep_engine.light.maps import read_map
from btfsep_engine.pipeline.materials import object_materials
from btfsep_engine.pipeline.scene import PreparedScene
from btfsep_engine.pipeline.settings import Settings
from btfsep_engine.storage.atomic import check_folder
from btfsep_engine.threads import one_thread


def lighting_of(path):
    """The lighting in a file, ``lighting.json`` or an environment map (EXR, HDR, PNG, …).

    Returns
    -------
    all of the light, the same without its suns, and the tuple of them
    """
    path = Path(path)
    if path.suffix.lower() == ".json":
        light = read_lighting(path)
        return *seen_lighting(light), light.suns
    light = EnvironmentMaps(read_map(path)[None], (path.stem,))
    return light, light, ()


def earlier_estimate(job) -> dict:
    """What is kept of an earlier estimate of the same job; empty where there is none."""
    try:
        record = json.loads((job.folder / "result" / "result.json").read_text())
    except (OSError, ValueError):
        return {}
    return record if isinstance(record, dict) else {}


def earlier_materials(job, record: dict) -> list:
    """Names of the materials that an `earlier_estimate` found, None where there is none."""
    try:
        found = {o["name"]: o["material"] for o in record["objects"]}
    except (KeyError, TypeError):
        return [None] * len(job.objects)  # no estimate yet: recognise
    known = [found.get(o.name) for o in job.objects]
    return [None if name == GIVEN else name for name in known]  # what an earlier job said by numbers, this one may not


@one_thread()
def run_relight(folder, library, settings: Settings, *, lighting, out, material=None, reporter) -> dict:
    """Renders the job's objects under ``lighting`` (a file) into the image ``out``; the background is black.

    The material of each object is the one given, or the job's, or that of an earlier estimate, or recognised. Textures
    that this was told to leave as they are (``delight``) stay so. Raises InputError where ``out`` is no .exr or .png.

    Returns
    -------
    dict, JSON-ready
    """
    with reporter.stage("reading"):
        job = load_job(folder)
        light, sky, suns = lighting_of(lighting)
        suffix = Path(out).suffix.lower()
        if suffix not in (".exr", ".png"):
            raise InputError("--out", f"'{out}'", "name an .exr (linear) or a .png (for looking at)")
        check_folder(Path(out).parent)
    scene, record = PreparedScene(job, reporter), earlier_estimate(job)
    chosen = record.get("settings")
    if isinstance(chosen, dict) and chosen.get("delight") == "never":
        settings = replace(settings, delight="never")
    if material is None:
        earlier = earlier_materials(job, record)
        names = [o.material or (None if o.surface else e) for o, e in zip(job.objects, earlier, strict=True)]
    else:
        names = [material] * len(job.objects)
    found = object_materials(scene, library, settings, names=names)
    with reporter.stage("transport"):
        materials = [m.material for m in found]
        indirect = scene.indirect(materials, light, settings, bounces=settings.reflections)
        image = render_objects(
            scene, materials, sky, textured=True, directions=settings.many_directions, indirect=indirect, suns=suns
        )[0]
    shown = np.isfinite(image).all(-1)
    image = np.where(shown[..., None], image, 0).astype(np.float32)
    with reporter.stage("writing"):
        if suffix == ".exr":
            images.write_exr(out, image)
        else:
            images.write_png(out, image * exposure(image, shown))
    return {
        "out": str(out),
        "objects": [{"name": o.name, "material": m.name} for o, m in zip(job.objects, found, strict=True)],
        **run_record(settings, reporter),
    }
