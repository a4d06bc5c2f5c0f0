# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether the engine works on this machine: what it found of itself, shown in the preferences.

It is asked once by itself, some seconds after the add-on was switched on for the first time: on most Windows and macOS
machines something has to be installed first, which is better known before there is a photo.
"""

import json
from pathlib import Path

import bpy

from . import atomic, durations, engine_process, runs
from .errors import InputError

FILE = "checkup.json"
SOON, LOOK = 3.0, 0.5  # seconds after switching on; between looks
SHOWN = {
    "variant": "Renderer",
    "libLLVM": "libLLVM",
    "CUDA driver": "CUDA driver",
    "test render": "Test render",
    "processors": "Processors",
    "library": "Library",
    "cache": "Cache",
}  # fact -> words for people

_found = None
"""{"ok", "facts", "message", "bytes"} of the last time; {} where it was never asked."""
_process = None


def _file() -> Path:
    return durations._file().with_name(FILE)


def found() -> dict:
    """What is known."""
    global _found
    if _found is None:
        try:
            _found = json.loads(_file().read_text(encoding="utf-8"))
        except (OSError, ValueError):
            _found = {}
        if not isinstance(_found, dict) or not isinstance(_found.get("facts", {}), dict):
            _found = {}
    return _found


def take(result: dict) -> None:
    """The engine works; ``result`` is its ``doctor``'s."""
    _keep({"ok": True, "facts": {str(k): str(v) for k, v in (result.get("facts") or {}).items()}, "message": ""})


def take_failure(message: str) -> None:
    """It does not: ``what; what was got; what to do``."""
    _keep({"ok": False, "facts": found().get("facts") or {}, "message": message})


def measure() -> None:
    """How much the cache holds now."""
    if found():
        _keep({key: value for key, value in found().items() if key != "bytes"})


def _keep(state: dict) -> None:
    global _found
    folder = state["facts"].get("cache")
    held = sum(p.stat().st_size for p in Path(folder).rglob("*") if p.is_file()) if folder else 0
    _found = state | {"bytes": held}
    try:
        atomic.write_bytes(_file(), json.dumps(_found).encode())
    except InputError:
        pass  # it is asked again the next time
    runs.redraw(at_once=True)


def draw(layout) -> None:
    """The findings, the button that asks anew, and the cache."""
    state = found()
    box = layout.box()
    row = box.row()
    if not state:
        row.label(text="The engine was not tested yet", icon="QUESTION")
    elif state["ok"]:
        row.label(text="The engine works", icon="CHECKMARK")
    else:
        row.label(text="The engine cannot work", icon="ERROR")
    row.operator("btfsep.doctor")
    for part in filter(None, state.get("message", "").split("; ")):
        line = box.row()
        line.alert = True
        line.label(text=part)
    column = box.column(align=True)
    column.use_property_split = False
    for name, label in SHOWN.items():
        value = (state.get("facts") or {}).get(name)
        if value:
            line = column.split(factor=0.25)
            line.label(text=label)
            line.label(text=value)
    row = box.row()
    row.label(text=f"Kept of earlier runs: {state.get('bytes', 0) / 1e6:.0f} MB")
    row.operator("btfsep.clear_cache", icon="TRASH")


def _first_time():
    """A timer: asks the engine, and looks whether it has answered."""
    global _process
    if _process is None:
        try:
            _process = runs.start_engine(["doctor"], stays=False)
        except InputError as error:
            take_failure(str(error))
            return None
    for message in _process.poll():
        if isinstance(message, engine_process.Done):
            take(message.result)
        elif isinstance(message, engine_process.Failed):
            take_failure(message.message)
    if _process.over:
        _process = None
        return None
    return LOOK


def register():
    if not bpy.app.background and not found():
        bpy.app.timers.register(_first_time, first_interval=SOON, persistent=True)


def unregister():
    global _process, _found
    if bpy.app.timers.is_registered(_first_time):
        bpy.app.timers.unregister(_first_time)
    if _process is not None:
        _process.kill()
    _process = _found = None
