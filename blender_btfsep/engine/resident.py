# SPDX-License-Identifier: GPL-3.0-or-later
"""One engine that stays while Blender does, and keeps what its next run may need. No bpy in this file.

:func:`start` gives what looks like an `EngineProcess` of its own for every run. The resident engine (``btfsep serve``,
``docs/formats.md``) is started for the first, ends with Blender, and has a successor if it died. An engine that cannot
stay, and a run beside another one, have a process of their own.
"""

import contextlib
import json
import os
import queue
import subprocess
import time

from .engine_process import BUG, LAST, TAIL, Cancelled, Engine, EngineProcess, Failed, parse

LATE = 0.3  # seconds in which a run that is cancelled has to be over: it takes milliseconds

_here = None  # the Resident of this Blender
_cannot_stay = set()  # commands of engines that do not know ``serve``


class Resident(EngineProcess):
    """The process: it takes requests by its standard input, and what it says goes to the run that it is for.

    ``ready`` : whether it has said so
    """

    stdin = subprocess.PIPE

    def __init__(self, engine: Engine):
        self.engine, self.ready, self._runs, self._number = engine, False, {}, 0
        super().__init__(engine, ["serve"])

    def _read(self):
        for line in self._process.stdout:
            text = line.decode("utf-8", "replace")
            try:
                data = json.loads(text)
            except (json.JSONDecodeError, RecursionError):
                continue
            if not isinstance(data, dict):
                continue
            self.ready = self.ready or data.get("type") == "ready"
            lines = self._runs.get(data.get("id"))
            if lines is not None:
                lines.put(text)

    @property
    def ended(self) -> bool:
        """Whether it is gone, and all that it said is known."""
        return self._process.poll() is not None and not self._reader.is_alive()

    @property
    def busy(self) -> bool:
        """Whether it has a run that is not over."""
        return bool(self._runs)

    def ask(self, arguments) -> tuple[int, queue.SimpleQueue]:
        """Begins a run: its number, and where its lines will be."""
        self._number += 1
        lines = self._runs[self._number] = queue.SimpleQueue()
        command, *rest = map(str, arguments)
        self.send(id=self._number, command=command, arguments=rest)
        return self._number, lines

    def leave(self, number: int) -> None:
        """A run is over; what is said of it from now on is for nobody."""
        self._runs.pop(number, None)

    def send(self, **request) -> None:
        """A request; to a process that has ended, none."""
        with contextlib.suppress(OSError, ValueError):
            self._process.stdin.write(json.dumps(request).encode() + b"\n")
            self._process.stdin.flush()

    def kill(self) -> None:
        """As of every process."""
        super().kill()
        with contextlib.suppress(OSError):
            self._process.stdin.close()

    def errors_from(self, place: int) -> str:
        """What it said for people from a place on, the last of it."""
        if self.over:
            return ""
        size = self._errors.seek(0, os.SEEK_END)
        self._errors.seek(max(size - TAIL, min(place, size)))
        return self._errors.read().decode("utf-8", "replace").strip()

    def errors_until_now(self) -> int:
        """The place of :meth:`errors_from`."""
        return self._errors.seek(0, os.SEEK_END)


class ResidentRun(EngineProcess):
    """A run of the resident engine, asked as an `EngineProcess` is.

    Parameters
    ----------
    resident : Resident, without another run
    arguments : list of str, as on the command line, without ``--json``
    """

    def __init__(self, resident: Resident, arguments):
        self.over, self._cancelled_at, self._alone = False, None, None
        self._resident, self._arguments, self._said = resident, list(arguments), resident.errors_until_now()
        self._number, self._lines = resident.ask(arguments)

    @property
    def pid(self) -> int:
        """Of the resident engine, or of the one in its place."""
        return (self._alone or self._resident).pid

    def poll(self) -> list:
        """As of every run."""
        if self.over:
            return []
        if self._alone is not None:
            messages = self._alone.poll()
            self.over = self._alone.over
            return messages
        ended, messages = self._resident.ended, []  # before the lines: those that come in between are seen next time
        while not self._lines.empty():
            message = parse(self._lines.get())
            if isinstance(message, LAST):
                return [*messages, self._end(message)]
            if message is not None:
                messages.append(message)
        if self._cancelled_at is not None and time.monotonic() - self._cancelled_at > LATE:
            self._resident.kill()
            return [*messages, self._end(Cancelled())]
        if ended and not self._resident.ready and self._cancelled_at is None:
            _cannot_stay.add(self._resident.engine.command)
            self._resident.leave(self._number)
            self._alone = EngineProcess(self._resident.engine, self._arguments)
        elif ended:
            (*_, last) = self._resident.poll() or [Failed("the engine has ended; run it again", BUG)]
            messages.append(self._end(last))
        return messages

    def _end(self, last):
        """The last message, when this is it."""
        self.over = True
        self._resident.leave(self._number)
        if self._cancelled_at is not None:
            return Cancelled()
        if isinstance(last, Failed) and last.exit_code == BUG and not last.details:
            return Failed(last.message, BUG, self._resident.errors_from(self._said))
        return last

    def cancel(self) -> None:
        """Asks for the end of the run; the engine stays."""
        if self._alone is not None:
            self._alone.cancel()
        elif not self.over and self._cancelled_at is None:
            self._cancelled_at = time.monotonic()
            self._resident.send(cancel=self._number)

    def kill(self) -> None:
        """Ends the run now, and waits until it is over."""
        if self._alone is not None:
            self._alone.kill()
            self.over = True
            return
        self.cancel()
        if not self.over:
            self.wait()


def start(engine: Engine, arguments) -> EngineProcess:
    """A run of the engine. Raises InputError when it cannot be started."""
    global _here
    if _here is not None and (_here.ended or (_here.engine != engine and not _here.busy)):
        stop()
    if engine.command in _cannot_stay or (_here is not None and _here.busy):
        return EngineProcess(engine, arguments)
    if _here is None:
        _here = Resident(engine)
    return ResidentRun(_here, arguments)


def stop() -> None:
    """Ends the engine that stays, if there is one."""
    global _here
    if _here is not None:
        _here.kill()
        _here = None
