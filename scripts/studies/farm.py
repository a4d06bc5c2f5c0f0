# SPDX-License-Identifier: GPL-3.0-or-later
"""Hundreds of jobs, some poisoned, by lanes, Dask's workers and openjd: jobs a second, memory, what a kill costs.

scripts/study farm FOLDER                          1,000 jobs by two lanes, 200 by the other ways; docs/results/farm.md
scripts/study farm FOLDER --jobs 100 --others 40 --out page.md

Jobs are 64 x 64 pixels of a sphere of given material under a light of order 2 with 1 % noise, each turned otherwise, so
that none has anything of another; preset draft, no report. One of twenty cannot be read, in one of five ways. Beside
them stand usual jobs (384 x 384, balanced, with report): what a small one costs is mostly not its pixels.
"""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import psutil
import trimesh

from btfsep_engine.cli.jobs import find_jobs
from btfsep_engine.imaging import images
from scripts.studies import ROOT, parser
from scripts.studies.stage import looking_down, positive_light, shaded_ball, write_job
from scripts.studies.tables import fill, table

PAGE = ROOT / "docs" / "results" / "farm.md"
TEMPLATE = ROOT / "btfsep_engine" / "data" / "templates" / "btfsep.openjd.yaml"
MATERIAL = "reference/white-diffuse"
SMALL, USUAL = ["--preset", "draft", "--no-report"], ["--preset", "balanced"]
POISONED = 20  # one of so many
MARKS = (0.02, 0.1, 0.25, 0.5, 0.75, 1.0)
BIN = Path(sys.executable).parent
MB = 1 << 20


def make_jobs(folder: Path, count: int, size: int) -> None:
    """Jobs in FOLDER/NNNNN, of which one of `POISONED` cannot be read."""
    rng = np.random.default_rng(0)
    camera, light = looking_down(size, 1.4 * size), positive_light(2)
    lit, ball = shaded_ball(camera, light), trimesh.creation.icosphere(4)
    for i in range(count):
        job = folder / f"{i:05}"
        turned = trimesh.transformations.rotation_matrix(1e-3 + i / count, [1, 2, 3])
        write_job(job, ball, camera, material=MATERIAL, to_world=turned.tolist())
        images.write_exr(job / "photo.exr", lit * (1 + 0.01 * rng.normal(size=lit.shape)))
        if i % POISONED == POISONED - 1:
            poison(job, i // POISONED)


def poison(job: Path, kind: int) -> None:
    """Spoils a job: no photo, half a photo, half a mesh, no JSON, a photo that is a folder."""
    photo, mesh, text = job / "photo.exr", job / "object.ply", job / "job.json"
    spoilt = (photo, photo, mesh, text, photo)[kind % 5]
    half = spoilt.read_bytes()[: spoilt.stat().st_size // 2]
    spoilt.unlink()
    if kind % 5 == 4:
        spoilt.mkdir()
    elif kind % 5:
        spoilt.write_bytes(half)


def memory(pid: int) -> tuple[float, float, int]:
    """Megabytes of a process, of the largest of those that it started, and how many these are."""
    try:
        this = psutil.Process(pid)
        below = [child.memory_info().rss / MB for child in this.children(recursive=True)]
        return this.memory_info().rss / MB, max(below, default=0.0), len(below)
    except psutil.NoSuchProcess:
        return 0.0, 0.0, 0


def lives(process: psutil.Process) -> bool:
    """Whether it does anything: one that has ended stays in the system's list until somebody looks."""
    try:
        return process.status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False


def watched(command, jobs: int) -> dict:
    """Runs a command that reports a batch by ``--json``: its seconds, end, and the memory at `MARKS`."""
    before, began = os.times(), time.perf_counter()
    marks, held, last = list(MARKS), [], {}
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as run:
        for line in run.stdout:
            last = json.loads(line)
            over = last.get("fraction", 0) if last.get("stage") == "batch" else 0
            if marks and over >= marks[0]:
                held.append((marks.pop(0), *memory(run.pid)))
    seconds, after = time.perf_counter() - began, os.times()
    work = after.children_user + after.children_system - before.children_user - before.children_system
    counts = last.get("result", {})
    return {"seconds": seconds, "work": work, "rate": jobs / seconds, "memory": held, "exit": run.returncode, **counts}


def batch(jobs: list, out: Path, *options) -> list:
    """The command of a batch."""
    listed = out.with_suffix(".txt")
    listed.parent.mkdir(parents=True, exist_ok=True)
    listed.write_text("\n".join(map(str, jobs)))
    return [str(BIN / "btfsep"), "batch", "--list", str(listed), "--out", str(out), "--json", *map(str, options)]


@contextmanager
def workers(count: int):
    """The address of a Dask scheduler with so many workers of one thread, processes of their own."""
    from distributed import LocalCluster

    told = {"n_workers": count, "threads_per_worker": 1, "processes": True, "dashboard_address": None}
    with LocalCluster(**told, silence_logs=50) as cluster:
        yield cluster.scheduler_address


def by_openjd(jobs: list, folder: Path, tasks: int) -> dict:
    """As `watched`, of the template: two sessions at once, each with half of the tasks and an engine of its own."""
    shots, out = folder / "openjd", folder / "openjd-light"
    shots.mkdir(parents=True)
    for job in jobs:
        (shots / job.name).symlink_to(job, target_is_directory=True)
    told = {"Jobs": shots, "Results": out, "Tasks": tasks, "Preset": "draft", "Options": "--no-report"}
    words = [word for name, value in told.items() for word in ("-p", f"{name}={value}")]
    environment = os.environ | {"PATH": f"{BIN}{os.pathsep}{os.environ['PATH']}"}
    began, halves = time.perf_counter(), []
    for half in (0, 1):
        shares = json.dumps([{"Share": str(k)} for k in range(1 + half, tasks + 1, 2)])
        command = [str(BIN / "openjd"), "run", str(TEMPLATE), *words, "--step", "Estimate", "--tasks", shares]
        halves.append(subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.STDOUT))
    codes = [half.wait() for half in halves]
    seconds = time.perf_counter() - began
    join = [str(BIN / "btfsep"), "batch", "--join", str(out), "--out", str(out), "--json", "--allow-failures"]
    counts = json.loads(subprocess.run(join, capture_output=True, text=True).stdout.splitlines()[-1])["result"]
    return {"seconds": seconds, "work": np.nan, "rate": len(jobs) / seconds, "exit": max(codes), **counts}


def killed(jobs: list, out: Path) -> dict:
    """What it costs to kill a batch of two lanes in the middle (SIGKILL), and then a lane of the one that goes on."""
    command = batch(jobs, out, "--lanes", 2, *SMALL)
    first = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    told = 0
    for line in first.stdout:
        told += '"stage": "batch"' in line and " of " in line
        if told >= len(jobs) // 2:
            break
    below = psutil.Process(first.pid).children(recursive=True)
    first.send_signal(signal.SIGKILL)
    first.wait()
    began = time.perf_counter()
    while (left := [each for each in below if lives(each)]) and time.perf_counter() - began < 5:
        time.sleep(0.005)
    ended = time.perf_counter() - began
    again, victim = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True), None
    last, over = {}, 0
    for line in again.stdout:
        last = json.loads(line)
        over += last.get("stage") == "batch"
        if over > 0.75 * len(jobs) and victim is None:
            victim = psutil.Process(again.pid).children()[0]
            victim.kill()
    counts = last["result"]
    return {"told": told, "left": len(left), "ended": ended, "exit": again.wait(), **counts}


def rows_of(ways: dict) -> list:
    """A line of the table for each way."""
    out = []
    for name, r in ways.items():
        work = f"{r['work'] / r['jobs']:.2f}".replace("nan", "–")
        bad = r["failed"] + r["crashed"]
        out.append([name, r["jobs"], f"{r['seconds']:.0f}", f"{r['rate']:.2f}", work, r["done"], bad, r["exit"]])
    return out


def main(arguments) -> None:
    told = parser("farm", __doc__)
    told.add_argument("folder", type=Path, help="for the jobs and results; some hundred kilobytes each")
    told.add_argument("--jobs", type=int, default=1000, help="by two lanes")
    told.add_argument("--others", type=int, default=200, help="by the other ways")
    told.add_argument("--usual", type=int, default=12, help="of a usual size, by two lanes")
    told.add_argument("--out", type=Path, default=PAGE)
    given = told.parse_args(arguments)
    folder = given.folder.absolute()
    make_jobs(folder / "small", max(given.jobs, given.others), 64)
    make_jobs(folder / "usual", given.usual, 384)
    every, usual = find_jobs([folder / "small"]), find_jobs([folder / "usual"])
    some, ways = every[: given.others], {}

    def way(name: str, jobs, result: dict) -> dict:
        ways[name] = result | {"jobs": len(jobs)}
        print(name, {k: v for k, v in result.items() if k != "memory"}, flush=True)
        return ways[name]

    out = folder / "light"
    whole = way("2 lanes", every, watched(batch(every, out / "two", "--lanes", 2, *SMALL), len(every)))
    kept = watched(batch(every, out / "two", "--lanes", 2, *SMALL), len(every))
    way("1 lane", some, watched(batch(some, out / "one", "--lanes", 1, *SMALL), len(some)))
    way("2 lanes, the same jobs", some, watched(batch(some, out / "again", "--lanes", 2, *SMALL), len(some)))
    with workers(2) as address:
        command = batch(some, out / "dask", "--scheduler", address, *SMALL)
        way("Dask, 2 workers", some, watched(command, len(some)) | {"work": np.nan})
    tasks = max(2, len(some) // 10)
    way(f"openjd, 2 sessions, {tasks} tasks", some, by_openjd(some, folder, tasks))
    large = way("usual jobs, 2 lanes", usual, watched(batch(usual, out / "usual", "--lanes", 2, *USUAL), len(usual)))
    kill = killed(some, out / "killed") | {"jobs": len(some)}
    fill(given.out, "figures", page(ways, whole, kept, large, kill))
    shutil.rmtree(out)


def page(ways: dict, whole: dict, kept: dict, large: dict, kill: dict) -> str:
    """The printed part of the page."""
    head = ("way", "jobs", "seconds", "jobs a second", "processor seconds a job", "done", "failed", "exit status")
    held = [
        (f"{100 * mark:.0f} %", f"{parent:.0f}", f"{child:.0f}", count)
        for mark, parent, child, count in whole["memory"]
    ]
    small, usual = (r["work"] / r["jobs"] for r in (whole, large))
    estimate = [
        (name, f"{work:.2f}", f"{1e5 * work / 3600:.0f}", f"{1e5 * work / 3600 / 64:.1f}")
        for name, work in (("64 x 64, draft", small), ("384 x 384, balanced, report", usual))
    ]
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else float("nan")
    return "\n\n".join(
        [
            f"{os.cpu_count()} cores, which others used, too (load {load:.0f} at the end).",
            table(head, rows_of(ways)),
            f"The same {kept['done'] + kept['failed']} jobs a second time: {kept['kept']} kept, in "
            f"{kept['seconds']:.0f} s, {1000 * kept['seconds'] / whole['jobs']:.0f} ms each; poisoned ones anew.",
            "Memory of the first row, in megabytes:",
            table(("of the jobs", "the command", "the larger lane", "processes below"), held),
            f"A batch of two lanes, killed (SIGKILL) when it had told of {kill['told']} of {kill['jobs']} jobs: of its "
            f"processes {kill['left']} were left, the last ended {kill['ended']:.2f} s after it. The run after it kept "
            f"{kill['kept']} and did the others; one of its lanes, killed in turn, was replaced: {kill['done']} done, "
            f"{kill['failed']} failed, {kill['crashed']} crashed.",
            "100,000 shots, from processor seconds a job:",
            table(("jobs", "processor seconds each", "core hours", "hours on 64 cores"), estimate),
        ]
    )
