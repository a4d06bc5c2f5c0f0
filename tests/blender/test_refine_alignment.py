# SPDX-License-Identifier: GPL-3.0-or-later
"""The button Refine Alignment: what it moves, and what it says; and once with the engine itself, on a render."""

import json

import addon_utils
import bpy
import numpy as np
import pytest
from mathutils import Matrix

from blender_btfsep.light import lighting_file
from blender_btfsep.photo.camera import for_photo, to_world
from blender_btfsep.run import answer, request
from blender_btfsep.window import alignment
from scripts.cycles import studio
from tests.blender.lit import LIGHTING

MOVED = {
    "aligned": True,
    "why": "moved: outlines and shading go better, by 7.1 deviations (outline without an edge 65 % before, …)",
    "moved_px": 3.14,
    "degrees": 1.25,
    "focal_percent": 2.0,
}


def camera_of(scene):
    """The pinhole of the scene's camera, as a job has it."""
    bpy.context.view_layer.update()
    return for_photo(scene, scene.camera, (48, 32)) | {"to_world": to_world(scene.camera)}


def other(camera: dict) -> dict:
    """A camera a little aside, turned and longer."""
    turn = np.array(Matrix.Rotation(0.03, 4, (0.3, 1, -0.2)))
    turn[:3, 3] = 0.2, -0.1, 0.05
    return {"to_world": (camera["to_world"] @ turn).tolist(), "fx": 1.02 * camera["fx"], "fy": 1.02 * camera["fy"]}


def test_the_camera_moves_and_the_objects_stay(photographed, fake_engine):
    camera = photographed.camera
    camera.scale = (2.0, 2.0, 2.0)
    cube = photographed.btfsep.objects[0].object
    before, stood = camera_of(photographed), cube.matrix_world.copy()
    after = other(before)
    fake_engine(aligned=after, result=MOVED)
    assert bpy.ops.btfsep.refine_alignment() == {"FINISHED"}
    found = camera_of(photographed)
    np.testing.assert_allclose(found["to_world"], after["to_world"], atol=1e-5)
    assert found["fx"] == pytest.approx(after["fx"], rel=1e-5)
    assert tuple(camera.scale) == pytest.approx((2.0, 2.0, 2.0))
    assert cube.matrix_world == stood
    said = bpy.context.window_manager.btfsep.summary
    moved = "The camera was moved: 3.1 pixels in the photo, a turn of 1.2°, focal length +2.0%"
    assert said == f"{moved}\nOutlines and shading go better"
    assert alignment.OLDER not in said


def test_a_light_that_is_older_than_the_camera_is_said_to_be(photographed, fake_engine):
    answer.apply_light(photographed, lighting_file.validate(LIGHTING))
    for live in (True, False):
        photographed.btfsep.live = live
        fake_engine(aligned=other(camera_of(photographed)), result=MOVED)
        assert bpy.ops.btfsep.refine_alignment() == {"FINISHED"}
        assert (alignment.OLDER in bpy.context.window_manager.btfsep.summary) == (not live)  # Live asks by itself
    fake_engine(aligned={}, result=MOVED | {"aligned": False, "why": "it is in place"})
    assert bpy.ops.btfsep.refine_alignment() == {"FINISHED"}
    assert alignment.OLDER not in bpy.context.window_manager.btfsep.summary


def test_the_objects_move_and_are_seen_as_if_the_camera_had(photographed, fake_engine):
    scene, cube = photographed, photographed.btfsep.objects[0].object
    child = bpy.data.objects.new("child", cube.data)
    scene.collection.objects.link(child)
    child.parent, child.location = cube, (0.3, 0.1, 0)
    scene.btfsep.objects.add().object = child
    before = camera_of(scene)
    after = other(before)
    stood = [np.array(thing.matrix_world) for thing in (cube, child)]
    fake_engine(aligned=after, result=MOVED)
    assert bpy.ops.btfsep.refine_alignment(moves="OBJECTS") == {"FINISHED"}
    found = camera_of(scene)
    np.testing.assert_allclose(found["to_world"], before["to_world"], atol=1e-6)
    assert found["fx"] == pytest.approx(after["fx"], rel=1e-5)
    for thing, place in zip((cube, child), stood, strict=True):
        seen = np.linalg.inv(before["to_world"]) @ np.array(thing.matrix_world)
        np.testing.assert_allclose(seen, np.linalg.inv(after["to_world"]) @ place, atol=1e-5)
    assert bpy.context.window_manager.btfsep.summary.startswith("The objects were moved")


def test_an_orthographic_camera_gets_another_scale(photographed, fake_engine):
    camera = photographed.camera.data
    camera.type, camera.ortho_scale = "ORTHO", 5.0
    fake_engine(aligned=other(camera_of(photographed)), result=MOVED)
    assert bpy.ops.btfsep.refine_alignment() == {"FINISHED"}
    assert camera.ortho_scale == pytest.approx(5.0 / 1.02)


def test_without_a_gain_nothing_moves(photographed, fake_engine):
    before = camera_of(photographed)
    why = "it lies within 0.3 pixels of where it goes best"
    fake_engine(aligned=other(before), result=MOVED | {"aligned": False, "why": f"left as it is: {why}"})
    assert bpy.ops.btfsep.refine_alignment() == {"FINISHED"}
    np.testing.assert_array_equal(camera_of(photographed)["to_world"], before["to_world"])
    assert bpy.context.window_manager.btfsep.summary == f"Nothing was moved; {why}"


@pytest.mark.parametrize("moves", ["CAMERA", "OBJECTS"])
def test_what_something_else_holds_stays_and_is_named(photographed, fake_engine, moves):
    held = photographed.camera if moves == "CAMERA" else photographed.btfsep.objects[0].object
    hold = held.constraints.new("LIMIT_LOCATION")
    for axis, place in zip("xyz", held.location, strict=True):
        for end in ("min", "max"):
            setattr(hold, f"use_{end}_{axis}", True)
            setattr(hold, f"{end}_{axis}", place)
    before = camera_of(photographed)
    stood = [np.array(thing.matrix_world) for thing in photographed.objects]
    fake_engine(aligned=other(before), result=MOVED)
    with pytest.raises(RuntimeError, match=f"object '{held.name}'; constraints, keyframes or a driver hold it"):
        bpy.ops.btfsep.refine_alignment(moves=moves)
    found = camera_of(photographed)
    assert found["fx"] == pytest.approx(before["fx"])
    for thing, place in zip(photographed.objects, stood, strict=True):
        np.testing.assert_allclose(np.array(thing.matrix_world), place, atol=1e-6)


def test_the_photo_of_a_depth_is_shifted(photographed, fake_engine, tmp_path):
    """The shift goes into the next job, and camera and objects stay."""
    settings, before = photographed.btfsep, camera_of(photographed)
    settings.objects.clear()
    drawn = bpy.data.images.new("drawn", 48, 32, float_buffer=True)
    drawn.filepath_raw, drawn.file_format = str(tmp_path / "depth.exr"), "OPEN_EXR"
    drawn.save()
    settings.depth = bpy.data.images.load(str(tmp_path / "depth.exr"))
    settings.depth_shift = 1.0, 0.0
    assert json.loads((request.write_job(bpy.context) / "job.json").read_text())["depth_shift"] == [1.0, 0.0]
    moved = MOVED | {"degrees": 0.0, "focal_percent": 0.0, "depth_shift": [2.5, -1.0]}
    fake_engine(aligned={}, result=moved, job={"depth_shift": [3.5, -1.0]})
    assert bpy.ops.btfsep.refine_alignment() == {"FINISHED"}
    assert tuple(settings.depth_shift) == (3.5, -1.0)
    np.testing.assert_array_equal(camera_of(photographed)["to_world"], before["to_world"])
    said = bpy.context.window_manager.btfsep.summary
    shifted = "The photo was shifted against the depth: +2.5 pixels to the right, -1.0 down"
    assert said == f"{shifted}\nOutlines and shading go better"
    settings.depth, settings.objects.add().object = None, bpy.data.objects["Cube"]
    assert "depth_shift" not in json.loads((request.write_job(bpy.context) / "job.json").read_text())


@pytest.fixture
def posed(tmp_path, small_light):
    """A rendered monkey, its photo and the monkey in the panel's settings: the scene, the object."""
    scene, _, base, _ = studio.make_scene("suzanne", "white", small_light("courtyard"), resolution=160)
    addon_utils.enable("blender_btfsep", default_set=True)  # a new file switches it off
    studio.render_photo(scene, tmp_path / "photo.exr", 16)
    monkey = bpy.data.objects[base.name]
    scene.btfsep.image = bpy.data.images.load(str(tmp_path / "photo.exr"))
    scene.btfsep.objects.add().object = monkey
    yield scene, monkey
    addon_utils.disable("blender_btfsep", default_set=True)


def test_the_engine_finds_a_rendered_object_again(posed):
    """A camera that is turned after the photo was taken comes back."""
    scene, monkey = posed
    camera = scene.camera
    bpy.context.view_layer.update()
    true = np.array(camera.matrix_world)
    camera.matrix_world = camera.matrix_world @ Matrix.Rotation(0.02, 4, "X") @ Matrix.Rotation(-0.025, 4, "Y")
    bpy.context.view_layer.update()
    off = np.array(camera.matrix_world)
    assert bpy.ops.btfsep.refine_alignment() == {"FINISHED"}
    bpy.context.view_layer.update()
    found = np.array(camera.matrix_world)
    corners = np.array([[*c, 1] for c in monkey.bound_box])
    corners = corners @ np.array(monkey.matrix_world).T

    def seen(matrix):
        local = corners @ np.linalg.inv(matrix).T
        return local[:, :2] / local[:, 2:3]

    before, after = (np.linalg.norm(seen(m) - seen(true), axis=1).mean() for m in (off, found))
    assert after < 0.3 * before
    assert "The camera was moved" in bpy.context.window_manager.btfsep.summary
