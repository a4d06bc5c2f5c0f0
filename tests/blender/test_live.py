# SPDX-License-Identifier: GPL-3.0-or-later
"""Live: which changes the light follows, what is asked of the engine then, and that nothing else is disturbed."""

import json
import time

import bpy
import pytest

from blender_btfsep.light import lighting_file, sun_lamp, world
from blender_btfsep.run import answer, request, runs
from blender_btfsep.scene import meshes
from blender_btfsep.window import live, live_changes
from tests.blender.lit import LIGHTING
from tests.blender.test_addon_operators import coefficients


@pytest.fixture
def asked(photographed, fake_engine, tmp_path, monkeypatch):
    """A scene that has a light and is live; gives the list of what the engine is asked from now on."""
    light = tmp_path / "light.json"
    light.write_text(json.dumps(LIGHTING))
    answer.apply_light(photographed, lighting_file.read(light))
    fake_engine(lighting=LIGHTING, lines=[{"type": "light", "lighting": str(light)}])
    monkeypatch.setattr(live, "SETTLED", 0.3)
    found, start = [], runs.start_engine

    def started(arguments, **more):
        found.append([str(argument) for argument in arguments])
        return start(arguments, **more)

    monkeypatch.setattr(runs, "start_engine", started)
    bpy.context.view_layer.update()
    photographed.btfsep.live = True
    return found


def follow():
    """What Blender's timer does, until there is no more to do."""
    bpy.context.view_layer.update()
    until(lambda: not live._follower.step())


def until(condition):
    """Waits for something that comes in a moment, or never."""
    end = time.monotonic() + 60
    while not condition():
        assert time.monotonic() < end, "it never comes to rest"
        time.sleep(live.INTERVAL)


def asleep(scene, fake_engine, folder):
    """A draft that is asked, of an engine that sleeps."""
    begun = folder / "begun"
    fake_engine(sleep=600, log=str(begun))
    scene.camera.location.x += 0.1
    bpy.context.view_layer.update()
    until(lambda: live._follower.step() and begun.exists())
    return live._follower.run


def presets(asked):
    return [arguments[arguments.index("--preset") + 1] for arguments in asked]


def test_what_was_said_is_of_the_file_that_was_open(photographed, tmp_path):
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
    state = runs.run_state()
    state.error, state.summary, state.warnings.add().name = "no", "done", "odd"
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "a.blend"))
    state = runs.run_state()
    assert not (state.error or state.summary or len(state.warnings))


def test_a_draft_comes_at_once_and_the_preset_when_all_is_quiet(photographed, asked):
    made, group = photographed.world, photographed.world.node_tree.nodes[0].node_tree
    made.node_tree.nodes[0].inputs["Y 0 0"].default_value = (0, 0, 0)
    photographed.camera.location.x += 0.1
    bpy.context.view_layer.update()
    assert bpy.app.timers.is_registered(live._step)
    until(lambda: live._follower.step() and asked)
    assert "--no-report" in asked[0] and asked[0][0] == "estimate" and not runs.is_running()
    follow()
    assert presets(asked) == ["draft", "balanced"] and "--no-report" not in asked[1]
    assert ["never" in arguments for arguments in asked] == [True, False]  # what takes long comes with the preset
    assert ["least" in arguments for arguments in asked] == [True, False]
    assert photographed.world == made and made.node_tree.nodes[0].node_tree == group  # in place
    assert coefficients(made) == [tuple(row) for row in LIGHTING["coefficients"]] and world.is_ours(made)
    follow()
    assert len(asked) == 2  # what it does itself is no change


def material(scene):
    made = bpy.data.materials.new("Paint")
    scene.btfsep.objects[0].object.data.materials.append(made)
    bpy.context.view_layer.update()
    return made


def mask(scene):
    image = bpy.data.images.new("mask", 48, 32)
    image.generated_color = (1, 1, 1, 1)
    scene.btfsep.objects[0].mask = image
    scene.update_tag()  # as the panel does


def beside(scene):
    settle(scene)
    bpy.ops.mesh.primitive_cube_add(location=(2, 0, 0))
    scene.view_layers[0].objects.active.data.materials.append(bpy.data.materials.new("Beside"))


def settle(scene):
    """What was changed so far is how the scene was before."""
    scene.view_layers[0].update()
    live_changes.remember(scene)
    live._follower.give_way()


def as_evidence(scene):
    beside(scene)
    settle(scene)
    thing = scene.view_layers[0].objects.active
    thing.btfsep_evidence = True
    thing.update_tag()  # as the panel does


def gone(scene):
    beside(scene)
    settle(scene)
    bpy.data.objects.remove(scene.view_layers[0].objects.active)


def not_rendered(scene):
    beside(scene)
    settle(scene)
    scene.view_layers[0].objects.active.hide_render = True


def edit(scene, path, value):
    owner, _, name = path.rpartition(".")
    setattr(scene.path_resolve(f"btfsep.{owner}") if owner else scene.btfsep, name, value)
    scene.update_tag()


CHANGES = {
    "object": lambda scene: scene.btfsep.objects[0].object.location.__setitem__(0, 0.1),
    "shape": lambda scene: scene.btfsep.objects[0].object.modifiers.new("Round", "SUBSURF"),
    "lens": lambda scene: setattr(scene.camera.data, "lens", 60),
    "colour": lambda scene: (edit(scene, "objects[0].source", "COLOUR"), edit(scene, "objects[0].colour", (1, 0, 0))),
    "own material": lambda scene: setattr(material(scene), "roughness", 0.3),
    "mask": mask,
    "another object": lambda scene: beside(scene),
    "another object as evidence": as_evidence,
    "another object that goes": gone,
    "another object that is not rendered any more": not_rendered,
    "curve": lambda scene: edit(scene, "curve", "linear"),
    "order": lambda scene: edit(scene, "order", 2),
}
INDIFFERENT = {
    "lamp": lambda scene: scene.collection.objects.link(
        bpy.data.objects.new("Lamp", bpy.data.lights.new("L", "POINT"))
    ),
    "empty": lambda scene: scene.collection.objects.link(bpy.data.objects.new("Empty", None)),
    "another object, which casts no shadow": lambda scene: (edit(scene, "occluders", "NONE"), beside(scene)),
    "selection": lambda scene: scene.btfsep.objects[0].object.select_set(False),
    "strength": lambda scene: setattr(scene.world.node_tree.nodes[0].inputs["Strength"], "default_value", 2),
    "exposure of the view": lambda scene: setattr(scene.view_settings, "exposure", 1),
    "candidate": lambda scene: edit(scene, "objects[0].recognised", "wood/oak"),
}


@pytest.mark.parametrize("name", [*CHANGES, *INDIFFERENT])
def test_what_the_light_follows(photographed, asked, name):
    (CHANGES | INDIFFERENT)[name](photographed)
    follow()
    photographed.update_tag()  # it is told again, with something that matters not
    follow()
    assert presets(asked) == (["draft", "balanced"] if name in CHANGES else [])


def test_it_follows_nothing_where_it_is_off_or_there_is_no_light(photographed, asked):
    from blender_btfsep.light import kept_light

    photographed.btfsep.live = False
    photographed.camera.location.x += 0.1
    follow()
    photographed.btfsep.live = True
    kept_light.forget(photographed)
    photographed.camera.location.x += 0.1
    follow()
    assert asked == []


def test_a_light_waits_until_the_user_has_put_its_lamps_down(photographed, asked, monkeypatch):
    photographed.world.node_tree.nodes[0].inputs["Y 0 0"].default_value = (0, 0, 0)
    held = [True]
    monkeypatch.setattr(sun_lamp, "are_moved", lambda scene: scene == photographed and held[0])
    photographed.camera.location.x += 0.1
    bpy.context.view_layer.update()
    until(lambda: live._follower.step() and asked)
    for _ in range(100):  # meanwhile it has answered
        assert live._follower.step() and coefficients(photographed.world)[0] == (0, 0, 0)
        time.sleep(live.INTERVAL)
    held[0] = False
    follow()
    assert coefficients(photographed.world)[0] == tuple(LIGHTING["coefficients"][0])
    monkeypatch.undo()
    assert not sun_lamp.are_moved(photographed)  # no hand, nothing held


def test_the_newest_change_wins(photographed, asked, fake_engine, tmp_path):
    first = asleep(photographed, fake_engine, tmp_path)
    fake_engine(lighting=LIGHTING)
    photographed.camera.location.x += 0.1
    follow()
    assert first.over and presets(asked) == ["draft", "draft", "balanced"]


def test_a_run_of_the_users_ends_what_is_asked(photographed, asked, fake_engine, tmp_path):
    first = asleep(photographed, fake_engine, tmp_path)
    fake_engine(lighting=LIGHTING)
    assert bpy.ops.btfsep.estimate() == {"FINISHED"}
    assert first.over and not live._follower.step() and presets(asked) == ["draft", "balanced"]
    assert not bpy.context.window_manager.btfsep.following


def test_the_export_of_what_a_render_has_finer_is_no_change(photographed, asked):
    cube = photographed.btfsep.objects[0].object
    round_ = cube.modifiers.new("Round", "SUBSURF")
    round_.levels, round_.render_levels = 0, 2
    follow()
    assert len(asked) == 2 and not meshes.is_as_rendered() and round_.levels == 0


def test_only_the_view_layer_that_is_exported_counts(photographed, asked):
    photographed.view_layers.new("Other").update()
    photographed.camera.location.x += 0.1
    photographed.view_layers["Other"].update()
    assert not live._follower.step()
    follow()
    assert len(asked) == 2


def test_a_draft_takes_what_was_recognised_for_known(photographed, asked, monkeypatch):
    jobs = []
    start = runs.start_engine

    def read(arguments, **more):
        jobs.append(json.loads((arguments[1] / "job.json").read_text())["objects"][0]["material"])
        return start(arguments, **more)

    monkeypatch.setattr(runs, "start_engine", read)
    photographed.btfsep.objects[0].recognised = "wood/oak-boards"
    photographed.camera.location.x += 0.1
    follow()
    assert jobs == ["wood/oak-boards", None]


@pytest.fixture
def written(photographed, asked, monkeypatch):
    """As `asked`, with things that stand around the cube; gives a list that grows with each job that is written."""
    found, write = [], request.write_job

    def counted(*given, **more):
        found.append(1)
        runs.warn("a lamp is left out")
        return write(*given, **more)

    bpy.ops.mesh.primitive_plane_add(size=3, location=(0, 0, -1))
    monkeypatch.setattr(request, "write_job", counted)
    settle(photographed)
    photographed.camera.location.x += 0.1
    follow()
    assert len(found) == 1 and len(asked) == 2  # once for draft and preset
    return found


def other_photo(scene, *, size=(48, 32), name="other.png"):
    image = bpy.data.images.new("other", *size)
    image.generated_color = (0.2, 0.4, 0.1, 1)
    image.filepath_raw, image.file_format = bpy.path.abspath(scene.btfsep.image.filepath_raw) + name, "PNG"
    image.save()
    scene.btfsep.image = bpy.data.images.load(image.filepath_raw)
    scene.update_tag()


def hang(scene):
    scene.camera.parent = bpy.data.objects.new("Crane", None)
    scene.collection.objects.link(scene.camera.parent)
    scene.camera.parent.location.x = 0.1


AS_WRITTEN = {
    "camera": lambda scene: scene.camera.location.__setitem__(1, -6.2),
    "lens": lambda scene: setattr(scene.camera.data, "lens", 60),
    "photo": other_photo,
    "curve": lambda scene: edit(scene, "curve", "linear"),
    "order": lambda scene: edit(scene, "order", 2),
    "both": lambda scene: (edit(scene, "order", 2), scene.camera.location.__setitem__(0, 0.2)),
}
ANEW = {
    "object": lambda scene: scene.btfsep.objects[0].object.location.__setitem__(0, 0.1),
    "all of it": lambda scene: (
        scene.camera.location.__setitem__(0, 0.2),
        edit(scene, "objects[0].source", "COLOUR"),
    ),
    "a camera far away": lambda scene: scene.camera.location.__setitem__(1, -9),
    "a camera that hangs on something": hang,
    "a hidden camera": lambda scene: (scene.camera.location.__setitem__(0, 0.2), scene.camera.hide_set(True)),
    "a photo of another size": lambda scene: other_photo(scene, size=(96, 64)),
    "units": lambda scene: (setattr(scene.unit_settings, "scale_length", 0.1), scene.update_tag()),
}


@pytest.mark.parametrize("name", [*AS_WRITTEN, *ANEW])
def test_what_is_asked_is_the_scene_as_it_is_however_little_of_it_is_written(photographed, written, name, tmp_path):
    (AS_WRITTEN | ANEW)[name](photographed)
    follow()
    assert len(written) == (1 if name in AS_WRITTEN else 2)
    assert [w.name for w in runs.run_state().warnings].count("a lamp is left out") == 1
    fresh, folder = request.write_job(photographed, folder=tmp_path / "fresh"), live._follower.job[0]
    job = json.loads((folder / "job.json").read_text())
    assert job == json.loads((fresh / "job.json").read_text())
    for file in fresh.iterdir():
        assert (folder / file.name).read_bytes() == file.read_bytes()


def test_a_run_of_the_users_has_the_scene_written_anew(photographed, written):
    assert bpy.ops.btfsep.estimate() == {"FINISHED"}
    assert len(written) == 2 and live._follower.job is None


def test_what_goes_wrong_is_said_once(photographed, asked, fake_engine):
    fake_engine(lines=[{"type": "failed", "message": "the photo; it is dark", "exit_code": 2}], exit=2)
    photographed.camera.location.x += 0.1
    follow()
    assert len(asked) == 1 and bpy.context.window_manager.btfsep.error == "the photo; it is dark"
    edit(photographed, "order", 3)
    photographed.btfsep.image = None  # the panel says that it is missing
    follow()
    assert len(asked) == 1


def test_another_file_ends_it(photographed, asked, fake_engine, tmp_path):
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "live.blend"))
    first = asleep(photographed, fake_engine, tmp_path)
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "live.blend"))
    assert first.over and not live._follower.step()
    fake_engine(lighting=LIGHTING)
    scene = bpy.context.scene
    follow()
    assert scene.btfsep.live and len(asked) == 1  # what is loaded is no change
    edit(scene, "order", 3)
    follow()
    assert len(asked) > 1  # and it goes on there
