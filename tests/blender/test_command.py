# SPDX-License-Identifier: GPL-3.0-or-later
"""The command line inside Blender, in processes of its own: exit status, words, the saved file."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import bpy
import pytest

ROOT = Path(__file__).resolve().parents[2]
LIGHTING = {
    "format": "btfsep-lighting",
    "version": 1,
    "basis": "real-sh",
    "order": 0,
    "coefficients": [[1, 2, 3]],
    "stddev": None,
    "determined": None,
    "frame": "blender-z-up",
    "exposure_ev": 0.0,
}
DRIVER = """
import sys
sys.path.insert(0, sys.argv[1])
import bpy
import blender_btfsep
blender_btfsep.register()
if sys.argv[2]:
    bpy.ops.wm.open_mainfile(filepath=sys.argv[2])
status = blender_btfsep.command.main(sys.argv[3:])
blender_btfsep.unregister()
sys.exit(status)
"""


def blender(blend, *arguments):
    """What ``blender --background BLEND --command btfsep ARGUMENTS`` does, with the wheel."""
    command = [sys.executable, "-c", DRIVER, str(ROOT), str(blend or ""), *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)


@pytest.fixture
def blend(photographed, tmp_path):
    """A saved file in which everything is chosen."""
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    return tmp_path / "scene.blend"


def test_estimate_saves_the_world(blend, fake_engine, tmp_path):
    objects = [{"name": "Cube", "material": "wood/oak", "unknown": False, "candidates": []}]
    engine = fake_engine(lighting=LIGHTING, result={"objects": objects}, log=str(tmp_path / "log"))
    done = blender(
        blend,
        *("estimate", "--engine", engine, "--material", "wood/oak", "--order", 0, "--preset", "draft"),
        *("--job", tmp_path / "job", "--out", tmp_path / "out", "--save", tmp_path / "lit.blend"),
    )
    assert done.returncode == 0, done.stderr
    assert "Cube: wood/oak" in done.stdout and str(tmp_path / "lit.blend") in done.stdout
    assert f"wrote {tmp_path / 'out'}" in done.stdout
    arguments = json.loads((tmp_path / "log").read_text())
    assert arguments[arguments.index("--preset") + 1] == "draft"
    assert json.loads((tmp_path / "job" / "job.json").read_text())["objects"][0]["material"] == "wood/oak"
    assert (tmp_path / "out" / "lighting.json").is_file()
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "lit.blend"))
    group = bpy.context.scene.world.node_tree.nodes["BTFsep SH Lighting"]
    assert tuple(group.inputs["Y 0 0"].default_value) == (1, 2, 3)


def test_faults_end_with_2_and_one_line(blend, fake_engine, tmp_path):
    engine = fake_engine(
        lines=[{"type": "failed", "message": "photo; all black; expose longer", "exit_code": 2}], exit=2
    )
    cases = {
        ("estimate", "--engine", engine): "error: photo; all black; expose longer",
        ("estimate", "--object", "Teapot"): "error: object 'Teapot'; there is none of that name; choose from",
        ("estimate", "--image", tmp_path / "absent.png"): "error: the photo absent.png; there is no such file;",
        ("estimate", "--scene", "Other"): "error: scene 'Other'; there is none",
        ("apply", tmp_path / "absent.json"): "error: absent.json; No such file or directory;",
        ("estimate", "--world", "sky"): "invalid choice: 'sky'",
    }
    for arguments, words in cases.items():
        done = blender(blend, *arguments, "--save", tmp_path / "never.blend")
        assert done.returncode == 2, done.stderr
        assert words in done.stderr and "Traceback" not in done.stderr
    assert not (tmp_path / "never.blend").exists()
    (tmp_path / "file").write_text("")
    engine = fake_engine(lighting=LIGHTING, log=str(tmp_path / "log"))
    done = blender(blend, "estimate", "--engine", engine, "--save", tmp_path / "file" / "lit.blend")
    assert done.returncode == 2 and "is no folder" in done.stderr and not (tmp_path / "log").exists()  # before the work


def test_a_bug_ends_with_1(blend, fake_engine):
    done = blender(blend, "recognise", "--engine", fake_engine(exit=7, stderr="Traceback: deep inside"))
    assert done.returncode == 1 and "deep inside" in done.stderr


def test_recognise_and_export(blend, fake_engine, tmp_path):
    found = {
        "name": "Cube",
        "material": "wood/oak",
        "unknown": True,
        "candidates": [{"name": "wood/oak", "score": 0.5}],
    }
    engine = fake_engine(lines=[{"type": "done", "result": {"objects": [found]}}])
    done = blender(blend, "recognise", "--engine", engine)
    assert done.returncode == 0 and "Cube: wood/oak (unsure" in done.stdout and "0.500  wood/oak" in done.stdout
    done = blender(blend, "export", "--job", tmp_path / "job", "--occluders", "none")
    assert done.returncode == 0 and json.loads((tmp_path / "job" / "job.json").read_text())["occluders"] == []


def test_apply_without_an_engine(blend, tmp_path):
    (tmp_path / "lighting.json").write_text(json.dumps(LIGHTING))
    arguments = ("apply", tmp_path / "lighting.json", "--world", "texture", "--save", tmp_path / "lit.blend")
    done = blender(blend, *arguments)
    assert done.returncode == 0, done.stderr
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "lit.blend"))
    group = bpy.context.scene.world.node_tree.nodes["BTFsep Light Map"].node_tree
    assert group.nodes["Environment Texture"].image.packed_file


def test_sequence_saves_keyframes(blend, fake_engine, tmp_path):
    names = ["dusk 3.png", "dusk 12.png"]
    (tmp_path / "frames").mkdir()
    for name in names:
        shutil.copy(tmp_path / "photo.png", tmp_path / "frames" / name)
    lights = {name: LIGHTING | {"coefficients": [[i, 2, 3]]} for i, name in enumerate(names)}
    engine = fake_engine(sequence=lights, log=str(tmp_path / "log"))
    given = ("sequence", "--engine", engine, "--images", tmp_path / "frames" / "*.png", "--order", 0)
    done = blender(
        blend, *given, "--interpolation", "constant", "--out", tmp_path / "out", "--save", tmp_path / "lit.blend"
    )
    assert done.returncode == 0, done.stderr
    assert "2 lights, frames 3 to 12" in done.stdout and f"wrote {tmp_path / 'out'}" in done.stdout
    assert json.loads((tmp_path / "log").read_text())[0] == "sequence"
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "lit.blend"))
    scene = bpy.context.scene
    found = []
    for frame in (3, 11, 12):
        scene.frame_set(frame)
        tree = scene.world.evaluated_get(bpy.context.evaluated_depsgraph_get()).node_tree
        found.append(tuple(tree.nodes["BTFsep SH Lighting"].inputs["Y 0 0"].default_value))
    assert found == [(0, 2, 3), (0, 2, 3), (1, 2, 3)]

    cases = {
        ("--world", "texture"): "a texture has no keyframes",
        ("--image", tmp_path / "photo.png"): "a sequence has more than one",
        ("--images", tmp_path / "none*.png"): "no image matches",
    }
    for arguments, words in cases.items():
        done = blender(blend, *given, *arguments)
        assert done.returncode == 2 and words in done.stderr and "Traceback" not in done.stderr


def test_depth_exposure_and_options_of_the_estimate(blend, fake_engine, tmp_path):
    (tmp_path / "z.exr").write_bytes(b"copied as it is")
    engine = fake_engine(lighting=LIGHTING, log=str(tmp_path / "log"))
    given = ("--depth", tmp_path / "z.exr", "--exposure", "-1.5", "--material", "wood/oak", "--job", tmp_path / "job")
    done = blender(
        blend,
        "estimate",
        "--engine",
        engine,
        *given,
        "--appearance",
        "mean",
        "--order",
        "auto",
        "--delight",
        "never",
        "--job",
        tmp_path / "job",
    )
    assert done.returncode == 0, done.stderr
    job = json.loads((tmp_path / "job" / "job.json").read_text())
    assert (job["depth"], job["exposure_ev"]) == ("depth.exr", -1.5)
    assert [(o["name"], o["mesh"], o["material"]) for o in job["objects"]] == [("Surface", None, "wood/oak")]
    assert (tmp_path / "job" / "depth.exr").read_bytes() == b"copied as it is"
    arguments = json.loads((tmp_path / "log").read_text())
    assert arguments[arguments.index("--order") + 1] == "auto"
    assert arguments[arguments.index("--appearance") + 1] == "mean"
    assert arguments[arguments.index("--delight") + 1] == "never"
    done = blender(blend, "export", "--depth", tmp_path / "z.exr", "--object", "Cube")
    assert done.returncode == 2 and "objects are named, too" in done.stderr


def test_no_scene_is_removed_in_a_way_that_needs_a_window():
    """Blender 4.3 dies of it in ``--command``, the wheel does not."""
    sources = {path.name: path.read_text() for path in (ROOT / "blender_btfsep").glob("*.py")}
    assert [n for n, text in sources.items() if ".scenes.remove(" in text] == []


@pytest.mark.skipif("BTFSEP_BLENDER" not in os.environ, reason="BTFSEP_BLENDER names no Blender with the add-on")
def test_a_real_blender_measures_and_exports_from_a_saved_file(blend, fake_engine, tmp_path):
    """As a user runs it: it ends well and leaves nothing in the temporary folder."""
    material = bpy.data.materials.new("Paint")
    material.use_nodes = True
    bpy.data.objects["Cube"].active_material = material
    bpy.context.scene.btfsep.mapping = "UNWRAP"
    bpy.context.scene.btfsep.image.pack()
    bpy.context.scene.btfsep.image.pixels[0] = 1  # painted: it is saved through a scene of its own
    bpy.context.scene.btfsep.image.pack()
    bpy.ops.wm.save_mainfile()
    said = {"name": "paint", "file": "paint.btf", "measured": True, "library": "", "relief_mm": 0}
    engine = fake_engine(log=str(tmp_path / "log"), lines=[{"type": "done", "result": said}])
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    measure = ("measure", "--object", "Cube", "--class", "wallpaper", "--size-mm", "30", "--library", tmp_path / "lib")
    for arguments in ((*measure, "--engine", engine), ("export", "--job", tmp_path / "job")):
        done = subprocess.run(
            [os.environ["BTFSEP_BLENDER"], "--background", blend, "--command", "btfsep", *map(str, arguments)],
            capture_output=True,
            text=True,
            check=False,
            timeout=300,
            env={**os.environ, "TMPDIR": str(temporary)},
        )
        assert done.returncode == 0, done.stdout + done.stderr
        assert not [p.name for p in temporary.iterdir() if "btfsep" in p.name or "crash" in p.name]
    assert json.loads((tmp_path / "log").read_text())[:2] == ["library", "measure"]
    assert (tmp_path / "job" / "job.json").is_file()


def test_results_that_go_when_blender_ends_are_not_named(blend, fake_engine):
    done = blender(blend, "estimate", "--engine", fake_engine(lighting=LIGHTING))
    assert done.returncode == 0 and "Trust" in done.stdout and "wrote" not in done.stdout
