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

from btfsep_engine.errors import InputError
from btfsep_engine.fit.log_normal import LightSolver
from btfsep_engine.fit.stated import Fit, expected_error
from btfsep_engine.images import SUFFIXES
from btfsep_engine.job.load import load_job, read_photo
from btfsep_engine.light.files import Lighting, write_lighting, write_lighting_exr
from btfsep_engine.pipeline.estimation import determined_words, material_record, object_materials
from btfsep_engine.pipeline.modelling import appearance, part_of
from btfsep_engine.pipeline.problem import pose, shares
from btfsep_engine.pipeline.record import run_record, write_json
from btfsep_engine.pipeline.scene import PreparedScene
from btfsep_engine.pipeline.settings import Settings
from btfsep_engine.render.sampling import choose_pixels

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
    """Frames of one view, solved with what stands still.

    Parameters
    ----------
    basis : (p, terms, 3); normals : (p, 3) unit; pixels : (p, 2) row and column
    settings : Settings
    """

    def __init__(self, basis, normals, pixels, settings: Settings):
        self.basis, self.normals, self.pixels, self.settings = basis, normals, pixels, settings
        self.solver = self._solver(slice(None))
        self.before: Fit | None = None

    def _solver(self, chosen) -> LightSolver:
        return LightSolver(
            self.basis[chosen], normals=self.normals[chosen], order=int(self.settings.order), seed=self.settings.seed
        )

    def solve(self, photo):
        """The Fit of a `job.model.Photo`, and how many of the pixels were saturated.

        A frame keeps the last one's model, from its light on, unless that explains it much worse (`WORSE`).
        """
        rows, columns = self.pixels.T
        usable = photo.usable[rows, columns]
        lost = int((~usable).sum())
        solver = self._solver(usable) if lost else self.solver
        b = photo.radiance[rows[usable], columns[usable]]
        before = self.before
        fit = solver.solve(b, start=before)
        if before is not None and fit.residual > WORSE * before.residual:
            fit = solver.solve(b)
        self.before = fit
        return fit, lost


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
    found = object_materials(scene, library, settings, names=[material or o.material for o in job.objects])
    with reporter.stage("transport"):
        counts = shares(scene, settings.pixels)
        points = [
            scene.points(i, region=part_of(r, n, settings), textured=settings.appearance == "textured")
            for i, (r, n) in enumerate(zip(scene.regions, counts, strict=True))
        ]
        points = [
            p.take(choose_pixels(p, n, seed=settings.seed)) if n else p for p, n in zip(points, counts, strict=True)
        ]
        problem = pose(scene, [appearance(m.material, settings) for m in found], points, settings)
    with reporter.stage("factorising"):
        solver = FrameSolver(problem.all_basis, problem.normals, problem.pixels, settings)
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
        "objects": [{"name": o.name, **material_record(m)} for o, m in zip(job.objects, found, strict=True)],
        "order": settings.order,
        "frames": lights,
        "median_milliseconds_per_further_frame": round(1000 * float(np.median(solving[1:] or solving)), 2),
        **run_record(settings, reporter),
    }
    result["seconds"]["total"] = round(time.perf_counter() - started, 4)
    write_json(out / "sequence.json", result)
    return {**result, "out": str(out)}
