# SPDX-License-Identifier: GPL-3.0-or-later
"""Light that lies over a photo and never met the objects: seen by hollows and shadows, and taken off."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from btfsep_engine.btf.library import open_library
from btfsep_engine.pipeline.estimation import estimate
from btfsep_engine.pipeline.materials import ObjectMaterial
from btfsep_engine.pipeline.model import first_model, solve_model
from btfsep_engine.pipeline.refine import veil
from btfsep_engine.pipeline.settings import choose
from tests.render.scenes import as_mesh, in_white, off_as_seen, scene_of, with_photo

WHITE = "reference/white-diffuse"
SETTINGS = choose("draft", refine="all", bounces=1, directions=1024)
VEIL = np.array([0.3, 0.35, 0.4])


@pytest.fixture(scope="module")
def photographed():
    """A ball under a plate's shade and another, its photo with a camera's noise, and the light."""
    parts = [trimesh.creation.icosphere(4, radius) for radius in (0.5, 0.3, 0.25)]
    for part, place in zip(parts, ((0, 0, 0), (0.5, 0.35, 0.35), (-0.45, 0.3, 0.4)), strict=True):
        part.apply_translation(place)
    return in_white(as_mesh(trimesh.util.concatenate(parts)))


def found_of(scene, image):
    there = scene_of(with_photo(scene.job, image))
    return estimate(there, open_library(None), SETTINGS, material=WHITE)


def solved(scene, image):
    """The model of a photo, and its light, before anything is asked of a veil."""
    there = scene_of(with_photo(scene.job, image))
    known = ObjectMaterial(WHITE, open_library(None).load(WHITE), True)
    return solve_model(first_model([there], [[known]], SETTINGS))[:2]


def test_a_veil_is_found_taken_off_and_said(photographed):
    scene, image, truth = photographed
    level = image[scene.view.mesh == 0].mean()
    clear, veiled = found_of(scene, image), found_of(scene, image + (VEIL * level).astype(np.float32))
    assert "veil" not in clear.choice and clear.model.problems[0].veil is None
    assert "% (red, green, blue)" in veiled.choice["veil"]
    np.testing.assert_allclose(veiled.model.problems[0].veil / level, VEIL, rtol=0.25)
    assert any("lies over the photo" in said for said in veiled.scene.reporter.warnings)
    off, off_veiled = (off_as_seen(each.fit.coefficients[:9], truth) for each in (clear, veiled))
    assert off_veiled < off + 0.05


def test_a_photo_that_is_too_dark_everywhere_has_none(photographed):
    scene, image, _ = photographed
    level = image[scene.view.mesh == 0].mean()
    assert "veil" not in found_of(scene, np.maximum(image - 0.2 * level, 0)).choice


def test_what_is_missing_everywhere_does_not_speak_of_a_veil(photographed):
    scene, image, _ = photographed
    level = image[scene.view.mesh == 0].mean()
    chi2 = []
    for more in (0.4, -0.2):
        model, light = solved(scene, np.maximum(image + more * level, 0).astype(np.float32))
        chi2.append(veil._speaks(model.problems, light, np.full((len(model.problems[0].pixels), 3), level)))
    assert chi2[0] > veil.SPEAKS and chi2[1] == 0


def test_no_veil_is_brighter_than_the_darkest_pixel_or_less_than_none(photographed):
    """Where a light leaves nearly all of the photo over, or explains more than there is."""
    scene, image, _ = photographed
    model, light = solved(scene, image)
    (problem,) = model.problems
    least = problem.radiance().min(0)
    for share, wanted in ((0.01, least), (2.0, np.zeros(3))):
        other = replace(light, fit=replace(light.fit, seen=share * light.fit.shown))
        assert (least > 0).all() and np.array_equal(veil._veils([problem], other), [wanted])


def test_a_veil_stays_where_without_it_as_much_is_left_over(photographed, monkeypatch):
    scene, image, _ = photographed
    level = image[scene.view.mesh == 0].mean()
    model, light = solved(scene, image + (VEIL * level).astype(np.float32))
    assert veil.veiled(model, light)[0].problems[0].veil is not None
    before = veil._left(model.problems, light)
    monkeypatch.setattr(veil, "_left", lambda *_: before)
    assert veil.veiled(model, light)[1] is light


def test_problems_of_some_points_keep_the_veil(photographed):
    scene, image, _ = photographed
    problem = found_of(scene, image).model.problems[0]
    veiled = replace(problem, veil=VEIL)
    some = np.arange(len(problem.pixels)) % 3 == 0
    np.testing.assert_allclose(veiled.subset(some).radiance(), problem.radiance()[some] - VEIL)
