# SPDX-License-Identifier: GPL-3.0-or-later
"""What the tests let a worker's process do: a process finds it by its module's name."""

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

from btfsep_engine.cli.worker import Worker

done = []


def count(task, reporter) -> dict:
    """How many this process has done; says its task, and warns of it."""
    done.append(task)
    with reporter.stage("counting"):
        reporter.warn(f"task {task}")
    return {"done": len(done), "pid": os.getpid(), "threads": os.environ.get("OMP_NUM_THREADS")}


def noisy(task, reporter) -> dict:
    """Prints as Python does and as native code does."""
    print("not for the program that reads standard output")
    os.write(1, b"native words\n")
    subprocess.run([sys.executable, "-c", "print('of a grandchild')"], check=True)
    return {"said": task}


def wrong(task, reporter):
    raise ValueError(f"{task} is odd")


def short_of_memory(task, reporter):
    raise MemoryError


def interrupted(task, reporter):
    raise KeyboardInterrupt


def not_to_be_sent(task, reporter) -> dict:
    return {"lock": threading.Lock()}


def die(task, reporter):
    """As a native library that aborts, as the system that needs memory, as a plain exit."""
    how = {"abort": os.abort, "kill": lambda: os.kill(os.getpid(), signal.SIGKILL), "exit": lambda: os._exit(9)}
    how[task]()


def die_once(task, reporter) -> dict:
    """Dies where the file ``task`` is not there yet, and makes it."""
    if not Path(task).exists():
        Path(task).touch()
        os.abort()
    return {"survived": True}


def endless(task, reporter):
    """Reports for ever; the file ``task`` is there when it has begun, and says when it has stopped."""
    try:
        while True:
            reporter.progress("waiting", 0.5)
            Path(task).touch()
            time.sleep(0.01)
    except KeyboardInterrupt:
        Path(task).write_text("stopped")
        raise


def deaf(task, reporter):
    """Never reports, and never lets another thread of its process run: a native call that keeps the interpreter."""
    reporter.progress("deaf", 0.0)
    Path(task).write_text(str(os.getpid()))
    return {"digits": len(str(pow(7, 3**17)))} if sys.set_int_max_str_digits(0) is None else {}


def large(task, reporter) -> dict:
    """Holds so many megabytes from now on."""
    done.append(bytearray(int(task) << 20))
    return {"pid": os.getpid()}


def parent(folder: str, work: str) -> None:
    """A parent of its own: a worker with a task that does not end."""
    worker = Worker()
    worker.run(globals()[work], str(Path(folder) / "begun"))


def busy(task, reporter) -> dict:
    """Computes for ever and says nothing; the file ``task`` is there when it has begun, and says when it stopped."""
    try:
        Path(task).touch()
        while True:
            sum(range(100))
    except KeyboardInterrupt:
        Path(task).write_text("stopped")
        raise


def stubborn(task, reporter) -> dict:
    """As :func:`busy`, but what it is first told goes unheard, as in a callback."""
    try:
        Path(task).touch()
        while True:
            sum(range(100))
    except KeyboardInterrupt:
        return busy(task, reporter)
