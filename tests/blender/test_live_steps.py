# SPDX-License-Identifier: GPL-3.0-or-later
"""The steps of undo that Live makes: each goes with what it followed, and none ends what may be redone."""

import json

import bpy
import pytest

from blender_btfsep.light import lighting_file, sun_lamp, world
from blender_btfsep.run import answer
from blender_btfsep.window import live, live_steps
from tests.blender.lit import LIGHTING, lighting, random_coefficients
from tests.blender.test_between_steps import follow, now


def press(what):
    """Ctrl Z or its opposite, and what Blender's timer does then; what Blender tells of afterwards."""
    step = getattr(bpy.ops.ed, what)
    if step.poll():
        step()
    while bpy.app.timers.is_registered(live_steps._go_on):
        bpy.app.timers.unregister(live_steps._go_on)
        while live_steps._go_on() is not None:
            pass
    bpy.context.scene.camera.update_tag()  # in a window it tells of all that is there
    bpy.context.view_layer.update()


def edit(x, monkeypatch):
    """The user moves the camera, some time later."""
    bpy.context.view_layer.update()
    with monkeypatch.context() as now:
        now.setattr(live_steps, "_moved", 0.0)
        now.setattr(live_steps, "_echo", False)
        bpy.context.scene.camera.location.x = x
        bpy.context.view_layer.update()
    bpy.ops.ed.undo_push(message=f"to {x}")


def test_lamps_that_come_live_go_with_what_they_followed(lit):
    follow()
    assert now() == (1, 0.5)
    for _ in range(2):
        press("undo")
        assert now() == (0, 0.0)
        press("redo")
        assert now() == (1, 0.5)


def test_what_the_user_did_after_the_lamps_is_undone_alone(lit, monkeypatch):
    follow()
    edit(0.6, monkeypatch)
    live._follower.give_way()
    press("undo")
    assert now() == (1, 0.5)
    press("undo")
    assert now() == (0, 0.0)
    press("redo")
    assert now() == (1, 0.5)
    press("redo")
    assert now() == (1, pytest.approx(0.6))


def test_a_light_with_lamps_waits_while_there_is_something_to_redo(lit):
    follow()
    press("undo")
    follow()  # the engine finds a sun here, too
    assert now() == (0, 0.0) and live.waits(bpy.context.scene)
    press("redo")
    assert now() == (1, 0.5) and not live.waits(bpy.context.scene)


def test_a_light_that_fits_does_not_wait(lit, fake_engine):
    follow()
    press("undo")
    told = json.loads(json.dumps(LIGHTING))
    told["coefficients"][0] = [3, 3, 3]
    fake_engine(lighting=told, result={})
    follow()
    scene = bpy.context.scene
    assert tuple(scene.world.node_tree.nodes[0].inputs["Y 0 0"].default_value) == (3, 3, 3)
    assert not live.waits(scene)
    press("redo")
    assert now() == (1, 0.5)


def test_the_light_that_waits_is_there_for_a_button(lit):
    follow()
    assert not bpy.ops.btfsep.take_light.poll()
    press("undo")
    follow()
    assert bpy.ops.btfsep.take_light() == {"FINISHED"}
    assert now() == (1, 0.0) and not live.waits(bpy.context.scene)
    press("redo")
    assert now() == (1, 0.0)
    press("undo")
    assert now() == (0, 0.0)  # a step like any other: what was before stays


def test_after_an_edit_there_is_nothing_to_wait_for(lit, monkeypatch):
    follow()
    press("undo")
    edit(0.7, monkeypatch)
    follow()
    assert now() == (1, pytest.approx(0.7))
    press("undo")
    assert now() == (0, 0.0)


def test_a_lamp_that_goes_is_such_a_step_too(lit, fake_engine, monkeypatch):
    follow()
    lamp = sun_lamp.lamps(bpy.context.scene)[0].session_uid
    fake_engine(lighting=LIGHTING | lighting(random_coefficients(4)), result={})  # in the nodes that are there
    edit(0.6, monkeypatch)
    follow()
    assert now() == (0, pytest.approx(0.6))
    press("undo")
    assert now() == (1, 0.5) and sun_lamp.lamps(bpy.context.scene)[0].session_uid == lamp
    press("redo")
    assert now() == (0, pytest.approx(0.6))


def test_several_steps_at_once_are_as_the_user_chose(lit, monkeypatch):
    follow()
    edit(0.6, monkeypatch)
    live._follower.give_way()
    bpy.ops.ed.undo_history(item=1)  # of: live, moved, Live, to 0.6
    assert not bpy.app.timers.is_registered(live_steps._go_on) and now() == (0, 0.5)


def a_light(order, **more):
    given = lighting(random_coefficients(order, **more))
    return lighting_file.validate({**LIGHTING, **given})


@pytest.mark.parametrize("name", ["as it is", "other numbers", "a lamp", "an order", "a map", "none of ours"])
def test_what_fits(photographed, sunny, name):
    scene = photographed
    answer.apply_light(scene, a_light(2))
    other = a_light(3 if name == "an order" else 2, seed=1)
    if name == "a lamp":
        other = lighting_file.read(sunny[0])
    if name == "a map":
        scene.btfsep.world_mode = "TEXTURE"
    if name == "none of ours":
        world.restore_previous(scene)
    made = {each.session_uid for kind in (bpy.data.objects, bpy.data.node_groups, bpy.data.worlds) for each in kind}
    fits = answer.fits(scene, other)
    answer.apply_light(scene, other)
    after = {each.session_uid for kind in (bpy.data.objects, bpy.data.node_groups, bpy.data.worlds) for each in kind}
    assert fits == (made == after) == (name in {"as it is", "other numbers"})
