# SPDX-License-Identifier: GPL-3.0-or-later
"""``btfsep serve``: a resident engine. Requests come by standard input, answers go by standard output, a line each.

The commands run one after another in one supervised process (`cli.worker`), which keeps what it has made (`kept`). This
process itself does nothing but listen: it answers at once whatever the other one is at, and lives on when that dies.
"""

import contextlib
import json
import os
import sys
import threading
import time
from collections import deque

import click

from btfsep_engine import __version__
from btfsep_engine.cli.command import INPUT_FAULT
from btfsep_engine.cli.worker import STOPPED, Worker
from btfsep_engine.errors import InputError
from btfsep_engine.loading import loading
from btfsep_engine.storage import kept
from btfsep_engine.storage.atomic import plain

NOT_HERE = {"serve"}
LONGEST = 1 << 20  # bytes of a request
AGAIN = 0.01  # seconds between two looks whether a cancelled command is over
AT_ONCE = 0.04  # seconds in which most commands stop: it is said when they have
GRACE = 2.0  # seconds; then the process ends, and what it keeps is lost
FORM = 'send one JSON object a line: {"id": 1, "command": "estimate", "arguments": ["JOB"]}'


def run_command(arguments, reporter) -> dict:
    """The result of a command, given as on the command line without ``--json``; what it says goes to ``reporter``.

    Raises what the command does; of a misuse of the command line an InputError.
    """
    from btfsep_engine.cli.commands import cli

    try:
        result = cli.main(args=list(arguments), prog_name="btfsep", standalone_mode=False, obj=reporter)
    except click.ClickException as error:
        raise InputError(error.format_message(), "", "") from None
    except click.Abort:  # what it makes of a KeyboardInterrupt
        raise KeyboardInterrupt from None
    return result if isinstance(result, dict) else {}  # of --help, whose text is on standard error


def load(_task, _reporter) -> dict:
    """Imports what an estimate needs, and chooses the renderer's backend."""
    with loading():
        import btfsep_engine.pipeline.estimation  # noqa: F401
    from btfsep_engine.render.backend import import_mitsuba

    import_mitsuba()
    return {}


class Server:
    """Requests in, answers out; see docs/formats.md.

    Parameters
    ----------
    say : function of a line's fields
    memory_mb : that the process of the commands may hold between two of them, half of it things that are kept
    idle_minutes : without a request, after which that process ends
    """

    def __init__(self, say, *, memory_mb: float, idle_minutes: float):
        self._say, self._memory_mb, self._idle = say, memory_mb, 60 * idle_minutes
        os.environ[kept.ENVIRONMENT] = str(memory_mb / 2)  # the process inherits it
        self._asked, self._changed = deque(), threading.Condition()
        self._running, self._over = None, False
        self._worker = None

    def heard(self, line: bytes) -> bool:
        """Takes a request; false where it is the last."""
        try:
            request = json.loads(line)
            if not isinstance(request, dict):
                raise ValueError("no object")
        except (ValueError, RecursionError) as error:
            self._refuse(None, f"a request; it is no JSON object ({error}); {FORM}")
            return True
        if request.get("quit"):
            return False
        if "cancel" in request:
            self._cancel(request["cancel"])
        else:
            self._ask(request)
        return True

    def _refuse(self, number, message: str) -> None:
        self._say(id=number, type="failed", message=message, exit_code=INPUT_FAULT)

    def _ask(self, request: dict) -> None:
        number, command, arguments = request.get("id"), request.get("command"), request.get("arguments", [])
        if not isinstance(number, int | str) or isinstance(number, bool):
            return self._refuse(None, f"a request; its id is no number and no text; {FORM}")
        known = isinstance(command, str) and isinstance(arguments, list)
        if not known or not all(isinstance(a, str | int | float) for a in arguments):
            return self._refuse(number, f"request {number}; it has no command, or its arguments are no list; {FORM}")
        if command in NOT_HERE:
            return self._refuse(number, f"btfsep {command}; it is running already; ask it for something else")
        with self._changed:
            if number == self._running or any(number == other for other, _ in self._asked):
                return self._refuse(None, f"request {number}; one of this id is not over yet; give each its own")
            self._asked.append((number, [command, *map(str, arguments)]))
            self._changed.notify()
        return None

    def _cancel(self, number) -> None:
        """Of what is over, or was never asked for, nothing is said."""
        with self._changed:
            waiting = [each for each in self._asked if each[0] == number]
            for each in waiting:
                self._asked.remove(each)
            if number == self._running:
                threading.Thread(target=self._insist, args=[number], daemon=True).start()
        for _ in waiting:
            self._say(id=number, type="cancelled")

    def _insist(self, number) -> None:
        """Cancels what runs until it does not: it may have been asked for, and not have begun."""
        while True:
            with self._changed:
                if number != self._running or self._worker is None:
                    return
                self._worker.cancel()
            time.sleep(AGAIN)

    def work(self) -> None:
        """Answers requests until :meth:`close`."""
        self._ready().run(load, None)
        while True:
            # a request waits where it can be taken back until one that was cancelled has stopped
            while not (self._over or self._worker is None or self._worker.settled(AGAIN)):
                pass
            with self._changed:
                if not self._changed.wait_for(lambda: self._asked or self._over, timeout=self._idle):
                    self._retire()
                    self._changed.wait_for(lambda: self._asked or self._over)
                if self._over:
                    return
                self._running, arguments = self._asked.popleft()
                worker = self._ready()
            self._answer(worker, self._running, arguments)

    def _answer(self, worker: Worker, number, arguments: list) -> None:
        ended = worker.run(run_command, arguments, lambda fields: self._say(id=number, **fields))
        if ended.exit_code == STOPPED:
            worker.settled(AT_ONCE)
        with self._changed:
            self._running = None  # from its last line on, its id is free
        if ended.exit_code == STOPPED:
            self._say(id=number, type="cancelled")
        elif ended.exit_code:
            found = {"result": ended.result} if ended.result else {}
            self._say(id=number, type="failed", message=ended.message, exit_code=ended.exit_code, **found)
        else:
            self._say(id=number, type="done", result=ended.result)

    def _ready(self) -> Worker:
        if self._worker is None:
            self._worker = Worker(grace=GRACE, most_mb=self._memory_mb)
        return self._worker

    def _retire(self) -> None:
        if self._worker is not None:
            self._worker.close()
            self._worker = None

    def close(self) -> None:
        """Ends what runs, and the process."""
        with self._changed:
            self._over = True
            self._changed.notify()
        self._retire()


@click.command()
@click.option(
    "--memory", type=click.FloatRange(256), default=2048, show_default=True, help="Megabytes between requests."
)
@click.option(
    "--idle", type=click.FloatRange(0.01), default=30, show_default=True, help="Minutes until it lets go of all."
)
@click.option("--json", "_as_json", is_flag=True, hidden=True)  # it says nothing else
def serve(memory, idle, _as_json):
    """Stays and runs commands that come by standard input, a JSON object a line; keeps what the next may need.

    {"id": 1, "command": "estimate", "arguments": ["JOB"]} runs a command, {"cancel": 1} stops it, {"quit": true} or the
    end of the input ends the engine. Answers are the lines of --json with the id. No port is opened.
    """
    lock, out = threading.Lock(), os.fdopen(os.dup(1), "w", encoding="utf-8", newline="\n")
    os.dup2(2, 1)  # what is printed by anybody else is no answer

    def say(**fields):
        text = json.dumps(plain(fields), allow_nan=False) + "\n"
        with lock, contextlib.suppress(OSError, ValueError):  # nobody listens: the input ends, too
            out.write(text)
            out.flush()

    server = Server(say, memory_mb=memory, idle_minutes=idle)
    say(type="ready", version=__version__)
    working = threading.Thread(target=server.work, daemon=True)
    working.start()
    try:
        while line := sys.stdin.buffer.readline(LONGEST):
            if line.strip() and not server.heard(line):
                break
    finally:
        server.close()
        working.join(2)
