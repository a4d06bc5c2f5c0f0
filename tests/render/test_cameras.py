# SPDX-License-Identifier: GPL-3.0-or-later
"""Whole runs with cameras that are no plain pinholes: the light comes back, and the photo is rendered again."""

from dataclasses import replace

import numpy as np
import pytest

from btfsep_engine.btf.library import open_library
from btfsep_engine.commands.estimate import run_estimate
from btfsep_engine.commands.relight import run_relight
from btfsep_engine.imaging import images
from btfsep_engine.light.files import read_lighting
from btfsep_engine.pipeline.settings import choose
from btfsep_engine.progress import Reporter
from scripts.studies.depth import z_depth
from tests.render.scenes import edited, off_as_seen, positive_light, scene_of
from tests.render.test_alignment import photographed, potato

WHITE = "reference/white-diffuse"
CAMERAS = {
    "orthographic": {"projection": "orthographic", "fx": 45.0, "fy": 40.0},
    "lens": {"k1": -0.5, "k2": 0.1, "p1": 0.02, "p2": -0.03},
    "part": {"cx": 20.0, "cy": 80.0},
}
SETTINGS = {"pixels": 800, "key_light": "never"}


@pytest.fixture(params=CAMERAS)
def job(request, tmp_path):
    """The folder of a job of a white shape, and the light that it was photographed in."""
    photographed(tmp_path, potato(), **CAMERAS[request.param])
    return tmp_path, positive_light(2)


def test_the_light_comes_back_and_makes_the_photo_again(job):
    folder, truth = job
    library, settings = open_library(None), choose("draft", **SETTINGS)
    result = run_estimate(folder, library, settings, material=WHITE, reporter=Reporter())
    assert off_as_seen(read_lighting(result["lighting"]).coefficients, truth) < 0.05
    assert (folder / "result" / "report.png").exists()
    out = folder / "again.exr"
    told = {"lighting": result["lighting"], "out": out, "material": WHITE}
    run_relight(folder, library, replace(settings, bounces=1), reporter=Reporter(), **told)
    shown, photo = images.read_linear(out).pixels, images.read_linear(folder / "photo.exr").pixels
    seen = scene_of(folder).regions[0]
    assert np.median(np.abs(shown - photo)[seen] / photo[seen]) < 0.05


def test_a_depth_of_the_same_camera_gives_the_same_light(job):
    folder, truth = job
    images.write_exr(folder / "z.exr", z_depth(scene_of(folder)))
    edited(folder, depth="z.exr", objects=[])
    settings = choose("draft", **SETTINGS)
    result = run_estimate(folder, open_library(None), settings, material=WHITE, with_report=False, reporter=Reporter())
    assert off_as_seen(read_lighting(result["lighting"]).coefficients, truth) < 0.1


def test_a_smaller_picture_has_the_rays_of_its_blocks(job):
    whole = scene_of(job[0])
    small, edge = whole.at_most(32), 3
    rows, columns = np.mgrid[: small.job.camera.height, : small.job.camera.width].reshape(2, -1)
    found = small.job.camera.rays(columns + 0.5, rows + 0.5)
    expected = whole.job.camera.rays(edge * columns + edge // 2 + 0.5, edge * rows + edge // 2 + 0.5)
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-9)
