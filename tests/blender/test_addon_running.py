# SPDX-License-Identifier: GPL-3.0-or-later
"""What happens while a child process runs: its bar, and a scene that is renamed, undone or deleted meanwhile."""

import json

import bpy
import pytest

from tests.blender.test_addon_operators import FOUND, LIGHTING, coefficients


def during_the_run(monkeypatch, change):
    """Has ``change()`` called once while the real operator waits for a real child."""
    from blender_btfsep.run import runs

    heard = runs.EngineOperator._heard

    def hearing(self, message):
        heard(self, message)
        if changes:
            changes.pop()()

    changes = [change]
    monkeypatch.setattr(runs.EngineOperator, "_heard", hearing)


def test_what_the_engine_finds_of_itself_is_kept_for_the_preferences(photographed, fake_engine, tmp_path):
    from blender_btfsep.engine import checkup
    from blender_btfsep.window import first_checkup

    checkup._file().unlink(missing_ok=True)
    checkup._found = None
    assert checkup.findings() == {}
    cache = tmp_path / "cache"
    cache.mkdir()
    (cache / "a.entry").write_bytes(bytes(3_000_000))
    facts = {"variant": "llvm_ad_rgb", "cache": str(cache)}
    fake_engine(lines=[{"type": "done", "result": {"ok": True, "facts": facts}}])
    assert bpy.ops.btfsep.doctor() == {"FINISHED"}
    checkup._found = None  # of the next session: read from its file
    assert checkup.findings() == {"ok": True, "facts": facts, "message": "", "bytes": 3_000_000}
    assert checkup.fact_words("test render", "right, with llvm_ad_rgb /usr/lib/libLLVM.so.19.1") == "right"
    assert checkup.fact_words("libLLVM", "/usr/lib/libLLVM.so.19.1") == "/usr/lib/libLLVM.so.19.1"
    (cache / "b.entry").write_bytes(bytes(1_000_000))
    fake_engine(lines=[{"type": "done", "result": {"objects": []}}])
    assert bpy.ops.btfsep.recognise() == {"FINISHED"} and checkup.findings()["bytes"] == 4_000_000
    for entry in cache.iterdir():
        entry.unlink()
    fake_engine(lines=[{"type": "done", "result": {"folder": str(cache), "bytes": 0, "freed": 3_000_000}}])
    assert bpy.ops.btfsep.clear_cache() == {"FINISHED"} and checkup.findings()["bytes"] == 0
    assert bpy.context.window_manager.btfsep.summary == "3 MB are free now"
    sentence = "this machine; no libLLVM was found; install one (brew install llvm)"
    fake_engine(lines=[{"type": "failed", "message": sentence, "exit_code": 2}], exit=2)
    with pytest.raises(RuntimeError, match="brew install llvm"):
        bpy.ops.btfsep.doctor()
    assert not checkup.findings()["ok"] and checkup.findings()["message"] == sentence

    # what is asked once by itself, some seconds after switching on
    fake_engine(lines=[{"type": "done", "result": {"ok": True, "facts": facts}}])
    while first_checkup._first_time() is not None:
        pass
    assert checkup.findings()["ok"]
    for text in ("", "[]", '{"facts": 3}'):
        checkup._file().write_text(text)
        checkup._found = None
        assert checkup.findings() == {}
    checkup._file().unlink()
    checkup._found = None


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


def test_a_light_that_came_before_the_run_was_stopped_is_said(photographed, fake_engine, monkeypatch, tmp_path):
    from blender_btfsep.run import runs

    came = tmp_path / "lighting.json"
    came.write_text(json.dumps(LIGHTING))
    for lines in ([LINE], [{"type": "light", "lighting": str(came)}, LINE]):
        during_the_run(monkeypatch, lambda: runs.current.cancel())
        fake_engine(lines=lines, sleep=60)
        assert bpy.ops.btfsep.estimate() == {"CANCELLED"}
        said, *more = runs.run_state().summary.splitlines()
        assert said == "Estimating: cancelled" and (photographed.world is not None) == bool(more)
    assert "unchecked" in more[0]


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
    from blender_btfsep.run import runs

    state, seen = bpy.context.window_manager.btfsep, []
    monkeypatch.setattr(runs, "redraw", lambda **_: seen.append((state.stage, state.message, round(state.fraction, 3))))
    line = {"type": "progress", "stage": "a stage of tomorrow", "title": "Tomorrow", "fraction": 1.0, "message": "oak"}
    done = {"type": "done", "result": FOUND}
    fake_engine(lines=[line | {"whole": 0.25}, line | {"whole": 0.75, "message": ""}, done])
    assert bpy.ops.btfsep.recognise() == {"FINISHED"}
    writing = ("Writing the job", "", 0.0)
    assert [s for s in seen if s[0]] == [writing, ("Tomorrow", "oak", 0.25), ("Tomorrow", "", 0.75)]


def test_the_bar_and_the_tooltip_go_by_the_last_run(photographed, fake_engine):
    """Half of the engine's guide was a tenth of the time: then it is a tenth the next time."""
    from blender_btfsep.engine import durations
    from blender_btfsep.window import operators

    now = [0.0]
    assert durations.in_words("x") == "" and durations.Clock("x").left() is None
    clock = durations.Clock("x", lambda: now[0])
    for whole, at in ((0.5, 4.0), (0.75, 30.0)):
        now[0] = at
        clock.heard(whole)
        assert clock.fraction() == whole  # nothing better is known
    now[0] = 40.0
    clock.keep()
    assert durations.in_words("x") == "About 40 s, as the last one"

    now[0] = 100.0
    again = durations.Clock("x", lambda: now[0])
    now[0] = 102.0
    again.heard(0.5)
    assert again.fraction() == pytest.approx(0.1) and again.left() == pytest.approx(36)
    now[0] = 112.0  # the engine is silent: the bar goes on, as far as the last run was at what it says next
    assert again.fraction() == pytest.approx(0.35)
    now[0] = 200.0
    assert again.fraction() == pytest.approx(0.75)
    again.heard(0.6)  # never back
    assert again.fraction() == pytest.approx(0.75)

    fake_engine(lines=[{"type": "done", "result": FOUND}])
    bpy.ops.btfsep.recognise()
    assert durations.expected("BTFSEP_OT_recognise balanced") is not None
    photographed.btfsep.preset = "draft"
    assert durations.expected("BTFSEP_OT_recognise draft") is None
    kinds = []
    for source in ("RECOGNISE", "COLOUR"):
        photographed.btfsep.objects[0].source = source
        kinds.append(operators.BTFSEP_OT_estimate.kind(photographed))
    assert len(set(kinds)) == 2  # recognition takes longer than the light does


def test_durations_that_make_no_sense_are_none(photographed):
    from blender_btfsep.engine import durations

    for text in ("", "[]", '{"x": 3}', '{"x": [[1, 2], [0, 1]]}', '{"x": [[1, "a"]]}', '{"x": [[0, 0]]}'):
        durations._file().write_text(text)
        assert durations.curve_of("x") == []


def test_what_is_found_for_a_file_that_was_left_is_said(photographed, fake_engine, tmp_path):
    from blender_btfsep.run import request, runs

    fake_engine(lighting=LIGHTING, lines=[LINE])
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "one.blend"))
    folder = request.write_job(bpy.context)
    runs.current = runs.start_engine(["estimate", folder, "--out", folder / "result"])
    look = runs.leave(runs.current, "Estimating", "Scene")
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "two.blend"))
    assert request.job_folder(bpy.context.scene) != folder and runs.is_running()
    while look() is not None:
        pass
    said = bpy.context.window_manager.btfsep.summary
    assert said == f"The light of scene 'Scene', of the file that was left, is in {folder / 'result' / 'lighting.json'}"
    assert (folder / "result" / "lighting.json").is_file() and not runs.is_running()


def begun(photographed):
    """A run of the real engine process, as an operator leaves it whose window is closed: it, and what that knew."""
    from blender_btfsep.engine import durations
    from blender_btfsep.run import request, runs

    folder = request.write_job(bpy.context)
    runs.current = runs.start_engine(["estimate", folder, "--out", folder / "result"])
    runs.run_state().running = False
    clock = durations.Clock("x")
    ids = request.ids_of(photographed.btfsep)
    return runs.current, {
        "_scene": photographed.session_uid,
        "_scene_name": "Scene",
        "_ids": ids,
        "_clock": clock,
        "_told": 0,
    }


def test_a_run_goes_on_in_another_window_when_its_own_is_closed(photographed, fake_engine):
    from blender_btfsep.run import runs
    from blender_btfsep.window import operators

    fake_engine(lighting=LIGHTING, lines=[LINE])
    process, known = begun(photographed)
    runs.given_up(operators.BTFSEP_OT_estimate, process, known, {})
    assert coefficients(photographed.world) == [tuple(row) for row in LIGHTING["coefficients"]]
    assert process.over and runs.adopted is None and not runs.is_running() and not runs.run_state().running


def test_what_was_not_yet_written_when_its_window_was_closed_is_begun_anew(photographed, fake_engine):
    from blender_btfsep.run import runs
    from blender_btfsep.window import operators

    fake_engine(lighting=LIGHTING, lines=[LINE])
    runs.current = runs.Preparation(x for x in range(3))
    known = {"_scene": photographed.session_uid, "_scene_name": "Scene"}
    runs.given_up(operators.BTFSEP_OT_estimate, runs.current, known, {})
    assert coefficients(photographed.world) == [tuple(row) for row in LIGHTING["coefficients"]]


def test_a_run_whose_file_was_left_ends_or_says_where_its_light_is(photographed, fake_engine, tmp_path):
    from blender_btfsep.run import runs
    from blender_btfsep.window import operators

    fake_engine(lighting=LIGHTING, lines=[LINE])
    for operator in (operators.BTFSEP_OT_recognise, operators.BTFSEP_OT_estimate):
        process, known = begun(photographed)
        runs.given_up(operator, process, known | {"_scene": -1}, {})
        assert runs.is_running() == operator.outlives and photographed.world is None
    runs.stop_now()


def test_a_bug_leaves_no_run_that_never_ends(photographed, fake_engine, monkeypatch):
    from blender_btfsep.run import runs

    def change():
        raise KeyError("a bug")

    during_the_run(monkeypatch, change)
    fake_engine(lighting=LIGHTING, lines=[LINE])
    with pytest.raises(RuntimeError, match="a bug"):
        bpy.ops.btfsep.estimate()
    state = runs.run_state()
    assert not runs.is_running() and not state.running and "please report it" in state.error
    monkeypatch.undo()
    assert bpy.ops.btfsep.estimate() == {"FINISHED"}


def test_escape_is_ours_over_the_panel_only(scene):
    from blender_btfsep.run import runs

    window = bpy.context.window_manager.windows[0]
    (area,) = (a for a in window.screen.areas if a.type == "VIEW_3D")
    region = {r.type: r for r in area.regions}
    assert runs.over_panel(window, region["UI"].x, region["UI"].y)
    assert not runs.over_panel(window, region["WINDOW"].x + 5, region["WINDOW"].y + 5)
    assert not runs.over_panel(None, 0, 0)
