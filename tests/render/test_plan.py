# SPDX-License-Identifier: GPL-3.0-or-later
"""plan, sequence and several photos through the command line, against known answers."""

import json

import numpy as np
import pytest

from btfsep_engine.btf.library import open_library
from btfsep_engine.cli import main
from btfsep_engine.commands.sequence import run_sequence
from btfsep_engine.errors import InputError
from btfsep_engine.imaging import images
from btfsep_engine.imaging.srgb import linear_to_srgb
from btfsep_engine.light.files import read_lighting
from btfsep_engine.pipeline.settings import choose
from btfsep_engine.progress import Reporter
from tests.render.progress_lines import assert_whole_run
from tests.render.scenes import answer, edited, off_as_seen

WHITE = ["--material", "reference/white-diffuse"]
QUICK = ["--pixels", "800", "--directions", "128", "--bounces", "1"]


def test_a_plan_needs_no_photo_and_knows_what_gloss_adds(sphere_job_folder, capsys):
    folder, _ = sphere_job_folder
    (folder / "photo.exr").unlink()
    found = {}
    for name in ("reference/white-diffuse", "leather/brown-grain"):
        found[name] = answer(capsys, "plan", folder, "--material", name, "--noise", "0.05", *QUICK)
    white, leather = found.values()
    assert 3 < white["effective_degrees_of_freedom"] < leather["effective_degrees_of_freedom"] < 100
    # across the view a matte sphere tells; along it (z), half of the normals are not seen
    assert [white["determined_coefficients"][i] for i in (0, 1, 3)] == [True] * 3 and len(white["stddev"]) == 25
    # odd orders from 3 up leave no trace on a matte sphere
    share = np.array(white["prior_share"])
    assert share[9:16].mean() > 0.8 > 0.3 > share[[1, 3]].max()
    assert share[2] > 2 * share[[1, 3]].max()
    assert 0 < white["expected_error"]["order_1"]["median"] < 1
    assert (folder / "plan" / "plan.png").read_bytes()[:4] == b"\x89PNG"
    written = json.loads((folder / "plan" / "plan.json").read_text())
    assert written["determined"] == leather["determined"] and "could determine" in written["determined"]
    assert main(["plan", str(folder), *QUICK]) == 2
    assert "give --material" in capsys.readouterr().err


def test_noise_makes_a_plan_less_sure(sphere_job_folder, capsys):
    folder, _ = sphere_job_folder
    errors = []
    for noise in ("0.01", "0.4"):
        planned = answer(capsys, "plan", folder, *WHITE, "--noise", noise, *QUICK)
        errors.append(planned["expected_error"]["order_1"]["median"])
    assert errors[0] < errors[1]


def test_a_sequence_gives_each_frame_what_it_gives_alone(sphere_job_folder, capsys, tmp_path):
    folder, truth = sphere_job_folder
    photo = images.read_linear(folder / "photo.exr").pixels
    frames = tmp_path / "frames"
    frames.mkdir()
    for i, factor in enumerate((1.0, 3.0, 0.5)):
        images.write_exr(frames / f"f{i + 8}.exr", photo * np.float32(factor))
    command = ["sequence", str(folder), "--images", str(frames / "*.exr"), *WHITE, "--order", "2", *QUICK, "--exr"]
    assert main([*command, "--json"]) == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert_whole_run(lines, "sequence")
    photos = [(line["message"], line["fraction"]) for line in lines if line.get("stage") == "photos"]
    assert photos == [("f8.exr", 0.3333), ("f9.exr", 0.6667), ("f10.exr", 1)]
    result = lines[-1]["result"]
    assert [f["image"] for f in result["frames"]] == ["f8.exr", "f9.exr", "f10.exr"]
    for frame, factor in zip(result["frames"], (1.0, 3.0, 0.5), strict=True):
        light = read_lighting(folder / "sequence" / frame["lighting"]).coefficients
        assert off_as_seen(light, factor * truth) < 0.06
        assert (folder / "sequence" / frame["image"]).exists()
    first = read_lighting(folder / "sequence" / "f8.json").coefficients
    assert main([*command[:3], str(frames / "f8.exr"), *command[4:], "--out", str(tmp_path / "alone")]) == 0
    own = read_lighting(tmp_path / "alone" / "f8.json").coefficients
    assert np.allclose(first, own, rtol=1e-5, atol=1e-6)
    assert main([*command[:3], str(frames / "*.png"), *WHITE]) == 2


def test_a_sequence_by_another_estimator_or_of_no_order_says_which_option_is_at_fault(sphere_job_folder):
    folder, _ = sphere_job_folder
    for settings, words in ((choose("paper"), "--estimator least-squares"), (choose(order="auto"), "--order auto")):
        with pytest.raises(InputError, match=f"a sequence; {words}"):
            run_sequence(folder, open_library(), settings, frames=folder / "photo.exr", reporter=Reporter())


def test_frames_of_a_sequence_are_coded_as_the_job_says(sphere_job_folder, capsys, tmp_path):
    folder, truth = sphere_job_folder
    photo = images.read_linear(folder / "photo.exr").pixels
    scale = 0.5 / photo.max()
    for i in range(2):  # the first frame and further ones are read in different places
        images.write_exr(tmp_path / f"f{i}.exr", linear_to_srgb(photo * scale).astype(np.float32))
    edited(folder, image_colorspace="srgb")
    assert main(["sequence", str(folder), "--images", str(tmp_path / "*.exr"), *WHITE, "--order", "2", *QUICK]) == 0
    for i in range(2):
        light = read_lighting(folder / "sequence" / f"f{i}.json").coefficients / scale
        assert off_as_seen(light, truth) < 0.06


@pytest.mark.parametrize("factor", [1.0, 2.5])
def test_two_photos_share_one_light_at_any_exposure(sphere_job_folder, capsys, tmp_path, factor):
    folder, truth = sphere_job_folder
    other = tmp_path / "other"
    other.mkdir()
    images.write_exr(other / "photo.exr", images.read_linear(folder / "photo.exr").pixels * np.float32(factor))
    (other / "sphere.ply").write_bytes((folder / "sphere.ply").read_bytes())
    edited(folder, to=other)
    result = answer(capsys, "estimate", folder, "--with", other, *WHITE, "--order", "2", "--no-report", *QUICK)
    assert result["photos"][1]["exposure"] == pytest.approx(factor, rel=0.01)
    found = read_lighting(result["lighting"]).coefficients
    assert off_as_seen(found, truth) < 0.12  # reflectance is known to a tenth
