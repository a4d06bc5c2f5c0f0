# SPDX-License-Identifier: GPL-3.0-or-later
"""The World against the engine's harmonics, rendered by Cycles."""

import bpy
import numpy as np
import pytest
from mathutils import Matrix

from blender_btfsep.basics import colour, harmonics
from blender_btfsep.basics.errors import InputError
from blender_btfsep.light import animation, sh_nodes, world
from btfsep_engine import conventions, sh
from btfsep_engine.light import positivity
from tests.blender.lit import lighting, look_around, positive_coefficients, random_coefficients, white_ball


def test_recurrence_equals_the_engines():
    directions = np.concatenate([conventions.fibonacci_sphere(400), np.eye(3), -np.eye(3)])
    assert np.abs(harmonics.evaluate(9, directions) - sh.evaluate(9, directions)).max() < 1e-12
    c = random_coefficients(5)
    assert np.abs(harmonics.to_map(c, 16, 32) - sh.to_map(c, 16, 32)).max() < 1e-12


@pytest.mark.parametrize("order", [0, 1, 4, 9])
def test_nodes_show_every_term(scene, render, order):
    """Random coefficients, so a wrong sign, place or size of any (l, m) shows."""
    look_around(scene)
    c = random_coefficients(order, seed=order)
    world.apply_lighting(scene, lighting(c), clamp=False)
    truth = sh.to_map(c, 64, 128)
    assert np.abs(render(scene) - truth).max() < 1e-3 * np.abs(truth).max()
    # the tester: one coefficient with the wrong sign must be seen
    wrong = c.copy()
    wrong[-1] *= -1
    assert np.abs(sh.to_map(wrong, 64, 128) - truth).max() > 0.02 * np.abs(truth).max()


def lamp_and_sky(order):
    """A warm lamp on a blue sky, cut off at ``order``: it rings."""
    d = conventions.pixel_directions(64, 128)
    lamp = np.exp(((d @ [0.48, -0.6, 0.64]) - 1) / 0.02)[..., None] * [30.0, 22.0, 15.0]
    return sh.project_map(lamp + (0.6 + 0.4 * d[..., 2:]) * [0.6, 0.8, 1.0], order)


def test_what_keeps_a_light_from_being_negative_is_the_engines():
    assert np.array_equal(harmonics.LUMINANCE, conventions.REC709_LUMINANCE)
    for order in (0, 1, 2, 4, 9, 12):
        assert np.allclose(harmonics.positive_window(order), positivity.positive_window(order), atol=1e-12)
        for c in (lamp_and_sky(order), random_coefficients(order, seed=order)):
            assert np.allclose(harmonics.positive_share(c), positivity.positive_share(c), rtol=1e-9)
            theirs = positivity.positive_radiance(c, conventions.pixel_directions(32, 64))
            assert np.allclose(harmonics.positive_map(c, 32, 64), theirs, atol=1e-9)


@pytest.mark.parametrize("order", [1, 4, 9])
def test_nodes_and_texture_show_the_light_that_the_engine_makes_of_a_series(scene, render, order):
    """Rendered by Cycles: the node group, the baked map, and the engine's own function."""
    look_around(scene)
    c = lamp_and_sky(order)
    assert sh.to_map(c, 64, 128).min() < 0 < positivity.positive_share(c)[0]
    truth = positivity.positive_radiance(c, conventions.pixel_directions(64, 128))
    world.apply_lighting(scene, lighting(c), mode="NODES")
    nodes = render(scene)
    assert nodes.min() >= 0 and np.abs(nodes - truth).max() < 1e-3 * truth.max()
    world.apply_lighting(scene, lighting(c), mode="TEXTURE")
    texture = render(scene)
    assert texture.min() >= 0 and np.abs(texture - truth).max() < 5e-3 * truth.max()
    # the amount of light is that of the series, not that of the series with its negative part cut off
    whole = c[0] @ conventions.REC709_LUMINANCE
    assert sh.project_map(nodes, 0)[0] @ conventions.REC709_LUMINANCE == pytest.approx(whole, rel=5e-3)
    cut = sh.project_map(np.maximum(sh.to_map(c, 64, 128), 0), 0)[0] @ conventions.REC709_LUMINANCE
    assert order == 9 or cut > 1.015 * whole


def most_alive(tree) -> int:
    """Floats that are in use at once, where nodes are computed as the output asks for them, first inputs first."""
    order = []

    def visit(node):
        for socket in node.inputs:
            for link in socket.links:
                if link.from_node not in order and link.from_node.type != "GROUP_INPUT":
                    visit(link.from_node)
        order.append(node)

    visit(next(node for node in tree.nodes if node.type == "GROUP_OUTPUT"))
    last = {s: max(order.index(link.to_node) for link in s.links) for n in order for s in n.outputs if s.links}
    wide = {s: 1 if s.type == "VALUE" else 3 for s in last}
    return max(sum(wide[s] for s in last if order.index(s.node) <= at <= last[s]) for at in range(len(order)))


def test_the_highest_order_leaves_room_on_the_stack_of_cycles():
    """It has 255 floats; Blender 5 computes what the output asks for, not what was made first."""
    assert most_alive(sh_nodes.build_group(sh_nodes.MAX_NODE_ORDER)) < 128


def test_texture_above_the_order_of_the_nodes(scene, render):
    look_around(scene)
    c = random_coefficients(12) / np.repeat(np.arange(13) + 1, 2 * np.arange(13) + 1)[:, None]
    with pytest.raises(InputError, match="apply it as a texture"):
        world.apply_lighting(scene, lighting(c))
    world.apply_lighting(scene, lighting(c), mode="TEXTURE", clamp=False)
    truth = sh.to_map(c, 64, 128)
    assert np.abs(render(scene) - truth).max() < 5e-3 * np.abs(truth).max()


@pytest.mark.parametrize("mode", ["NODES", "TEXTURE"])
def test_rotation_turns_the_light_counter_clockwise(scene, render, mode):
    look_around(scene)
    c = random_coefficients(3, seed=3)
    made = world.apply_lighting(scene, lighting(c), mode=mode, clamp=False)
    angle = 0.7
    sh_nodes.node_of(made.node_tree).inputs["Rotation"].default_value = angle
    turned = sh.rotation_matrix(3, np.array(Matrix.Rotation(angle, 3, "Z"))) @ c
    truth = sh.to_map(turned, 64, 128)
    assert np.abs(render(scene) - truth).max() < 3e-3 * np.abs(truth).max()


def test_strength_and_edited_coefficients_take_effect(scene, render):
    look_around(scene)
    c = random_coefficients(2, seed=5)
    made = world.apply_lighting(scene, lighting(c), clamp=False)
    inputs = made.node_tree.nodes["BTFsep SH Lighting"].inputs
    inputs["Strength"].default_value = 2.5
    c[5] = inputs["Y 2 -1"].default_value = (0.5, -1.5, 0.25)
    truth = 2.5 * sh.to_map(c, 64, 128)
    assert np.abs(render(scene) - truth).max() < 1e-3 * np.abs(truth).max()


@pytest.mark.parametrize(
    ("axis", "mode"), [(None, "NODES"), ("X", "NODES"), ("Y", "NODES"), ("Z", "NODES"), (None, "TEXTURE")]
)
def test_white_sphere_under_the_world_is_shaded_as_theory_says(scene, render, add_camera, axis, mode):
    """A white matte sphere, path-traced by Cycles, against the closed form, within 1 %; turned about all axes."""
    c = positive_coefficients(4, seed=11)
    if axis:
        c = sh.rotation_matrix(4, np.array(Matrix.Rotation(1.1, 3, axis))) @ c
    world.apply_lighting(scene, lighting(c), mode=mode)
    normals, inside = white_ball(scene, add_camera, size=48, samples=256)
    picture = render(scene)
    truth = sh.irradiance(c, normals) / np.pi
    error = (picture - truth)[inside]
    assert np.sqrt((error**2).mean()) < 0.01 * np.sqrt((truth[inside] ** 2).mean())
    # and without bias, region by region: the noise of single pixels averaged away
    x = np.linspace(-1.1, 1.1, 48)
    px, py = np.meshgrid(x, -x)
    for part in (px < -0.4, px > 0.4, py < -0.4, py > 0.4):
        where = inside & part
        assert np.abs(picture[where].mean(0) / truth[where].mean(0) - 1).max() < 0.01


def test_second_run_replaces_and_nothing_piles_up(scene):
    user = bpy.data.worlds.new("Mine")
    scene.world = user
    first = world.apply_lighting(scene, lighting(random_coefficients(4)))
    for mode in ("TEXTURE", "NODES", "NODES", "TEXTURE", "NODES"):
        again = world.apply_lighting(scene, lighting(random_coefficients(3, seed=2)), mode=mode)
        assert again == first and scene.world == first
    assert [w.name for w in bpy.data.worlds] == ["BTFsep Lighting", "Mine"]
    assert [g.name for g in bpy.data.node_groups] == ["BTFsep SH Lighting"]
    assert not bpy.data.images
    assert user.use_fake_user and not world.is_ours(user)

    assert world.restore_previous(scene) == user
    assert scene.world == user and not user.use_fake_user
    assert len(bpy.data.worlds) == 1 and not bpy.data.node_groups


def test_the_users_world_is_kept_untouched_and_saved(scene, tmp_path):
    user = bpy.data.worlds.new("Mine")
    user.use_nodes = True
    user.node_tree.nodes["Background"].inputs["Strength"].default_value = 0.125
    scene.world = user
    world.apply_lighting(scene, lighting(random_coefficients(1)), mode="TEXTURE")
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "saved.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "saved.blend"))
    scene = bpy.context.scene
    assert bpy.data.worlds["Mine"].node_tree.nodes["Background"].inputs["Strength"].default_value == 0.125
    image = bpy.data.images["BTFsep Lighting Map"]
    assert image.packed_file is not None and image.size[:] == (512, 256)
    assert world.restore_previous(scene) == bpy.data.worlds["Mine"]


def test_a_world_chosen_by_the_user_after_ours_is_not_touched(scene):
    world.apply_lighting(scene, lighting(random_coefficients(1)))
    mine = bpy.data.worlds.new("Mine")
    scene.world = mine
    made = world.apply_lighting(scene, lighting(random_coefficients(1)))
    assert made != mine and made["btfsep_previous_world"] == mine
    assert sorted(w.name for w in bpy.data.worlds) == sorted([made.name, "Mine"])


def test_restore_without_one_of_ours_is_refused(scene):
    scene.world = bpy.data.worlds.new("Mine")
    with pytest.raises(InputError, match="not made by BTFsep"):
        world.restore_previous(scene)
    assert scene.world.name == "Mine"


def ours(scene):
    return sh_nodes.node_of(scene.world.node_tree)


def set_by_the_user(scene):
    """Strength, a rotation and a tint, nodes before and after ours, a key: all of it the user's."""
    tree = scene.world.node_tree
    node = ours(scene)
    node.inputs["Strength"].default_value, node.inputs["Rotation"].default_value = 2.5, 0.7
    value = tree.nodes.new("ShaderNodeRGB")
    value.name, value.outputs[0].default_value = "My Tint", (1.0, 0.5, 0.25, 1.0)
    tree.links.new(value.outputs[0], node.inputs["Tint"])
    gamma = tree.nodes.new("ShaderNodeGamma")
    gamma.name, gamma.inputs["Gamma"].default_value = "My Gamma", 1.5
    tree.links.new(node.outputs[0], gamma.inputs["Color"])
    tree.links.new(gamma.outputs[0], tree.nodes["Background"].inputs["Color"])
    node.inputs["Saturation"].keyframe_insert("default_value", frame=3)


def assert_still_set(scene):
    tree, node = scene.world.node_tree, ours(scene)
    assert (node.inputs["Strength"].default_value, round(node.inputs["Rotation"].default_value, 5)) == (2.5, 0.7)
    assert node.inputs["Tint"].links[0].from_node.name == "My Tint"
    assert [link.to_node.name for link in node.outputs[0].links] == ["My Gamma"]
    assert tree.nodes["Background"].inputs["Color"].links[0].from_node.name == "My Gamma"
    paths = [c.data_path for c in animation.fcurves(tree.animation_data)]
    assert paths == [node.inputs["Saturation"].path_from_id("default_value")]


def test_another_light_keeps_what_the_user_has_set_and_built(scene, tmp_path):
    world.apply_lighting(scene, lighting(random_coefficients(1)))
    set_by_the_user(scene)
    for order, mode in ((2, "NODES"), (3, "TEXTURE"), (1, "TEXTURE"), (4, "NODES")):
        c = random_coefficients(order, seed=order)
        world.apply_lighting(scene, lighting(c), mode=mode)
        assert_still_set(scene)
    assert np.allclose(ours(scene).inputs["Y 4 +2"].default_value, c[4 * 4 + 4 + 2])
    animation.apply_sequence(scene, [(n, lighting(random_coefficients(1, seed=n)) | {"suns": None}) for n in (1, 2)])
    assert len(animation.fcurves(scene.world.node_tree.animation_data)) == 3 * 4 + 2 + 1
    world.apply_lighting(scene, lighting(random_coefficients(2)))
    assert_still_set(scene)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "kept.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "kept.blend"))
    assert_still_set(bpy.context.scene)
    assert len(bpy.data.node_groups) == 1 and not bpy.data.images


def test_a_light_of_the_same_order_keeps_the_group(scene):
    world.apply_lighting(scene, lighting(random_coefficients(2)), clamp=False)
    group = ours(scene).node_tree
    c = random_coefficients(2, seed=7)
    world.apply_lighting(scene, lighting(c), clamp=False)
    assert ours(scene).node_tree == group and ours(scene).inputs["Clamp Negative"].default_value == 0
    places = [(l, m) for l in range(3) for m in range(-l, l + 1)]
    assert np.allclose([ours(scene).inputs[sh_nodes.coefficient_name(*p)].default_value for p in places], c)
    world.apply_lighting(scene, lighting(random_coefficients(3)))
    assert [g.name for g in bpy.data.node_groups] == ["BTFsep SH Lighting"] and len(ours(scene).inputs) == 6 + 16


def test_a_world_without_our_node_is_the_users(scene):
    made = world.apply_lighting(scene, lighting(random_coefficients(1)))
    made.node_tree.nodes.remove(ours(scene))
    made.node_tree.nodes.new("ShaderNodeRGB")
    again = world.apply_lighting(scene, lighting(random_coefficients(1)))
    assert again != made and not world.is_ours(made) and len(made.node_tree.nodes) == 3
    assert world.restore_previous(scene) == made


@pytest.mark.parametrize("mode", ["NODES", "TEXTURE"])
def test_tint_and_saturation(scene, render, mode):
    look_around(scene)
    c = positive_coefficients(2, seed=4)
    world.apply_lighting(scene, lighting(c), mode=mode)
    inputs = ours(scene).inputs
    inputs["Tint"].default_value, inputs["Saturation"].default_value = (1.0, 0.5, 0.25, 1.0), 0.3
    whole = sh.to_map(c, 64, 128)
    grey = (whole @ conventions.REC709_LUMINANCE)[..., None]
    truth = (0.7 * grey + 0.3 * whole) * [1.0, 0.5, 0.25]
    assert np.abs(render(scene) - truth).max() < 5e-3 * truth.max()
    assert np.allclose(colour.adjusted(whole, tint=(1.0, 0.5, 0.25), saturation=0.3), truth)


def test_a_world_that_another_scene_has_too_stays_that_scenes(scene):
    """A scene that was made as a linked copy has the World of the first, until it has a light of its own."""
    first = positive_coefficients(1, seed=1)
    world.apply_lighting(scene, lighting(first))
    node = ours(scene)
    node.inputs["Strength"].default_value = 2
    node.inputs["Strength"].keyframe_insert("default_value", frame=3)
    node.inputs["Y 0 0"].keyframe_insert("default_value", frame=3)
    before = scene.world
    bpy.ops.scene.new(type="LINK_COPY")
    other = bpy.context.scene
    assert other != scene and other.world == before
    world.apply_lighting(other, lighting(2 * first))
    assert scene.world == before and other.world != before and world.is_ours(other.world)
    for each, factor in ((scene, 1), (other, 2)):
        inputs = ours(each).inputs
        assert np.allclose(inputs["Y 0 0"].default_value[:3], factor * first[0], atol=1e-6)
        assert inputs["Strength"].default_value == 2
    paths = [{c.data_path for c in animation.fcurves(s.world.node_tree.animation_data)} for s in (scene, other)]
    assert len(paths[0]) == 2 and len(paths[1]) == 1 and paths[1] < paths[0]
