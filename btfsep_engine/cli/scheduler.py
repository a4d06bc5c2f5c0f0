# SPDX-License-Identifier: GPL-3.0-or-later
"""Tasks done by the workers of a Dask scheduler: as :func:`btfsep_engine.cli.lanes.run_all`, on other machines.

The queue is Dask's: it gives tasks to whoever is free, and those of a worker that is lost to another. Each thread of a
worker has a supervised process of ours, so that a job that aborts or never ends costs that process and not the worker.
Jobs, results and library have to be seen by all machines under the same paths.
"""

import logging
import os
import threading
from collections.abc import Iterable, Iterator
from contextlib import suppress

from btfsep_engine.cli.command import BUG
from btfsep_engine.cli.lanes import MOST_MB, MOST_TASKS, with_retries
from btfsep_engine.cli.worker import Outcome, Worker
from btfsep_engine.errors import InputError

AHEAD = 4  # tasks that are with the scheduler, for each thread of its workers: enough that none waits
PATIENCE = 30.0  # seconds for the scheduler to answer
own = threading.local()  # of each thread of a worker: its process


def run_scheduled(
    address: str, work, tasks: Iterable, *, time_limit: float | None = None, retries: int = 0
) -> Iterator[tuple[int, Outcome]]:
    """Does tasks on the workers of a scheduler; arguments and what it yields are those of `run_all`.

    Raises InputError: Dask is not installed, there is no scheduler at ``address``, or it is lost.
    """
    try:
        from distributed import Client, as_completed
    except ImportError as error:
        raise InputError("--scheduler", f"Dask is not there ({error})", 'pip install "btfsep[farm]"') from error
    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # what is lost is said here, in one line
    try:
        client = Client(address, timeout=PATIENCE, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        raise InputError(f"--scheduler {address}", error, "give the address that dask scheduler says") from error
    with client:
        todo, numbers, ends = enumerate(tasks), {}, as_completed(loop=client.loop)

        def submit() -> bool:
            number, task = next(todo, (None, None))
            if number is None:
                return False
            # not pure: what it does is to write files, which may be wanted anew
            future = client.submit(done_here, work, task, time_limit, retries, pure=False)
            numbers[future] = number
            ends.add(future)
            return True

        try:
            while True:
                # workers may come and go
                threads = sum(client.nthreads().values())
                while len(numbers) < AHEAD * max(threads, 1) and submit():
                    pass
                if not numbers:
                    return
                future = next(ends)
                if future.status in ("lost", "pending"):  # its worker went before it gave the result away: done anew
                    ends.add(future)
                    continue
                if future.status == "cancelled":
                    raise OSError("the scheduler was lost, or forgot its tasks")
                number = numbers.pop(future)
                yield number, _end_of(future)
        except OSError as error:
            do = "start it, and run this again: what is done stays"
            raise InputError(f"--scheduler {address}", error, do) from error
        finally:
            with suppress(Exception):  # of a scheduler that is gone
                client.cancel(list(numbers), force=True)


def _end_of(future) -> Outcome:
    """What became of a task; of one whose workers were lost again and again, that."""
    if future.status == "finished":
        return future.result()
    error = future.exception()
    died = type(error).__name__ == "KilledWorker"
    return Outcome(BUG, f"{type(error).__name__}: {error}" if not died else "its workers were lost", died=died)


def done_here(work, task, time_limit: float | None, retries: int) -> Outcome:
    """On a worker: the task in this thread's own process, which has one core, as the thread has."""
    if getattr(own, "worker", None) is None:
        # Dask has malloc give memory back all the time, for the worker's own sake; an estimate takes half as long again
        os.environ.pop("MALLOC_TRIM_THRESHOLD_", None)
        own.worker = Worker(threads=1, most_tasks=MOST_TASKS, most_mb=MOST_MB)
    return with_retries(own.worker, work, task, time_limit, retries)
