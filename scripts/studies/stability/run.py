# SPDX-License-Identifier: GPL-3.0-or-later
"""Runs every method on every case; each answer is a small file, so that a stopped run goes on where it was."""

import json
import shutil
import tempfile
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from tqdm import tqdm

from btfsep_engine.btf.library import open_library
from btfsep_engine.commands.compare import psnr
from btfsep_engine.fit import compare
from btfsep_engine.light.lightings import SHBasis
from btfsep_engine.pipeline.settings import MODELLED_BOUNCES, Settings
from btfsep_engine.render.sampling import spread
from btfsep_engine.storage.atomic import write_text
from scripts.studies.estimates import scene_of
from scripts.studies.measures import TERMS, covered, errors
from scripts.studies.stability import cases, methods, scenes
from scripts.studies.stability.axes import AXES, Setting

UNDISTURBED = "undisturbed"
RERENDER_PIXELS = 3000
SPHERES = ("diffuse", "silver", "mirror")


@dataclass(frozen=True)
class Task:
    """One photograph under one disturbance. ``index`` 0: not disturbed, 1 to 5: the axis's values."""

    axis: str
    index: int
    scene: scenes.Scene
    light: str

    def path(self, work, method: str) -> Path:
        name = f"{self.index}-{self.scene.name}-{scenes.light_name(self.light)}-{method}.json"
        return Path(work) / "estimates" / self.axis.replace(",", "").replace(" ", "-") / name

    @property
    def value(self):
        """The severity; None where nothing is disturbed."""
        if self.axis == UNDISTURBED:
            return None
        axis = AXES[self.axis]
        return axis.zero if self.index == 0 else axis.values[self.index - 1]

    def case(self, work, lights):
        if self.axis == UNDISTURBED:
            return cases.undisturbed(work, self.scene, self.light)
        return AXES[self.axis].make(Setting(work, self.scene, self.light, tuple(lights)), self.value)


def tasks(pairs, names) -> list[Task]:
    """All tasks of pairs (scene, light) and axes; first what is not disturbed."""
    out = [Task(UNDISTURBED, 0, s, l) for s, l in pairs]
    for name in names:
        numbers = range(0 if AXES[name].zero is not None else 1, len(AXES[name].values) + 1)
        out += [Task(name, i, s, l) for i in numbers for s, l in pairs if AXES[name].concerns(s)]
    return out


def zero_of(task: Task) -> Task:
    """The undisturbed task that belongs to a task."""
    own = task.axis != UNDISTURBED and AXES[task.axis].zero is not None
    return Task(task.axis if own else UNDISTURBED, 0, task.scene, task.light)


def source(task: Task, method: str) -> Task:
    """The task whose answer serves a method: what it is not told cannot mislead it."""
    told = task.axis == UNDISTURBED or AXES[task.axis].changes == "photo" or method not in methods.BLIND
    return task if told else zero_of(task)


def run(chosen, given) -> None:
    """Estimates what is missing."""
    library = open_library()
    todo = tasks(scenes.pairs(chosen, given.lights, half=given.half), given.axes)
    shard, shards = (int(n) for n in given.shard.split("/"))
    todo = todo[shard::shards]
    missing = {t: [m for m in given.methods if source(t, m) == t and not t.path(given.work, m).exists()] for t in todo}
    for task, names in tqdm([each for each in missing.items() if each[1]], desc="photographs"):
        solve(task, names, given, library)


def solve(task: Task, names, given, library) -> None:
    """Runs methods on a task."""
    case = task.case(given.work, given.lights)
    pixels = rerendering(given.work, task.scene, case)
    folder = Path(tempfile.mkdtemp(prefix="job-", dir=given.work))
    try:
        cases.write_job(case, folder)
        for method in names:
            found = methods.estimate(method, folder, case, library)
            record = {
                "task": asdict(task) | {"scene": task.scene.name},
                "refused": found.coefficients is None,
                "warnings": list(found.warnings),
                "seconds": found.seconds,
                **({} if found.coefficients is None else measure(found, case.truth, pixels)),
            }
            path = task.path(given.work, method)
            path.parent.mkdir(parents=True, exist_ok=True)
            write_text(path, json.dumps(record, indent=1) + "\n")
    finally:
        shutil.rmtree(folder)


def read(task: Task, work, method: str) -> dict | None:
    """A method's answer, None where there is none yet."""
    path = source(task, method).path(work, method)
    return json.loads(path.read_text()) if path.exists() else None


def measure(found, truth, pixels) -> dict:
    """The measures of a light that a method found.

    Parameters
    ----------
    found : methods.Given
    truth : (terms, 3)
    pixels : (basis (p, terms, 3), radiance (p, 3)) of `rerendering`

    Returns
    -------
    dict, JSON-ready: `measures.errors`, si_rmse and degrees of each sphere, spheres (mean si_rmse), psnr (dB, of the
    photograph rendered again), and, where a spread is stated, `measures.covered` and stated (the relative error up to
    order 2 that the method expects; of least squares its standard deviations over its size)
    """
    lacking = max(0, TERMS - len(found.coefficients))  # of a light of order 1: they count as 0, and as surely so
    x = np.pad(found.coefficients, ((0, lacking), (0, 0)))
    out = errors(x, truth)
    known = min(len(x), len(truth))
    pictures = [compare.spheres(c[:known], size=64) for c in (x, truth)]
    for kind in SPHERES:
        off = compare.image_errors(pictures[0][kind], pictures[1][kind])
        out[f"{kind}_si_rmse"], out[f"{kind}_degrees"] = off["si_rmse"], off["angular_degrees"]
    each = [out[f"{kind}_si_rmse"] for kind in SPHERES]
    out["spheres"] = None if None in each else float(np.mean(each))
    basis, radiance = pixels
    again = np.einsum("pmc,mc->pc", basis[:, : len(x)], x[: basis.shape[1]])
    out["psnr"] = psnr(again[None], radiance[None])
    if found.stddev is not None:
        spread = np.pad(found.stddev, ((0, lacking), (0, 0)))[:TERMS]
        ends = None if found.interval is None else found.interval[:, :TERMS]
        out |= covered(x[:TERMS], spread, truth[:TERMS], interval=ends)
        out["stated"] = found.expected or float(np.linalg.norm(spread) / max(np.linalg.norm(x[:TERMS]), 1e-300))
    return out


@lru_cache(maxsize=64)
def _basis(folder: Path, material: str):
    scene = scene_of(folder)
    points = scene.points(0, textured=False)
    points = points.take(spread(points, RERENDER_PIXELS))
    told, lights = open_library().load(material).mean_material(), SHBasis(scenes.ORDER)
    indirect = scene.indirect([told], lights, Settings(), bounces=MODELLED_BOUNCES)
    return points.pixels, scene.radiance(points, told, lights, directions=512, indirect=indirect).astype(np.float64)


def rerendering(work, scene, case):
    """What renders a case's photograph again: with the true geometry and material, under any light.

    Returns
    -------
    basis : (p, terms, 3) radiance of pixels under each spherical harmonic
    radiance : (p, 3) the photograph's, undisturbed
    """
    pixels, basis = _basis(scenes.geometry_folder(work, scene, case.geometry), scene.given)
    return basis, case.clean[pixels[:, 0], pixels[:, 1]]
