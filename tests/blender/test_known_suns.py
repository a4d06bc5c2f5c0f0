# SPDX-License-Identifier: GPL-3.0-or-later
"""Suns whose direction is known: what a job says of them; an estimate neither moves nor loses them; undo, live."""

import json

import bpy
import numpy as np
import pytest
from mathutils import Vector

from blender_btfsep import command
from blender_btfsep.light import lighting_file, sun_lamp, world
from blender_btfsep.run import answer, request, runs
from blender_btfsep.window import known_suns, live
from btfsep_engine import sh
from btfsep_engine.job.load import load_job
from btfsep_engine.light.files import Lighting, write_lighting
from btfsep_engine.light.sun import Sun

FOUND = np.array([-0.6, -0.48, 0.64])
DIRECTION = Vector((0.3, -0.8, 0.5)).normalized()  # where the user turns it


def light_of(path, *suns):
    """A lighting.json of the engine, read."""
    x = sum((s.coefficients(4) for s in suns), np.eye(sh.term_count(4))[:, :1] * np.ones(3))
    write_lighting(path, Lighting(4, x, np.zeros_like(x), np.ones(len(x), bool), suns=suns))
    return lighting_file.read(path)


def sun(direction, power=2.0, **more):
    return Sun(np.asarray(direction), [power] * 3, np.zeros(3), **more)


def shines_from(lamp):
    bpy.context.view_layer.update()
    return np.array(lamp.matrix_world)[:3, 2] / np.linalg.norm(np.array(lamp.matrix_world)[:3, 2])


def told(scene, folder):
    """Directions of the known lamps in the job of the panel, as the engine reads it."""
    return [lamp.direction for lamp in load_job(request.write_job(scene, folder=folder)).known_lamps]


@pytest.fixture
def lamp(photographed, tmp_path):
    """The Sun lamp of an estimate, which the user has turned, and the World beside it by half a radian."""
    world.apply_lighting(photographed, light_of(tmp_path / "first.json", sun(FOUND), sun((0, 0, 1), 1.0)))
    first = max(sun_lamp.lamps(photographed), key=lambda thing: thing.data.energy)
    first.rotation_euler = sun_lamp.facing(DIRECTION).to_euler()
    world_node = photographed.world.node_tree.nodes["BTFsep SH Lighting"]
    world_node.inputs["Rotation"].default_value = 0.5
    bpy.context.view_layer.update()
    return first


def test_a_job_has_a_known_sun_as_it_stands_without_the_turn_of_the_world(photographed, lamp, tmp_path):
    assert told(photographed, tmp_path / "none") == []
    assert bpy.ops.btfsep.freeze_sun(name=lamp.name) == {"FINISHED"}
    assert bpy.ops.btfsep.freeze_sun(name=lamp.name) == {"FINISHED"}  # it is known already
    (direction,) = told(photographed, tmp_path / "ours")
    np.testing.assert_allclose(direction, DIRECTION, atol=1e-6)
    assert not np.allclose(shines_from(lamp), DIRECTION, atol=0.1)  # the World has turned it
    # one of the user's own, on a parent: as it is seen beside a light that is turned
    parent = bpy.data.objects.new("Parent", None)
    own = bpy.data.objects.new("Own", bpy.data.lights.new("Own", "SUN"))
    for thing in (parent, own):
        photographed.collection.objects.link(thing)
    own.parent, parent.rotation_euler = parent, (0.9, 0.2, 0.4)
    bpy.context.view_layer.update()
    assert bpy.ops.btfsep.freeze_sun(name="Own") == {"FINISHED"}
    turn = np.array([[np.cos(0.5), np.sin(0.5), 0], [-np.sin(0.5), np.cos(0.5), 0], [0, 0, 1]])
    np.testing.assert_allclose(told(photographed, tmp_path / "two")[1], turn @ shines_from(own), atol=1e-6)
    assert bpy.ops.btfsep.free_sun(name=lamp.name) == {"FINISHED"}
    assert [thing.name for thing in sun_lamp.known_suns(photographed)] == ["Own"]


def test_an_estimate_neither_moves_nor_loses_it_and_makes_it_as_bright_as_found(photographed, lamp, tmp_path):
    bpy.ops.btfsep.freeze_sun(name=lamp.name)
    before, matrix = shines_from(lamp), np.array(lamp.matrix_world)
    (direction,) = told(photographed, tmp_path / "job")
    for power in (5.0, 3.0):
        # another, brighter lamp stands nearer to where this one once was found
        lights = sun(direction, power, given=True), sun(FOUND, 9.0), sun((0, 0, 1), 1.0)
        world.apply_lighting(photographed, light_of(tmp_path / "next.json", *lights))
        np.testing.assert_allclose(shines_from(lamp), before, atol=1e-6)
        np.testing.assert_allclose(np.array(lamp.matrix_world), matrix, atol=1e-5)
        assert lamp.data.energy == pytest.approx(power) and len(sun_lamp.lamps(photographed)) == 3
        np.testing.assert_allclose(told(photographed, tmp_path / "again"), [direction], atol=1e-6)
    # too little of the light to be told apart: it is in the World, and the lamp stays, dark
    world.apply_lighting(photographed, light_of(tmp_path / "none.json", sun(FOUND)))
    assert lamp.name in photographed.objects and len(sun_lamp.lamps(photographed)) == 2
    world.apply_lighting(photographed, light_of(tmp_path / "back.json", sun(direction, 4.0, given=True)))
    assert lamp.data.energy == pytest.approx(4.0) and len(sun_lamp.lamps(photographed)) == 1
    world.apply_lighting(photographed, light_of(tmp_path / "all.json", sun(direction, given=True)), lamp=False)
    assert lamp.data.energy == 0 and np.allclose(shines_from(lamp), before, atol=1e-6)
    # freed, it goes with the light as any other does
    bpy.ops.btfsep.free_sun(name=lamp.name)
    world.apply_lighting(photographed, light_of(tmp_path / "last.json"))
    assert not sun_lamp.lamps(photographed)


def test_a_lamp_that_the_light_knows_nothing_of_is_told_from_ours_and_from_a_known_one(photographed, lamp):
    assert not sun_lamp.others(photographed)
    mine = bpy.data.objects.new("Mine", bpy.data.lights.new("Mine", "SUN"))
    photographed.collection.objects.link(mine)
    assert sun_lamp.others(photographed) == [mine]
    bpy.ops.btfsep.freeze_sun(name="Mine")
    assert not sun_lamp.others(photographed)
    bpy.ops.btfsep.free_sun(name="Mine")
    mine.hide_render = True
    assert not sun_lamp.others(photographed)


def test_the_previous_world_comes_back_without_it(photographed, lamp):
    bpy.ops.btfsep.freeze_sun(name=lamp.name)
    assert bpy.ops.btfsep.restore_world() == {"FINISHED"}
    assert not sun_lamp.known_suns(photographed) and not sun_lamp.lamps(photographed)


def test_freezing_is_undone(photographed, lamp):
    name, scene = lamp.name, photographed.name
    bpy.ops.ed.undo_push(message="before")
    bpy.ops.btfsep.freeze_sun(name=name)
    bpy.ops.ed.undo_push(message="frozen")
    bpy.ops.ed.undo()
    assert not sun_lamp.known_suns(bpy.data.scenes[scene])
    bpy.ops.ed.redo()
    assert [thing.name for thing in sun_lamp.known_suns(bpy.data.scenes[scene])] == [name]


def test_what_is_no_sun_is_refused(photographed):
    point = bpy.data.objects.new("Point", bpy.data.lights.new("Point", "POINT"))
    photographed.collection.objects.link(point)
    for name in ("Point", photographed.camera.name, "none"):
        with pytest.raises(RuntimeError, match="no Sun lamp"):
            bpy.ops.btfsep.freeze_sun(name=name)
    for i in range(known_suns.MOST):
        one = bpy.data.objects.new(f"Sun {i}", bpy.data.lights.new(f"Sun {i}", "SUN"))
        photographed.collection.objects.link(one)
        bpy.ops.btfsep.freeze_sun(name=one.name)
    more = bpy.data.objects.new("More", bpy.data.lights.new("More", "SUN"))
    photographed.collection.objects.link(more)
    with pytest.raises(RuntimeError, match="there are 8"):
        bpy.ops.btfsep.freeze_sun(name="More")


def test_without_a_window_suns_are_named(photographed, lamp, tmp_path, capsys):
    job = tmp_path / "job" / "job.json"

    def exported(*more):
        status = command.main(["export", "--job", str(job.parent), *more])
        return json.loads(job.read_text()).get("known_lamps") if status == 0 else status

    np.testing.assert_allclose(exported("--known-sun", lamp.name)[0]["direction"], DIRECTION, atol=1e-6)
    assert exported() is None and not sun_lamp.known_suns(photographed)
    bpy.ops.btfsep.freeze_sun(name=lamp.name)
    assert len(exported()) == 1 and exported("--known-sun") is None
    assert exported("--known-sun", photographed.camera.name) == 2 and "it is no Sun lamp" in capsys.readouterr().err


def test_turning_a_frozen_sun_is_a_change_and_an_estimate_of_it_is_none(photographed, lamp, tmp_path, monkeypatch):
    bpy.ops.btfsep.freeze_sun(name=lamp.name)
    seen = []
    monkeypatch.setattr(live._follower, "changed", lambda scene, what: seen.append(scene.name))
    light = light_of(tmp_path / "light.json", sun(told(photographed, tmp_path / "job")[0], given=True))
    answer.apply_light(photographed, light)
    bpy.context.view_layer.update()
    photographed.btfsep.live = True
    answer.apply_light(photographed, light)
    lamp.data.energy = 7.0
    bpy.context.view_layer.update()
    assert not seen
    lamp.rotation_euler.x += 0.2
    bpy.context.view_layer.update()
    assert seen
    bpy.ops.btfsep.free_sun(name=lamp.name)
    bpy.context.view_layer.update()
    count = len(seen)
    lamp.rotation_euler.x += 0.2
    bpy.context.view_layer.update()
    assert len(seen) == count and not runs.is_running()
