# SPDX-License-Identifier: GPL-3.0-or-later
"""Runs every method on every case; each answer is a small file, so that a stopped run goes on where it was."""

import json
import shutil
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path

from btfsep_engine.atomic import write_text
from scripts.studies import axes, cases, methods, scenes
from scripts.studies.axes import AXES, Setting

UNDISTURBED = "undisturbed"


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

    def case(self, work, lights):
        setting = Setting(work, self.scene, self.light, tuple(lights))
        if self.axis == UNDISTURBED:
            return cases.undisturbed(work, self.scene, self.light)
        axis = AXES[self.axis]
        return axis.make(setting, axis.zero if self.index == 0 else axis.values[self.index - 1])


def tasks(pairs, names) -> list[Task]:
    """All tasks of pairs (scene, light) and axes; first what is not disturbed."""
    out = [Task(UNDISTURBED, 0, s, l) for s, l in pairs]
    for name in names:
        axis = axes.AXES[name]
        numbers = ([0] if axis.zero is not None else []) + list(range(1, len(axis.values) + 1))
        out += [Task(name, i, s, l) for i in numbers for s, l in pairs if axis.concerns(s)]
    return out


def zero_of(task: Task) -> Task:
    """The undisturbed task that belongs to a task."""
    own = task.axis != UNDISTURBED and AXES[task.axis].zero is not None
    return Task(task.axis if own else UNDISTURBED, 0, task.scene, task.light)


def source(task: Task, method: str) -> Task:
    """The task whose answer serves a method: what it is not told cannot mislead it."""
    if task.axis != UNDISTURBED and AXES[task.axis].changes != "photo" and method in methods.BLIND:
        return zero_of(task)
    return task


def run(chosen, options) -> None:
    """Estimates what is missing."""
    from btfsep_engine.btf.library import open_library

    library = open_library()
    todo = tasks(scenes.pairs(chosen, options.lights, half=options.half), options.axes)
    shard, shards = (int(n) for n in options.shard.split("/"))
    todo = todo[shard::shards]
    for method in options.anew:
        for task in todo:
            task.path(options.work, method).unlink(missing_ok=True)
    missing = [t for t in todo if any(not t.path(options.work, m).exists() for m in asked(t, options.methods))]
    started = time.perf_counter()
    for number, task in enumerate(missing):
        told = solve(task, options, library)
        print(
            f"[estimate {number + 1}/{len(missing)}, {time.perf_counter() - started:.0f} s] {task.axis} {task.index}, "
            f"{task.scene.name}, {scenes.light_name(task.light)}: {told}",
            flush=True,
        )


def asked(task: Task, names) -> list:
    """The methods that have to be run on a task."""
    return [m for m in names if source(task, m) == task]


def solve(task: Task, options, library) -> str:
    """Runs the methods that have no answer for a task yet; gives the errors in words."""
    from scripts.studies import measures

    work = options.work
    case = task.case(work, options.lights)
    pixels = measures.rerendering(work, task.scene, case)
    folder = Path(tempfile.mkdtemp(prefix="job-", dir=work))
    words = []
    try:
        cases.write_job(case, folder)
        for method in asked(task, options.methods):
            path = task.path(work, method)
            if path.exists():
                continue
            given = methods.estimate(method, folder, case, library)
            found = {} if given.coefficients is None else measures.measure(given, case, pixels)
            record = {
                "task": asdict(task) | {"scene": task.scene.name},
                "refused": given.coefficients is None,
                "warnings": list(given.warnings),
                "determined": given.determined,
                "seconds": given.seconds,
                **found,
            }
            path.parent.mkdir(parents=True, exist_ok=True)
            write_text(path, json.dumps(record, indent=1) + "\n")
            words.append(f"{method} {found['order2']:.2f}" if found else f"{method} refused")
    finally:
        shutil.rmtree(folder)
    return ", ".join(words)


def read(task: Task, work, method: str) -> dict | None:
    """A method's answer, None where there is none yet."""
    path = source(task, method).path(work, method)
    return json.loads(path.read_text()) if path.exists() else None
