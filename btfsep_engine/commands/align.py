# SPDX-License-Identifier: GPL-3.0-or-later
"""`btfsep align`: a job folder in, the same job with the camera that goes with its photo out."""

import json
from pathlib import Path

import numpy as np
from scipy.ndimage import binary_dilation, binary_erosion

from btfsep_engine.commands import report
from btfsep_engine.commands.record import peak_memory_mb, versions
from btfsep_engine.errors import InputError
from btfsep_engine.imaging.images import write_png
from btfsep_engine.pipeline.aligner import Left
from btfsep_engine.pipeline.alignment import Alignment, align, camera_keys, with_camera
from btfsep_engine.pipeline.scene import PreparedScene, read_scene
from btfsep_engine.storage import atomic
from btfsep_engine.storage.atomic import write_json

RESULT, OVERLAY = "alignment.json", "alignment.png"
BEFORE, AFTER = (255, 40, 40), (40, 255, 80)  # red and green
THICK = 500  # pixels of the photo's longer edge for each pixel of a line


def named_files(tree: dict) -> list[str]:
    """Every file that the content of a job.json names."""
    geometry = [*tree.get("objects", ()), *tree.get("occluders", ())]
    names = [tree["image"], tree.get("depth"), *(g.get(key) for g in geometry for key in ("mesh", "mask"))]
    for surface in (g.get("surface") or {} for g in geometry):
        names += [surface[key] for key in ("base_color", "finish") if isinstance(surface.get(key), str)]
    return list(dict.fromkeys(name.replace("\\", "/") for name in names if name))


def write_job(source: Path, out: Path, alignment: Alignment) -> None:
    """Copies a job that was read without fault, with the camera that was found; of a depth, with the shift."""
    tree = json.loads((source / "job.json").read_text(encoding="utf-8-sig"))
    for name in named_files(tree):
        atomic.write_bytes(out / name, atomic.read_bytes(source / name))
    if alignment.shift is None:
        tree["camera"] |= camera_keys(alignment.camera)
    else:
        tree["depth_shift"] = [a + b for a, b in zip(tree.get("depth_shift", (0, 0)), alignment.shift, strict=True)]
    write_json(out / "job.json", tree)


def write_overlay(path: Path, scene: PreparedScene, alignment: Alignment) -> None:
    """The photo with the outline of the geometry before, red, and, where it was moved, after, green."""
    photo, seen = scene.job.photo.radiance.astype(np.float64), scene.view.mesh >= 0
    picture = report.display(photo, report.exposure(photo, seen))
    drawn = [(scene.view, BEFORE)]
    if alignment.aligned:
        drawn.append((with_camera(scene, alignment.camera).view, AFTER))
    for view, colour in drawn:
        seen = view.mesh >= 0
        edge = seen & ~binary_erosion(seen, border_value=1)
        width = max(photo.shape[:2]) // THICK
        picture[binary_dilation(edge, iterations=width) if width else edge] = colour
    write_png(path, picture)


def run_align(folder, *, out=None, reporter) -> dict:
    """The whole command: reads the job, looks for its camera, writes the job with it, its result and a picture.

    Parameters
    ----------
    folder : job folder
    out : folder for the results, default ``folder/aligned``

    Returns
    -------
    dict, the content of ``alignment.json`` and ``out``

    Raises
    ------
    InputError
        Where ``out`` is the job's own folder.
    """
    scene = read_scene(folder, reporter)
    job = scene.job
    out = Path(out) if out is not None else job.folder / "aligned"
    if out.resolve() == job.folder.resolve():
        raise InputError("--out", "it is the job's own folder, whose job.json stays", "name another folder")
    atomic.check_folder(out)
    with reporter.stage("alignment"):
        alignment = align(scene)
    with reporter.stage("writing"):
        write_job(job.folder, out, alignment)
        write_overlay(out / OVERLAY, scene, alignment)
    result = {
        "format": "btfsep-alignment",
        "version": 1,
        "job_digest": job.digest,
        "aligned": alignment.aligned,
        "why": alignment.why,
        "moved_px": alignment.moved_px,
        "degrees": alignment.degrees,
        "focal_percent": alignment.focal_percent,
        "depth_shift": alignment.shift,
        "gain": None if alignment.gain is None else vars(alignment.gain),
        "objective": {"before": _left(alignment.before), "after": _left(alignment.after)},
        "warnings": list(reporter.warnings),
        "seconds": {stage: round(seconds, 4) for stage, seconds in reporter.seconds.items()},
        "peak_memory_mb": peak_memory_mb(),
        "versions": versions(),
    }
    write_json(out / RESULT, result)
    return {**result, "out": str(out)}


def _left(left: Left | None):
    return None if left is None else {"outline": left.outline, "shading": left.shading}
