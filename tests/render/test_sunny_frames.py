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
from btfsep_engine.pipeline.following import Follower
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
    """A job of lacquered things, and five frames under a sky and a sun, which jumps before the fourth; noise of 1 %."""
    folder, _ = sphere_job_folder
    egg, pebble = (trimesh.creation.icosphere(4, 1.0) for _ in range(2))
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
    for i in range(5):
        sun = Sun(TOWARDS if i < 3 else ELSEWHERE, np.full(3, 4.0), np.zeros(3))
        image = np.zeros((96, 96, 3))
        image[tuple(points.pixels.T)] = below + scene.sun_radiance(points, material, sun)
        image += 0.01 * image.mean() * random.normal(size=image.shape)
        images.write_exr(folder / "frames" / f"{i}.exr", np.maximum(image, 0).astype(np.float32))
    return folder


@pytest.fixture
def searches(monkeypatch):
    """([of all], [of each further frame]): how often a model is searched for, counted as it goes."""
    count, further = [0], []
    solve, follow = search.solve, Follower.estimate

    def counted(*given, **how):
        count[0] += 1
        return solve(*given, **how)

    def followed(follower, scene):
        before = count[0]
        found = follow(follower, scene)
        further.append(count[0] - before)
        return found

    monkeypatch.setattr("btfsep_engine.fit.election.solve", counted)
    monkeypatch.setattr(Follower, "estimate", followed)
    return count, further


def test_a_sun_that_stands_is_followed_and_one_that_jumps_is_sought_anew(sunny, capsys, searches):
    """A frame that is followed is as a photo alone, and searches for no model."""
    frames = answer(capsys, "sequence", sunny, "--images", sunny / "frames" / "*.exr")["frames"]
    assert "sharp" in frames[0]["choice"]
    followed = [f["by"] == "light followed" for f in frames]
    assert followed[1:] == [True, True, False, True]
    (every,), further = searches
    assert [count == 0 for count in further] == followed[1:] and every > sum(further)
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
