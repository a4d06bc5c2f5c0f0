# SPDX-License-Identifier: GPL-3.0-or-later
"""What the command line can beside the plain estimate: JSON, objects one by one, frames, batches, lights in files."""

import json
import shutil
import subprocess
import sys

import bpy
import numpy as np
import pytest

from blender_btfsep.light import light_files, world
from btfsep_engine import sh
from tests.blender.lit import positive_coefficients
from tests.blender.test_command import LIGHTING, ROOT, blend, blender  # noqa: F401


def lines_of(done) -> list:
    return [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]


def test_json_lines(blend, fake_engine, tmp_path):  # noqa: F811
    progress = {"type": "progress", "stage": "fit", "title": "Solving", "fraction": 0.5, "whole": 0.7, "message": ""}
    warning = {"type": "warning", "message": "half of it is saturated"}
    engine = fake_engine(lighting=LIGHTING, lines=[progress, warning])
    done = blender(blend, "estimate", "--engine", engine, "--json", "--save", tmp_path / "lit.blend")
    first, second, last = lines_of(done)
    assert done.returncode == 0 and first == progress and second == warning
    assert last["type"] == "done" and last["result"]["saved"] == str(tmp_path / "lit.blend")
    assert any("The World is now" in said for said in last["result"]["said"])
    done = blender(blend, "estimate", "--object", "Teapot", "--json")
    (failed,) = lines_of(done)
    assert (done.returncode, failed["type"], failed["exit_code"]) == (2, "failed", 2)
    assert failed["message"].startswith("object 'Teapot'; there is none of that name")


def test_each_object_has_its_own_material_and_mask(photographed, fake_engine, tmp_path):
    bpy.ops.mesh.primitive_cube_add(location=(3, 0, 0))
    photographed.btfsep.objects.add().object = bpy.context.object
    bpy.ops.mesh.primitive_cube_add(location=(-3, 0, 0))
    bpy.context.object.name = "a=b"
    photographed.btfsep.objects.add().object = bpy.context.object
    photographed.camera.keyframe_insert("location", frame=1)
    photographed.camera.location.x = 1
    photographed.camera.keyframe_insert("location", frame=20)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "two.blend"))
    bpy.data.images.load(str(tmp_path / "photo.png")).save(filepath=str(tmp_path / "mask.png"))
    white = bpy.data.images.new("white", 48, 32)
    white.pixels.foreach_set(np.ones(48 * 32 * 4, np.float32))
    white.save(filepath=str(tmp_path / "white.png"))
    given = ("--material", "wood/oak", "--material", "Cube.001=stone/slate", "--material", "a=b=felt/grey")
    more = ("--mask", f"Cube={tmp_path / 'white.png'}", "--mapping", "own", "--frame", 20)
    done = blender(
        *(tmp_path / "two.blend", "estimate", *given, *more),
        *("--engine", fake_engine(lighting=LIGHTING), "--job", tmp_path / "job"),
    )
    assert done.returncode == 0, done.stderr
    job = json.loads((tmp_path / "job" / "job.json").read_text())
    assert {o["name"]: o["material"] for o in job["objects"]} == {
        "Cube": "wood/oak",
        "Cube.001": "stone/slate",
        "a=b": "felt/grey",
    }
    assert [o["mask"] is not None for o in job["objects"]] == [True, False, False]
    assert {o["uv"] for o in job["objects"]} == {"mesh"} and job["camera"]["to_world"][0][3] == pytest.approx(1)
    for option, value in (("--material", "Teapot=wood/oak"), ("--mask", "Teapot=x.png")):
        done = blender(tmp_path / "two.blend", "estimate", option, value)
        assert done.returncode == 2 and "no object of the job is called 'Teapot'" in done.stderr
    done = blender(tmp_path / "two.blend", "export", "--mask", tmp_path / "absent.png")
    assert done.returncode == 2 and "the mask" in done.stderr and "Traceback" not in done.stderr


def test_a_batch_of_files_and_photos(blend, fake_engine, tmp_path):  # noqa: F811
    (tmp_path / "photos").mkdir()
    for name in ("one.png", "two.png"):
        shutil.copy(tmp_path / "photo.png", tmp_path / "photos" / name)
    shutil.copy(blend, tmp_path / "other.blend")
    engine = fake_engine(lighting=LIGHTING, log=str(tmp_path / "log"))
    given = ("--photos", tmp_path / "photos" / "*.png", "--engine", engine, "--out", tmp_path / "out", "--save-lit")
    files = (blend, tmp_path / "absent.blend", tmp_path / "other.blend")
    done = blender(None, "batch", *files, *given, "--json")
    assert done.returncode == 2, done.stderr
    entries = lines_of(done)[-1]["result"]["entries"]
    assert [bool(e["error"]) for e in entries] == [False, False, True, True, False, False]
    assert json.loads((tmp_path / "out" / "batch.json").read_text())["entries"] == entries
    for name in ("scene-one", "scene-two", "other-one", "other-two"):
        assert (tmp_path / "out" / name / "lighting.json").is_file() and (
            tmp_path / "out" / name / "lit.blend"
        ).is_file()
    (tmp_path / "log").unlink()
    done = blender(None, "batch", blend, *given)  # all of it is there
    assert done.returncode == 0 and "2 of 2 have their light" in done.stdout and not (tmp_path / "log").exists()
    lit = tmp_path / "out" / "scene-two" / "lit.blend"
    lit.unlink()  # as of a run that was stopped before it
    done = blender(None, "batch", blend, *given)
    assert done.returncode == 0 and lit.is_file() and "scene-one: there already" in done.stdout
    shutil.copy(tmp_path / "photo.png", tmp_path / "photos" / "two.tif")
    done = blender(None, "batch", blend, "--photos", tmp_path / "photos", "--out", tmp_path / "out")
    assert done.returncode == 2 and "'scene-two'; two results would go there" in done.stderr
    done = blender(None, "batch", blend, "--photos", tmp_path / "none" / "*.png", "--out", tmp_path / "out")
    assert done.returncode == 2 and "--photos" in done.stderr and "--images" not in done.stderr
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "out" / "other-two" / "lit.blend"))
    assert world.is_ours(bpy.context.scene.world)
    for arguments, words in {
        ("batch", blend): "--out; it is missing",
        ("batch", blend, "--out", tmp_path, "--image", "x.png"): "a batch has more than one",
        ("batch", blend, blend, "--out", tmp_path): "two files have this name",
    }.items():
        done = blender(None, *arguments)
        assert done.returncode == 2 and words in done.stderr


def test_a_light_goes_to_a_file_and_comes_from_one(addon, scene, tmp_path):
    c = positive_coefficients(2, seed=3)
    world.apply_lighting(scene, {"order": 2, "coefficients": c.tolist()})
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "lit.blend"))
    done = blender(tmp_path / "lit.blend", "light", tmp_path / "sky.exr", "--json")
    assert done.returncode == 0 and lines_of(done)[-1]["result"]["file"] == str(tmp_path / "sky.exr"), done.stderr
    done = blender(None, "apply", tmp_path / "sky.exr", "--order", 2, "--save", tmp_path / "again.blend")
    assert done.returncode == 0, done.stderr
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "again.blend"))
    found = light_files.of_world(bpy.context.scene)[0]
    assert np.abs(found - sh.to_map(c, 256, 512)).max() < 2e-3 * found.max()
    done = blender(None, "light", tmp_path / "x.exr")
    assert done.returncode == 2 and "none of BTFsep's" in done.stderr


CALLED = """
import sys
sys.path.insert(0, {root!r})
import bpy
import blender_btfsep
blender_btfsep.register()
if {opened!r}:
    bpy.ops.wm.open_mainfile(filepath={opened!r})
sys.argv = ["blender", "-b", {named!r}, "--command", "btfsep", "recognise"]
status = blender_btfsep.command.by_blender(["recognise", "--object", "Teapot"])
blender_btfsep.unregister()
sys.exit(status)
"""


@pytest.mark.parametrize("opened", [True, False])
def test_a_file_that_blender_did_not_read_is_named(blend, tmp_path, opened):  # noqa: F811
    """Blender goes on with its default scene, and says so on its own account only."""
    named = str(blend) if opened else str(tmp_path / "missing.blend")
    code = CALLED.format(root=str(ROOT), opened=str(blend) if opened else "", named=named)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=120)
    words = "object 'Teapot'; there is none" if opened else "missing.blend; there is no such file"
    assert done.returncode == 2 and words in done.stderr
