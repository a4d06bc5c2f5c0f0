# SPDX-License-Identifier: GPL-3.0-or-later
"""Every command of ``scripts/`` that a page names is there, with the options that stand beside it."""

import ast
import importlib.util
import re
import subprocess
import sys
from importlib.machinery import SourceFileLoader
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
PAGES += [*sorted((ROOT / "btfsep_engine").rglob("README.md")), *sorted((ROOT / "scripts").rglob("*.py"))]
COMMAND = re.compile(r"\bscripts/([A-Za-z0-9_./-]+)((?:[ \t]+(?:\\\n\s*)?[^\s`#\\]+)*)")
OPTION = re.compile(r"(?<=\s)--[a-z][a-z-]*")


@pytest.fixture(scope="module")
def study():
    loader = SourceFileLoader("study", str(ROOT / "scripts" / "study"))
    module = importlib.util.module_from_spec(importlib.util.spec_from_loader("study", loader))
    keep = list(sys.path)
    loader.exec_module(module)  # takes the first place of the path, for the modules that it starts
    sys.path[:] = keep
    return module


def commands():
    """(page, first word after scripts/, the words after it) of every page."""
    for page in PAGES:
        for found in COMMAND.finditer(page.read_text(encoding="utf-8")):
            yield page.relative_to(ROOT), found[1].rstrip("./"), found[2]


def options_of(path: Path) -> set:
    """Options that a module's parser is given: string constants that begin with two dashes."""
    constants = (n.value for n in ast.walk(ast.parse(path.read_text(encoding="utf-8"))) if isinstance(n, ast.Constant))
    return {c for c in constants if isinstance(c, str) and c.startswith("--")}


def test_what_pages_name_exists(study):
    known = {name for names in study.ROOMS.values() for name in names}
    asked = 0
    for page, script, words in commands():
        assert (ROOT / "scripts" / script).exists(), f"{page}: scripts/{script}"
        first = words.split()[0] if words.split() else ""
        if script != "study" or not re.fullmatch(r"[a-z][a-z-]*", first):
            continue
        assert first in known, f"{page}: scripts/study {first}"
        asked += 1
        missing = set(OPTION.findall(words)) - options_of(study.module_of(first)[1]) - {"--help"}
        generic = {o for o in missing if first in ("bench-transport", "build-library")}  # made from tables of defaults
        assert missing == generic, f"{page}: scripts/study {first} {missing - generic}"
    assert asked > 30


def test_every_study_is_listed_and_starts_from_a_main(study):
    listed = {study.module_of(name)[1] for names in study.ROOMS.values() for name in names}
    for path in listed:
        tree = ast.parse(path.read_text(encoding="utf-8"))
        mains = [n for n in tree.body if isinstance(n, ast.FunctionDef) and n.name == "main"]
        assert [a.arg for a in mains[0].args.args] == ["arguments"], path
    room = ROOT / "scripts" / "studies"
    makers = {p for p in (room / "makers").glob("*.py") if p.name != "__init__.py"}
    shared = {"__init__", "clutter", "cues", "estimates", "fisher", "measures", "plate_light", "plate_sets", "stage"}
    shared |= {"plate_things", "tables"}
    own = {p for p in room.glob("*.py") if p.stem not in shared} | {p for p in room.glob("*/__init__.py")}
    assert makers | own - {room / "makers" / "__init__.py"} == listed


def test_help_has_a_line_of_each_study():
    asked = subprocess.run([sys.executable, ROOT / "scripts" / "study"], capture_output=True, text=True, check=False)
    assert asked.returncode == 0
    assert re.search(r"^  real +Photographs of real objects", asked.stdout, re.M)
    wrong = subprocess.run([sys.executable, ROOT / "scripts" / "study", "none"], capture_output=True, check=False)
    assert wrong.returncode == 2


def test_links_between_pages_lead_somewhere():
    """Of README, CONTRIBUTING and docs: files and pictures; links to the web are not asked."""
    broken = [
        f"{page.relative_to(ROOT)}: {target}"
        for page in PAGES
        if page.suffix == ".md"
        for target in re.findall(r"(?:\]\(|src=\")([^)#\"\s]+)[^)\"]*[)\"]", page.read_text(encoding="utf-8"))
        if "://" not in target and not (page.parent / target).exists()
    ]
    assert not broken
