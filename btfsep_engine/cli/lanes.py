# SPDX-License-Identifier: GPL-3.0-or-later
"""Work done in child processes that stay warm; a child that dies costs the task at hand only.

A lane is a thread with a process pool of one. A native library that aborts, or the system that kills for memory, breaks
that pool: the task has failed, the lane takes a new process and goes on.
"""

import contextlib
import multiprocessing
import os
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field

from btfsep_engine.cli.command import failure_of

DIED = 1  # exit code of a task whose process ended without an answer
STOPPED = 130


@dataclass(frozen=True)
class Outcome:
    """How a task ended: ``exit_code`` as a command's (0 done, 2 the input is at fault, 1 a bug), why, with what."""

    exit_code: int = 0
    message: str = ""
    result: dict = field(default_factory=dict)


def outcome(work: Callable[..., dict], task) -> Outcome:
    """``work(task)``, done here; what it prints goes to standard error: a program may read standard output."""
    try:
        with contextlib.redirect_stdout(sys.stderr):
            return Outcome(result=work(task))
    except KeyboardInterrupt:
        return Outcome(STOPPED, "stopped")
    except Exception as error:
        message, exit_code = failure_of(error)
        return Outcome(exit_code, message)


def _begin(threads: int) -> None:
    """In a lane's process: its share of the cores."""
    from btfsep_engine.render.backend import limit_threads

    limit_threads(threads)


class Lane(threading.local):
    """A thread's own warm process."""

    pool = None

    def run(self, work, task, threads: int) -> Outcome:
        """:func:`outcome`, in this lane's process; ``work`` and ``task`` can be pickled."""
        if self.pool is None:
            # spawn: the renderer's threads do not survive a fork
            self.pool = ProcessPoolExecutor(
                1, mp_context=multiprocessing.get_context("spawn"), initializer=_begin, initargs=(threads,)
            )
        try:
            return self.pool.submit(outcome, work, task).result()
        except BrokenProcessPool:
            self.pool = None
            return Outcome(DIED, "its process died (killed, or out of memory)")


def run_all(work, tasks, lanes: int) -> Iterator[tuple[int, Outcome]]:
    """Does tasks in ``lanes`` processes at once.

    Parameters
    ----------
    work : function of a module, task -> dict
    lanes : number of processes, each with its share of the cores

    Yields
    ------
    (number of the task, its :class:`Outcome`), in the order in which they end
    """
    lane, threads = Lane(), max(1, (os.cpu_count() or 1) // lanes)
    with ThreadPoolExecutor(lanes, thread_name_prefix="lane") as pool:
        numbers = {pool.submit(lane.run, work, task, threads): i for i, task in enumerate(tasks)}
        try:
            for future in as_completed(numbers):
                yield numbers[future], future.result()
        finally:
            pool.shutdown(wait=False, cancel_futures=True)  # after an interrupt nothing more is begun
