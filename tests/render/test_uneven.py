# SPDX-License-Identifier: GPL-3.0-or-later
"""Surfaces that are lighter here and darker there than anybody told: found by the misfit, and what is dark counts."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from btfsep_engine.btf.library import open_library
from btfsep_engine.btf.surfaces import GIVEN, SURFACES, Surface
from btfsep_engine.pipeline.estimation import REFINEMENTS, estimate
from btfsep_engine.pipeline.problem import make_problem
from btfsep_engine.pipeline.refine import uneven
from btfsep_engine.pipeline.refine.uneven import _may_be_uneven, _overthrown, uneven_surfaces
from btfsep_engine.pipeline.settings import choose
from btfsep_engine.render.homogeneous import homogeneous
from tests.render.scenes import ball_with_another, in_white, lit_by_a_lamp, off_as_seen, scene_of, with_photo

WHITE = "reference/white-diffuse"
SETTINGS = choose("draft", refine="all", bounces=1, directions=1024)
WITHOUT = [r for r in REFINEMENTS if r is not uneven_surfaces]
VARIES = 0.4  # of the logarithm of the albedo


@pytest.fixture(scope="module")
def photographed():
    """A ball with another before it, its photo with a camera's noise, and the light."""
    return in_white(ball_with_another())


def blotched(image, seed):
    """The photo of a surface of blotches as large as two pixels."""
    blotches = gaussian_filter(np.random.default_rng(seed).standard_normal(image.shape[:2]), 1)
    return image * np.exp(VARIES * blotches / blotches.std())[..., None].astype(np.float32)


def found_of(scene, image, **how):
    there = scene_of(with_photo(scene.job, image))
    return estimate(there, open_library(None), SETTINGS, material=WHITE, **how)


def test_blotches_are_found_and_the_light_is_better_for_it(photographed):
    scene, off = photographed[0], []
    for seed in range(4):
        image, truth = lit_by_a_lamp(scene, seed)
        photo = blotched(image, seed)
        found, plain = found_of(scene, photo), found_of(scene, photo, refinements=WITHOUT)
        assert "brightness" in found.choice["uneven"] and "uneven" not in plain.choice
        off.append([off_as_seen(each.fit.coefficients[:9], truth) for each in (found, plain)])
    with_law, without_law = np.mean(off, 0)
    assert with_law < 0.9 * without_law


def test_the_dark_counts_for_more(photographed):
    scene, image, _ = photographed
    problem = found_of(scene, blotched(image, 0)).model.problems[0]
    seen = problem.radiance().mean(1)
    dark, bright = seen < np.percentile(seen, 20), seen > np.percentile(seen, 80)
    assert problem.weights[dark].mean() > 2 * problem.weights[bright].mean()
    np.testing.assert_allclose(problem.weights.mean(0), 1)


def test_an_even_surface_has_none(photographed):
    scene, image, _ = photographed
    found = found_of(scene, image)
    assert "uneven" not in found.choice and found.model.problems[0].weights is None


@pytest.fixture(scope="module")
def blotchy(photographed):
    """The estimate of a blotched photo by all else."""
    scene, image, _ = photographed
    return found_of(scene, blotched(image, 0), refinements=WITHOUT)


def turned(fit):
    """A Fit by half a turn about the vertical."""
    x = fit.all_coefficients.copy()
    x[[1, 3]] *= -1
    return replace(fit, all_coefficients=x)


def test_a_light_that_would_be_another_one_is_not_taken(blotchy, monkeypatch):
    before = blotchy.fit
    assert not _overthrown(before, before)
    assert not _overthrown(before, replace(before, all_coefficients=1.01 * before.all_coefficients))
    assert _overthrown(before, turned(before))
    model, light = blotchy.model, blotchy.light
    assert "uneven" in uneven_surfaces(model, light)[2]
    monkeypatch.setattr(uneven, "followed", lambda *given, of=uneven.followed: turned(of(*given)))
    _, kept, words = uneven_surfaces(model, light)
    assert kept is light and not words


def test_pixels_that_hardly_count_explain_nothing(blotchy, monkeypatch):
    """Less is left over without the half that fits worst, but then as much is not explained."""

    def of_the_better_half(misfit, left_over, **_):
        size = np.square(misfit).sum(1, keepdims=True)
        return np.where(size < np.median(size), 1.99, 0.01) * np.ones(3)

    monkeypatch.setattr(uneven, "precision", of_the_better_half)
    model, light = blotchy.model, blotchy.light
    _, kept, words = uneven_surfaces(model, light)
    assert kept is light and not words


@pytest.mark.parametrize(
    ("name", "surface", "may_be"),
    [
        ("surface/plastic", SURFACES["surface/plastic"], True),
        ("surface/plastic", Surface((0.2, 0.2, 0.2), roughness=0.2), False),  # its brightest are highlights
        (GIVEN, SURFACES["surface/plastic"], False),  # who gave it knows where it is light and dark
    ],
)
def test_only_what_is_not_given_and_has_no_highlights_may_be_uneven(photographed, name, surface, may_be):
    scene = photographed[0]
    problem = make_problem(scene, [homogeneous(surface, name)], [scene.points(0, textured=False)], SETTINGS)
    np.testing.assert_array_equal(_may_be_uneven(problem), np.full(len(problem.pixels), may_be))
