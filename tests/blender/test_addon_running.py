# SPDX-License-Identifier: GPL-3.0-or-later
"""What happens while a child process runs: its bar, and a scene that is renamed, undone or deleted meanwhile."""

import bpy
import pytest

from tests.blender.test_addon_operators import FOUND, LIGHTING, coefficients


def during_the_run(monkeypatch, change):
    """Has ``change()`` called once while the real operator waits for a real child."""
    from blender_btfsep import runs

    heard = runs.EngineOperator._heard

    def hearing(self, message):
        heard(self, message)
        if changes:
            changes.pop()()

    changes = [change]
    monkeypatch.setattr(runs.EngineOperator, "_heard", hearing)


LINE = {"type": "progress", "stage": "fit", "fraction": 0.5, "message": ""}


def test_a_scene_renamed_or_undone_during_the_run_gets_the_light(photographed, fake_engine, monkeypatch):
    photographed.name = "Mine"
    bpy.ops.ed.undo_push(message="before")
    photographed.btfsep.objects[0].object.location.z = 1
    bpy.ops.ed.undo_push(message="moved")

    def change():
        bpy.ops.ed.undo()  # all of the file's data stand elsewhere in memory now
        bpy.context.scene.name = "Another name"
        bpy.data.scenes.new("Mine")

    during_the_run(monkeypatch, change)
    fake_engine(lighting=LIGHTING, lines=[LINE])
    assert bpy.ops.btfsep.estimate() == {"FINISHED"}
    renamed, other = bpy.data.scenes["Another name"], bpy.data.scenes["Mine"]
    assert coefficients(renamed.world) == [tuple(row) for row in LIGHTING["coefficients"]] and other.world is None


def test_objects_that_change_names_during_the_run_get_their_own_materials(photographed, fake_engine, monkeypatch):
    entries = photographed.btfsep.objects
    one = entries[0].object
    two = one.copy()
    photographed.collection.objects.link(two)
    entries.add().object = two
    found = [{"name": one.name, "material": "of/one"}, {"name": two.name, "material": "of/two"}]

    def change():
        one.name, two.name = "Between", one.name
        one.name = found[1]["name"]
        entries.move(0, 1)

    during_the_run(monkeypatch, change)
    fake_engine(lines=[LINE, {"type": "done", "result": {"objects": found}}])
    assert bpy.ops.btfsep.recognise() == {"FINISHED"}
    assert {e.object: e.recognised for e in entries} == {one: "of/one", two: "of/two"}


def test_a_scene_deleted_during_the_run_is_named(photographed, fake_engine, monkeypatch):
    photographed.name = "Mine"
    other = bpy.data.scenes.new("Other")

    def change():
        bpy.data.scenes.remove(bpy.data.scenes["Mine"])
        bpy.data.scenes.new("Mine")  # of the same name, but not the same

    during_the_run(monkeypatch, change)
    fake_engine(lighting=LIGHTING, lines=[LINE])
    with pytest.raises(RuntimeError, match="scene 'Mine'; it is gone"):
        bpy.ops.btfsep.estimate()
    assert other.world is None


def test_the_bar_is_where_the_engine_says(photographed, fake_engine, monkeypatch):
    """The real operator and a real child; what it heard is looked at after each message."""
    from blender_btfsep import runs

    state, seen = bpy.context.window_manager.btfsep, []
    monkeypatch.setattr(runs, "redraw", lambda: seen.append((state.stage, state.message, round(state.fraction, 3))))
    line = {"type": "progress", "stage": "a stage of tomorrow", "title": "Tomorrow", "fraction": 1.0, "message": "oak"}
    done = {"type": "done", "result": FOUND}
    fake_engine(lines=[line | {"whole": 0.25}, line | {"whole": 0.75, "message": ""}, done])
    assert bpy.ops.btfsep.recognise() == {"FINISHED"}
    assert [s for s in seen if s[0]] == [("Tomorrow", "oak", 0.25), ("Tomorrow", "", 0.75)]
