# SPDX-License-Identifier: GPL-3.0-or-later
"""Light that lies over a photo and never met the objects: seen by hollows and shadows, and taken off."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from btfsep_engine.btf.library import open_library
from btfsep_engine.pipeline.estimation import estimate
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


def test_problems_of_some_points_keep_the_veil(photographed):
    scene, image, _ = photographed
    problem = found_of(scene, image).model.problems[0]
    veiled = replace(problem, veil=VEIL)
    some = np.arange(len(problem.pixels)) % 3 == 0
    np.testing.assert_allclose(veiled.subset(some).radiance(), problem.radiance()[some] - VEIL)
