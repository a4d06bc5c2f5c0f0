# SPDX-License-Identifier: GPL-3.0-or-later
"""The engine as a child process: finding it, starting it, its messages, stopping it. No bpy in this file.

The engine prints one JSON object a line (``docs/formats.md``); here each becomes a small frozen dataclass.
"""

import contextlib
import importlib.util
import json
import os
import queue
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path

from ..basics.errors import InputError

INPUT_FAULT, BUG = 2, 1
GRACE = 0.2  # seconds between asking the engine to stop and making it stop; it writes files whole or not at all
INTERVAL = 0.05  # seconds between looks at it
TAIL = 8000  # bytes of what it said last
WINDOWS = os.name == "nt"


@dataclass(frozen=True)
class Progress:
    """A stage stands at ``fraction``, and the run at ``whole`` (0 to 1). ``title``: the stage in words for people."""

    stage: str
    fraction: float
    message: str = ""
    whole: float = 0.0
    title: str = ""


@dataclass(frozen=True)
class Notice:
    """A warning in words; the run goes on."""

    message: str


@dataclass(frozen=True)
class Light:
    """The light is in the file ``lighting``, for good; what is known of it besides comes later."""

    lighting: str


@dataclass(frozen=True)
class Failed:
    """The run is over. ``exit_code`` 2: the input is at fault; 1: a bug, ``details`` has what was said last."""

    message: str
    exit_code: int
    details: str = ""


@dataclass(frozen=True)
class Cancelled:
    """The run is over because it was told to stop."""


@dataclass(frozen=True)
class Done:
    """The run is over and went well."""

    result: dict


LAST = Done | Failed | Cancelled


@dataclass(frozen=True)
class Engine:
    """How to start the engine: ``command`` and what to add to the environment."""

    command: tuple
    environment: dict = field(default_factory=dict)


def find_engine(preference: str = "") -> Engine:
    """The engine to use.

    In this order: what the preferences say (a Python, a virtual environment or the ``btfsep`` program); the
    ``.venv`` of the source checkout that this add-on lies in; the wheels that came with the extension, run with
    Blender's own Python; ``btfsep`` on the PATH.

    Raises InputError when there is none.
    """
    if preference:
        return _chosen(Path(preference).expanduser())
    root = Path(__file__).resolve().parents[2]
    if (root / "btfsep_engine" / "__main__.py").is_file():
        python = _python_of(root / ".venv")
        if python is not None:
            return Engine((str(python), "-m", "btfsep_engine"), {"PYTHONPATH": str(root)})
    bundled = _bundled()
    if bundled is not None:
        return bundled
    program = shutil.which("btfsep")
    if program:
        return Engine((program,))
    raise InputError(
        "the engine of BTFsep",
        "it was not found",
        "install the extension that contains it (its name ends in a platform and a Python), or give the .venv of the "
        "source tree under Preferences > Add-ons > BTFsep",
    )


def _python_of(folder: Path) -> Path | None:
    for name in ("bin/python", "bin/python3", "Scripts/python.exe"):
        if (folder / name).is_file():
            return folder / name
    return None


def _chosen(path: Path) -> Engine:
    if path.is_dir():
        python = _python_of(path) or _python_of(path / ".venv")
        if python is None:
            raise InputError(f"the engine's folder {path}", "it holds no Python", "choose a virtual environment")
        path = python
    if not path.is_file():
        raise InputError(f"the engine {path}", "there is no such file", "correct it in the preferences of BTFsep")
    if not os.access(path, os.X_OK):
        raise InputError(f"the engine {path}", "it is not a program", "correct it in the preferences of BTFsep")
    if path.name.lower().startswith("python"):
        return Engine((str(path), "-m", "btfsep_engine"))
    return Engine((str(path),))


def _bundled() -> Engine | None:
    """Blender's Python with the folders of the extension's wheels, which a child does not see by itself."""
    folders = []
    for name in ("btfsep_engine", "mitsuba", "numpy"):
        try:
            found = importlib.util.find_spec(name)
        except (ImportError, ValueError):
            found = None
        if found is None or not found.submodule_search_locations:
            return None
        folder = str(Path(next(iter(found.submodule_search_locations))).parent)
        if folder not in folders:
            folders.append(folder)
    python = Path(sys.executable)
    if not python.name.lower().startswith("python"):
        return None
    return Engine((str(python), "-m", "btfsep_engine"), {"PYTHONPATH": os.pathsep.join(folders)})


def parse(line: str):
    """The message in one line of output, or None if it is none (a library that prints, an unknown type)."""
    try:
        data = json.loads(line)
    except (json.JSONDecodeError, RecursionError):
        return None
    if not isinstance(data, dict):
        return None
    kind = data.get("type")
    try:
        if kind == "progress":
            fraction, whole = (min(max(float(data.get(key, 0)), 0.0), 1.0) for key in ("fraction", "whole"))
            stage = str(data.get("stage", ""))
            return Progress(stage, fraction, str(data.get("message", "")), whole, str(data.get("title", stage)))
        if kind == "warning":
            return Notice(str(data["message"]))
        if kind == "light":
            return Light(str(data["lighting"]))
        if kind == "cancelled":
            return Cancelled()
        if kind == "failed":
            return Failed(str(data["message"]), int(data.get("exit_code", BUG)))
        if kind == "done" and isinstance(data.get("result"), dict):
            return Done(data["result"])
    except (KeyError, TypeError, ValueError):
        return None
    return None


class EngineProcess:
    """One run of the engine.

    Call :meth:`poll` now and then: it gives the new messages; the last one is Done, Failed or Cancelled, and then
    ``over`` is true. Nothing here blocks but :meth:`wait` and :meth:`kill`.

    Parameters
    ----------
    engine : Engine
    arguments : list of str, as on the command line, without ``--json``

    Raises InputError when it cannot be started.
    """

    stdin = subprocess.DEVNULL

    def __init__(self, engine: Engine, arguments):
        self.over = False
        self._outcome = None
        self._cancelled_at = None
        self._lines = queue.SimpleQueue()
        self._errors = tempfile.TemporaryFile()
        environment = {k: v for k, v in os.environ.items() if k not in {"PYTHONHOME", "PYTHONPATH", "PYTHONSTARTUP"}}
        # Safe path: modules that lie in the current folder are not the engine's.
        environment |= {"PYTHONUNBUFFERED": "1", "PYTHONUTF8": "1", "PYTHONSAFEPATH": "1"} | engine.environment
        # A group of its own, so that stopping it stops its children too.
        group = {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP} if WINDOWS else {"start_new_session": True}
        command = [*engine.command, *map(str, arguments), "--json"]
        try:
            self._process = subprocess.Popen(
                command, stdin=self.stdin, stdout=subprocess.PIPE, stderr=self._errors, env=environment, **group
            )
        except OSError as error:
            self._errors.close()
            raise InputError(f"the engine {command[0]}", error, "correct it in the preferences of BTFsep") from error
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    @property
    def pid(self) -> int:
        """The process id of the engine, which is also that of its group."""
        return self._process.pid

    def _read(self):
        for line in self._process.stdout:
            self._lines.put(line.decode("utf-8", "replace"))

    def poll(self) -> list:
        """New messages since the last call, oldest first."""
        messages = []
        # Read the state before the lines: lines that come in between are then seen next time, not lost.
        ended = self._process.poll() is not None and not self._reader.is_alive()
        while not self._lines.empty():
            message = parse(self._lines.get())
            if isinstance(message, Done | Failed):
                self._outcome = message
            elif message is not None:
                messages.append(message)
        if self._cancelled_at is not None and not ended and time.monotonic() - self._cancelled_at > GRACE:
            self._signal_group(hard=True)
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(timeout=INTERVAL)  # it is dead at once as a rule: said now, not at the next look
        if ended and not self.over:
            self.over = True
            messages.append(self._last_word())
            self._errors.close()
        return messages

    def _last_word(self):
        if self._cancelled_at is not None:
            return Cancelled()
        code = self._process.returncode
        said = self._stderr_tail()
        if isinstance(self._outcome, Done) and code == 0:
            return self._outcome
        if isinstance(self._outcome, Failed):
            details = said if self._outcome.exit_code != INPUT_FAULT else ""
            return Failed(self._outcome.message, self._outcome.exit_code, details)
        errors = [line[7:] for line in said.splitlines() if line.startswith("error: ")]
        if code == INPUT_FAULT and errors:
            return Failed(errors[-1], INPUT_FAULT)
        if "No module named btfsep_engine" in said:
            return Failed(
                "the engine's Python; the engine is not installed there; "
                "choose the .venv of the source tree in the preferences of BTFsep, or another Python that has it",
                INPUT_FAULT,
            )
        if code == 0:
            return Failed("the engine ended without a result; please report it", BUG, said)
        if code < 0 or code > 255:
            cure = "close what needs much memory, take a quicker preset, or look at Test Engine in the preferences"
            name = signal.Signals(-code).name if not WINDOWS and -code in set(signal.Signals) else str(code)
            return Failed(f"the engine was ended by the system ({name}); {cure}", BUG, said)
        return Failed(f"the engine stopped with exit status {code}; please report it", BUG, said)

    def _stderr_tail(self) -> str:
        size = self._errors.seek(0, os.SEEK_END)
        self._errors.seek(max(size - TAIL, 0))
        return self._errors.read().decode("utf-8", "replace").strip()

    def cancel(self) -> None:
        """Asks the engine to stop; if it does not within GRACE, :meth:`poll` makes it stop."""
        if self.over or self._cancelled_at is not None:
            return
        self._cancelled_at = time.monotonic()
        self._signal_group(hard=False)

    def kill(self) -> None:
        """Ends the engine and its children now, and waits until they are gone."""
        if self.over:
            return
        if self._cancelled_at is None:
            self._cancelled_at = time.monotonic()
        self._signal_group(hard=True)
        self._process.wait()
        self._reader.join(timeout=1)
        self.poll()

    def _signal_group(self, *, hard: bool) -> None:
        try:
            if WINDOWS:
                if hard:
                    subprocess.run(["taskkill", "/F", "/T", "/PID", str(self.pid)], capture_output=True, check=False)
                else:
                    self._process.send_signal(signal.CTRL_BREAK_EVENT)
            else:
                # not SIGINT: a Blender that a shell's "&" has started ignores that, and what it starts does, too
                os.killpg(self.pid, signal.SIGKILL if hard else signal.SIGTERM)
        except (ProcessLookupError, PermissionError):
            pass  # it has just ended

    def wait(self, on_message=None):
        """Blocks until the run is over; gives the last message. ``on_message`` is called with each one before it."""
        while True:
            for message in self.poll():
                if self.over and isinstance(message, LAST):
                    return message
                if on_message is not None:
                    on_message(message)
            time.sleep(INTERVAL)
