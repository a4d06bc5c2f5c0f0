# SPDX-License-Identifier: GPL-3.0-or-later
"""The commands as a user runs them: results, JSON lines, errors in one sentence, exit status, nothing half-written."""

import hashlib
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from btfsep_engine import sh
from btfsep_engine.cli import main
from btfsep_engine.commands import report
from btfsep_engine.errors import InputError
from btfsep_engine.imaging import images
from btfsep_engine.light.files import exactly, read_lighting, write_lighting, write_lighting_exr
from btfsep_engine.storage import cache
from tests.render.progress_lines import assert_whole_run
from tests.render.scenes import edited, looking_down, off_as_seen

A_TENTH = 0.12  # reflectance is known no better: a white ball may be a rough one with a little gloss
WHITE = ["--material", "reference/white-diffuse"]


def json_lines(text) -> list:
    return [json.loads(line) for line in text.splitlines()]


def test_doctor_finds_this_machine_well(capsys):
    assert main(["doctor"]) == 0
    said = capsys.readouterr().out
    assert "test render" in said and "right, with" in said


def test_the_cache_is_shown_and_cleared(capsys, tmp_path, monkeypatch):
    monkeypatch.setenv("BTFSEP_CACHE", str(tmp_path))
    cache.write(tmp_path / "kind" / "a.entry", {"x": np.zeros(250_000)})
    assert main(["cache"]) == 0 and capsys.readouterr().out == f"2 MB in {tmp_path}\n"
    assert main(["cache", "--clear", "--json"]) == 0
    (done,) = json_lines(capsys.readouterr().out)
    assert done["result"]["bytes"] == 0 and done["result"]["freed"] > 2e6 and not list(tmp_path.iterdir())


def test_what_of_the_cache_cannot_be_taken_away_is_said(capsys, tmp_path, monkeypatch):
    monkeypatch.setenv("BTFSEP_CACHE", str(tmp_path))
    cache.write(tmp_path / "kind" / "a.entry", {"x": np.zeros(250_000)})

    def refused(path, *_, **__):
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr(Path, "unlink", refused)
    assert main(["cache", "--clear", "--json"]) == 0
    warned, done = json_lines(capsys.readouterr().out)
    assert "2.0 MB stay" in warned["message"] and done["result"]["freed"] == 0 and done["result"]["bytes"] > 2e6


def test_estimate_gives_back_the_light_of_a_white_sphere(sphere_job_folder, capsys):
    """Closed-form shading, order 2: all that one view of a matte sphere shows."""
    folder, truth = sphere_job_folder
    assert main(["estimate", str(folder), *WHITE, "--order", "2", "--json"]) == 0
    lines = json_lines(capsys.readouterr().out)
    result = lines[-1]["result"]
    assert lines[-1]["type"] == "done"
    assert_whole_run(lines, "estimate")
    assert lines[0]["stage"] == "starting"
    report = next(line for line in lines if line.get("stage") == "report")
    assert report["whole"] < 0.95, "the bar is full before the report is made"
    found = read_lighting(result["lighting"])
    assert off_as_seen(found.coefficients, truth) < A_TENTH
    assert result["objects"][0]["material"] == "reference/white-diffuse" and not result["objects"][0]["recognised"]
    assert result["residual"] < 0.05
    written = sorted(p.name for p in (folder / "result").iterdir())
    assert written == ["lighting.exr", "lighting.json", "report.png", "result.json"]
    kept = json.loads((folder / "result" / "result.json").read_text())
    assert kept["settings"]["order"] == 2 and kept["versions"]["mitsuba"] and kept["seconds"]["fit"] >= 0
    sky = images.read_linear(folder / "result" / "lighting.exr").pixels
    assert (sky >= 0).all()  # the fit's own positive light, of which the series is the first orders
    assert np.allclose(sh.project_map(sky, 2), found.coefficients, atol=0.04 * found.coefficients.max())


def test_the_light_is_written_and_said_before_checks_and_report(sphere_job_folder, capsys):
    folder, _ = sphere_job_folder
    run = ["estimate", str(folder), *WHITE, "--order", "1", "--preset", "draft", "--json"]
    assert main(run) == 0
    lines = json_lines(capsys.readouterr().out)
    place = next(i for i, line in enumerate(lines) if line["type"] == "light")
    stages = [line.get("stage") for line in lines]
    assert stages.index("alternatives") < place < stages.index("checks") < stages.index("report")
    assert lines[place]["lighting"] == lines[-1]["result"]["lighting"] == str(folder / "result" / "lighting.json")
    files = json.loads((folder / "result" / "result.json").read_text())["files"]
    assert set(files) == {"lighting.json", "lighting.exr", "report.png"}
    for name, digest in files.items():
        assert hashlib.sha256((folder / "result" / name).read_bytes()).hexdigest() == digest
    assert main([*run, "--no-report"]) == 0
    assert {p.name for p in (folder / "result").iterdir()} == {"lighting.json", "lighting.exr", "result.json"}


def test_a_run_that_stops_after_its_light_leaves_that_and_nothing_of_an_earlier_run(
    sphere_job_folder, capsys, monkeypatch
):
    folder, _ = sphere_job_folder
    run = ["estimate", str(folder), *WHITE, "--order", "1", "--preset", "draft"]
    assert main(run) == 0
    before = (folder / "result" / "lighting.json").read_bytes()

    def full(path, found):
        raise InputError("the disk", "it is full", "free space")

    monkeypatch.setattr(report, "write_estimate_report", full)
    assert main([*run, "--order", "2"]) == 2
    assert {p.name for p in (folder / "result").iterdir()} == {"lighting.json", "lighting.exr"}
    assert (folder / "result" / "lighting.json").read_bytes() != before
    edited(folder, image="elsewhere.exr")  # stops before its light: what is there stays
    assert main(run) == 2
    assert {p.name for p in (folder / "result").iterdir()} == {"lighting.json", "lighting.exr"}


def test_a_disk_that_is_full_leaves_the_earlier_set_as_it_was(sphere_job_folder, capsys, monkeypatch):
    folder, _ = sphere_job_folder
    run = ["estimate", str(folder), *WHITE, "--order", "1", "--preset", "draft"]
    assert main(run) == 0
    before = {p.name: p.read_bytes() for p in (folder / "result").iterdir()}

    class Full(images.OpenEXR.File):
        def write(self, *_):
            raise RuntimeError("No space left on device")

    monkeypatch.setattr(images.OpenEXR, "File", Full)
    assert main([*run, "--order", "2"]) == 2
    assert "cannot write" in capsys.readouterr().err
    assert {p.name: p.read_bytes() for p in (folder / "result").iterdir()} == before


def test_presets_and_options_reach_the_run(sphere_job_folder, capsys, tmp_path):
    folder, _ = sphere_job_folder
    out = tmp_path / "elsewhere"
    options = [
        "--preset",
        "draft",
        "--order",
        "1",
        "--pixels",
        "300",
        "--bounces",
        "1",
        "--no-report",
        "--out",
        str(out),
    ]
    assert main(["estimate", str(folder), *WHITE, *options, "--json"]) == 0
    settings = json_lines(capsys.readouterr().out)[-1]["result"]["settings"]
    assert (settings["preset"], settings["order"], settings["bounces"]) == ("draft", 1, 1)
    assert not (out / "report.png").exists() and (out / "lighting.json").exists()
    assert not (folder / "result").exists()


@pytest.mark.parametrize("how, fitted", [(["--preset", "paper"], 2), (["--estimator", "map"], 9), ([], 9)])
def test_the_estimator_is_the_presets_or_as_told(sphere_job_folder, capsys, how, fitted):
    """The paper's fit has the reported orders and no others; the prior's has all, and reports what was asked for."""
    folder, truth = sphere_job_folder
    assert main(["estimate", str(folder), *WHITE, "--order", "2", "--no-report", *how, "--json"]) == 0
    result = json_lines(capsys.readouterr().out)[-1]["result"]
    assert result["settings"]["estimator"] == result["estimator"] == ("map" if fitted == 9 else "least-squares")
    assert (result["fit_order"], result["order"]) == (fitted, 2)
    found = read_lighting(result["lighting"])
    assert found.coefficients.shape == (9, 3)
    assert off_as_seen(found.coefficients, truth) < (0.01 if fitted == 2 else A_TENTH)
    count = int(found.determined.sum())
    all_or_some = f"{count} of 9 coefficients" if fitted == 2 else f", {count} of the 9 that are reported"
    assert result["determined"].startswith("the photo determines ") and all_or_some in result["determined"]
    if fitted == 2:
        assert result["effective_degrees_of_freedom"] == 9 and result["noise"] is None
    else:
        assert 0.9 < result["effective_degrees_of_freedom"] < 100 and 0.0499 < result["noise"] < 0.08
        assert result["colour_unknown"] < 0.5 and "light" in result["choice"] and "colour" in result["choice"]


@pytest.mark.parametrize("material", ["reference/chrome", "reference/white-diffuse"])
def test_a_series_that_rings_relights_as_its_map_does(sphere_job_folder, tmp_path, material):
    """lighting.json and lighting.exr are one light, nowhere negative, also where a mirror shows it."""
    folder, _ = sphere_job_folder
    x = np.outer(sh.evaluate(4, np.array([0.0, 0.6, 0.8])), [3.0, 2.0, 1.0])  # a lamp, cut off at order 4
    x[0] += [0.5, 1.0, 2.0]
    light = exactly(x)
    assert sh.to_map(x, 64, 128).min() < -0.3
    write_lighting(tmp_path / "light.json", light)
    write_lighting_exr(tmp_path / "light.exr", light)
    same = ["relight", str(folder), "--material", material, "--bounces", "1"]
    pictures = []
    for name in ("light.json", "light.exr"):
        assert main([*same, "--lighting", str(tmp_path / name), "--out", str(tmp_path / f"{name}.relit.exr")]) == 0
        pictures.append(images.read_linear(tmp_path / f"{name}.relit.exr").pixels)
    assert pictures[0].min() >= 0 and np.abs(pictures[0] - pictures[1]).max() < 0.02 * pictures[1].max()


def test_a_known_light_survives_relight_and_estimate(sphere_job_folder, capsys, tmp_path):
    """relight makes a photo under a known light; estimate gives that light back."""
    folder, _ = sphere_job_folder
    light = exactly(np.array([[3, 2.5, 2], [0.5, 0, 0], [0.3, 0.8, 0.1], [-0.4, 0.2, 0.9]], float))
    write_lighting(tmp_path / "known.json", light)
    photo = folder / "photo.exr"
    same = ["--directions", "512"]
    command = ["relight", str(folder), *WHITE, *same, "--lighting", str(tmp_path / "known.json"), "--out"]
    assert main([*command, str(tmp_path / "made.png")]) == 0
    assert main([*command, str(photo)]) == 0
    assert main(["estimate", str(folder), *WHITE, *same, "--order", "1", "--no-report"]) == 0
    found = read_lighting(folder / "result" / "lighting.json")
    assert off_as_seen(found.coefficients, light.coefficients) < A_TENTH
    capsys.readouterr()
    assert main(["compare", str(folder / "result" / "lighting.json"), str(tmp_path / "known.json"), "--json"]) == 0
    measures = json_lines(capsys.readouterr().out)[-1]["result"]
    assert json.dumps(measures)  # all of it plain JSON
    with_job = [
        "compare",
        str(tmp_path / "known.json"),
        str(tmp_path / "known.json"),
        "--job",
        str(folder),
        *WHITE,
        "--json",
    ]
    assert main(with_job) == 0
    assert json_lines(capsys.readouterr().out)[-1]["result"]["rendering_psnr_free_scale"] > 100


def test_saturated_pixels_do_not_darken_the_light_and_are_told(sphere_job_folder, capsys):
    folder, truth = sphere_job_folder
    photo = images.read_linear(folder / "photo.exr").pixels
    scale = 1 / np.percentile(photo, 90)
    images.write_png(folder / "photo.png", photo * scale)
    edited(folder, image="photo.png")
    assert main(["estimate", str(folder), *WHITE, "--order", "2", "--no-report", "--json"]) == 0
    lines = json_lines(capsys.readouterr().out)
    assert any(line["type"] == "warning" and "saturated" in line["message"] for line in lines)
    assert lines[-1]["result"]["saturated_pixels"] > 100
    found = read_lighting(folder / "result" / "lighting.json").coefficients / scale
    assert off_as_seen(found, truth) < A_TENTH


def broken(folder, name):
    """Breaks a job; returns the words that must be said."""
    if name == "no mesh file":
        (folder / "sphere.ply").unlink()
        return "sphere.ply"
    if name == "NaN":
        photo = images.read_linear(folder / "photo.exr").pixels
        photo[3, 5] = np.nan
        images.write_exr(folder / "photo.exr", photo)
        return "NaN"
    if name == "turned away":
        edited(folder, camera={"to_world": (looking_down().to_world @ np.diag([1, -1, -1, 1])).tolist()})
        return "the camera does not see it"
    if name == "version":
        edited(folder, version=7)
        return "version"
    if name == "truncated photo":
        data = (folder / "photo.exr").read_bytes()
        (folder / "photo.exr").write_bytes(data[: len(data) // 3])
        return "photo.exr"
    edited(folder, first={"material": "reference/white-difuse"})
    return "reference/white-diffuse"


@pytest.mark.parametrize("name", ["no mesh file", "NaN", "turned away", "version", "truncated photo", "material"])
def test_bad_input_gets_one_sentence_and_leaves_nothing(sphere_job_folder, capsys, name):
    folder, _ = sphere_job_folder
    words = broken(folder, name)
    before = sorted(p.name for p in folder.iterdir())
    assert main(["estimate", str(folder)]) == 2
    captured = capsys.readouterr()
    (line,) = [text for text in captured.err.splitlines() if text.startswith("error: ")]
    assert words in line and line.count(";") >= 2
    assert captured.out == "" and sorted(p.name for p in folder.iterdir()) == before
    assert main(["estimate", str(folder), "--json"]) == 2
    last = json_lines(capsys.readouterr().out)[-1]
    assert last["type"] == "failed" and last["exit_code"] == 2 and words in last["message"]


@pytest.mark.parametrize(
    "arguments",
    [
        ["estimate"],
        ["estimate", "JOB", "--order", "12"],
        ["estimate", "JOB", "--preset", "fast"],
        ["estimate", "JOB", "--appearance", "shiny"],
        ["estimate", "JOB", "--directions", "1"],
        ["estimate", "JOB", "--estimator", "bayes"],
        ["estimate", "JOB", "--order", "two"],
        ["estimate", "JOB", "--seed", "-1"],
        ["plan", "JOB", "--seed", str(2**32)],
        ["relight", "JOB", "--lighting", "none.json", "--out", "x.exr"],
        ["nonsense"],
        ["library", "show", "leather/nothing"],
        ["library", "list", "--library", "/nonexistent"],
    ],
)
def test_misuse_is_told_in_a_line(sphere_job_folder, capsys, arguments):
    folder, _ = sphere_job_folder
    assert main([str(folder) if a == "JOB" else a for a in arguments]) == 2
    assert len([text for text in capsys.readouterr().err.splitlines() if text.startswith("error: ")]) == 1


def test_a_folder_that_cannot_be_written_is_told(sphere_job_folder, capsys, tmp_path):
    folder, _ = sphere_job_folder
    blocked = tmp_path / "file"
    blocked.write_text("not a folder")
    assert main(["estimate", str(folder), *WHITE, "--no-report", "--out", str(blocked / "result")]) == 2
    assert "cannot write" in capsys.readouterr().err
    assert blocked.read_text() == "not a folder"


@pytest.mark.parametrize("command", ["estimate", "align", "plan", "sequence", "relight", "chart"])
def test_a_place_that_cannot_be_written_is_told_before_the_work(sphere_job_folder, capsys, tmp_path, command):
    folder, _ = sphere_job_folder
    (tmp_path / "file").write_text("not a folder")
    out, more = str(tmp_path / "file" / "result"), [] if command == "align" else WHITE
    if command == "sequence":
        more = [*WHITE, "--images", str(folder / "*.exr")]
    elif command == "relight":
        write_lighting(folder / "light.json", exactly(np.ones((4, 3))))
        out, more = f"{out}/picture.exr", [*WHITE, "--lighting", str(folder / "light.json")]
    assert main([command, str(folder), *more, "--out", out, "--json"]) == 2
    *before, last = json_lines(capsys.readouterr().out)
    assert "cannot write into" in last["message"] and "is no folder" in last["message"]
    assert {line.get("stage") for line in before} <= {"starting", "reading", "geometry"}


def test_the_module_and_the_console_script_are_the_same_program():
    run = subprocess.run([sys.executable, "-m", "btfsep_engine", "--version"], capture_output=True, text=True)
    assert run.returncode == 0 and run.stdout.startswith("btfsep, version")


def test_two_objects_share_one_light(sphere_job_folder, capsys):
    """A second sphere of another albedo beside the first: the fit uses both."""
    folder, truth = sphere_job_folder
    small = {"name": "small", "mesh": "sphere.ply", "material": "reference/grey18"}
    small["to_world"] = [[0.1, 0, 0, -0.8], [0, 0.1, 0, 0.8], [0, 0, 0.1, 0], [0, 0, 0, 1]]
    first = {"name": "ball", "mesh": "sphere.ply", "material": "reference/white-diffuse"}
    edited(folder, objects=[first, small])
    light = exactly(truth)
    write_lighting(folder / "light.json", light)
    assert (
        main(["relight", str(folder), "--lighting", str(folder / "light.json"), "--out", str(folder / "photo.exr")])
        == 0
    )
    assert main(["estimate", str(folder), "--order", "2", "--no-report", "--json"]) == 0
    result = json_lines(capsys.readouterr().out.split("\n", 1)[1])[-1]["result"]
    assert [o["material"] for o in result["objects"]] == ["reference/white-diffuse", "reference/grey18"]
    assert min(o["pixels"] for o in result["objects"]) > 10 and max(o["residual"] for o in result["objects"]) < 0.3
    found = read_lighting(result["lighting"]).coefficients
    assert off_as_seen(found, truth) < A_TENTH


@pytest.mark.parametrize("command", ["plan", "sequence", "relight"])
def test_auto_can_be_asked_for_wherever_it_is_the_default(sphere_job_folder, capsys, tmp_path, command):
    folder, truth = sphere_job_folder
    write_lighting(tmp_path / "light.json", exactly(truth))
    own = {
        "plan": [],
        "sequence": ["--images", str(folder / "photo.exr")],
        "relight": ["--lighting", str(tmp_path / "light.json")],
    }[command]
    found = []
    for how in ([], ["--bounces", "auto", "--directions", "auto"]):
        out = str(tmp_path / "out.exr") if command == "relight" else str(tmp_path / "out")
        assert main([command, str(folder), *WHITE, "--preset", "draft", *own, *how, "--out", out, "--json"]) == 0
        result = json_lines(capsys.readouterr().out)[-1]["result"]
        assert (result["settings"]["bounces"], result["settings"]["directions"]) == ("auto", "auto")
        found.append(images.read_linear(out).pixels if command == "relight" else result["settings"])
    assert np.array_equal(*found)


def test_folders_and_files_of_any_name(sphere_job_folder, capsys, tmp_path_factory):
    """Bytes that are no text, and names like an option's: estimated as any other job."""
    job, truth = sphere_job_folder
    folder = tmp_path_factory.mktemp("shots") / os.fsdecode(b"--caf\xe9")
    job.rename(folder)
    (folder / os.fsdecode(b"notes\xff.txt")).write_text("beside the job")
    light = folder / "light.json"
    write_lighting(light, exactly(truth))
    options = [*WHITE, "--preset", "draft"]
    assert main(["relight", *options, "--lighting", str(light), "--out", str(folder / "photo.exr"), str(folder)]) == 0
    assert main(["estimate", *options, "--order", "2", str(folder)]) == 0
    assert b"caf\\udce9" in capsys.readouterr().out.encode()
    found = read_lighting(folder / "result" / "lighting.json").coefficients
    assert off_as_seen(found, truth) < A_TENTH
    assert images.read_linear(folder / "result" / "lighting.exr").usable.all()


def test_being_told_to_end_cleans_up_as_ctrl_c_does(tmp_path):
    """SIGTERM in the midst of writing a file: one line, status 130, nothing half-written."""
    code = """
import os, signal, sys, time
from btfsep_engine.storage import atomic
from btfsep_engine.cli import commands

@commands.cli.command()
def write():
    with atomic.replacing("whole.txt") as scratch:
        scratch.write_text("half")
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(60)

sys.argv = ["btfsep", "write"]
sys.exit(commands.main())
"""
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, timeout=120)
    assert (done.returncode, done.stderr.strip()) == (130, "error: stopped")
    assert not list(tmp_path.iterdir())
