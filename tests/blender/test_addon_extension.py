# SPDX-License-Identifier: GPL-3.0-or-later
"""The extension as users get it: built, installed by Blender's own operator in a fresh place, switched on, used."""

import json
import os
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

import btfsep_engine
from scripts.studies.makers.build_extension import without_engine, zip_name

ROOT = Path(__file__).resolve().parents[2]
INSTALL = """
import sys, json
import bpy
done = bpy.ops.extensions.package_install_files(filepath=sys.argv[1], repo="user_default", enable_on_install=True)
name = "bl_ext.user_default.btfsep"
assert done == {"FINISHED"} and name in bpy.context.preferences.addons, done
from bl_ext.user_default.btfsep import command
from bl_ext.user_default.btfsep.engine import engine_process
import btfsep_engine
status = command.main(["apply", sys.argv[2], "--save", sys.argv[3]])
bundled = engine_process.find_engine()
last = engine_process.EngineProcess(bundled, ["compare", sys.argv[2], sys.argv[2]]).wait()
preferences = bpy.context.preferences.addons[name].preferences
print("FOUND", json.dumps({
    "status": status, "engine": btfsep_engine.__file__, "command": bundled.command, "last": type(last).__name__,
    "words": str(last), "keep": preferences.keep_jobs, "path": bundled.environment.get("PYTHONPATH", ""),
}))
"""


@pytest.fixture(scope="module")
def extension(tmp_path_factory):
    """The zip without dependencies, built as the README says: by whatever Python the script finds first."""
    folder = tmp_path_factory.mktemp("extension")
    command = [ROOT / "scripts" / "build_extension", "--output", folder]
    built = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)
    assert built.returncode == 0, built.stdout + built.stderr
    (found,) = folder.glob("*.zip")
    return found


def test_the_version_is_the_engines():
    manifest = tomllib.loads((ROOT / "blender_manifest.toml").read_text())
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert manifest["version"] == project["version"] == btfsep_engine.__version__
    assert f"\nversion: {manifest['version']}\n" in (ROOT / "CITATION.cff").read_text()
    assert "blender" not in manifest["name"].lower() and "network" not in manifest["permissions"]


def test_the_zip_holds_the_addon_and_the_engine(extension):
    with zipfile.ZipFile(extension) as archive:
        names = archive.namelist()
        manifest = tomllib.loads(archive.read("blender_manifest.toml").decode())
        for name in manifest["wheels"]:
            with zipfile.ZipFile(archive.open(name.removeprefix("./"))) as wheel:
                assert "btfsep_engine/cli/commands.py" in wheel.namelist()
                assert any(n.startswith("btfsep_engine/data/lights/") for n in wheel.namelist())
    modules = {path.name for path in (ROOT / "blender_btfsep").glob("*.py")}
    assert modules | {"example.blend"} <= set(names)
    assert not [name for name in names if "__pycache__" in name or name.endswith((".pyc", "ruff.toml"))]


def test_zips_of_different_content_have_different_names():
    contents = [(None, ["3.11"]), ("linux-x64", ["3.11"]), ("linux-x64", ["3.13"]), ("linux-x64", ["3.11", "3.13"])]
    names = [zip_name("0.1.0", *content) for content in [*contents, ("windows-x64", ["3.11"])]]
    assert len(set(names)) == len(names) and names[2] == "btfsep-0.1.0-linux-x64-py313.zip"


def test_a_zip_for_a_python_without_engine_is_refused_in_a_sentence(tmp_path):
    command = [ROOT / "scripts" / "build_extension", "--with-dependencies", "linux-x64", "--output", tmp_path]
    done = subprocess.run([*command, "--python", "3.99"], capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode and not list(tmp_path.iterdir())
    assert done.stderr.startswith("error: Python 3.99; there is no engine for it; ") and done.stderr.count("\n") == 1
    assert without_engine(["3.11", "3.13"]) == []


def test_it_installs_and_works_in_a_fresh_place(extension, tmp_path):
    lighting = {
        "format": "btfsep-lighting",
        "version": 1,
        "basis": "real-sh",
        "order": 1,
        "coefficients": [[1, 1, 1], [0.1, 0, 0], [0, 0.2, 0], [0, 0, 0.3]],
        "stddev": [[0.1] * 3] * 4,
        "determined": [True] * 4,
        "frame": "blender-z-up",
        "exposure_ev": 0.0,
    }
    (tmp_path / "lighting.json").write_text(json.dumps(lighting))
    (tmp_path / "user").mkdir()
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    environment["BLENDER_USER_RESOURCES"] = str(tmp_path / "user")
    # -P: the source tree must not stand in for what the zip lacks
    done = subprocess.run(
        [sys.executable, "-P", "-c", INSTALL, extension, tmp_path / "lighting.json", tmp_path / "lit.blend"],
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
        env=environment,
        cwd=tmp_path,
    )
    lines = [line for line in done.stdout.splitlines() if line.startswith("FOUND ")]
    assert lines, done.stdout + done.stderr
    found = json.loads(lines[-1].removeprefix("FOUND "))
    assert found["status"] == 0 and (tmp_path / "lit.blend").is_file()
    assert found["last"] == "Done", found["words"]
    assert found["keep"] is False
    unpacked = list((tmp_path / "user").rglob("site-packages/btfsep_engine/__init__.py"))
    assert len(unpacked) == 1  # the wheel's own copy, not the one that these tests import
