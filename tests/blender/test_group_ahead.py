# SPDX-License-Identifier: GPL-3.0-or-later
"""The node group that is made while the engine works: the same as at once, used, and never in the way of undo."""

import bpy
import pytest

from blender_btfsep.light import group_ahead, sh_nodes, world
from blender_btfsep.run import between_steps
from blender_btfsep.window import operators
from tests.blender.lit import LIGHTING, lighting, random_coefficients


def content(tree):
    """What a tree computes: its nodes with what is set in them, its links."""

    def values(node):
        return [
            tuple(s.default_value) if hasattr(s.default_value, "__len__") else s.default_value
            for s in node.inputs
            if hasattr(s, "default_value") and not s.is_linked
        ]

    nodes = [(node.name, node.bl_idname, getattr(node, "operation", ""), values(node)) for node in tree.nodes]
    ends = [(k.from_node.name, k.from_socket.identifier, k.to_node.name, k.to_socket.identifier) for k in tree.links]
    return nodes, sorted(ends), [item.name for item in tree.interface.items_tree]


def begun(order, monkeypatch):
    """A group of which a piece is made."""
    monkeypatch.setattr(group_ahead, "PIECE", 0.0)
    assert not group_ahead.go_on(order)
    (uid,) = group_ahead.waiting()
    return next(tree for tree in bpy.data.node_groups if tree.session_uid == uid)


def test_a_group_in_pieces_is_that_which_is_built_at_once(addon, scene, monkeypatch):
    monkeypatch.setattr(group_ahead, "PIECE", 1e-4)
    count = 1
    while not group_ahead.go_on(3):
        count += 1
    made = group_ahead.take(3)
    assert count > 1 and content(made) == content(sh_nodes.build_group(3)) and not group_ahead.waiting()


@pytest.mark.parametrize("asked", [2, 3])
def test_a_light_takes_what_was_begun_where_it_is_of_its_order(addon, scene, monkeypatch, asked):
    tree = begun(3, monkeypatch)
    uid = tree.session_uid
    made = world.apply_lighting(scene, lighting(random_coefficients(asked)))
    used = sh_nodes.node_of(made.node_tree).node_tree
    assert (used.session_uid == uid) == (asked == 3) and content(used) == content(sh_nodes.build_group(asked))
    assert [tree.users for tree in bpy.data.node_groups].count(0) == 1  # the one to compare with
    assert not world.needs_group(scene, asked) and world.needs_group(scene, 4)


def test_what_the_user_has_purged_is_begun_anew(addon, scene, monkeypatch):
    bpy.data.node_groups.remove(begun(3, monkeypatch))
    assert not group_ahead.go_on(3) and content(group_ahead.take(3)) == content(sh_nodes.build_group(3))


def test_a_step_back_leaves_nothing_half_made_in_hand(addon, scene, monkeypatch):
    """Where a step has some of it, that is there after the step back, but none of what was held of it."""
    bpy.ops.ed.undo_push(message="one")
    begun(3, monkeypatch)
    bpy.ops.ed.undo_push(message="two")
    monkeypatch.setattr(group_ahead, "PIECE", 1e-4)
    group_ahead.go_on(3)
    bpy.ops.ed.undo_push(message="three")
    bpy.ops.ed.undo()
    assert len(bpy.data.node_groups) == 1 and group_ahead.waiting() == set() and not group_ahead.go_on(3)
    bpy.ops.ed.redo()
    made = world.apply_lighting(bpy.context.scene, lighting(random_coefficients(3)))
    assert content(sh_nodes.node_of(made.node_tree).node_tree) == content(sh_nodes.build_group(3))


def test_a_light_in_a_group_made_ahead_is_a_step_of_undo(addon, scene, monkeypatch):
    bpy.ops.ed.undo_push(message="none")
    world.apply_lighting(scene, lighting(random_coefficients(2)))
    bpy.ops.ed.undo_push(message="a light")
    begun(3, monkeypatch)
    with between_steps.writing(group_ahead.waiting()):
        world.apply_lighting(scene, lighting(random_coefficients(3)))
    assert between_steps.is_open()  # the World, which was there, points to what no step has
    bpy.ops.ed.undo()
    assert not world.needs_group(bpy.context.scene, 2)


def test_an_estimate_makes_it_meanwhile_and_leaves_none(photographed, fake_engine, monkeypatch):
    photographed.btfsep.order, seen = 5, []
    heard = operators.BTFSEP_OT_estimate._heard

    def hearing(self, message):
        heard(self, message)
        self.meanwhile()
        seen.append(len(group_ahead.waiting()))

    monkeypatch.setattr(operators.BTFSEP_OT_estimate, "_heard", hearing)
    fake_engine(lighting=LIGHTING, lines=[{"type": "warning", "message": "dark"}], result={})
    assert bpy.ops.btfsep.estimate() == {"FINISHED"}
    assert seen == [1] and not group_ahead.waiting() and all(tree.users for tree in bpy.data.node_groups)
