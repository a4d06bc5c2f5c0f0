# SPDX-License-Identifier: GPL-3.0-or-later
"""Whole estimates as studies make them, by the shipped library, and what is kept of a photograph from run to run."""

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

from btfsep_engine.btf.library import open_library
from btfsep_engine.job.load import load_job
from btfsep_engine.job.model import Job
from btfsep_engine.pipeline.estimation import Estimate, estimate
from btfsep_engine.pipeline.mending import mended
from btfsep_engine.pipeline.scene import PreparedScene
from btfsep_engine.pipeline.settings import choose
from btfsep_engine.progress import Reporter
from btfsep_engine.storage import atomic
from scripts.studies.measures import judged

library = cache(open_library)


def scene_of(job, *, uv: str | None = None) -> PreparedScene:
    """A job, or that of a folder, in the ray tracer; its ``reporter`` has the warnings.

    ``uv`` : how textures lie, in place of what the job says; "xatlas": the engine lays them itself, so that nothing
    lines up with the photograph's
    """
    job = job if isinstance(job, Job) else load_job(job)
    if uv is not None:
        job = replace(job, objects=tuple(replace(o, uv=uv) for o in job.objects))
    return PreparedScene(job, Reporter())


def estimated(job, material: str | None = None, *, preset: str = "balanced", refinements=None, **changes) -> Estimate:
    """The estimate of a job, of a folder's, or of a scene; ``material`` is that of all objects, None: as the job says.

    As a user has it: with the camera moved where the outlines ask for it (`mending`). ``refinements`` : as of
    `found_light`; ``changes`` : of the preset's settings
    """
    settings = choose(preset, **changes)
    scene = mended(job if isinstance(job, PreparedScene) else scene_of(job), settings)
    return estimate(scene, library(), settings, material=material, refinements=refinements)


def worth(found: Estimate, truth, **how) -> dict:
    """What an estimate's light is worth against true coefficients: `measures.judged`."""
    return judged(found.lighting, found.fit.samples, truth, **how)


def kept(folder: Path | None, name: str, make):
    """What ``make()`` gives, as JSON has it; where a folder is given, from there, if an earlier run has left it."""
    if folder is None:
        return make()
    path = folder / f"{name}.json"
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        atomic.write_text(path, json.dumps(make()))
    return json.loads(path.read_text())
