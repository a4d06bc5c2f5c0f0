# SPDX-License-Identifier: GPL-3.0-or-later
"""The material library in the panel: read by a child process of its own while Blender goes on, with thumbnails."""

from pathlib import Path

import bpy

from ..basics.errors import InputError
from ..engine import engine_process, preferences
from ..run import request, runs
from . import icons

INTERVAL = 0.2  # seconds between looks at the child process
SIDE = 96  # pixels of a thumbnail
ALL = ("ALL", "All Classes", "Every material of the library")

_reading = None
_last: tuple = (None, {})
"""The folder that was read last, and the engine's answer: opening a file empties what is on the WindowManager."""
_choices: dict = {}


def arguments() -> list:
    """The engine's command that lists the library."""
    thumbnails = Path(bpy.app.tempdir) / "btfsep" / "thumbnails"
    return ["library", "list", "--thumbnails", thumbnails, "--side", SIDE, *request.library_arguments()]


def take(result: dict) -> int:
    """Puts the engine's list into the panel; gives how many materials there are."""
    global _last
    state = runs.run_state()
    state.library.clear()
    for material in result.get("materials") or []:
        item = state.library.add()
        item.name, item.kind = str(material["name"]), str(material.get("class") or "")
        item.thumbnail = str(material.get("thumbnail") or "")
        item.colour = material.get("albedo") or (0.5, 0.5, 0.5)
    state.library_error, state.library_for = "", preferences.get().library
    _last = (state.library_for, result)
    return len(state.library)


def forget() -> None:
    """The library has changed: it is read anew where it is drawn next."""
    global _last
    _last = (None, {})
    runs.run_state().property_unset("library_for")


def ensure() -> None:
    """Has the library read if it was not; called where it is drawn, so it only asks for it."""
    read = runs.run_state().library_for == preferences.get().library
    if not read and _reading is None and not bpy.app.timers.is_registered(_step):
        bpy.app.timers.register(_step, first_interval=INTERVAL, persistent=True)


def _step() -> float | None:
    """Starts the child, looks at it, takes what it says; seconds to the next look, None at the end."""
    global _reading
    state, folder = runs.run_state(), preferences.get().library
    try:
        if _reading is None and _last[0] == folder and state.library_for != folder:
            take(_last[1])
        elif _reading is None:
            found = engine_process.find_engine(bpy.path.abspath(preferences.get().engine))
            _reading = engine_process.EngineProcess(found, arguments())
            return INTERVAL
        for message in _reading.poll() if _reading is not None else ():
            if isinstance(message, engine_process.Done):
                take(message.result)
            elif isinstance(message, engine_process.Failed):
                raise InputError(message.message, "", "")
    except InputError as error:
        state.library.clear()  # what was read of another folder is not in this one
        state.library_error, state.library_for = str(error).strip("; "), folder
        if _reading is not None:
            _reading.kill()
        _reading = None
    if _reading is not None and not _reading.over:
        return INTERVAL
    _reading = None
    runs.redraw()
    return None


def _kept(choices: list) -> list:
    """The same list whenever it has the same choices: Blender keeps no copy of an enumeration's strings."""
    return _choices.setdefault(tuple(choices), choices)


def classes() -> list:
    """The choices of the class filter."""
    kinds = sorted({item.kind for item in runs.run_state().library if item.kind})
    return _kept([ALL, *((kind, kind.capitalize(), "") for kind in kinds)])


def items(entry) -> list:
    """The materials to choose from for an object: of the class that is chosen, what was recognised first."""
    state = runs.run_state()
    scores = {c.name: c.score for c in entry.candidates}
    kind = state.library_class or "ALL"
    out = []
    for number, item in enumerate(state.library, 1):
        if kind in ("ALL", item.kind) or item.name == entry.material:
            own = item.name.partition("/")[2].replace("-", " ") or item.name
            words = f"{own} ({100 * scores[item.name]:.0f} %)" if item.name in scores else own
            icon = icons.of_file(item.thumbnail) if item.thumbnail else 0
            out.append((item.name, words, f"{item.name}, {item.kind}", icon, number))
    out.sort(key=lambda item: -scores.get(item[0], 0))
    if not number_of(entry.material):
        out.insert(0, ("NONE", "Choose", "No material of the library is chosen", "MATERIAL", 0))
    return _kept(out)


def number_of(name: str) -> int:
    """Where the material stands in the library, from 1; 0: nowhere."""
    return runs.run_state().library.find(name) + 1


def name_of(number: int) -> str:
    """The material at a place, of :func:`number_of`."""
    library = runs.run_state().library
    return library[number - 1].name if 0 < number <= len(library) else ""


def register():
    global _last
    _last = (None, {})


def unregister():
    global _reading
    if bpy.app.timers.is_registered(_step):
        bpy.app.timers.unregister(_step)
    if _reading is not None:
        _reading.kill()
        _reading = None
