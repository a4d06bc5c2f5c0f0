# SPDX-License-Identifier: GPL-3.0-or-later
"""Frames under a sun that has an image of its own: followed while it stands, elected anew where it jumps."""

import json

import numpy as np
import pytest
import trimesh

from btfsep_engine.btf.library import open_library
from btfsep_engine.cli import main
from btfsep_engine.fit import search
from btfsep_engine.imaging import images
from btfsep_engine.job.load import load_job
from btfsep_engine.light.files import read_lighting
from btfsep_engine.light.lightings import SHLighting
from btfsep_engine.light.sun import Sun
from btfsep_engine.pipeline.scene import PreparedScene
from btfsep_engine.progress import Reporter

GLOSS = "wood/walnut-lacquered"
QUICK = ("--material", GLOSS, "--preset", "draft", "--refine", "all", "--align", "never")
TOWARDS, ELSEWHERE = (np.array(d) / np.linalg.norm(d) for d in ([-0.45, 0.3, 0.84], [0.3, 0.3, 0.84]))


def answer(capsys, *command) -> dict:
    """The result of a command."""
    assert main([*map(str, command), *QUICK, "--json"]) == 0
    return json.loads(capsys.readouterr().out.splitlines()[-1])["result"]


@pytest.fixture
def sunny(sphere_job_folder):
    """A job of lacquered things, and six frames under a sky and a sun, which jumps before the fifth; noise of 1 %."""
    folder, _ = sphere_job_folder
    egg, pebble = (trimesh.creation.icosphere(5, 1.0) for _ in range(2))
    egg.apply_scale([0.5, 0.7, 0.45])
    pebble.apply_scale([0.3, 0.25, 0.35]).apply_translation([0.55, 0.4, 0.0])
    both = trimesh.util.concatenate([egg, pebble])
    trimesh.Trimesh(both.vertices, both.faces, process=False).export(folder / "sphere.ply")
    scene = PreparedScene(load_job(folder), Reporter())
    points, material = scene.points(0, textured=False), open_library(None).load(GLOSS).mean_material()
    sky = np.zeros((9, 3))
    sky[:4] = [[1.5], [0.3], [0.5], [-0.2]]
    below, random = scene.radiance(points, material, SHLighting(sky), directions=4096)[:, 0], np.random.default_rng(0)
    (folder / "frames").mkdir()
    for i in range(6):
        sun = Sun(TOWARDS if i < 4 else ELSEWHERE, np.full(3, 4.0), np.zeros(3))
        image = np.zeros((96, 96, 3))
        image[tuple(points.pixels.T)] = below + scene.sun_radiance(points, material, sun)
        image += 0.01 * image.mean() * random.normal(size=image.shape)
        images.write_exr(folder / "frames" / f"{i}.exr", np.maximum(image, 0).astype(np.float32))
    return folder


def test_a_sun_that_stands_is_followed_and_one_that_jumps_is_sought_anew(sunny, capsys):
    frames = answer(capsys, "sequence", sunny, "--images", sunny / "frames" / "*.exr")["frames"]
    assert "sharp" in frames[0]["choice"]
    assert [f["by"] for f in frames[1:4]] == ["light followed"] * 3 and frames[5]["by"] == "light followed"
    assert frames[4]["by"] != "light followed"
    for frame in frames[1:]:
        (sunny / "photo.exr").write_bytes((sunny / "frames" / frame["image"]).read_bytes())
        alone = answer(capsys, "estimate", sunny, "--no-report")
        light, other = (read_lighting(p) for p in (sunny / "sequence" / frame["lighting"], alone["lighting"]))
        off = np.abs(light.coefficients - other.coefficients) / other.stddev
        if frame["by"] == "light followed":
            assert 0 < off.max() < 0.1 and frame["residual"] == pytest.approx(alone["residual"], rel=0.02)
            assert frame["warnings"] == alone["warnings"]
        else:
            assert not off.any()
        (sun,), (known,) = light.suns, other.suns
        assert sun.direction @ known.direction > np.cos(np.radians(0.2))
        np.testing.assert_allclose(sun.irradiance, known.irradiance, rtol=0.02)
        assert sun.share == pytest.approx(known.share, rel=0.02)


def test_a_followed_frame_searches_for_no_model(sunny, capsys, monkeypatch):
    searches, solve = [], search.solve

    def counted(*given, **how):
        searches.append(given)
        return solve(*given, **how)

    monkeypatch.setattr("btfsep_engine.fit.election.solve", counted)
    command = ["sequence", sunny, "--images"]
    answer(capsys, *command, sunny / "frames" / "0.exr")
    first = len(searches)
    frames = answer(capsys, *command, sunny / "frames" / "[0-3].exr")["frames"]
    assert len(frames) == 4 and len(searches) == 2 * first > 0
