# SPDX-License-Identifier: GPL-3.0-or-later
"""One supervised child process that does tasks one after another and stays warm.

A native library that aborts, or a system that kills for memory, costs the task at hand: the next gets a new process.
The child is Python with this module; tasks come by its standard input, messages go by its standard output, pickled. It
is a plain subprocess and not one of `multiprocessing`, which starts none inside a daemonic process, as a scheduler's
workers are, and imports the program's main file anew.

It ends with its parent, however that ends: the parent alone holds the open end of a pipe (the *lifeline*). Where the
system can (POSIX), its closing is a signal that kills at once, inside a native call that keeps the interpreter, too;
elsewhere a thread sees the end of the standard input.
"""

import _thread
import contextlib
import os
import pickle
import queue
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from btfsep_engine.cli.command import failure_of
from btfsep_engine.cli.output import JsonReporter
from btfsep_engine.storage.atomic import plain

DIED = 1  # exit code of a task whose process ended without an answer
TOO_LONG = 124  # as of coreutils' timeout
STOPPED = 130  # as of a command that Ctrl-C has ended
GRACE = 5.0  # seconds that a task has to stop of itself, before its process is killed
AGAIN = 0.01  # seconds between two requests to stop: in some places a task is not to be ended
UNHEARD = 0.2  # seconds after which one that was heard in vain is repeated: Python ignores errors in a callback
UNTOUCHED = "<frozen importlib", "threadpoolctl.py"  # such: a module half imported, threads not given back
FAREWELL = 0.5  # and when the process is no longer wanted


@dataclass(frozen=True)
class Outcome:
    """How a task ended: ``exit_code`` as a command's (0 done, 2 the input is at fault, 1 a bug), why, with what.

    Beside these: `DIED`, `TOO_LONG`, `STOPPED`; ``died`` tells the first from a bug.
    """

    exit_code: int = 0
    message: str = ""
    result: dict = field(default_factory=dict)
    died: bool = False


class ChildReporter(JsonReporter):
    """Says everything to the parent, and raises KeyboardInterrupt at the next word after the parent has cancelled."""

    def __init__(self, say: Callable[[dict], None], **fields):
        super().__init__(**fields)
        self._say, self._cancelled, self._interrupted = say, threading.Event(), -UNHEARD

    def cancel(self) -> None:
        """The task is no longer wanted; of any thread."""
        self._cancelled.set()

    def interrupt(self, _signal, frame) -> None:
        """Handles SIGINT: ends a task that is no longer wanted, but where `UNTOUCHED` code would be left half done.

        Nothing else: Ctrl-C reaches the parent as well, which decides.
        """
        if not self._cancelled.is_set() or time.monotonic() - self._interrupted < UNHEARD:
            return  # what the task does at its end is not interrupted
        while frame is not None and frame.f_code is not _do.__code__:
            if any(name in frame.f_code.co_filename for name in UNTOUCHED):
                return
            frame = frame.f_back
        if frame is not None:
            self._interrupted = time.monotonic()
            raise KeyboardInterrupt

    def check(self) -> None:
        """Raises KeyboardInterrupt where the task is no longer wanted; for loops that have nothing to say."""
        if self._cancelled.is_set():
            raise KeyboardInterrupt

    def _line(self, **fields):
        self.check()
        self._say(plain(fields))

    def warn(self, message):
        self.check()
        super().warn(message)


def outcome(work: Callable[..., dict], task, reporter) -> Outcome:
    """``work(task, reporter)``, done here; what it prints goes to standard error: a program may read the output."""
    try:
        with contextlib.redirect_stdout(sys.stderr):
            return Outcome(result=work(task, reporter))
    except KeyboardInterrupt:
        return Outcome(STOPPED, "stopped")
    except Exception as error:
        message, exit_code = failure_of(error)
        return Outcome(exit_code, message, getattr(error, "result", None) or {})


class Worker:
    """A warm child process, and another one when that has died; one task at a time.

    Parameters
    ----------
    threads : at most so many in the child; 0: as many as it likes
    grace : seconds that a cancelled task has to stop of itself, before its process is killed
    most_tasks, most_mb : after so many tasks, or a task that leaves it with more memory, a new process; 0: never
    """

    def __init__(self, *, threads: int = 0, grace: float = GRACE, most_tasks: int = 0, most_mb: float = 0.0):
        self.threads, self.grace, self.most_tasks, self.most_mb = threads, grace, most_tasks, most_mb
        self._one_at_a_time, self._child, self._running, self._number = threading.Lock(), None, 0, 0
        self._closed = False

    def start(self) -> None:
        """Begins the process, which loads while the caller does something else."""
        with self._one_at_a_time:
            self._ready()

    def run(self, work: Callable[..., dict], task, on_message=None, *, time_limit: float | None = None) -> Outcome:
        """``work(task, reporter)`` in the child.

        Parameters
        ----------
        work : function of a module that the child can import
        task : anything that can be pickled
        on_message : called here, while the task runs, with each of its messages: the dicts of ``--json``
        time_limit : seconds, or None
        """
        payload = pickle.dumps((work, task), pickle.HIGHEST_PROTOCOL)
        with self._one_at_a_time:
            if self._closed:
                return Outcome(STOPPED, "stopped")
            child = self._ready()
            if self._closed:  # while this waited for the task before
                child.end(FAREWELL)
                return Outcome(STOPPED, "stopped")
            self._number += 1
            self._running = number = self._number
            end = None if time_limit is None else time.monotonic() + time_limit
            try:
                child.begin(number, payload)
                while True:
                    left = None if end is None else max(end - time.monotonic(), 0.0)
                    try:
                        kind, of, content = child.answers.get(timeout=left)
                    except queue.Empty:
                        return Outcome(TOO_LONG, f"it took more than {time_limit:g} s")
                    if kind == "died":
                        return Outcome(DIED, f"its process died ({child.last_words()})", died=True)
                    if of != number:  # what an earlier task, which nobody waits for, had still to say
                        continue
                    if kind == "cancel":
                        return Outcome(STOPPED, "stopped")
                    if kind == "ended":
                        return content
                    if on_message is not None:
                        on_message(content)
            finally:
                self._running = 0
                child.leave(number, self.grace)  # which nobody waits for: no more than this

    def cancel(self) -> None:
        """Whoever waits in :meth:`run` has the answer `STOPPED` now; the task stops when it next reports."""
        child, number = self._child, self._running
        if child is not None and number:
            child.answers.put(("cancel", number, None))

    def settled(self, seconds: float) -> bool:
        """Whether no task is running any more, within so many seconds."""
        child = self._child
        return child is None or child.free.wait(seconds)

    def close(self, farewell: float = FAREWELL) -> None:
        """Ends the process, within ``farewell`` seconds, for good: :meth:`run` answers `STOPPED`. Of any thread."""
        self._closed = True
        self.cancel()
        child, self._child = self._child, None
        if child is not None:
            child.end(farewell)

    def _ready(self) -> "_Child":
        """A child that is free."""
        child = self._child
        if child is not None:
            child.free.wait()  # at most the grace of the task before
            used_up = self.most_tasks and child.tasks >= self.most_tasks
            if not child.dead and (used_up or 0 < self.most_mb < child.megabytes):
                child.end(FAREWELL)
                child = None  # whether its listener has seen that already or not
            elif child.dead:
                child = None
        if child is None:
            child = self._child = _Child(self.threads)
        return child

    @property
    def pid(self) -> int | None:
        """Of the process, where there is one."""
        return None if self._child is None else self._child.process.pid


class _Child:
    """A process and the thread that listens to it.

    Attributes
    ----------
    answers : queue of (kind, number of the task, content): "message", "ended", and "died" once at the end
    free : set while no task is running, and when it is dead
    tasks, megabytes : how many it has done, and how much it held after the last
    """

    def __init__(self, threads: int):
        lifeline, self._lifeline = os.pipe()
        program = (
            f"import sys; sys.path[:] = {sys.path!r}; from btfsep_engine.cli import worker; "
            f"worker.work_for_parent({lifeline if os.name == 'posix' else None}, {threads})"
        )
        kept = {"pass_fds": (lifeline,)} if os.name == "posix" else {}
        self.process = subprocess.Popen(
            [sys.executable, "-P", "-c", program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, **kept
        )
        os.close(lifeline)
        self.answers, self.free, self._said = queue.SimpleQueue(), threading.Event(), threading.Lock()
        self.free.set()
        self.busy, self.tasks, self.megabytes, self.dead = 0, 0, 0.0, False
        threading.Thread(target=self._listen, name="worker", daemon=True).start()

    def _listen(self) -> None:
        with contextlib.suppress(EOFError, OSError, pickle.UnpicklingError, ValueError):
            while True:
                kind, number, content = pickle.load(self.process.stdout)
                if kind == "ended":
                    content, self.megabytes = content
                    self.tasks, self.busy = self.tasks + 1, 0
                    self.free.set()
                self.answers.put((kind, number, content))
        self.kill()
        self.process.wait()
        self.dead = True
        with contextlib.suppress(OSError):
            self.process.stdin.close()
        self.process.stdout.close()
        os.close(self._lifeline)
        self.answers.put(("died", 0, None))
        self.free.set()

    def _send(self, *message) -> None:
        """To a dead process nothing is said: `_listen` tells."""
        with self._said, contextlib.suppress(OSError, ValueError):
            pickle.dump(message, self.process.stdin, pickle.HIGHEST_PROTOCOL)
            self.process.stdin.flush()

    def begin(self, number: int, payload: bytes) -> None:
        self.free.clear()
        self.busy = number
        if self.dead:
            self.free.set()
        self._send("run", number, payload)

    def leave(self, number: int, grace: float) -> None:
        """A task that may still be running is asked to stop, and killed after ``grace`` seconds."""
        if self.busy != number or self.dead:
            return
        self._send("cancel", number, None)

        def late():
            if self.busy == number:
                self.kill()

        timer = threading.Timer(grace, late)
        timer.daemon = True
        timer.start()

    def end(self, farewell: float) -> None:
        self._send("end", 0, None)
        try:
            self.process.wait(farewell)
        except subprocess.TimeoutExpired:
            self.kill()
            self.process.wait()
        self.free.wait(farewell)

    def kill(self) -> None:
        with contextlib.suppress(OSError):
            self.process.kill()

    def last_words(self) -> str:
        code = self.process.returncode
        if code >= 0:
            return f"exit status {code}"
        with contextlib.suppress(ValueError):
            name = signal.Signals(-code).name
            return f"{name}: out of memory, or killed" if name == "SIGKILL" else name
        return f"signal {-code}"


def work_for_parent(lifeline: int | None, threads: int) -> None:
    """All of the child's life."""
    signal.signal(signal.SIGINT, lambda *where: [reporter.interrupt(*where) for reporter in list(running.values())])
    running: dict = {}
    _end_with_parent(lifeline)
    told, say = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    with open(os.devnull, "rb") as nothing:
        os.dup2(nothing.fileno(), 0)
    os.dup2(2, 1)  # native libraries print, too
    with contextlib.suppress(OSError):  # Linux: rather this process than its parent, a Blender perhaps
        Path("/proc/self/oom_score_adj").write_text("500")
    lock, tasks = threading.Lock(), queue.SimpleQueue()

    def answer(*message) -> None:
        text = pickle.dumps(message, pickle.HIGHEST_PROTOCOL)
        with lock:
            say.write(text)
            say.flush()

    def insist(number: int) -> None:
        while number in running:
            _thread.interrupt_main()
            time.sleep(AGAIN)

    def listen() -> None:
        try:
            while True:
                kind, number, payload = pickle.load(told)
                if kind == "run":
                    running[number] = ChildReporter(lambda fields, number=number: answer("message", number, fields))
                    tasks.put((number, payload))
                elif kind == "cancel" and (reporter := running.get(number)) is not None:
                    reporter.cancel()
                    threading.Thread(target=insist, args=[number], daemon=True).start()
                elif kind == "end":
                    break
        except (EOFError, OSError):
            os._exit(DIED)  # nobody is left to answer
        tasks.put(None)
        for reporter in list(running.values()):
            reporter.cancel()

    threading.Thread(target=listen, daemon=True).start()
    if threads:
        from btfsep_engine.render.backend import limit_threads

        limit_threads(threads)
    while (task := tasks.get()) is not None:
        number, payload = task
        reporter = running[number]
        ended = outcome(_do, payload, reporter)
        del running[number]
        try:
            answer("ended", number, (ended, resident_mb()))
        except Exception as error:  # what cannot be pickled
            message, exit_code = failure_of(error)
            answer("ended", number, (Outcome(exit_code, message), resident_mb()))
    sys.stderr.flush()
    os._exit(0)  # without waiting for what native libraries do at the end


def _do(payload: bytes, reporter) -> dict:
    work, task = pickle.loads(payload)
    return work(task, reporter)


def _end_with_parent(lifeline: int | None) -> None:
    """The closing of the lifeline kills this process: SIGIO, which nobody handles."""
    if lifeline is None:
        return
    import fcntl

    signal.signal(signal.SIGIO, signal.SIG_DFL)
    fcntl.fcntl(lifeline, fcntl.F_SETOWN, os.getpid())
    fcntl.fcntl(lifeline, fcntl.F_SETFL, fcntl.fcntl(lifeline, fcntl.F_GETFL) | os.O_ASYNC | os.O_NONBLOCK)
    with contextlib.suppress(BlockingIOError):
        if not os.read(lifeline, 1):  # it was closed before anybody looked
            os._exit(DIED)


def resident_mb() -> float:
    """Memory that this process holds now, in megabytes; where the system does not say, the most that it ever held."""
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        return pages * os.sysconf("SC_PAGE_SIZE") / (1 << 20)
    except (OSError, ValueError, AttributeError, IndexError):
        from btfsep_engine.commands.record import peak_memory_mb  # brings NumPy, which who supervises never needs

        return peak_memory_mb() or 0.0
