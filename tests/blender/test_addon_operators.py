# SPDX-License-Identifier: GPL-3.0-or-later
"""Switching the add-on on and off, and its buttons, with a child process that speaks the engine's protocol."""

import json

import bpy
import pytest

from blender_btfsep.light import kept_light
from tests.blender import lit

LIGHTING = lit.LIGHTING | {
    "stddev": [[0.1] * 3] * 4,
    "determined": [True, True, True, False],
    "frame": "blender-z-up",
    "exposure_ev": 0.0,
}
FOUND = {
    "objects": [
        {
            "name": "Cube",
            "material": "wood/oak",
            "unknown": True,
            "candidates": [{"name": "wood/oak", "score": 0.8}, {"name": "leather/black", "score": 0.1}],
        }
    ]
}
SAID = {
    "determined": "the photo determines 3 of 4 coefficients; of order 2 and above: none",
    "expected_error": {"order_1": None, "order_2": {"median": 0.124, "low": 0.08, "high": 0.2}},
    "choice": {"appearance": "wood/oak has no texture", "order": "the order is 4"},
}


def coefficients(world):
    inputs = world.node_tree.nodes["BTFsep SH Lighting"].inputs
    return [tuple(s.default_value) for s in inputs if s.name.startswith("Y ")]


def leftovers():
    kinds = (bpy.types.Operator, bpy.types.Panel, bpy.types.PropertyGroup, bpy.types.UIList, bpy.types.AddonPreferences)
    named = {cls.__name__ for kind in kinds for cls in kind.__subclasses__() if getattr(cls, "is_registered", False)}
    return {name for name in named if name.startswith("BTFSEP")} | {
        owner.__name__ for owner in (bpy.types.Scene, bpy.types.WindowManager) if hasattr(owner, "btfsep")
    }


def test_on_off_on_leaves_nothing_behind(scene):
    import blender_btfsep

    before = set(dir(bpy.types)), len(bpy.types.TOPBAR_MT_file_import._dyn_ui_initialize())
    assert not leftovers()
    for _ in range(2):
        blender_btfsep.register()
        assert {"Scene", "WindowManager", "BTFSEP_OT_estimate", "BTFSEP_PG_run"} <= leftovers()
        blender_btfsep.unregister()
        assert not leftovers()
    assert (set(dir(bpy.types)), len(bpy.types.TOPBAR_MT_file_import._dyn_ui_initialize())) == before


def test_settings_survive_saving(photographed, tmp_path):
    photographed.btfsep.preset = "draft"
    photographed.btfsep.objects[0].material = "wood/oak"
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "a.blend"))
    settings = bpy.context.scene.btfsep
    assert (settings.preset, settings.objects[0].object.name, settings.objects[0].material) == (
        "draft",
        "Cube",
        "wood/oak",
    )
    assert settings.image.name == "photo.png"


def test_estimate_writes_the_world(photographed, fake_engine, tmp_path):
    log = tmp_path / "arguments"
    fake_engine(
        log=str(log),
        lighting=LIGHTING,
        result=FOUND | SAID,
        lines=[
            {"type": "progress", "stage": "fit", "fraction": 0.5, "message": ""},
            {"type": "warning", "message": "half of it is saturated"},
        ],
    )
    photographed.btfsep.order = 1
    photographed.btfsep.objects[0].material = "wood/oak"
    assert bpy.ops.btfsep.estimate() == {"FINISHED"}
    assert coefficients(photographed.world) == [tuple(row) for row in LIGHTING["coefficients"]]
    state = bpy.context.window_manager.btfsep
    assert not state.running and not state.error
    assert [w.name for w in state.warnings] == ["half of it is saturated"]
    assert state.summary == "The World is now the lighting of order 1"
    card = kept_light.card(kept_light.kept(photographed))
    assert card["details"][:3] == [
        "The photo determines 3 of 4 coefficients; of order 2 and above: none",
        "wood/oak has no texture",
        "The order is 4",
    ]
    assert card["warnings"] == [{"short": "Half of it is saturated", "mend": "", "object": ""}]
    entry = photographed.btfsep.objects[0]
    assert (entry.recognised, entry.unknown) == ("wood/oak", True)
    assert [(c.name, round(c.score, 3)) for c in entry.candidates] == [("wood/oak", 0.8), ("leather/black", 0.1)]

    arguments = json.loads(log.read_text())
    assert arguments[0] == "estimate" and arguments[-1] == "--json"
    assert arguments[arguments.index("--preset") + 1] == "balanced" and arguments[arguments.index("--order") + 1] == "1"
    job = json.loads(open(f"{arguments[1]}/job.json").read())
    assert [(o["name"], o["material"]) for o in job["objects"]] == [("Cube", "wood/oak")]

    bpy.ops.btfsep.apply(mode="TEXTURE")
    assert "BTFsep Light Map" in photographed.world.node_tree.nodes
    assert len(bpy.data.worlds) == 1


def test_an_estimate_that_is_not_to_be_applied_leaves_the_world(photographed, fake_engine):
    fake_engine(lighting=LIGHTING)
    photographed.btfsep.world_mode = "NONE"
    photographed.world = mine = bpy.data.worlds.new("Mine")
    bpy.ops.btfsep.estimate()
    assert photographed.world == mine and len(bpy.data.worlds) == 1
    assert bpy.ops.btfsep.apply() == {"FINISHED"}
    assert photographed.world != mine
    assert bpy.ops.btfsep.restore_world() == {"FINISHED"}
    assert photographed.world == mine


def test_recognise_fills_the_list(photographed, fake_engine):
    fake_engine(lines=[{"type": "done", "result": FOUND}])
    assert bpy.ops.btfsep.recognise() == {"FINISHED"}
    entry = photographed.btfsep.objects[0]
    assert entry.recognised == "wood/oak" and entry.material == "" and len(entry.candidates) == 2
    bpy.ops.btfsep.use_candidate(material="leather/black")
    assert entry.material == "leather/black"


def test_the_engines_fault_is_reported_and_changes_nothing(photographed, fake_engine):
    sentence = "object 'Cube'; the camera does not see it; move the camera"
    fake_engine(lines=[{"type": "failed", "message": sentence, "exit_code": 2}], exit=2)
    photographed.world = mine = bpy.data.worlds.new("Mine")
    with pytest.raises(RuntimeError, match="the camera does not see it"):
        bpy.ops.btfsep.estimate()
    assert bpy.context.window_manager.btfsep.error == sentence
    assert photographed.world == mine and len(bpy.data.worlds) == 1


def test_a_lighting_file_that_makes_no_sense_changes_nothing(photographed, fake_engine):
    photographed.world = mine = bpy.data.worlds.new("Mine")
    fake_engine(lighting=LIGHTING | {"order": 2})
    with pytest.raises(RuntimeError, match="order 2 needs 9"):
        bpy.ops.btfsep.estimate()
    assert photographed.world == mine


def test_a_scene_that_lacks_something_is_refused(photographed, fake_engine):
    photographed.btfsep.objects.clear()
    with pytest.raises(RuntimeError, match=r"poll\(\) Add the objects"):
        bpy.ops.btfsep.estimate()
    photographed.btfsep.image = None
    with pytest.raises(RuntimeError, match=r"poll\(\) Choose the photo"):
        bpy.ops.btfsep.recognise()


def test_a_wrong_engine_in_the_preferences_is_named(photographed):
    bpy.context.preferences.addons["blender_btfsep"].preferences.engine = "/absent/engine"
    with pytest.raises(RuntimeError, match="no such file"):
        bpy.ops.btfsep.estimate()


def test_library_names(addon, fake_engine):
    fake_engine(lines=[{"type": "done", "result": {"materials": [{"name": "wood/oak", "class": "wood"}]}}])
    bpy.ops.btfsep.read_library()
    assert [m.name for m in bpy.context.window_manager.btfsep.library] == ["wood/oak"]


def test_objects_are_added_once_and_removed(photographed):
    bpy.ops.mesh.primitive_monkey_add()
    bpy.ops.object.select_all(action="SELECT")
    bpy.ops.btfsep.add_objects()
    bpy.ops.btfsep.add_objects()
    assert [e.object.name for e in photographed.btfsep.objects] == ["Cube", "Suzanne"]
    bpy.ops.btfsep.remove_object(index=0)
    assert [e.object.name for e in photographed.btfsep.objects] == ["Suzanne"]


def test_import_and_undo(addon, scene, tmp_path):
    path = tmp_path / "lighting.json"
    path.write_text(json.dumps(LIGHTING))
    mine = bpy.data.worlds.new("Mine")
    scene.world = mine
    bpy.ops.ed.undo_push(message="before")
    assert bpy.ops.btfsep.import_lighting(filepath=str(path)) == {"FINISHED"}
    assert coefficients(bpy.context.scene.world) == [tuple(row) for row in LIGHTING["coefficients"]]
    bpy.ops.ed.undo_push(message="imported")
    bpy.ops.ed.undo()
    assert bpy.context.scene.world.name == "Mine"
    assert not bpy.data.node_groups and [w.name for w in bpy.data.worlds] == ["Mine"]
    bpy.ops.ed.redo()
    assert len(coefficients(bpy.context.scene.world)) == 4


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"format": "other"}, "not a BTFsep lighting"),
        ({"version": 9}, "version 9"),
        ({"basis": "wavelets"}, "the basis is 'wavelets'"),
        ({"frame": "y-up"}, "the frame is 'y-up'"),
        ({"order": 10**9}, "the order is"),
        ({"order": True}, "the order is"),
        ({"coefficients": [[1, 2, 3]]}, "has 1 rows"),
        ({"coefficients": [[1, 2, 3]] * 3 + [[1, 2]]}, "row 3"),
        ({"coefficients": [[1, 2, 3]] * 3 + [[1, 2, float("nan")]]}, "row 3"),
        ({"coefficients": [[1, 2, 3]] * 3 + [[1, 2, "x"]]}, "row 3"),
        ({"stddev": 5}, "'stddev' has no list"),
        ({"determined": [True]}, "'determined'"),
        ({"exposure_ev": float("inf")}, "'exposure_ev'"),
    ],
)
def test_bad_lighting_files_are_refused_in_words(addon, scene, tmp_path, change, words):
    path = tmp_path / "lighting.json"
    path.write_text(json.dumps(LIGHTING | change))
    with pytest.raises(RuntimeError, match=words):
        bpy.ops.btfsep.import_lighting(filepath=str(path))
    assert not bpy.data.worlds


def test_files_that_are_no_json_are_refused_in_words(addon, scene, tmp_path):
    for content in (b"", b"\xff\xfe", b"[" * 100000, b"[1, 2]"):
        (tmp_path / "x.json").write_bytes(content)
        with pytest.raises(RuntimeError, match=r"not JSON|not a BTFsep lighting"):
            bpy.ops.btfsep.import_lighting(filepath=str(tmp_path / "x.json"))
    with pytest.raises(RuntimeError, match="No such file"):
        bpy.ops.btfsep.import_lighting(filepath=str(tmp_path / "absent.json"))


@pytest.fixture
def photo_sequence(photographed, tmp_path):
    """The photo is one of three files, 0007 to 0009, opened as an image sequence; the World is the user's own."""
    folder = tmp_path / "frames"
    folder.mkdir()
    for number in (7, 8, 9):
        bpy.data.images.load(str(tmp_path / "photo.png")).save(filepath=str(folder / f"shot_{number:04}.png"))
    image = bpy.data.images.load(str(folder / "shot_0008.png"))
    image.source = "SEQUENCE"
    photographed.btfsep.image = image
    photographed.world = bpy.data.worlds.new("Mine")
    return photographed


def light_of(number):
    return LIGHTING | {"coefficients": [[number, 2, 3], [0.5, -0.5, 0], [0.25, 0, number], [0, 0, -1]]}


ANSWER = {f"shot_{number:04}.png": light_of(number) for number in (7, 8, 9)}


def first_coefficient(scene, frame):
    scene.frame_set(frame)
    return coefficients(scene.world.evaluated_get(bpy.context.evaluated_depsgraph_get()))[0]


def test_a_sequence_becomes_keyframes_and_one_undo_takes_them_back(photo_sequence, fake_engine, tmp_path):
    log = tmp_path / "arguments"
    fake_engine(log=str(log), sequence=ANSWER | {"shot_x_0001.png": light_of(1)}, result=FOUND)
    photo_sequence.btfsep.auto_order, photo_sequence.btfsep.appearance = True, "mean"
    bpy.ops.ed.undo_push(message="before")
    assert bpy.ops.btfsep.estimate_sequence() == {"FINISHED"}
    scene = bpy.context.scene
    assert [first_coefficient(scene, n) for n in (7, 8, 9)] == [(n, 2, 3) for n in (7, 8, 9)]
    assert "3 lights, frames 7 to 9" in bpy.context.window_manager.btfsep.summary

    arguments = json.loads(log.read_text())
    option = dict(zip(arguments[2:-1:2], arguments[3:-1:2], strict=True))
    assert arguments[0] == "sequence" and (option["--order"], option["--appearance"]) == ("4", "mean")
    assert option["--images"] == str(tmp_path / "frames" / "shot_[0-9][0-9][0-9][0-9].png")
    assert "Cube" in [o["name"] for o in json.loads(open(f"{arguments[1]}/job.json").read())["objects"]]

    bpy.ops.ed.undo_push(message="sequence")
    bpy.ops.ed.undo()
    assert bpy.context.scene.world.name == "Mine" and not bpy.data.actions and not bpy.data.node_groups


def test_frames_of_a_sequence_follow_the_background_image(photo_sequence, fake_engine):
    fake_engine(sequence=ANSWER)
    background = photo_sequence.camera.data.background_images.new()
    background.image = photo_sequence.btfsep.image
    background.image_user.frame_start, background.image_user.frame_offset = 101, 6  # photo 7 stands at frame 101
    bpy.ops.btfsep.estimate_sequence()
    assert [first_coefficient(photo_sequence, n)[0] for n in (101, 103)] == [7, 9]
    bpy.ops.btfsep.estimate_sequence(frame_start=-5)
    assert [first_coefficient(photo_sequence, n)[0] for n in (-5, -3)] == [7, 9]


def test_a_photo_of_the_sequence_can_be_estimated_alone(photo_sequence, fake_engine, tmp_path):
    log = tmp_path / "arguments"
    fake_engine(log=str(log), lighting=LIGHTING)
    (tmp_path / "frames" / "shot_0007.png").unlink()
    assert bpy.ops.btfsep.estimate() == {"FINISHED"}
    job = json.loads(log.read_text())[1]
    assert open(f"{job}/photo.png", "rb").read() == (tmp_path / "frames" / "shot_0008.png").read_bytes()


def test_a_sequence_that_fails_leaves_the_world(photo_sequence, fake_engine, tmp_path):
    sentence = "shot_0008.png; the image is truncated or damaged; export it again"
    answers = {
        "truncated or damaged": {"lines": [{"type": "failed", "message": sentence, "exit_code": 2}], "exit": 2},
        "order 3 needs 16": {"sequence": ANSWER | {"shot_0009.png": LIGHTING | {"order": 3}}},
    }
    for words, behaviour in answers.items():
        fake_engine(**behaviour)
        with pytest.raises(RuntimeError, match=words):
            bpy.ops.btfsep.estimate_sequence()
        assert photo_sequence.world.name == "Mine" and len(bpy.data.worlds) == 1 and not bpy.data.actions
        assert words in bpy.context.window_manager.btfsep.error
    photo_sequence.btfsep.image.colorspace_settings.name = "Non-Color"
    with pytest.raises(RuntimeError, match="colour space Non-Color"):
        bpy.ops.btfsep.estimate_sequence()
    photo_sequence.btfsep.image = bpy.data.images.new("painted", 48, 32)
    with pytest.raises(RuntimeError, match="its source is GENERATED"):
        bpy.ops.btfsep.estimate_sequence()
    with pytest.raises(RuntimeError, match="no image matches"):
        bpy.ops.btfsep.estimate_sequence(images=str(tmp_path / "nothing" / "*.exr"))
    assert photo_sequence.world.name == "Mine"


def test_a_sequence_by_pattern_that_is_not_applied(photo_sequence, fake_engine, tmp_path):
    fake_engine(sequence=ANSWER)
    photo_sequence.btfsep.world_mode = "NONE"
    assert bpy.ops.btfsep.estimate_sequence(images=str(tmp_path / "frames" / "*.png")) == {"FINISHED"}
    assert photo_sequence.world.name == "Mine"


def test_automatic_order_and_texture(photographed, fake_engine, tmp_path):
    log = tmp_path / "arguments"
    fake_engine(log=str(log), lighting=LIGHTING)
    photographed.btfsep.auto_order, photographed.btfsep.appearance = True, "textured"
    bpy.ops.btfsep.estimate()
    arguments = json.loads(log.read_text())
    assert arguments[arguments.index("--order") + 1] == "auto"
    assert arguments[arguments.index("--appearance") + 1] == "textured"


def test_pictures_are_opened_for_the_object_and_the_depth(photographed, fake_engine, tmp_path):
    picture = str(tmp_path / "photo.png")
    assert bpy.ops.btfsep.open_picture(filepath=picture, target="mask") == {"FINISHED"}
    assert photographed.btfsep.objects[0].mask == photographed.btfsep.image
    assert bpy.ops.btfsep.open_picture(filepath=picture, target="depth") == {"FINISHED"}
    assert photographed.btfsep.depth == photographed.btfsep.image
    with pytest.raises(RuntimeError, match="absent"):
        bpy.ops.btfsep.open_picture(filepath=str(tmp_path / "absent.png"), target="depth")
    photographed.btfsep.depth = None
    photographed.btfsep.objects.clear()
    with pytest.raises(RuntimeError, match="the list of objects; it is empty"):
        bpy.ops.btfsep.open_picture(filepath=picture, target="mask")
