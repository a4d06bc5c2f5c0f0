# SPDX-License-Identifier: GPL-3.0-or-later
"""The light of every picture of a sequence: camera, objects and materials stand still, only the light changes.

Basis images are made and factorised once; a further frame is read, multiplied and solved. A frame of which pixels are
saturated has fewer equations: it costs a factorisation of its own.
"""

import re
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from btfsep_engine.atomic import write_json
from btfsep_engine.errors import InputError
from btfsep_engine.fit.stated import Fit, expected_error
from btfsep_engine.images import SUFFIXES
from btfsep_engine.job.load import load_job, read_photo
from btfsep_engine.light.files import Lighting, write_lighting, write_lighting_exr
from btfsep_engine.pipeline.materials import object_materials
from btfsep_engine.pipeline.model import view_problem
from btfsep_engine.pipeline.problem import Problem
from btfsep_engine.pipeline.record import determined_words, run_record
from btfsep_engine.pipeline.scene import PreparedScene
from btfsep_engine.pipeline.settings import Settings
from btfsep_engine.pipeline.together import light_solver
from btfsep_engine.threads import one_thread

_DIGITS = re.compile(r"([0-9]+)")


def frame_files(pattern) -> list[Path]:
    """The files of a pattern like ``frames/*.exr`` (or a folder), in the order of their names and numbers.

    Raises
    ------
    InputError
        When there are none, or two of them have one stem, which would be one result.
    """
    path = Path(pattern)
    folder, name = (path, "*") if path.is_dir() else (path.parent, path.name)
    found = [p for p in folder.glob(name) if p.is_file() and p.suffix.lower() in SUFFIXES] if folder.is_dir() else []
    if not found:
        raise InputError(f"--images '{pattern}'", "no image matches", "give a pattern in quotes, like 'frames/*.exr'")
    found.sort(key=lambda p: [int(x) if i % 2 else x for i, x in enumerate(_DIGITS.split(p.name))])
    stems = [p.stem for p in found]
    for i, stem in enumerate(stems):
        if stem in stems[:i]:
            raise InputError(f"--images '{pattern}'", f"two frames are named '{stem}'", "match one kind of file only")
    return found


WORSE = 1.2  # of the last frame's residual: from there on a frame's model is looked for anew


class FrameSolver:
    """Frames of one view, solved with what stands still: a Problem without a photo of its own."""

    def __init__(self, problem: Problem, settings: Settings):
        self.problem, self.settings = problem, settings
        self.solver = light_solver([problem], settings)
        self.before: Fit | None = None

    def solve(self, photo):
        """The Fit of a `job.model.Photo`, and how many of the pixels were saturated.

        A frame keeps the last one's model, from its light on, unless that explains it much worse (`WORSE`).
        """
        usable, problem, solver = self.problem.values_of(photo.usable), self.problem, self.solver
        if not usable.all():
            problem = problem.subset(usable)
            solver = light_solver([problem], self.settings)
        b, before = problem.values_of(photo.radiance), self.before
        fit = solver.solve(b, start=before)
        if before is not None and fit.residual > WORSE * before.residual:
            fit = solver.solve(b)
        self.before = fit
        return fit, int((~usable).sum())


@one_thread()
def run_sequence(
    folder, library, settings: Settings, *, frames, material=None, out=None, with_exr=False, reporter
) -> dict:
    """The whole command: writes FRAME.json for each frame (and FRAME.exr), and sequence.json.

    Parameters
    ----------
    folder : job folder; its own image need not be there
    frames : pattern of the pictures, taken by the job's camera and coded as its `image_colorspace` says
    material : a name for all objects; else the job's, else as recognised in the first frame
    out : folder for the results, default ``folder/sequence``
    with_exr : whether the lights are written as maps, too

    Returns
    -------
    dict, the content of sequence.json and ``out``
    """
    started = time.perf_counter()
    if settings.estimator != "map":
        raise InputError("a sequence", f"--estimator {settings.estimator}", "it goes with --estimator map only")
    if settings.order == "auto":
        raise InputError("a sequence", "--order auto", "give one order for all frames")
    with reporter.stage("reading"):
        files = frame_files(frames)
        job = load_job(folder, with_photo=False)
        job = replace(job, photo=read_photo(files[0], job.camera, colorspace=job.image_colorspace))
        if job.image_colorspace == "unknown":
            raise InputError("a sequence", "image_colorspace 'unknown'", "say srgb or linear in the job")
    out = Path(out) if out is not None else job.folder / "sequence"
    scene = PreparedScene(job, reporter)
    materials = object_materials(scene, library, settings, names=[material or o.material for o in job.objects])
    with reporter.stage("transport"):
        problem = view_problem(scene, [m.material for m in materials], settings)
    with reporter.stage("factorising"):
        solver = FrameSolver(problem, settings)
    lights, solving = [], []
    for i, file in enumerate(files):
        with reporter.timed("reading"):
            photo = read_photo(file, job.camera, colorspace=job.image_colorspace) if i else job.photo
        begun = time.perf_counter()
        with reporter.timed("fit"):
            fit, lost = solver.solve(photo)
        solving.append(time.perf_counter() - begun)
        lighting = Lighting(settings.order, fit.coefficients, fit.stddev, fit.determined, job.exposure_ev)
        with reporter.timed("writing"):
            write_lighting(out / f"{file.stem}.json", lighting)
            if with_exr:
                write_lighting_exr(out / f"{file.stem}.exr", lighting)
        lights.append(
            {
                "image": file.name,
                "lighting": f"{file.stem}.json",
                "residual": fit.residual,
                "determined": determined_words(fit.determined, fit.all_determined),
                "expected_error": expected_error(fit.coefficients, fit.samples),
                "saturated_pixels": lost,
                "milliseconds": round(1000 * solving[-1], 2),
            }
        )
        reporter.progress("photos", (i + 1) / len(files), file.name)
    result = {
        "format": "btfsep-sequence",
        "version": 1,
        "objects": [{"name": o.name, **m.record} for o, m in zip(job.objects, materials, strict=True)],
        "order": settings.order,
        "frames": lights,
        "median_milliseconds_per_further_frame": round(1000 * float(np.median(solving[1:] or solving)), 2),
        **run_record(settings, reporter),
    }
    result["seconds"]["total"] = round(time.perf_counter() - started, 4)
    write_json(out / "sequence.json", result)
    return {**result, "out": str(out)}
