# SPDX-License-Identifier: GPL-3.0-or-later
"""What a file imports is what the map of rooms in CONTRIBUTING.md lets its room import, packages and other rooms."""

import ast
import graphlib
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
OURS = ("btfsep_engine", "blender_btfsep", "scripts", "tests")
GROUND = 3  # rows that all of the engine may import


def rows():
    """(places, what they may import) of each row of the map; a folder ends with a slash."""
    table = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8").split("| place | purpose | may import |\n")[1]
    for line in table.split("\n\n")[0].splitlines()[1:]:
        places, _, allowed = line.strip("|").split("|")
        yield named(places), [*named(allowed), *re.split(r",\s*", re.sub("`.*?`", "", allowed).strip(" ,"))]


def named(cell: str) -> list:
    """The places that a cell names, as paths from the root; bare ones are the engine's."""
    return [w if w.startswith(OURS) else f"btfsep_engine/{w}" for w in re.findall("`([^`]+)`", cell)]


def imported(path: str):
    """(line, package or file of ours) of every import of a file, those inside functions too."""
    for node in ast.walk(ast.parse((ROOT / path).read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            modules = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            above = path.split("/")[: -node.level] if node.level else []
            modules = [".".join([*above, *filter(None, [node.module]), alias.name]) for alias in node.names]
        else:
            continue
        for module in modules:
            top = module.split(".")[0]
            if top in OURS:
                yield node.lineno, file_of(module)
            elif top not in sys.stdlib_module_names and top != "__future__":
                yield node.lineno, top


def file_of(module: str) -> str:
    """The file of a module, or of the module that holds a name."""
    path = module.replace(".", "/")
    holder = path.rpartition("/")[0] or path
    return next(c for p in (path, holder) for c in (f"{p}.py", f"{p}/__init__.py") if (ROOT / c).exists())


def faults(path: str, imports, table) -> list:
    """Sentences: what a file imports and may not."""
    inside = {place: allowed for places, allowed in table for place in places if path.startswith(place)}
    room = max(inside, key=len)  # the narrowest place that holds the file
    allowed = inside[room]
    free = tuple(place for place in (room, *allowed) if "/" in place)
    if path.startswith("btfsep_engine/"):
        free += tuple(place for places, _ in table[:GROUND] for place in places)
    banned = [a.removeprefix("all but ") for a in allowed if a.startswith("all but ")]
    if banned or "all" in allowed:
        imports = [(line, target) for line, target in imports if target in banned]
    return [
        f"{path}:{line} imports {target}, which CONTRIBUTING.md does not let {room}"
        for line, target in imports
        if not (target.startswith(free) if target.endswith(".py") else target in allowed)
    ]


def files_of(*folders) -> list[str]:
    """The Python files of folders that git knows."""
    files = subprocess.run(["git", "ls-files", *folders], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    return [f for f in files.splitlines() if f.endswith(".py") and (ROOT / f).exists()]


def test_imports_are_those_of_the_map():
    table, files = list(rows()), files_of(*OURS)
    assert len(files) > 300
    wrong = [fault for path in files for fault in faults(path, imported(path), table)]
    assert not wrong, "\n".join(wrong)


def test_the_way_of_an_estimate_names_every_file():
    way = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8").split("The way of an estimate")[1]
    missing = [f for f in files_of("btfsep_engine/pipeline") if f"`{f.rpartition('/')[2]}`" not in way]
    assert [f for f in missing if not f.endswith("__init__.py")] == []


def test_no_file_imports_itself_by_way_of_others():
    """Those inside functions count, too; a package's own file stands for nothing that it gathers."""
    graph = {}
    for path in files_of("btfsep_engine", "blender_btfsep"):
        graph[path] = {target for _, target in imported(path) if target != path and not target.endswith("__init__.py")}
    try:
        graphlib.TopologicalSorter(graph).prepare()
    except graphlib.CycleError as error:
        raise AssertionError(" is imported by ".join(error.args[1])) from error


def test_the_map_says_no():
    """Each line would untie what the rooms are for."""
    table = list(rows())
    for path, target in (
        ("btfsep_engine/fit/stated.py", "btfsep_engine/render/transport.py"),
        ("btfsep_engine/render/transport.py", "btfsep_engine/pipeline/settings.py"),
        ("btfsep_engine/btf/model.py", "btfsep_engine/light/maps.py"),
        ("btfsep_engine/btf/library.py", "btfsep_engine/render/transport.py"),
        ("btfsep_engine/light/maps.py", "btfsep_engine/fit/stated.py"),
        ("btfsep_engine/recognise/vlad.py", "btfsep_engine/btf/library.py"),
        ("btfsep_engine/pipeline/model.py", "btfsep_engine/cli/words.py"),
        ("btfsep_engine/pipeline/model.py", "btfsep_engine/commands/record.py"),
        ("btfsep_engine/storage/cache.py", "btfsep_engine/imaging/images.py"),
        ("btfsep_engine/sh.py", "btfsep_engine/light/maps.py"),
        ("btfsep_engine/pipeline/model.py", "mitsuba"),
        ("btfsep_engine/pipeline/model.py", "bpy"),
        ("blender_btfsep/light/world.py", "btfsep_engine/sh.py"),
        ("blender_btfsep/light/world.py", "scipy"),
        ("blender_btfsep/light/world.py", "blender_btfsep/run/request.py"),
        ("blender_btfsep/scene/export.py", "blender_btfsep/engine/engine_process.py"),
        ("blender_btfsep/run/runs.py", "blender_btfsep/window/operators.py"),
        ("blender_btfsep/window/live.py", "blender_btfsep/panels/sidebar.py"),
        ("scripts/cycles/studio.py", "btfsep_engine/render/patch.py"),
        ("scripts/studies/fit.py", "bpy"),
        ("tests/blender/test_world.py", "mitsuba"),
    ):
        assert faults(path, [(1, target)], table), f"{path} may import {target}"
        assert not faults(path, [(1, path)], table)
