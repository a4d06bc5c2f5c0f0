# SPDX-License-Identifier: GPL-3.0-or-later
"""Undo beside a light that comes by itself: what it makes is a step of its own, and its pictures are no new ones."""

import bpy
import numpy as np

from blender_btfsep.basics import harmonics, pixels
from blender_btfsep.engine import engine_process
from blender_btfsep.light import kept_light, sh_nodes, sun_lamp, world
from blender_btfsep.run import answer, between_steps
from blender_btfsep.window import live, operators


def now():
    """(lamps, the camera's x) of the scene that there is."""
    scene = bpy.context.scene
    return len(sun_lamp.lamps(scene)), scene.camera.location.x


def follow():
    from tests.blender.test_live import until

    until(lambda: not live._follower.step())


def test_a_light_in_what_is_there_is_no_step(lit):
    follow()
    light = bpy.context.scene.btfsep.light
    images = {each.session_uid for each in bpy.data.images}
    assert light.picture.users == 2
    light.text = "{}"  # another one
    bpy.context.scene.camera.location.x = 1
    bpy.context.view_layer.update()
    bpy.ops.ed.undo_push(message="moved again")
    follow()
    assert {each.session_uid for each in bpy.data.images} == images and not between_steps._made
    bpy.ops.ed.undo()
    assert now() == (1, 0.5)


def test_a_light_that_undo_has_made_older_than_what_it_follows_comes_anew(lit):
    follow()
    live._follower.text = "of a camera that is there still"
    bpy.ops.ed.undo_push(message="something else")
    bpy.ops.ed.undo()
    assert bpy.context.scene.btfsep.live and live._follower.due
    follow()


def test_the_light_of_a_run_under_way_is_undone_alone(lit, monkeypatch):
    lit.btfsep.live = False
    seen = []

    def hearing(self, message):
        heard(self, message)
        if isinstance(message, engine_process.Light):
            assert now() == (1, 0.5)
            bpy.ops.ed.undo()
            seen.append(now())

    monkeypatch.setattr(answer, "take_estimate", lambda *given, **more: ["", ""])
    heard = operators.BTFSEP_OT_estimate._heard
    monkeypatch.setattr(operators.BTFSEP_OT_estimate, "_heard", hearing)
    bpy.ops.btfsep.estimate()
    assert seen == [(0, 0.5)]


def test_of_a_mesh_that_is_edited_nothing_new_is_left_to_point_to(lit):
    with between_steps.writing():
        made = bpy.data.images.new("Made", 4, 4)
    lit.btfsep.objects[0].mask = made
    bpy.context.view_layer.objects.active = lit.btfsep.objects[0].object
    bpy.ops.object.mode_set(mode="EDIT")
    assert not between_steps.close("Live")
    between_steps._before()
    assert "Made" not in bpy.data.images and lit.btfsep.objects[0].mask is None
    bpy.ops.object.mode_set(mode="OBJECT")


def test_a_picture_that_another_world_has_is_left_to_it(lit):
    scene = lit
    other = scene.world.copy()
    picture = scene.btfsep.light.picture
    kept_light.keep(scene, kept_light.lighting_of(scene.btfsep.light))
    assert scene.btfsep.light.picture != picture == other.btfsep_kept.picture


def test_a_second_map_comes_in_the_image_of_the_first(lit):
    images = []
    for factor in (1, 2):
        again = {"order": 1, "coefficients": (factor * np.ones((4, 3))).tolist()}
        world.apply_lighting(lit, again, mode="TEXTURE", clamp=False)
        (node,) = (each for each in lit.world.node_tree.nodes if each.type == "GROUP")
        image = sh_nodes.map_of(node.node_tree)
        images.append(image)
        assert image == images[0] and image.packed_file
        shown = pixels.colours(image)[::-1]
        assert np.allclose(shown, harmonics.to_map(np.array(again["coefficients"]), *shown.shape[:2]), atol=1e-5)
