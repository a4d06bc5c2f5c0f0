# SPDX-License-Identifier: GPL-3.0-or-later
"""The Sun lamps beside the World: as much light as the whole, made, replaced, taken away, undone, without a window."""

import json
import subprocess
import sys
from pathlib import Path

import bpy
import numpy as np
import pytest
from mathutils import Matrix, Vector

from blender_btfsep.basics.errors import InputError
from blender_btfsep.light import animation, lighting_file, sh_nodes, sun_lamp, world
from btfsep_engine import sh
from btfsep_engine.light.files import Lighting, write_lighting
from btfsep_engine.light.sun import Near, Sun
from tests.blender.lit import white_ball
from tests.blender.sunny import DIRECTION, write_sunny

ROOT = Path(__file__).resolve().parents[2]


def the_lamp(scene):
    (lamp,) = sun_lamp.lamps(scene)
    return lamp


def y_coefficients(made):
    inputs = made.node_tree.nodes["BTFsep SH Lighting"].inputs
    return np.array([tuple(s.default_value) for s in inputs if s.name.startswith("Y ")])


def test_lamp_and_world_light_a_sphere_as_theory_says_and_as_the_whole_does(scene, render, add_camera, sunny):
    path, light = sunny
    normals, inside = white_ball(scene, add_camera, size=48, samples=256)
    lighting = lighting_file.read(path)
    made = world.apply_lighting(scene, lighting)
    assert np.allclose(y_coefficients(made), light.sky, atol=1e-6)
    both = render(scene)
    # the lamp alone is E cos / pi of the irradiance E
    made.node_tree.nodes["BTFsep SH Lighting"].inputs["Strength"].default_value = 0
    alone = render(scene)
    made.node_tree.nodes["BTFsep SH Lighting"].inputs["Strength"].default_value = 1
    cosine = np.maximum(normals @ DIRECTION, 0)
    truth = cosine[..., None] * light.suns[0].irradiance / np.pi
    lit = inside & (cosine > 0.2)
    assert np.abs(alone[lit] / truth[lit] - 1).max() < 0.02
    assert alone[inside & (normals @ DIRECTION < -0.05)].max() < 1e-3
    # with the World it is closed form, too
    truth = truth + sh.irradiance(light.sky, normals) / np.pi
    assert np.abs(both / truth - 1)[inside].mean() < 0.01
    # all of it in the World: no lamp, and as much light on the whole, which a series of order 4 smears a little
    made = world.apply_lighting(scene, lighting, lamp=False, clamp=False)
    assert not sun_lamp.lamps(scene) and np.allclose(y_coefficients(made), light.coefficients, atol=1e-6)
    whole = render(scene)
    assert np.abs(whole[inside].mean(0) / both[inside].mean(0) - 1).max() < 0.02
    assert np.linalg.norm((whole - both)[inside]) < 0.05 * np.linalg.norm(both[inside])


def test_a_lamp_nearby_is_a_point_lamp_that_lights_what_is_said_as_much_and_turns_about_it(
    scene, render, add_camera, tmp_path
):
    normals, inside = white_ball(scene, add_camera, size=48, samples=256)  # of radius 1, about the origin
    centre, distance, strength = (0.3, -0.2, 0.1), 2.5, np.array([3.0, 2.0, 1.0])
    sun = Sun(DIRECTION, strength, np.zeros(3), near=Near(centre, distance, 2.0, 3.0))
    light = Lighting(2, sun.coefficients(2), np.zeros((9, 3)), np.ones(9, bool), 0.0, (sun,))
    write_lighting(tmp_path / "near.json", light)
    made = world.apply_lighting(scene, lighting_file.read(tmp_path / "near.json"))
    place, group = np.array(centre) + distance * DIRECTION, made.node_tree.nodes["BTFsep SH Lighting"]
    lamp = the_lamp(scene)
    assert lamp.data.type == "POINT" and np.allclose(lamp.location, place, atol=1e-6)

    def expected(place):
        to_lamp = place - normals
        far = np.linalg.norm(to_lamp, axis=-1)
        cosine = (normals * to_lamp).sum(-1) / far
        return np.maximum(cosine, 0)[..., None] * strength * (distance / far[..., None]) ** 2 / np.pi, cosine

    group.inputs["Strength"].default_value = 0
    for turned in (0.0, 0.5):  # the World's Rotation carries it about the vertical through the middle
        group.inputs["Rotation"].default_value = turned
        about = np.array(Matrix.Rotation(turned, 3, "Z")) @ (place - centre) + centre
        truth, cosine = expected(about)
        lit = inside & (cosine > 0.25)
        assert np.abs(render(scene)[lit] / truth[lit] - 1).max() < 0.03
    group.inputs["Rotation"].default_value = 0.0
    # as strong as the user has made it, it becomes a Sun where the next light has it far away
    lamp.data.energy *= 2
    write_sunny(tmp_path / "far.json")
    world.apply_lighting(scene, lighting_file.read(tmp_path / "far.json"))
    assert the_lamp(scene) == lamp and lamp.data.type == "SUN" and lamp.data.energy == pytest.approx(6)
    bpy.context.view_layer.update()
    assert np.allclose(np.array(lamp.matrix_world)[:3, 2], DIRECTION, atol=1e-6)
    for wrong in ({"centre": [0, 0], "distance": 1}, {"centre": [0, 0, 0], "distance": 0}, 3):
        data = json.loads((tmp_path / "near.json").read_text())
        data["suns"]["lamps"][0]["near"] = wrong
        (tmp_path / "wrong.json").write_text(json.dumps(data))
        with pytest.raises(InputError, match="near"):
            lighting_file.read(tmp_path / "wrong.json")


def test_the_lamp_can_be_edited_and_is_replaced(scene, sunny, tmp_path):
    path, _ = sunny
    mine = bpy.data.objects.new("Mine", bpy.data.lights.new("Mine", "SUN"))
    scene.collection.objects.link(mine)
    world.apply_lighting(scene, lighting_file.read(path))
    lamp = the_lamp(scene)
    assert lamp.name == "BTFsep Sun" and lamp.data.energy == pytest.approx(3)
    assert np.allclose(lamp.data.color, [1, 2 / 3, 1 / 3]) and lamp.data.angle == pytest.approx(np.radians(0.5))
    bpy.context.view_layer.update()
    assert np.allclose(np.array(lamp.matrix_world)[:3, 2], DIRECTION, atol=1e-6)  # a Sun shines along its -Z
    # three times as strong, without its red, turned about X, at another place: so it stays, of whatever light
    turn = Matrix.Rotation(0.2, 3, "X")
    lamp.name, lamp.data.energy, lamp.location = "Renamed", 9.0, (1, 2, 3)
    lamp.data.color = (0.0, 2 / 3, 1 / 3)
    lamp.rotation_euler = (turn @ lamp.rotation_euler.to_matrix()).to_euler()
    write_sunny(tmp_path / "other.json", direction=[0.0, 0.0, 1.0], irradiance=(1.0, 4.0, 2.0), size=3.0)
    for _ in range(3):
        world.apply_lighting(scene, lighting_file.read(tmp_path / "other.json"), mode="TEXTURE")
        assert the_lamp(scene) == lamp
        assert (lamp.name, round(lamp.data.energy, 4), lamp.location[:]) == ("Renamed", 12.0, (1, 2, 3))
        assert np.allclose(lamp.data.color, [0, 1, 0.5]) and lamp.data.angle == pytest.approx(np.radians(3))
        assert np.allclose(np.array(lamp.rotation_euler.to_matrix())[:, 2], turn @ Vector((0, 0, 1)), atol=1e-5)
    lamp.name = "BTFsep Sun"
    assert sorted(o.name for o in bpy.data.objects) == ["BTFsep Sun", "Mine"] and len(bpy.data.lights) == 2
    # a light without a sun takes the lamp away, and the user's stays
    plain = lighting_file.read(path) | {"suns": None}
    world.apply_lighting(scene, plain)
    assert [o.name for o in bpy.data.objects] == ["Mine"] and len(bpy.data.lights) == 1
    world.apply_lighting(scene, lighting_file.read(path))
    world.restore_previous(scene)
    assert [o.name for o in bpy.data.objects] == ["Mine"]


def test_a_copy_of_a_lamp_is_the_users(scene, lamplit, tmp_path):
    """As an artist makes a rim light: Shift D, turned, another colour."""
    light = lighting_file.read(lamplit[0])
    world.apply_lighting(scene, light)
    ours = sun_lamp.lamps(scene)
    copy = ours[0].copy()
    copy.data = ours[0].data.copy()
    scene.collection.objects.link(copy)
    copy.name, copy.rotation_euler.x, copy.data.energy = "A Rim", 2.0, 7.0  # its name comes before ours
    assert sun_lamp.lamps(scene) == ours and sun_lamp.others(scene) == [copy]
    scene.world[sun_lamp.KEY] = 3.0
    sun_lamp.follow(scene.world)
    assert sun_lamp.lamps(scene) == ours and copy.data.energy == 7
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "rim.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "rim.blend"))  # which numbers all things anew, by their names
    scene, copy = bpy.context.scene, bpy.data.objects["A Rim"]
    assert sun_lamp.others(scene) == [copy]
    for lighting in (light, light, {**light, "suns": None}):
        world.apply_lighting(scene, lighting)
        assert scene.objects.get("A Rim") == copy and copy.data.energy == 7 and copy.rotation_euler.x == 2
    assert sun_lamp.lamps(scene) == [] and sun_lamp.LAMP_TAG not in copy


def test_each_scene_has_its_own(scene, sunny):
    path, _ = sunny
    other = bpy.data.scenes.new("Other")
    for each in (scene, other, scene):
        world.apply_lighting(each, lighting_file.read(path))
    assert the_lamp(scene) != the_lamp(other)
    other.collection.objects.link(the_lamp(scene))  # the user shares it: taken out of one, it stays in the other
    shared = the_lamp(scene)
    world.apply_lighting(scene, lighting_file.read(path) | {"suns": None})
    assert not sun_lamp.lamps(scene) and shared in sun_lamp.lamps(other)


def test_a_sequence_has_all_of_its_light_in_the_world(scene, sunny):
    """Its keyframes have no lamp; one that was there before must not shine on."""
    path, light = sunny
    lighting = lighting_file.read(path)
    world.apply_lighting(scene, lighting)
    made = animation.apply_sequence(scene, [(1, lighting), (5, lighting)])
    assert not sun_lamp.lamps(scene) and np.allclose(y_coefficients(made), light.coefficients, atol=1e-6)


def test_import_panel_and_undo(addon, scene, sunny):
    path, light = sunny
    bpy.ops.ed.undo_push(message="before")
    assert bpy.ops.btfsep.import_lighting(filepath=str(path)) == {"FINISHED"}
    assert np.allclose(y_coefficients(bpy.context.scene.world), light.sky, atol=1e-6)
    the_lamp(bpy.context.scene)
    bpy.ops.ed.undo_push(message="imported")
    bpy.ops.ed.undo()
    assert not bpy.data.objects and not bpy.data.lights and bpy.context.scene.world is None
    bpy.ops.ed.redo()
    the_lamp(bpy.context.scene)
    assert bpy.ops.btfsep.import_lighting(filepath=str(path), lamp=False) == {"FINISHED"}
    assert not sun_lamp.lamps(bpy.context.scene)
    assert np.allclose(y_coefficients(bpy.context.scene.world), light.coefficients, atol=1e-6)


def test_estimate_and_apply_do_as_the_panel_says(photographed, fake_engine, sunny):
    path, light = sunny
    fake_engine(lighting=json.loads(path.read_text()), result={"objects": []})
    assert bpy.ops.btfsep.estimate() == {"FINISHED"}
    the_lamp(photographed)
    photographed.btfsep.sun_lamp = False
    assert bpy.ops.btfsep.apply() == {"FINISHED"}
    assert not sun_lamp.lamps(photographed)
    assert np.allclose(y_coefficients(photographed.world), light.coefficients, atol=1e-6)
    photographed.btfsep.sun_lamp = True
    assert bpy.ops.btfsep.apply() == {"FINISHED"}
    assert np.allclose(y_coefficients(photographed.world), light.sky, atol=1e-6)
    the_lamp(photographed)
    assert bpy.ops.btfsep.restore_world() == {"FINISHED"} and not sun_lamp.lamps(photographed)


def test_several_lamps_and_world_light_a_sphere_as_theory_says_and_as_the_whole_does(
    scene, render, add_camera, lamplit
):
    path, light = lamplit
    normals, inside = white_ball(scene, add_camera, size=48, samples=256)
    lighting = lighting_file.read(path)
    made = world.apply_lighting(scene, lighting)
    assert np.allclose(y_coefficients(made), light.sky, atol=1e-6) and len(sun_lamp.lamps(scene)) == 3
    both = render(scene)
    made.node_tree.nodes["BTFsep SH Lighting"].inputs["Strength"].default_value = 0
    alone = render(scene)
    made.node_tree.nodes["BTFsep SH Lighting"].inputs["Strength"].default_value = 1
    cosines = [np.maximum(normals @ s.direction, 0)[..., None] for s in light.suns]
    truth = sum(c * s.irradiance for c, s in zip(cosines, light.suns, strict=True)) / np.pi
    clear = inside & np.all([np.abs(normals @ s.direction) > 0.1 for s in light.suns], 0) & (truth.min(-1) > 0.05)
    assert clear.sum() > 500 and np.abs(alone[clear] / truth[clear] - 1).max() < 0.03
    truth = truth + sh.irradiance(light.sky, normals) / np.pi
    assert np.abs(both / truth - 1)[inside].mean() < 0.01
    made = world.apply_lighting(scene, lighting, lamp=False, clamp=False)
    assert not sun_lamp.lamps(scene) and np.allclose(y_coefficients(made), light.coefficients, atol=1e-6)
    whole = render(scene)
    assert np.abs(whole[inside].mean(0) / both[inside].mean(0) - 1).max() < 0.02
    assert np.linalg.norm((whole - both)[inside]) < 0.05 * np.linalg.norm(both[inside])


def test_what_stands_beside_the_world_is_said_by_its_kind(scene, tmp_path):
    towards = np.array([[0, 0, 1.0], [1, 0, 0], [0, 1, 0]])
    nears = [Near((0, 0, 0), 2.0, 1.5, 3.0), None, Near((0, 0, 0), 3.0, 2.0, 4.0)]
    for near, words in (
        (nears, ", with 2 Point lamps and one Sun lamp beside it"),
        (nears[:1], ", with one Point lamp beside it"),
    ):
        suns = [Sun(towards[i], np.full(3, 3.0 - i), np.zeros(3), near=each) for i, each in enumerate(near)]
        light = Lighting(2, sum(s.coefficients(2) for s in suns), np.zeros((9, 3)), np.ones(9, bool), 0.0, tuple(suns))
        write_lighting(tmp_path / "kinds.json", light)
        world.apply_lighting(scene, lighting_file.read(tmp_path / "kinds.json"))
        assert sun_lamp.beside(scene) == words


def test_several_lamps_come_and_go_together(scene, sunny, lamplit):
    mine = bpy.data.objects.new("Mine", bpy.data.lights.new("Mine", "SUN"))
    scene.collection.objects.link(mine)
    for _ in range(2):
        world.apply_lighting(scene, lighting_file.read(lamplit[0]))
        made = sun_lamp.lamps(scene)
        # as the file has them: the brightest first
        assert [round(lamp.data.energy, 5) for lamp in made] == [3.0, 2.0, 1.0]
        assert np.allclose(made[1].data.color, [0.25, 0.5, 1]) and made[1].data.angle == pytest.approx(np.radians(5))
        assert np.allclose(np.array(made[1].rotation_euler.to_matrix())[:, 2], [0.8, 0, -0.6], atol=1e-6)
        assert len(bpy.data.lights) == 4
        assert sun_lamp.beside(scene) == ", with 3 Sun lamps beside it"
        bpy.data.lights.remove(made[1].data)  # and its object: the user's right; the others still go
        world.apply_lighting(scene, lighting_file.read(sunny[0]))
        the_lamp(scene)
        assert sun_lamp.beside(scene) == ", with one Sun lamp beside it"
    world.apply_lighting(scene, lighting_file.read(lamplit[0]))
    world.restore_previous(scene)
    assert [o.name for o in bpy.data.objects] == ["Mine"] and not sun_lamp.beside(scene)


def test_several_lamps_are_one_undo(addon, scene, lamplit):
    bpy.ops.ed.undo_push(message="before")
    assert bpy.ops.btfsep.import_lighting(filepath=str(lamplit[0])) == {"FINISHED"}
    assert len(sun_lamp.lamps(bpy.context.scene)) == 3
    bpy.ops.ed.undo_push(message="imported")
    bpy.ops.ed.undo()
    assert not bpy.data.objects and not bpy.data.lights and bpy.context.scene.world is None
    bpy.ops.ed.redo()
    assert len(sun_lamp.lamps(bpy.context.scene)) == 3


def test_the_panel_says_how_many(photographed, fake_engine, sunny, lamplit):
    for path, words in ((lamplit[0], "with 3 Sun lamps beside it"), (sunny[0], "with one Sun lamp beside it")):
        light = json.loads(path.read_text())
        order = light["order"]
        fake_engine(lighting=light, result={"objects": []})
        assert bpy.ops.btfsep.estimate() == {"FINISHED"}
        assert f"The World is now the lighting of order {order}, {words}" in bpy.context.window_manager.btfsep.summary
    photographed.btfsep.sun_lamp = False
    assert bpy.ops.btfsep.estimate() == {"FINISHED"}
    assert "lamp" not in bpy.context.window_manager.btfsep.summary


def test_a_file_with_one_sun_from_before_there_could_be_several(scene, lamplit):
    path, light = lamplit
    data = json.loads(path.read_text())
    del data["suns"]
    data["sun"] |= {"widest_degrees": 4.0, "evidence": 30.0}
    made = world.apply_lighting(scene, lighting_file.validate(data))
    assert the_lamp(scene).data.energy == pytest.approx(3)
    assert np.allclose(y_coefficients(made), light.without(light.suns[:1]), atol=1e-6)


DRIVER = """
import sys
sys.path.insert(0, sys.argv[1])
import blender_btfsep
blender_btfsep.register()
status = blender_btfsep.command.main(sys.argv[2:])
blender_btfsep.unregister()
sys.exit(status)
"""


@pytest.mark.parametrize(("where", "lamps"), [(None, 3), ("lamp", 3), ("world", 0)])
def test_without_a_window(lamplit, tmp_path, where, lamps):
    options = ["--sun", where] if where else []
    saved = tmp_path / "lit.blend"
    command = [sys.executable, "-c", DRIVER, str(ROOT), "apply", str(lamplit[0]), "--save", str(saved), *options]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 0, done.stderr
    assert ("with 3 Sun lamps beside it" in done.stdout + done.stderr) == bool(lamps)
    bpy.ops.wm.open_mainfile(filepath=str(saved))
    assert len(sun_lamp.lamps(bpy.context.scene)) == lamps


def shines_from(lamp):
    """The direction of a lamp's light as the scene is evaluated, drivers and all."""
    bpy.context.view_layer.update()
    there = lamp.evaluated_get(bpy.context.evaluated_depsgraph_get())
    return np.array(there.matrix_world)[:3, 2]


@pytest.mark.parametrize("mode", ["NODES", "TEXTURE"])
def test_one_rotation_turns_world_and_lamps(addon, scene, lamplit, tmp_path, mode):
    path, light = lamplit
    made = world.apply_lighting(scene, lighting_file.read(path), mode=mode)
    made.btfsep.rotation = 0.9
    turn = np.array(Matrix.Rotation(0.9, 3, "Z"))
    wanted = sorted((turn @ sun.direction).tolist() for sun in light.suns)
    assert np.allclose(sorted(shines_from(lamp).tolist() for lamp in sun_lamp.lamps(scene)), wanted, atol=1e-5)
    # by the node itself, too; another light and a reopened file do not lose it
    sh_nodes.node_of(made.node_tree).inputs["Rotation"].default_value = 0.4
    assert made.btfsep.rotation == pytest.approx(0.4)
    other = {"NODES": "TEXTURE", "TEXTURE": "NODES"}[mode]
    world.apply_lighting(scene, lighting_file.read(path), mode=other)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "a.blend"))
    turn = np.array(Matrix.Rotation(0.4, 3, "Z"))
    wanted = sorted((turn @ sun.direction).tolist() for sun in light.suns)
    found = sorted(shines_from(lamp).tolist() for lamp in sun_lamp.lamps(bpy.context.scene))
    assert np.allclose(found, wanted, atol=1e-5)


def test_key_fill_tint_and_saturation(addon, scene, sunny, tmp_path):
    path, light = sunny
    sliders = world.apply_lighting(scene, lighting_file.read(path)).btfsep
    lamp = the_lamp(scene)
    lamp.data.energy *= 2  # the user's, and kept by all that follows
    sliders.key, sliders.fill, sliders.tint, sliders.saturation = 0.5, 3.0, (0.5, 1.0, 1.0), 0.25
    grey = light.suns[0].irradiance @ [0.2126, 0.7152, 0.0722]
    wanted = 2 * 0.5 * (0.75 * grey + 0.25 * light.suns[0].irradiance) * [0.5, 1.0, 1.0]

    def assert_so(lamp, sliders):
        assert np.allclose(lamp.data.energy * np.array(lamp.data.color), wanted, rtol=1e-4)
        assert sliders.fill == sh_nodes.node_of(sliders.id_data.node_tree).inputs["Strength"].default_value == 3.0
        assert sliders.key == 0.5 and np.allclose(sliders.tint, (0.5, 1, 1)) and sliders.saturation == 0.25

    assert_so(lamp, sliders)
    world.apply_lighting(scene, lighting_file.read(path))
    assert_so(lamp, sliders)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "a.blend"))
    lamp, sliders = the_lamp(bpy.context.scene), bpy.context.scene.world.btfsep
    assert_so(lamp, sliders)
    sliders.key = 0
    assert lamp.data.energy == 0
    sliders.key = 0.5  # from nothing back to what it was
    assert_so(lamp, sliders)


def test_sliders_of_a_world_that_is_not_ours_are_at_rest(addon, scene):
    mine = bpy.data.worlds.new("Mine")
    mine.use_nodes = True
    mine.btfsep.rotation = mine.btfsep.fill = 2.0
    mine.btfsep.tint = (0, 0, 0)
    assert (mine.btfsep.rotation, mine.btfsep.fill, tuple(mine.btfsep.tint)) == (0, 1, (1, 1, 1))
