# SPDX-License-Identifier: GPL-3.0-or-later
"""A limb brighter than the material's: it is seen to be, and does not pass for light from the sides."""

from dataclasses import replace

import numpy as np
import pytest

from btfsep_engine.btf.library import open_library
from btfsep_engine.btf.surfaces import Surface
from btfsep_engine.pipeline.estimation import estimate
from btfsep_engine.pipeline.model import view_problem
from btfsep_engine.pipeline.refine import limb
from btfsep_engine.pipeline.settings import choose
from btfsep_engine.render.homogeneous import homogeneous
from tests.render.scenes import egg_and_pebble, in_white, off_as_seen, scene_of

WHITE = "reference/white-diffuse"
SETTINGS = choose("draft", bounces=1, directions=1024)


@pytest.fixture(scope="module")
def photographed():
    """An egg and a pebble, their photo with a camera's noise, and the light."""
    return in_white(egg_and_pebble())


def with_limb(scene, image, brighter: float):
    """The photograph with a brightness that falls by ``brighter`` from a cosine of 0 to 1, and no other at 0.6."""
    points = scene.bare_points(0)
    cosine = (points.normal * points.to_eye).sum(1)
    out = image.copy()
    out[tuple(points.pixels.T)] *= (1 + brighter * (0.6 - cosine)).astype(np.float32)[:, None]
    return out


def found_of(scene, image):
    photo = replace(scene.job.photo, radiance=image)
    return estimate(scene_of(replace(scene.job, photo=photo)), open_library(None), SETTINGS, material=WHITE)


def test_a_brighter_limb_is_seen_and_does_not_pass_for_light(photographed, monkeypatch):
    scene, image, truth = photographed
    bright = with_limb(scene, image, 0.4)
    found = found_of(scene, bright)
    assert "light from below its skin" in found.choice["limb"]
    monkeypatch.setattr(limb, "SPEAKS", np.inf)
    without = found_of(scene, bright)
    assert "limb" not in without.choice and without.fit.evidence < found.fit.evidence - limb.CLEARLY
    assert off_as_seen(found.lighting.coefficients, truth) < 0.75 * off_as_seen(without.lighting.coefficients, truth)


@pytest.mark.parametrize("brighter", [0.0, -0.4])
def test_a_limb_as_the_material_has_it_or_darker_is_left_alone(photographed, brighter):
    scene, image, _ = photographed
    found = found_of(scene, with_limb(scene, image, brighter))
    assert "limb" not in found.choice and found.model.problems[0].slopes is None


def test_what_explains_no_more_is_not_kept(photographed, monkeypatch):
    scene, image, _ = photographed
    monkeypatch.setattr(limb, "CLEARLY", np.inf)
    assert "limb" not in found_of(scene, with_limb(scene, image, 0.4)).choice


def test_a_photo_of_which_much_is_left_over_is_not_asked(photographed, monkeypatch):
    scene, image, _ = photographed
    monkeypatch.setattr(limb, "MOST", 1e-3)
    assert "limb" not in found_of(scene, with_limb(scene, image, 0.4)).choice


def test_the_column_is_what_a_brighter_limb_adds_to_each_object(photographed):
    scene, _, _ = photographed
    problem = view_problem(scene, [open_library(None).load(WHITE)], SETTINGS)
    x = np.zeros((problem.basis[0].shape[1], 3))
    x[0] = 1.0, 2.0, 3.0
    (points,), shown = problem.points, problem.predicted(x)
    half = len(points) // 2
    parts = [
        points.take(np.arange(half)),
        points.take(np.arange(half, half + 40)),
        points.take(np.arange(half + 40, half + 60)),
    ]
    rows = [part[: half + 60] for part in (problem.basis[0],)]
    split = replace(problem, points=parts, basis=np.split(rows[0], [half, half + 40]))
    columns = limb.aslant(split, x)
    assert columns.shape == (half + 60, 3, 3)
    cosine = (points.normal * points.to_eye).sum(1)[:half]
    np.testing.assert_allclose(columns[:half, 0], shown[:half] * (cosine.mean() - cosine)[:, None], rtol=1e-5)
    assert not columns[half:, 0].any() and columns[half : half + 40, 1].any() and not columns[:half, 1].any()
    assert not columns[:, 2].any()  # too few pixels to tell


def test_light_goes_into_no_metal_and_no_mirror(photographed, monkeypatch):
    def made(metallic):
        return homogeneous(Surface((0.5, 0.5, 0.5), roughness=0.4, metallic=metallic), "surface/given")

    assert limb._has_depth(made(0.0)) and not limb._has_depth(made(1.0))
    library = open_library(None)
    white, metal = library.load(WHITE), Surface((0.5, 0.5, 0.5), metallic=1.0)
    assert not limb._has_depth(white, metal) and limb._has_depth(white, replace(metal, metallic=0.0))
    assert limb._has_depth(library.load(WHITE)) and not limb._has_depth(library.load("reference/chrome"))
    scene, image, _ = photographed
    monkeypatch.setattr(limb, "_has_depth", lambda *_: False)
    assert "limb" not in found_of(scene, with_limb(scene, image, 0.4)).choice
