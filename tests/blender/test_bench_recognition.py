# SPDX-License-Identifier: GPL-3.0-or-later
"""The bench of recognition measures what an estimate would do, and what becomes of a material left out."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from btfsep_engine.btf.library import open_library
from scripts.studies import bench_recognition

SCRIPT = Path(__file__).resolve().parents[2] / "scripts" / "study"
THREE = ("leather/brown-grain", "wallpaper/damask-teal", "wood/oak-boards")


@pytest.fixture
def library(tmp_path):
    """A folder with three of the shipped materials."""
    shipped, folder = open_library(), tmp_path / "library"
    folder.mkdir()
    index = json.loads((shipped.folder / "index.json").read_text())
    index["materials"] = [m for m in index["materials"] if m["name"] in THREE]
    for material in index["materials"]:
        shutil.copy(shipped.folder / material["file"], folder)
    (folder / "index.json").write_text(json.dumps(index))
    return folder


def test_a_material_left_out_is_counted_under_the_training_of_an_estimate(library, tmp_path):
    where = ["--object", "sphere", "--resolution", "128", "--library", library, "--folder", tmp_path / "bench"]
    what = ["--photos", "engine", "--preset", "draft", "--no-verify", "--hide", THREE[2]]
    child = subprocess.run(
        list(map(str, [sys.executable, SCRIPT, "bench-recognition", *where, *what])),
        capture_output=True, text=True, env=os.environ | {"BTFSEP_CACHE": str(tmp_path / "cache")},
    )  # fmt: skip
    assert child.returncode == 0, child.stderr
    assert "preset draft, 14 training lights" in child.stdout
    assert len(list((tmp_path / "cache" / "recognisers").glob("*.entry"))) == 1  # an estimate would find it there
    (found,) = json.loads((tmp_path / "bench" / "sphere-128" / "draft-svm-hidden.json").read_text())
    answers = found["answers"]
    assert {a[0] for a in answers} == {THREE[2]} and len({a[1] for a in answers}) == len(answers) == 8
    assert {a[2] for a in answers} <= {*THREE[:2], "reference/white-diffuse", "reference/chrome"}
    unknown = sum(a[4] > 1 for a in answers)
    assert f"renders by the engine of a material left out: {unknown} of 8 judged unknown" in child.stdout


def test_shares_come_with_their_range():
    assert bench_recognition.share(i < 22 for i in range(30)) == "73.3% (56 to 86)"
    assert bench_recognition.share([False] * 12) == "0.0% (0 to 24)"
