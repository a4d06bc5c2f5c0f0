# SPDX-License-Identifier: GPL-3.0-or-later
"""``btfsep batch``: the estimate of many jobs, on one machine, as a task of a farm's array, or by a scheduler.

One job that fails stops nothing. What is done stays, and is not done again: the results themselves say what they are of
(`commands/resume.py`), and whoever has a job looks at them first.
"""

import signal
import threading
from collections.abc import Iterable
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import click

from btfsep_engine import __version__
from btfsep_engine.cli.command import SomeFailed, command, opened_library
from btfsep_engine.cli.jobs import find_jobs, result_folders, shard_of
from btfsep_engine.cli.lanes import lanes_for, run_all, run_here
from btfsep_engine.cli.options import ESTIMATE, LIBRARY, MATERIAL, PATH, REPORT, out_option, takes_settings
from btfsep_engine.cli.scheduler import run_scheduled
from btfsep_engine.cli.summary import STATUSES, Journal, join
from btfsep_engine.cli.worker import TOO_LONG, Outcome
from btfsep_engine.errors import InputError
from btfsep_engine.pipeline.settings import Settings
from btfsep_engine.storage import atomic


@dataclass(frozen=True)
class EstimateTask:
    """One job of many: where its results go, and what ``estimate`` was told."""

    job: Path
    out: Path
    settings: Settings
    library_folder: Path | None = None
    material: str | None = None
    with_report: bool = True
    again: bool = False
    version: str = __version__  # of who asks


def estimate_job(task: EstimateTask, reporter) -> dict:
    """What a summary says of a job, which is estimated unless its results are there. Raises InputError."""
    if task.version != __version__:
        got = f"its version is {__version__}, and {task.version} is asked for"
        raise InputError("the engine of this machine", got, "install the same on all")
    from btfsep_engine.commands.estimate import run_estimate
    from btfsep_engine.commands.resume import finished_result

    reporter.command = "estimate"
    library = opened_library(task.library_folder)
    told = {"material": task.material, "with_report": task.with_report}
    result = None if task.again else finished_result(task.job, task.out, library, task.settings, **told)
    kept = result is not None
    if not kept:
        atomic.sweep(task.out)
        result = run_estimate(task.job, library, task.settings, out=task.out, reporter=reporter, **told)
    return {
        "kept": kept,
        "materials": [o["material"] for o in result["objects"]],
        "residual": result["residual"],
        "effective_degrees_of_freedom": result["effective_degrees_of_freedom"],
        "seconds": result["seconds"]["total"],
        "warnings": result["warnings"],
        "key": result["key"],
    }


def of_anywhere(task: EstimateTask) -> EstimateTask:
    """The task with paths that do not depend on the current folder."""
    library = None if task.library_folder is None else task.library_folder.absolute()
    return replace(task, job=task.job.absolute(), out=task.out.absolute(), library_folder=library)


def entry_of(job, out, ended: Outcome) -> dict:
    """What the summary says of one job."""
    status = "crashed" if ended.died else {0: "done", 2: "failed", TOO_LONG: "failed"}.get(ended.exit_code, "crashed")
    entry = {"job": str(job), "out": str(out), "status": status, "message": ended.message}
    return entry | ended.result if status == "done" else entry


def run_batch(jobs, folders, ends: Iterable[tuple[int, Outcome]], *, summary: Path, reporter, **facts) -> dict:
    """Takes the ends of all jobs as they come into the summary.

    Parameters
    ----------
    ends : (number of the job, its end), closed here
    facts : what else the summary says

    Returns
    -------
    dict: how many are "done", "failed", "crashed", and "kept" of the first; "summary": its path, None: not written
    """
    journal, kept, over, written = Journal(summary, reporter), 0, 0, None
    reporter.progress("batch", 0.0, f"{len(jobs)} jobs")
    try:
        with closing(ends):
            for number, ended in ends:
                entry = entry_of(jobs[number], folders[number], ended)
                kept, over = kept + bool(entry.get("kept")), over + 1
                journal.add(number, entry)
                if ended.exit_code:
                    reporter.warn(f"{jobs[number]}: {ended.message}")
                reporter.progress("batch", over / len(jobs), f"{over} of {len(jobs)} {jobs[number].name}")
    finally:  # of one that is stopped, what it came to
        written = journal.close(**facts)
    return {**journal.count, "kept": kept, "summary": None if written is None else str(written)}


@contextmanager
def stoppable():
    """SIGTERM is as Ctrl-C: children end first, and the summary says what was done."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def stop(*_):
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, stop)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def summary_place(named: Path | None, out: Path | None, usual: str) -> Path:
    """Where the summary goes. InputError: beside it a .csv and a .jsonl have to have room."""
    place = named or (out or Path(".")) / usual
    if place.suffix.lower() in (".csv", ".jsonl"):
        raise InputError("--summary", f"'{place}'", f"name a file such as {place.with_suffix('.json').name}")
    return place


def number_or_auto(context, parameter, value: str) -> str | int:
    """The value of ``--lanes``."""
    if value == "auto":
        return value
    if value.isascii() and value.isdigit() and int(value) <= 256:
        return int(value)
    raise click.BadParameter(f"'{value}'; give 0 to 256, or auto")


@click.command()
@click.argument("places", nargs=-1, metavar="[JOB]...", type=PATH)
@click.option("--list", "list_file", type=click.Path(), help="Text file, a job folder a line; - for input.")
@out_option("JOB/result")
@click.option("--summary", type=PATH, help="The summary.  [default: OUT/batch.json]")
@click.option(
    "--lanes",
    metavar="N|auto",
    callback=number_or_auto,
    default="1",
    show_default=True,
    help="Jobs at once; auto: as many as there are cores and memory for; 0: one, in this process.",
)
@click.option("--shard", metavar="K/N", help="Only every N-th job, from the K-th: a task of a farm's array.")
@click.option("--join", "joined", is_flag=True, help="Makes one summary of those that are named instead of jobs.")
@click.option("--allow-failures", is_flag=True, help="Exit status 0 also where jobs failed: a farm's task is done.")
@click.option("--again", is_flag=True, help="Estimate also what is done already.")
@click.option("--time-limit", type=click.FloatRange(min=0, min_open=True), help="Seconds for one job.")
@click.option(
    "--retries",
    type=click.IntRange(0, 100),
    default=1,
    show_default=True,
    help="How often a job is tried anew that took too long or whose process died.",
)
@click.option("--scheduler", metavar="ADDRESS", help="A Dask scheduler, tcp://…, whose workers do the jobs.")
@MATERIAL
@REPORT
@LIBRARY
@command
@takes_settings(*ESTIMATE)
def batch(
    *,
    places,
    list_file,
    out,
    summary,
    lanes,
    shard,
    joined,
    allow_failures,
    again,
    time_limit,
    retries,
    scheduler,
    reporter,
    **estimate_options,
):
    """Estimates the light of many jobs: job folders, or folders that hold job folders.

    JOB/result (or OUT/NAME) gets each job's results; batch.json and batch.csv sum them up. One that fails does not
    stop the others: exit status 3 says that some did. What is done already, for the same job and options, is kept.
    """
    if joined:
        if list_file or shard or not places:
            raise InputError("--join", "it takes summaries, and no jobs", "name the batch.json files of the shards")
        result = join(places, summary_place(summary, out, "batch.json"), reporter)
        return concluded(result, sum(result[s] for s in STATUSES), allow_failures)
    every = find_jobs(places, list_file)
    mine = shard_of(list(zip(every, result_folders(every, out), strict=True)), shard)
    usual = "batch.json" if shard is None else f"batch-{shard.replace('/', '-of-')}.json"
    summary = summary_place(summary, out, usual)
    if not mine:  # a farm may give more tasks than there are jobs
        words = f"shard {shard}: of {len(every)} jobs this one gets none; nothing was done"
        return {"done": 0, "failed": 0, "crashed": 0, "kept": 0, "summary": None}, words
    jobs, folders = zip(*mine, strict=True)
    del every, mine
    opened_library(estimate_options["library_folder"])  # what is wrong with it is said once
    tasks = (EstimateTask(*pair, again=again, **estimate_options) for pair in zip(jobs, folders, strict=True))
    limits = {"time_limit": time_limit, "retries": retries}
    if lanes == 0 and (scheduler or time_limit):
        raise InputError("--lanes 0", "it goes without --scheduler and --time-limit", "leave out one of them")
    if lanes == 0:
        ends = run_here(estimate_job, tasks, reporter)
    elif scheduler is None:
        ends = run_all(estimate_job, tasks, lanes_for(lanes, len(jobs)), **limits)
    else:
        ends = run_scheduled(scheduler, estimate_job, map(of_anywhere, tasks), **limits)
    with stoppable():
        facts = {} if shard is None else {"shard": shard}
        result = run_batch(jobs, folders, ends, summary=summary, reporter=reporter, **facts)
    return concluded(result, len(jobs), allow_failures)


def concluded(result: dict, total: int, allow_failures: bool) -> tuple[dict, str]:
    """The result and its words. Raises SomeFailed."""
    bad = total - result["done"]
    place = "the warnings above" if result["summary"] is None else result["summary"]
    if bad and not allow_failures:
        do = f"see their messages in {place}; run it again for these"
        raise SomeFailed("batch", f"{bad} of {total} jobs failed", do, result=result)
    kept = f" ({result['kept']} of them before)" if "kept" in result else ""
    failed = f", {bad} failed" if bad else ""
    return result, f"{result['done']} jobs done{kept}{failed}; see {place}"
