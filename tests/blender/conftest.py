# SPDX-License-Identifier: GPL-3.0-or-later
"""Tests inside Blender: the ``bpy`` wheel, in this process, nothing mocked."""

import json
import os
import sys
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
if str(ROOT) not in sys.path:
    sys.path.insert(0, str(ROOT))

bpy = pytest.importorskip("bpy")

from tests.blender.sunny import LAMPS, write_sunny  # noqa: E402 (the root is on the path by now)


def pytest_sessionfinish(session, exitstatus):
    session.config.status_of_tests = int(exitstatus)


@pytest.hookimpl(trylast=True)
def pytest_unconfigure(config):
    """Ends a process that is no worker's at once, when all is said.

    Where something still holds on to the module bpy before 5.0 when Python ends, the process waits for ever for a
    thread that would close the sound. Workers end so in any case.
    """
    if bpy.app.version < (5, 0) and not hasattr(config, "workerinput") and hasattr(config, "status_of_tests"):
        config.get_terminal_writer().flush()
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(config.status_of_tests)


@pytest.fixture
def scene():
    """An empty file; its only scene. Cycles on the CPU, EXR output, small pictures."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.cycles.device = "CPU"
    scene.cycles.use_denoising = False
    scene.cycles.use_adaptive_sampling = False
    scene.cycles.samples = 64
    scene.render.threads_mode, scene.render.threads = "FIXED", 2
    scene.render.resolution_x = scene.render.resolution_y = 64
    settings = scene.render.image_settings
    settings.file_format, settings.color_depth, settings.color_mode = "OPEN_EXR", "32", "RGB"
    return scene


@pytest.fixture
def addon(scene):
    """The add-on, switched on as Blender does it, for one test."""
    import addon_utils

    module = addon_utils.enable("blender_btfsep", default_set=True)
    assert module is not None
    (Path(bpy.app.tempdir) / "durations.json").unlink(missing_ok=True)  # of the test before
    yield module
    addon_utils.disable("blender_btfsep", default_set=True)


@pytest.fixture
def fake_engine(addon, tmp_path):
    """fake_engine(**behaviour): what the engine that the preferences name will do (fake_engine.py)."""
    program = tmp_path / "fake" / "btfsep"
    behaviour = tmp_path / "fake" / "behaviour.json"
    program.parent.mkdir()
    script = Path(__file__).with_name("fake_engine.py")
    program.write_text(f'#!/bin/sh\nexec "{sys.executable}" "{script}" "{behaviour}" "$@"\n')
    program.chmod(0o755)
    bpy.context.preferences.addons["blender_btfsep"].preferences.engine = str(program)

    def set_behaviour(**fields):
        behaviour.write_text(json.dumps(fields))
        return str(program)

    set_behaviour()
    return set_behaviour


@pytest.fixture
def photographed(addon, scene, add_camera, tmp_path):
    """A scene ready for a run: a cube, its camera, its photo, all in the panel's settings."""
    scene.render.resolution_x, scene.render.resolution_y = 48, 32
    bpy.ops.mesh.primitive_cube_add()
    cube = bpy.context.object
    add_camera(scene, (0, -6, 2))
    image = bpy.data.images.new("photo", 48, 32)
    image.filepath_raw, image.file_format = str(tmp_path / "photo.png"), "PNG"
    image.save()
    bpy.data.images.remove(image)
    scene.btfsep.image = bpy.data.images.load(str(tmp_path / "photo.png"))
    scene.btfsep.objects.add().object = cube
    return scene


@pytest.fixture(scope="session")
def small_light(tmp_path_factory):
    """small_light(name) -> the path of that map of Blender's with an eighth of its rows and columns.

    What Cycles does with a large one before its first sample takes longer than a small photo.
    """
    from btfsep_engine.imaging import images
    from btfsep_engine.light.maps import read_map
    from scripts.cycles.lights import light_path

    @cache
    def small(name: str) -> str:
        radiance, path = read_map(light_path(name)), tmp_path_factory.mktemp("light") / f"{name}.exr"
        rows, columns, _ = radiance.shape
        images.write_exr(path, radiance.reshape(rows // 8, 8, columns // 8, 8, 3).mean((1, 3)))
        return str(path)

    return small


@pytest.fixture
def render(tmp_path):
    """Renders a scene; gives (height, width, 3) float32, linear, row 0 is up."""
    from scripts.cycles import studio

    count = 0

    def run(scene):
        nonlocal count
        count += 1
        path = tmp_path / f"render{count}.exr"
        scene.render.filepath = str(path)
        bpy.ops.render.render(write_still=True, scene=scene.name)
        return studio.read_image(path)

    return run


@pytest.fixture
def add_camera():
    """add_camera(scene, location, target) -> camera object that looks at target, Z up."""
    from mathutils import Vector

    def add(scene, location, target=(0, 0, 0)):
        camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
        scene.collection.objects.link(camera)
        camera.location = location
        camera.rotation_euler = (Vector(target) - Vector(location)).to_track_quat("-Z", "Y").to_euler()
        scene.camera = camera
        bpy.context.view_layer.update()
        return camera

    return add


@pytest.fixture
def sunny(tmp_path):
    """The path of a lighting.json with a sky and a sun, and its Lighting."""
    path = tmp_path / "sunny.json"
    return path, write_sunny(path)


@pytest.fixture
def lamplit(tmp_path):
    """As `sunny`, with three key lights."""
    path = tmp_path / "lamplit.json"
    return path, write_sunny(path, others=LAMPS)


@pytest.fixture
def lit(photographed, tmp_path, fake_engine, sunny, monkeypatch):
    """A live scene that has a light without lamps, and an engine that finds a sun; the camera was moved since."""
    from blender_btfsep.light import lighting_file
    from blender_btfsep.run import answer
    from blender_btfsep.window import live
    from tests.blender.lit import LIGHTING

    monkeypatch.setattr(live, "SETTLED", 0.0)
    light = tmp_path / "light.json"
    light.write_text(json.dumps(LIGHTING))
    answer.apply_light(photographed, lighting_file.read(light))
    fake_engine(
        lighting=json.loads(sunny[0].read_text()), lines=[{"type": "light", "lighting": str(sunny[0])}], result={}
    )
    bpy.context.view_layer.update()
    photographed.btfsep.live = True
    bpy.ops.ed.undo_push(message="live")
    photographed.camera.location.x = 0.5
    bpy.context.view_layer.update()
    bpy.ops.ed.undo_push(message="moved")
    return photographed
