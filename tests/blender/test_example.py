# SPDX-License-Identifier: GPL-3.0-or-later
"""The example that the panel opens: two clicks to a light that is nearly the true one, and undo."""

import bpy
import numpy as np
import pytest

from blender_btfsep.light import kept_light, world
from blender_btfsep.run import request
from blender_btfsep.window import example
from scripts.cycles.example import LIGHT
from scripts.cycles.lights import true_lighting
from scripts.studies.measures import errors


def test_two_clicks_give_the_light_of_the_photo(addon, scene):
    assert bpy.ops.btfsep.open_example() == {"FINISHED"}
    opened = bpy.context.scene
    assert opened != scene and opened.name == example.SCENE and request.missing(bpy.context) == ""
    assert bpy.ops.btfsep.estimate() == {"FINISHED"}
    assert world.is_ours(opened.world) and not world.is_ours(scene.world)
    found = kept_light.lighting_of(opened.btfsep.light)
    off = errors(np.array(found["coefficients"]), true_lighting(LIGHT, found["order"]))
    assert off["order2_absolute"] < 0.2 and off["direction"] < 5
    said = kept_light.card(opened.btfsep.light)
    assert said["trust"] == "GREEN" and not said["warnings"]


def test_it_is_a_scene_beside_the_users_and_one_undo_takes_it_back(addon, scene):
    bpy.ops.mesh.primitive_cube_add()
    scene.name = "Mine"
    before = {kind: len(getattr(bpy.data, kind)) for kind in ("scenes", "objects", "images", "worlds", "materials")}
    bpy.ops.ed.undo_push(message="before")
    bpy.ops.btfsep.open_example()
    bpy.ops.ed.undo_push(message="opened")
    mine = bpy.data.scenes["Mine"]
    assert [thing.name for thing in mine.objects] == ["Cube"] and bpy.context.window.scene.name == example.SCENE
    bpy.ops.ed.undo()
    assert bpy.context.window.scene.name == "Mine" and bpy.data.objects["Cube"].name in bpy.context.scene.objects
    assert before == {kind: len(getattr(bpy.data, kind)) for kind in before}


def test_an_example_that_is_gone_is_said(addon, scene, monkeypatch, tmp_path):
    monkeypatch.setattr(example, "FILE", tmp_path / "example.blend")
    with pytest.raises(RuntimeError, match="install the extension again"):
        bpy.ops.btfsep.open_example()
    assert bpy.context.scene == scene
