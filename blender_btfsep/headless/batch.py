# SPDX-License-Identifier: GPL-3.0-or-later
"""``--command btfsep batch``: the light of many .blend files, of many photos, or of many photos of each file.

One that fails stops nothing; what is there already is not done again. The engine stays from one to the next, and keeps
what the next may need.
"""

import json
from functools import partial
from pathlib import Path

import bpy

from ..basics import atomic
from ..basics.errors import InputError
from ..engine import engine_settings
from ..engine.engine_process import BUG, INPUT_FAULT
from ..photo import frames
from . import terminal

SUMMARY = "batch.json"


def add_command(commands, parents, *, estimate, save) -> None:
    """Adds ``batch`` to the commands that Blender runs without a window; it does each by ``estimate`` and ``save``."""
    parser = commands.add_parser("batch", parents=parents, help="the light of many .blend files or photos")
    parser.add_argument("files", nargs="*", metavar="FILE.blend", help="the files (default: the one that is open)")
    parser.add_argument(
        "--photos", metavar="PATTERN", help="each of these photos, as 'photos/*.exr' (default: the panel's)"
    )
    parser.add_argument("--save-lit", action="store_true", help="save each file with its World beside its results")
    parser.add_argument("--world", choices=("nodes", "texture"), help="default: the panel's")
    parser.add_argument("--again", action="store_true", help="also what has its results already")
    engine_settings.add_options(parser, engine_settings.COMMANDS["estimate"], "the panel's")
    parser.set_defaults(run=partial(_run, estimate=estimate, save=save))


def _run(options, *, estimate, save) -> dict:
    if not options.out:
        raise InputError("--out", "it is missing", "name the folder for the results")
    if options.job or options.image:
        given = "--job" if options.job else "--image"
        raise InputError(given, "a batch has more than one", "leave it out; photos are given by --photos")
    files = [Path(file).absolute() for file in options.files] or [None]
    taken = [path.stem for path in files if path is not None]
    twice = next((name for name in taken if taken.count(name) > 1), None)
    if twice is not None:
        raise InputError(f"'{twice}.blend'", "two files have this name", "give them in two batches, with an --out each")
    photos = frames.matching(str(Path(options.photos).absolute()), "--photos") if options.photos else [None]
    out, entries = Path(options.out).absolute(), []
    todo = [(file, photo, _name(file, photo)) for file in files for photo in photos]
    names = [name for *_, name in todo]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise InputError(f"--out, folder '{twice}'", "two results would go there", "give the photos in two batches")
    for file, photo, name in todo:
        entry = {"file": str(file or bpy.data.filepath), "photo": str(photo or ""), "out": str(out / name)}
        entries.append(entry | _one(options, file, photo, out / name, estimate, save))
        _write(out, entries)
    failed = [entry for entry in entries if entry["error"]]
    terminal.say(f"{len(entries) - len(failed)} of {len(entries)} have their light; {out / SUMMARY} says which")
    return {"entries": entries, "exit_code": INPUT_FAULT if failed else 0}


def _name(file, photo) -> str:
    """What the folder of a result is called."""
    return "-".join(part.stem for part in (file, photo) if part is not None) or "light"


def _one(options, file, photo, folder: Path, estimate, save) -> dict:
    wanted = ["result.json", *["lit.blend"] * options.save_lit]  # this one is saved last
    if not options.again and all((folder / name).is_file() for name in wanted):
        terminal.say(f"{folder.name}: there already")
        return {"error": "", "done": "earlier"}
    try:
        _open(file)
        estimate(options, terminal.scene_of(options), image=photo, out=folder, stays=True)
        if options.save_lit:
            save(str(folder / "lit.blend"))
    except InputError as error:
        terminal.say(f"{folder.name}: error: {error}")
        return {"error": str(error), "exit_code": INPUT_FAULT}
    except terminal.EngineBug as error:
        terminal.say(f"{folder.name}: error: {error}\n{error.details}")
        return {"error": str(error), "exit_code": BUG}
    return {"error": "", "done": "now"}


def _open(file) -> None:
    """Opens a file anew, so that no photo has what another has left; None: the one that is open, or was never saved."""
    path = file or (Path(bpy.data.filepath) if bpy.data.filepath else None)
    if path is None:
        return
    try:
        bpy.ops.wm.open_mainfile(filepath=str(path), load_ui=False)
    except RuntimeError as error:
        raise InputError(str(path), error, "check the file") from None


def _write(out: Path, entries) -> None:
    atomic.write_bytes(out / SUMMARY, json.dumps({"entries": entries}, indent=1).encode())
