# SPDX-License-Identifier: GPL-3.0-or-later
"""Tasks done in several warm processes at once, as many as the machine has cores and memory for.

A lane is a thread with a `worker.Worker`. Tasks are taken from the front as lanes become free, and outcomes are handed
out as they come, so that a hundred thousand of them need no more memory than ten.
"""

import os
import queue
import threading
from collections.abc import Iterable, Iterator
from pathlib import Path

from btfsep_engine.cli.worker import STOPPED, TOO_LONG, Outcome, Worker, outcome
from btfsep_engine.progress import Reporter

LANE_MB = 1500.0  # what an estimate holds with a recogniser being trained; of usual pictures
MOST_MB = 3000.0  # a lane that holds more after a task begins the next in a new process
MOST_TASKS = 500  # and so does one that has done so many
AHEAD = 4  # outcomes that may wait for whoever takes them, for each lane


def available_mb() -> float | None:
    """Memory that can be had now, in megabytes; None where the system does not say."""
    found = []
    try:
        lines = Path("/proc/meminfo").read_text().splitlines()
        found += [int(line.split()[1]) / 1024 for line in lines if line.startswith("MemAvailable")]
        group = Path("/sys/fs/cgroup")  # of a container
        used, most = ((group / f"memory.{n}").read_text().strip() for n in ("current", "max"))
        found += [(int(most) - int(used)) / (1 << 20)] if most != "max" else []
    except (OSError, ValueError, IndexError):
        pass
    if not found and hasattr(os, "sysconf") and "SC_PHYS_PAGES" in os.sysconf_names:
        found = [os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") / (1 << 20) / 2]
    return min(found) if found else None


def lanes_for(wanted: str | int, tasks: int) -> int:
    """How many lanes for so many tasks; "auto": one for each core for which there is memory."""
    if wanted == "auto":
        room = available_mb()
        wanted = min(os.cpu_count() or 1, 1 if room is None else int(room // LANE_MB))
    return max(1, min(wanted, tasks))


def with_retries(worker: Worker, work, task, time_limit: float | None, retries: int) -> Outcome:
    """`Worker.run`, and again where the process died or it took too long."""
    for _ in range(retries + 1):
        end = worker.run(work, task, time_limit=time_limit)
        if not (end.died or end.exit_code == TOO_LONG):
            break
    return end


def run_here(work, tasks: Iterable, reporter) -> Iterator[tuple[int, Outcome]]:
    """As `run_all`, in this process, which is supervised itself: one that dies ends all."""
    check = getattr(reporter, "check", lambda: None)
    for number, task in enumerate(tasks):
        check()
        ended = outcome(work, task, Within(check))
        if ended.exit_code == STOPPED:
            raise KeyboardInterrupt
        yield number, ended


class Within(Reporter):
    """Says nothing; ``check`` is called at each word, and may raise."""

    def __init__(self, check):
        super().__init__()
        self.check = check

    def progress(self, stage, fraction, message=""):
        self.check()


def run_all(
    work, tasks: Iterable, lanes: int, *, time_limit: float | None = None, retries: int = 0
) -> Iterator[tuple[int, Outcome]]:
    """Does tasks in ``lanes`` processes at once.

    Parameters
    ----------
    work : function of a module, (task, reporter) -> dict
    lanes : number of processes, each with its share of the cores
    time_limit : seconds for each try of a task
    retries : how often a task is tried anew whose process died or that took too long

    Yields
    ------
    (number of the task, its :class:`Outcome`), in the order in which they end
    """
    todo, taking, ended, over = enumerate(tasks), threading.Lock(), queue.Queue(AHEAD * lanes), threading.Event()
    threads = max(1, (os.cpu_count() or 1) // lanes)
    workers = [Worker(threads=threads, most_tasks=MOST_TASKS, most_mb=MOST_MB) for _ in range(lanes)]

    def lane(worker: Worker) -> None:
        try:
            while not over.is_set():
                with taking:
                    number, task = next(todo, (None, None))
                if number is None:
                    break
                ended.put((number, with_retries(worker, work, task, time_limit, retries)))
        except BaseException as error:  # a task that cannot be sent, say: not for this thread alone to know
            ended.put((None, error))
        ended.put((None, None))

    for worker in workers:
        threading.Thread(target=lane, args=(worker,), name="lane", daemon=True).start()
    try:
        working = lanes
        while working:
            number, end = ended.get()
            if number is not None:
                yield number, end
            elif end is None:
                working -= 1
            else:
                raise end
    finally:  # after an interrupt nothing more is begun
        over.set()
        for worker in workers:
            worker.close()
