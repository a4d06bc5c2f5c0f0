# SPDX-License-Identifier: GPL-3.0-or-later
"""Lights of a sequence as keyframes: at the frame of a photo, Blender evaluates and renders the light of that photo."""

import json

import bpy
import numpy as np
import pytest

from blender_btfsep.basics.errors import InputError
from blender_btfsep.light import animation, world
from blender_btfsep.light.sh_nodes import CLAMP, CLAMP_GAIN, GROUP_NAME, coefficient_name
from blender_btfsep.photo import frames
from blender_btfsep.window import sequence_run
from btfsep_engine import sh
from btfsep_engine.light.positivity import positive_share
from scripts.cycles import studio
from tests.blender.lit import LIGHTING, lighting, look_around, positive_coefficients, random_coefficients, white_ball

FRAMES = (3, 4, 9)


def sequence(order=2, numbers=FRAMES):
    return [(number, lighting(random_coefficients(order, seed=number))) for number in numbers]


def evaluated(scene, frame):
    """Coefficients, and what keeps them from being negative, as Blender evaluates them at a frame."""
    scene.frame_set(frame)
    tree = scene.world.evaluated_get(bpy.context.evaluated_depsgraph_get()).node_tree
    inputs = tree.nodes[GROUP_NAME].inputs
    clamping = {name: inputs[name].default_value for name in (CLAMP, CLAMP_GAIN)}
    return np.array([s.default_value for s in inputs if s.name.startswith("Y ")]), clamping


@pytest.mark.parametrize("clamp", [True, False])
def test_each_frame_has_its_own_light(scene, clamp):
    lights = sequence()
    animation.apply_sequence(scene, lights, clamp=clamp)
    for number, light in lights:
        found, clamping = evaluated(scene, number)
        assert np.allclose(found, light["coefficients"], atol=1e-6)
        share, gain = positive_share(light["coefficients"]) if clamp else (0, 1)
        assert clamping == {CLAMP: pytest.approx(share, abs=1e-5), CLAMP_GAIN: pytest.approx(gain, abs=1e-5)}
        assert share > 0.1 or not clamp


def test_between_the_photos(scene):
    lights = sequence(1)
    before, after = (np.array(light["coefficients"]) for _, light in lights[1:])
    animation.apply_sequence(scene, lights)
    assert np.allclose(evaluated(scene, 6)[0], before + 0.4 * (after - before), atol=1e-5)
    animation.apply_sequence(scene, lights, interpolation="CONSTANT")
    assert np.allclose(evaluated(scene, 8)[0], before, atol=1e-6)
    assert np.allclose(evaluated(scene, 1)[0], lights[0][1]["coefficients"], atol=1e-6)


def test_a_white_ball_at_two_frames_is_shaded_as_theory_says(scene, render, add_camera):
    truth = {number: positive_coefficients(3, seed=number) for number in (2, 5)}
    normals, inside = white_ball(scene, add_camera)
    animation.apply_sequence(scene, [(number, lighting(c)) for number, c in truth.items()])
    errors = {}
    for number in truth:
        scene.frame_set(number)
        picture = render(scene)[inside]
        for other, c in truth.items():
            shading = sh.irradiance(c, normals[inside]) / np.pi
            errors[number, other] = np.sqrt(((picture - shading) ** 2).mean() / (shading**2).mean())
    assert errors[2, 2] < 0.015 and errors[5, 5] < 0.015
    assert errors[2, 5] > 0.1 and errors[5, 2] > 0.1  # the test can tell the two lights apart


def test_a_rendered_animation_shows_every_frame(scene, tmp_path):
    """Blender's own frame loop, which evaluates the World in a render's dependency graph."""
    look_around(scene)
    lights = sequence(1, (1, 2))
    animation.apply_sequence(scene, lights, clamp=False)
    scene.frame_start, scene.frame_end = 1, 2
    scene.render.filepath = str(tmp_path / "out_####")
    bpy.ops.render.render(animation=True, scene=scene.name)
    for number, light in lights:
        truth = sh.to_map(np.array(light["coefficients"]), 64, 128)
        assert np.abs(studio.read_image(tmp_path / f"out_{number:04}.exr") - truth).max() < 2e-3 * np.abs(truth).max()


def test_keys_can_be_edited_and_go_with_the_next_light(scene):
    made = animation.apply_sequence(scene, sequence(1))
    assert len(bpy.data.actions) == 1
    group = made.node_tree.nodes[GROUP_NAME]
    path = group.inputs[coefficient_name(1, -1)].path_from_id("default_value")
    curves = [c for c in animation.fcurves(made.node_tree.animation_data) if c.data_path == path]
    assert [len(c.keyframe_points) for c in curves] == [3, 3, 3]
    curves[1].keyframe_points[0].co.y = 7.5
    curves[1].update()
    assert evaluated(scene, 3)[0][1, 1] == 7.5

    animation.apply_sequence(scene, sequence(2, (1, 2)))  # another sequence: no key of the first is left
    curves = animation.fcurves(made.node_tree.animation_data)
    assert len(bpy.data.actions) == 1 and len(curves) == 3 * 9 + 2
    assert {len(c.keyframe_points) for c in curves} == {2}
    world.apply_lighting(scene, lighting(random_coefficients(1)))  # a still light stays as it is at all frames
    assert not bpy.data.actions
    still = evaluated(scene, 2)[0]
    assert np.array_equal(still, evaluated(scene, 9)[0]) and np.allclose(still, random_coefficients(1))
    animation.apply_sequence(scene, sequence(1))
    scene.world = None
    world._remove_orphans()
    assert not bpy.data.worlds
    world._remove_orphans()
    assert not bpy.data.actions


def test_sequences_that_make_no_sense_change_nothing(scene):
    scene.world = mine = bpy.data.worlds.new("Mine")
    with pytest.raises(InputError, match="no frame"):
        animation.apply_sequence(scene, [])
    with pytest.raises(InputError, match="orders"):
        animation.apply_sequence(scene, [*sequence(1, (1,)), *sequence(2, (2,))])
    assert scene.world == mine and len(bpy.data.worlds) == 1


def test_a_photo_without_a_light_leaves_its_frame_to_those_about_it(addon, scene, tmp_path):
    files = [tmp_path / f"shot.{number:04d}.exr" for number in FRAMES]
    lights = dict(sequence())
    for number in (3, 9):
        (tmp_path / f"shot.{number:04d}.json").write_text(json.dumps(LIGHTING | lights[number]))
    found = [{"image": f"shot.{n:04d}.exr", "lighting": f"shot.{n:04d}.json", "residual": 0.1} for n in (3, 9)]
    result = {"out": str(tmp_path), "frames": found, "failed": [{"image": "shot.0004.exr", "message": "damaged"}]}
    words = sequence_run.write_world(scene, result, files, None, apply=True, interpolation="LINEAR")
    assert "2 lights, frames 3 to 9" in words and "1 photo without a light, first shot.0004.exr" in words
    before, after = (np.array(lights[number]["coefficients"]) for number in (3, 9))
    assert np.allclose(evaluated(scene, 4)[0], before + (after - before) / 6, atol=1e-5)


def test_files_and_their_frames(tmp_path):
    for name in ("a_0009.exr", "a_0010.exr", "a_0100.exr", "b_0001.exr", "a_0011.png", "a_x_0012.exr", "a_1x.exr"):
        (tmp_path / name).touch()
    found = frames.family(tmp_path / "a_0010.exr")
    assert [p.name for p in found] == ["a_0009.exr", "a_0010.exr", "a_0100.exr"]
    assert [p.name for p in frames.matching(frames.pattern_of(found))] == [p.name for p in found]
    assert frames.numbers([p.name for p in found]) == [9, 10, 100]
    assert frames.numbers([p.name for p in found], start=1) == [1, 2, 92]
    assert frames.numbers(["dawn.exr", "noon.exr"]) == [1, 2] and frames.numbers(["t1 3.exr", "t2 3.exr"], start=5) == [
        5,
        6,
    ]
    assert frames.split("shot2_v3.0007.exr") == ("shot2_v3.", 7, ".exr")  # the last digits, not those of the suffix
    assert frames.split("a12b.jpg2") == ("a", 12, "b.jpg2")
    for number in (1, 10):
        (tmp_path / f"[c] {number}.png").touch()  # a name that means something in a pattern; lengths differ
    found = frames.family(tmp_path / "[c] 1.png")
    assert [p.name for p in frames.matching(frames.pattern_of(found))] == ["[c] 1.png", "[c] 10.png"]
    (tmp_path / "[c] 01.png").touch()
    for wrong, words in (("[c] 1.png", "two files"), ("a_1.exr", "no such file")):
        with pytest.raises(InputError, match=words):
            frames.family(tmp_path / wrong)
    (tmp_path / "still.exr").touch()
    with pytest.raises(InputError, match="no number"):
        frames.family(tmp_path / "still.exr")
    with pytest.raises(InputError, match="no image matches"):
        frames.matching(tmp_path / "z*.exr")


def test_from_photos_by_cycles_to_keyframes_by_the_engine(addon, scene, render, add_camera, tmp_path):
    """The whole way with the engine itself: the World at the frame of a photo lights the ball as in that photo."""
    white_ball(scene, add_camera, colour=0.8)
    scene.camera.data.type, scene.camera.data.lens = "PERSP", 80
    (tmp_path / "library").mkdir()
    (tmp_path / "library" / "index.json").write_text('{"format": "btfsep-library", "version": 1, "materials": []}')
    bpy.context.preferences.addons["blender_btfsep"].preferences.library = str(tmp_path / "library")
    (tmp_path / "photos").mkdir()
    y, x = np.mgrid[:40, :40] - 19.5
    ball = np.hypot(x, y) < 12  # its radius is 14 pixels
    photos = {}
    for number in (12, 14):
        world.apply_lighting(scene, lighting(positive_coefficients(2, seed=number)))
        photos[number] = render(scene)
        bpy.data.images.load(scene.render.filepath).save(filepath=str(tmp_path / "photos" / f"day_{number}.exr"))
    world.restore_previous(scene)
    settings = scene.btfsep
    settings.image = bpy.data.images.load(str(tmp_path / "photos" / "day_14.exr"))
    settings.image.source = "SEQUENCE"
    entry = settings.objects.add()
    entry.object, entry.material = bpy.data.objects["Sphere"], "reference/white-diffuse"
    settings.preset, settings.order, settings.occluders = "draft", 2, "NONE"
    assert bpy.ops.btfsep.estimate_sequence() == {"FINISHED"}
    assert "2 lights, frames 12 to 14" in bpy.context.window_manager.btfsep.summary
    assert bpy.ops.btfsep.rendered_view.poll()  # though no card is kept

    errors = {}
    for number in photos:
        scene.frame_set(number)
        picture = render(scene)
        for other, photo in photos.items():
            errors[number, other] = np.sqrt(((picture - photo)[ball] ** 2).mean() / (photo[ball] ** 2).mean())
    # a World of order 2 is made positive, and shades up to a sixth otherwise than the light of order 9 that was found
    assert errors[12, 12] < 0.2 and errors[14, 14] < 0.2
    assert errors[12, 14] > 1.5 * errors[12, 12] and errors[14, 12] > 1.5 * errors[14, 14]
