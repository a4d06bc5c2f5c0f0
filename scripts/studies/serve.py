# SPDX-License-Identifier: GPL-3.0-or-later
"""How long one waits for an estimate: by a process of its own, and by the resident engine, which keeps what it made.

scripts/study serve PHOTOS      jobs OBJECT_MATERIAL_LIGHT, as scripts/study photos leaves them; two lights of each

Of each object and material: a process of its own; the resident engine's first estimate of that scene (what a job of a
batch costs), the same once more, another photo of it, another material, and a camera that is moved by half a pixel.
Seconds are those that the caller waits, from the request to the light and to the end; processor seconds those of all of
the engine's processes. The error stands beside them: up to order 2, one free scale. Fills in
docs/results/resident.md.
"""

import json
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import psutil
from tqdm import tqdm

from btfsep_engine.light.files import read_lighting
from btfsep_engine.render.backend import choose_backend
from scripts.studies import ROOT, parser, tables
from scripts.studies.measures import order2
from scripts.studies.photos import WHITE, photographs_in, views

PAGE = ROOT / "docs" / "results" / "resident.md"
ENGINE = [sys.executable, "-P", "-m", "btfsep_engine"]
OTHER = {WHITE: "leather/brown-grain"}  # a material in place of another; of all but white: white
KINDS = {
    "alone": "a process of its own",
    "first": "first of a scene, warm",
    "again": "the same again",
    "photo": "another photo",
    "material": "another material",
    "camera": "another camera",
}


def follow(lines, begun: float) -> tuple[float, float]:
    """Seconds from ``begun`` to the line of the light, and to the last."""
    light = np.nan
    for line in lines:
        said = json.loads(line)
        if said["type"] == "light":
            light = time.perf_counter() - begun
        if said["type"] == "failed":
            raise SystemExit(f"error: {said['message']}")
        if said["type"] == "done":
            return light, time.perf_counter() - begun
    raise SystemExit("error: the engine ended without an answer")


def alone(arguments) -> tuple[float, float, float]:
    """Seconds to the light, to the end, and of the processor, of an engine that is started for one command."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    begun = time.perf_counter()
    with subprocess.Popen([*ENGINE, *arguments, "--json"], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as run:
        waited = follow(run.stdout, begun)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return *waited, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


class Resident:
    """A resident engine, asked for one command after another."""

    def __init__(self):
        pipe = subprocess.PIPE
        self.process = subprocess.Popen([*ENGINE, "serve"], stdin=pipe, stdout=pipe, stderr=subprocess.DEVNULL)

    def processor(self) -> float:
        """Seconds that its processes have taken."""
        served = psutil.Process(self.process.pid)
        spent = [process.cpu_times() for process in (served, *served.children(recursive=True))]
        return sum(times.user + times.system for times in spent)

    def ask(self, arguments) -> tuple[float, float, float]:
        """As :func:`alone`."""
        before, begun = self.processor(), time.perf_counter()
        request = {"id": 1, "command": arguments[0], "arguments": arguments[1:]}
        self.process.stdin.write(json.dumps(request).encode() + b"\n")
        self.process.stdin.flush()
        waited = follow((line for line in self.process.stdout if b'"ready"' not in line), begun)
        return *waited, self.processor() - before

    def end(self) -> None:
        self.process.stdin.close()
        self.process.wait()


def moved(job: Path, folder: Path) -> Path:
    """A copy of a job whose camera is moved by half a pixel."""
    shutil.copytree(job, folder)
    description = json.loads((folder / "job.json").read_text())
    description["camera"]["cx"] += 0.5
    (folder / "job.json").write_text(json.dumps(description))
    return folder


def measured(view, resident: Resident, scratch: Path, more) -> list[dict]:
    """A row of each of `KINDS` for two photographs of one object and material."""
    one, two = view[:2]
    other = OTHER.get(one.material, WHITE)
    out = scratch / "out"
    asked = {
        "alone": (alone, one, one.folder, one.material),
        "first": (resident.ask, one, one.folder, one.material),
        "again": (resident.ask, one, one.folder, one.material),
        "photo": (resident.ask, two, two.folder, two.material),
        "material": (resident.ask, two, two.folder, other),
        "camera": (resident.ask, two, moved(two.folder, scratch / two.folder.name), two.material),
    }
    rows = []
    for kind, (run, photo, job, material) in asked.items():
        waited = run(["estimate", str(job.resolve()), "--material", material, "--out", str(out.resolve()), *more])
        error = order2(read_lighting(out / "lighting.json").coefficients, photo.truth(2))
        rows.append({"kind": kind, "light": waited[0], "end": waited[1], "processor": waited[2], "error": error})
    return rows


def page(rows, more) -> str:
    """The table, and what was measured."""
    cells = []
    for kind, name in KINDS.items():
        of = [r for r in rows if r["kind"] == kind]
        seconds = [tables.spread([r[key] for r in of]) for key in ("light", "end", "processor")]
        error = "(another material)" if kind == "material" else tables.spread([r["error"] for r in of])
        cells.append([name, *seconds, error])
    head = ["estimate", "seconds to the light", "to the end", "of the processor", "error"]
    count = sum(r["kind"] == "alone" for r in rows)
    machine = f"{os.cpu_count()} cores, {choose_backend().variant}"
    told = f"{count} scenes, medians (and the worst), {machine}, options `{' '.join(more) or 'none'}`."
    return f"{told}\n\n{tables.table(head, cells)}"


def main(arguments) -> None:
    options = parser("serve", __doc__)
    options.add_argument("folder", type=Path)
    options.add_argument("--objects", nargs="+")
    options.add_argument("--preset", default="balanced")
    options.add_argument("--no-report", action="store_true", help="estimates make no picture")
    options.add_argument("--page", type=Path, default=PAGE)
    given = options.parse_args(arguments)
    more = ["--preset", given.preset, *(["--no-report"] if given.no_report else [])]
    scenes = [v for v in views(photographs_in(given.folder, objects=given.objects)).values() if len(v) > 1]
    if not scenes:
        raise SystemExit("error: no scene has two photographs")
    resident, rows = Resident(), []
    with tempfile.TemporaryDirectory() as folder:
        try:
            measured(scenes[-1], resident, Path(folder) / "warm", more)
            for i, view in enumerate(tqdm(scenes[:-1] or scenes, desc="scenes")):
                rows += measured(view, resident, Path(folder) / str(i), more)
        finally:
            resident.end()
    text = page(rows, more)
    print(text)
    tables.fill(given.page, "resident", text)
