# SPDX-License-Identifier: GPL-3.0-or-later
"""Commands run one after the other in child processes that stay warm; a child that dies costs one command only.

A lane is a thread with a process pool of one. A native library that aborts, or the system that kills for memory, breaks
that pool: the command at hand has failed, the lane takes a new process and goes on.
"""

import contextlib
import io
import json
import multiprocessing
import os
import threading
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool

from btfsep_engine.cli.commands import main

DIED = 1  # exit status of a command whose process ended without an answer


def outcome(arguments) -> dict:
    """Runs one command of the engine here, with ``--json``, and gives its last line.

    Parameters
    ----------
    arguments : list of str, the command first, without ``--json``

    Returns
    -------
    dict : ``exit_code`` (0 done, 2 the input is at fault, 1 a bug), ``message`` (what was at fault, "" when done),
        ``result`` (the command's own, {} when it failed)
    """
    said, complained = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(complained):
        code = main([arguments[0], "--json", *arguments[1:]])
    lines = [json.loads(line) for line in said.getvalue().splitlines() if line.startswith("{")]
    last = lines[-1] if lines else {}
    if code == 0 and last.get("type") == "done":
        return {"exit_code": 0, "message": "", "result": last["result"]}
    spoken = last.get("message") or complained.getvalue().strip().removeprefix("error: ")
    return {"exit_code": code or DIED, "message": spoken or "the command ended without an answer", "result": {}}


def _begin(threads: int) -> None:
    """In a lane's process: its share of the cores."""
    from btfsep_engine.render.backend import limit_threads

    limit_threads(threads)


class Lane(threading.local):
    """A thread's own warm process."""

    pool = None

    def run(self, arguments, threads: int) -> dict:
        """:func:`outcome`, in this lane's process."""
        if self.pool is None:
            # spawn: the renderer's threads do not survive a fork
            self.pool = ProcessPoolExecutor(
                1, mp_context=multiprocessing.get_context("spawn"), initializer=_begin, initargs=(threads,)
            )
        try:
            return self.pool.submit(outcome, arguments).result()
        except BrokenProcessPool:
            self.pool = None
            return {"exit_code": DIED, "message": "its process died (killed, or out of memory)", "result": {}}


def run_all(commands, lanes: int) -> Iterator[tuple[int, dict]]:
    """Runs commands in ``lanes`` processes at once.

    Parameters
    ----------
    commands : list of lists of str
    lanes : number of processes, each with its share of the cores

    Yields
    ------
    (number of the command, :func:`outcome`), in the order in which they end
    """
    lane, threads = Lane(), max(1, (os.cpu_count() or 1) // lanes)
    with ThreadPoolExecutor(lanes, thread_name_prefix="lane") as pool:
        numbers = {pool.submit(lane.run, command, threads): i for i, command in enumerate(commands)}
        try:
            for future in as_completed(numbers):
                yield numbers[future], future.result()
        finally:
            pool.shutdown(wait=False, cancel_futures=True)  # after an interrupt nothing more is begun
