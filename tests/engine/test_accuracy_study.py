# SPDX-License-Identifier: GPL-3.0-or-later
"""The yardsticks of the studies of accuracy: plain fits that recover light of their own model, and coverage."""

import json

import numpy as np
import pytest

from btfsep_engine import sh
from btfsep_engine.conventions import fibonacci_sphere
from btfsep_engine.errors import InputError
from btfsep_engine.imaging.images import write_exr
from btfsep_engine.imaging.srgb import linear_to_srgb
from btfsep_engine.job.load import load_job
from scripts.studies import balls, cameras, real
from scripts.studies.measures import covered, errors

NORMALS = fibonacci_sphere(800)
NORMALS = NORMALS[NORMALS[:, 1] < -0.15]


def grey(x):
    """Coefficients (terms,) in three equal channels."""
    return np.repeat(np.asarray(x)[:, None], 3, 1)


def test_one_lamp_is_found_from_the_lit_side_alone():
    lamp = np.array([0.5, -0.7, 0.4]) / np.linalg.norm([0.5, -0.7, 0.4])
    found = real.plain_fits(NORMALS, 3 * np.maximum(NORMALS @ lamp, 0))
    np.testing.assert_allclose(found["lamp"], sh.evaluate(2, lamp), atol=1e-9)
    assert errors(grey(found["order1"]), grey(sh.evaluate(2, lamp)))["order2"] > 0.3  # shadows are none of its model


def test_light_of_order_2_is_found_by_the_fit_of_order_2(rng):
    truth = np.array([4.0, *rng.normal(0, 0.3, 8)])
    b = sh.irradiance(np.repeat(truth[:, None], 3, 1), NORMALS)[:, 0]
    found = real.plain_fits(NORMALS, b)
    off = errors(grey(found["order2"]), grey(truth))
    assert off["order2"] < 1e-6 and off["scale"] > 0
    assert (
        np.array_equal(found["order1"][4:], np.zeros(5)) and errors(grey(found["order1"]), grey(truth))["order2"] > 0.05
    )


def test_coverage_counts_what_lies_inside():
    truth, spread = np.array([[0.0], [0.9], [1.5], [3.0]]), np.ones((4, 1))
    held = covered(np.zeros((4, 1)), spread, truth, interval=np.stack([np.zeros((4, 1)), np.full((4, 1), 0.9)]))
    assert held == {"within68": 0.5, "within95": 0.75, "inside": 0.5}


def test_a_truth_of_one_number_a_row_is_grey_and_one_of_few_rows_is_refused(tmp_path):
    (tmp_path / "truth.json").write_text(json.dumps({"coefficients": [[float(i)] for i in range(16)]}))
    assert np.array_equal(real.true_light(tmp_path), np.repeat(np.arange(9.0)[:, None], 3, 1))
    (tmp_path / "truth.json").write_text(json.dumps({"coefficients": [[1.0]] * 4}))
    with pytest.raises(InputError, match="9 rows or more"):
        real.true_light(tmp_path)


def test_a_job_saved_as_a_jpeg_is_read_by_the_curve_that_is_said_and_its_folder_stays(job):
    job.exr("photo.exr", np.full((8, 12, 3), 0.5, np.float32) * np.linspace(0.3, 1, 12, dtype=np.float32)[:, None])
    before = {path: path.read_bytes() for path in job.write().iterdir()}
    linear = load_job(job.folder).photo.radiance
    saved = {read: real.as_jpeg(job.folder, cameras.SRGB, read) for read in (None, "linear")}
    assert {path: path.read_bytes() for path in job.folder.iterdir()} == before
    assert [saved[read].image_colorspace for read in saved] == ["auto", "linear"]
    radiance, codes = (each.photo.radiance for each in saved.values())
    ratio = radiance / linear
    np.testing.assert_allclose(ratio, ratio.mean(), rtol=0.05)
    np.testing.assert_allclose(codes, linear_to_srgb(radiance), atol=0.004)
    by_canon = real.as_jpeg(job.folder, "Canon EOS 6D", "camera").photo.radiance
    np.testing.assert_allclose(by_canon / by_canon.mean(), linear / linear.mean(), rtol=0.25)


def test_a_mirror_ball_tells_the_light_of_the_grey_one_beside_it(tmp_path, rng, capsys):
    """A light of order 2 that a yellowish mirror shows, on a neutral ball of albedo 0.3; the jobs are read again."""
    normal, radius = balls.disc(128)
    to_eye = np.array([0.0, -1.0, 0.0])
    np.testing.assert_allclose(normal[64, 64], to_eye, atol=0.02)
    assert normal[20, 64, 2] > 0.6 and normal[64, 110, 0] > 0.6  # above is up, right is +x
    mirrored = 2 * (normal @ to_eye)[..., None] * normal - to_eye
    tint, lights = np.array([0.7, 0.65, 0.6]), []
    for i in range(3):
        light = grey([4.0, *rng.normal(0, 0.4, 8)]) * (1 + 0.1 * i)
        lights.append(light)
        chrome = sh.evaluate(2, mirrored) @ light * tint * (radius < 1)[..., None]
        ball = 0.3 / np.pi * sh.irradiance(light, normal.reshape(-1, 3)).reshape(128, 128, 3) * (radius < 1)[..., None]
        (tmp_path / "pairs").mkdir(exist_ok=True)
        write_exr(tmp_path / "pairs" / f"room_chrome_{i}.exr", chrome)
        write_exr(tmp_path / "pairs" / f"room_gray_{i}.exr", ball)
    assert balls.main([str(tmp_path / "pairs"), str(tmp_path / "jobs"), "--surface", "0.3", "0.5"]) == 0
    assert "3 jobs" in capsys.readouterr().out
    for i, light in enumerate(lights):
        folder = tmp_path / "jobs" / f"room_gray_{i}"
        job, truth = load_job(folder), real.true_light(folder)
        assert errors(truth, light)["order2"] < 0.01 and truth.std(1).max() < 1e-3 * truth.max()
        assert job.objects[0].surface.base_color == (0.3, 0.3, 0.3) and job.objects[0].mask[64, 64]
        seen, b = real.facing(real.scene_of(job))
        received = 0.3 / np.pi * sh.irradiance(light, seen)[:, 0]
        assert np.abs(b / received - 1).max() < 0.05  # a pixel's corners have other normals than its middle
    with pytest.raises(SystemExit):
        balls.main([str(tmp_path), str(tmp_path / "none")])
    assert "no pair of pictures" in capsys.readouterr().err
    write_exr(tmp_path / "pairs" / "room_gray_1.exr", np.ones((20, 30, 3)))
    with pytest.raises(SystemExit):
        balls.main([str(tmp_path / "pairs"), str(tmp_path / "none")])
    assert "no square" in capsys.readouterr().err and not (tmp_path / "none").exists()
