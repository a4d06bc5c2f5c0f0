# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether the engine works on this machine: what it found of itself, kept from session to session and shown."""

import json
from pathlib import Path

from ..basics import atomic, drawing, labels
from ..basics.errors import InputError
from . import durations

FILE = "checkup.json"
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
"""{"ok", "facts", "message", "bytes"} of the last time; {} where it was never asked; None: not read yet."""


def _file() -> Path:
    return durations._file().with_name(FILE)


def findings() -> dict:
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
    _keep({"ok": False, "facts": findings().get("facts") or {}, "message": message})


def measure() -> None:
    """How much the cache holds now."""
    if findings():
        _keep({key: value for key, value in findings().items() if key != "bytes"})


def _keep(state: dict) -> None:
    global _found
    folder = state["facts"].get("cache")
    held = sum(p.stat().st_size for p in Path(folder).rglob("*") if p.is_file()) if folder else 0
    _found = state | {"bytes": held}
    try:
        atomic.write_bytes(_file(), json.dumps(_found).encode())
    except InputError:
        pass  # it is asked again the next time
    drawing.redraw(at_once=True)


def fact_words(name: str, value: str) -> str:
    """A fact as it is shown: with what the test render ran is in lines of their own."""
    return value.partition(", with ")[0] if name == "test render" else value


def draw(context, layout) -> None:
    """The findings, the button that asks anew, and the cache."""
    state = findings()
    box = layout.box()
    row = box.row()
    if not state:
        row.label(text="The engine was not tested yet", icon="QUESTION")
    elif state["ok"]:
        row.label(text="The engine works", icon="CHECKMARK")
    else:
        row.label(text="The engine cannot work", icon="ERROR")
    row.operator("btfsep.doctor")
    if state.get("message"):
        column = box.column()
        column.alert = True
        labels.parted(context, column, state["message"])
    column = box.column(align=True)
    column.use_property_split = False
    for name, label in SHOWN.items():
        value = (state.get("facts") or {}).get(name)
        if value:
            line = column.split(factor=0.25)
            line.label(text=label)
            line.label(text=fact_words(name, value))
    row = box.row()
    row.label(text=f"Kept of earlier runs: {state.get('bytes', 0) / 1e6:.0f} MB")
    row.operator("btfsep.clear_cache", icon="TRASH")
