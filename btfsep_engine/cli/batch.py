# SPDX-License-Identifier: GPL-3.0-or-later
"""``btfsep batch``: the estimate of many jobs, on one machine or as one task of a farm's array.

One job that fails does not stop the others. What is done is not done again while job, options and engine stay the same.
"""

import csv
import hashlib
import io
import json
import os
from dataclasses import dataclass
from pathlib import Path

import click

from btfsep_engine import __version__
from btfsep_engine.atomic import write_text
from btfsep_engine.cli.command import command, opened_library
from btfsep_engine.cli.lanes import run_all
from btfsep_engine.cli.options import ESTIMATE, LIBRARY, MATERIAL, PATH, REPORT, out_option, takes_settings
from btfsep_engine.cli.worker import Outcome
from btfsep_engine.errors import InputError
from btfsep_engine.pipeline.record import write_json
from btfsep_engine.pipeline.settings import Settings

RESULT = "result"  # of a job folder, where --out is not given
COLUMNS = ("job", "status", "materials", "residual", "effective_degrees_of_freedom", "seconds", "warnings", "message")


@dataclass(frozen=True)
class EstimateTask:
    """One job of many: where its results go, and what ``estimate`` was told."""

    job: Path
    out: Path
    settings: Settings
    library_folder: Path | None = None
    material: str | None = None
    with_report: bool = True


def estimate_job(task: EstimateTask, reporter) -> dict:
    """The result of a job's estimate, as of `run_estimate`. Raises InputError."""
    from btfsep_engine.pipeline.estimation import run_estimate

    reporter.command = "estimate"
    return run_estimate(
        task.job,
        opened_library(task.library_folder),
        task.settings,
        material=task.material,
        out=task.out,
        with_report=task.with_report,
        reporter=reporter,
    )


def find_jobs(places, list_file=None) -> list[Path]:
    """Job folders: those named, those in folders that are named, and those that a text file names, a line each.

    Raises
    ------
    InputError
        Where a place is no job and holds none, or there is none at all.
    """
    places = [Path(p) for p in places]
    if list_file is not None:
        try:
            with click.open_file(str(list_file), "rb") as file:  # names are bytes, whatever text the machine speaks
                lines = [line.strip() for line in file.read().removeprefix(b"\xef\xbb\xbf").splitlines()]
            places += [Path(os.fsdecode(line)) for line in lines if line and not line.startswith(b"#")]
        except OSError as error:
            raise InputError(f"--list {list_file}", str(error), "give a text file with a job folder a line") from error
    found = []
    for place in places:
        if place.is_file() and place.name == "job.json":
            place = place.parent
        inside = [place] if (place / "job.json").is_file() else sorted(p.parent for p in place.glob("*/job.json"))
        if not inside:
            raise InputError(f"{place}", "neither it nor a folder in it has a job.json", "name job folders")
        found += inside
    if not found:
        raise InputError("batch", "no jobs", "name job folders, folders of them, or --list FILE")
    return list(dict.fromkeys(found))


def shard_of(jobs, shard: str | None) -> list[Path]:
    """Every n-th job of "k/n", k from 1: what the k-th of n tasks of a farm's array does."""
    if shard is None:
        return jobs
    try:
        k, n = (int(part) for part in shard.split("/"))
        if not 1 <= k <= n:
            raise ValueError
    except ValueError:
        raise InputError("--shard", f"'{shard}'", "give K/N with K from 1 to N, as in 3/10") from None
    return jobs[k - 1 :: n]


def result_folders(jobs, out) -> list[Path]:
    """Where each job's results go: JOB/result, or OUT/<name of the job folder>."""
    if out is None:
        return [job / RESULT for job in jobs]
    folders = [Path(out) / job.resolve().name for job in jobs]
    twice = {f.name for f in folders if folders.count(f) > 1}
    if twice:
        raise InputError("--out", f"two job folders are named '{min(twice)}'", "leave out --out, or rename one")
    return folders


def job_key(job: Path, *facts) -> str:
    """Changes when the engine, one of ``facts`` or any file of the job folder (by size and time) does."""
    facts = [__version__, *map(str, facts)]
    for path in sorted(job.rglob("*")):
        inside = path.relative_to(job)
        if inside.parts[0] != RESULT and path.is_file():
            stat = path.stat()
            facts.append(f"{inside} {stat.st_size} {stat.st_mtime_ns}")
    return hashlib.sha256(os.fsencode("\n".join(facts))).hexdigest()


def earlier(summary_file: Path) -> dict:
    """Entries of an earlier run's summary by job; {} where there is none that can be read."""
    try:
        entries = json.loads(summary_file.read_text(encoding="utf-8"))["jobs"]
        return {e["job"]: e for e in entries if isinstance(e, dict) and isinstance(e.get("job"), str)}
    except (OSError, ValueError, KeyError, TypeError):
        return {}


def entry_of(task: EstimateTask, key: str, ended: Outcome) -> dict:
    """What the summary says of one job."""
    result = ended.result
    status = {0: "done", 2: "failed"}.get(ended.exit_code, "crashed")
    entry = {"job": str(task.job), "out": str(task.out), "status": status, "message": ended.message, "key": key}
    if status == "done":
        entry |= {
            "materials": [o["material"] for o in result["objects"]],
            "residual": result["residual"],
            "effective_degrees_of_freedom": result["effective_degrees_of_freedom"],
            "seconds": result["seconds"]["total"],
            "warnings": result["warnings"],
        }
    return entry


def write_summary(path: Path, entries) -> None:
    """``path`` (JSON), and a table beside it (CSV), each whole or not at all."""
    write_json(path, {"format": "btfsep-batch", "version": 1, "jobs": entries})
    text = io.StringIO()
    table = csv.DictWriter(text, COLUMNS, extrasaction="ignore")
    table.writeheader()
    for entry in entries:
        table.writerow(
            {**entry, "materials": " ".join(entry.get("materials", [])), "warnings": len(entry.get("warnings", []))}
        )
    write_text(path.with_suffix(".csv"), text.getvalue())


def run_batch(tasks: list[EstimateTask], *, lanes: int, again: bool, summary: Path, reporter) -> dict:
    """Estimates all jobs; the summary is written anew after each of them."""
    before = {} if again else earlier(summary)
    digest = opened_library(tasks[0].library_folder).digest
    keys = [job_key(t.job, digest, t.out.resolve(), t.settings, t.material, t.with_report) for t in tasks]
    entries = [None] * len(tasks)
    for i, (task, key) in enumerate(zip(tasks, keys, strict=True)):
        old = before.get(str(task.job), {})
        if old.get("status") == "done" and old.get("key") == key and (task.out / "result.json").is_file():
            entries[i] = old
    todo = [i for i, entry in enumerate(entries) if entry is None]
    kept = len(tasks) - len(todo)
    reporter.progress("batch", kept / len(tasks), f"{kept} of {len(tasks)} done before")
    for number, ended in run_all(estimate_job, [tasks[i] for i in todo], min(lanes, max(1, len(todo)))):
        i = todo[number]
        entries[i] = entry_of(tasks[i], keys[i], ended)
        if ended.exit_code:
            reporter.warn(f"{tasks[i].job}: {ended.message}")
        write_summary(summary, [e for e in entries if e is not None])
        over = sum(e is not None for e in entries)
        reporter.progress("batch", over / len(tasks), f"{over} of {len(tasks)} {tasks[i].job.name}")
    write_summary(summary, entries)
    count = {status: sum(e["status"] == status for e in entries) for status in ("done", "failed", "crashed")}
    return {"jobs": entries, **count, "kept": kept, "summary": str(summary)}


@click.command()
@click.argument("places", nargs=-1, metavar="[JOB]...", type=PATH)
@click.option("--list", "list_file", type=click.Path(), help="Text file, a job folder a line; - for input.")
@out_option("JOB/result")
@click.option("--summary", type=PATH, help="The summary.  [default: OUT/batch.json]")
@click.option("--lanes", type=click.IntRange(1, 256), default=1, show_default=True, help="Jobs at once.")
@click.option("--shard", metavar="K/N", help="Only every N-th job, from the K-th: a task of a farm's array.")
@click.option("--again", is_flag=True, help="Estimate also what is done already.")
@MATERIAL
@REPORT
@LIBRARY
@command
@takes_settings(*ESTIMATE)
def batch(*, places, list_file, out, summary, lanes, shard, again, reporter, **estimate_options):
    """Estimates the light of many jobs: job folders, or folders that hold job folders.

    JOB/result (or OUT/NAME) gets each job's results; batch.json and batch.csv sum them up. One that fails does not
    stop the others. What is there already for the same job and options is not made again.
    """
    every = find_jobs(places, list_file)
    jobs = shard_of(every, shard)
    if not jobs:  # a farm may give more tasks than there are jobs
        words = f"shard {shard}: of {len(every)} jobs this one gets none; nothing was done"
        return {"jobs": [], "done": 0, "failed": 0, "crashed": 0, "kept": 0, "summary": None}, words
    if summary is None:
        place = "batch.json" if shard is None else f"batch-{shard.replace('/', '-of-')}.json"
        summary = (out or Path(".")) / place
    folders = result_folders(jobs, out)
    tasks = [EstimateTask(job, folder, **estimate_options) for job, folder in zip(jobs, folders, strict=True)]
    result = run_batch(tasks, lanes=lanes, again=again, summary=summary, reporter=reporter)
    bad = result["failed"] + result["crashed"]
    if bad:
        raise InputError(
            "batch", f"{bad} of {len(jobs)} jobs failed", f"see their messages in {summary}; run it again for these"
        )
    return result, f"{result['done']} jobs done ({result['kept']} of them before); summary in {summary}"
