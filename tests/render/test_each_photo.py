# SPDX-License-Identifier: GPL-3.0-or-later
"""Several photographs of one light: each counts as much as it is explained, and a bad one spoils no good one."""

from dataclasses import replace

import numpy as np
import pytest

from btfsep_engine.btf.library import open_library
from btfsep_engine.pipeline.estimation import REFINEMENTS, estimate
from btfsep_engine.pipeline.refine.each_photo import each_photo_by_itself, precisions
from btfsep_engine.pipeline.settings import choose
from btfsep_engine.pipeline.together import all_weights, counts, light_solver, of_photographs
from tests.render.scenes import egg_and_pebble, in_white, off_as_seen, scene_of

WHITE = "reference/white-diffuse"
SETTINGS = choose("draft", bounces=1, directions=512, align="never")
OTHERS = tuple(r for r in REFINEMENTS if r is not each_photo_by_itself)


@pytest.fixture(scope="module")
def photographed():
    """An egg and a pebble, their photo with a camera's noise, the same of things that are painted, and the light."""
    scene, image, truth = in_white(egg_and_pebble())
    y, x = np.mgrid[:96, :96]
    paint = 1 + 0.6 * np.sign(np.sin(x / 5) * np.sin(y / 7 + 1))
    darker_to_a_side = 1.6 - 1.2 * x / 96
    return scene, image, (image * (paint * darker_to_a_side)[..., None]).astype(np.float32), truth


def found_of(scene, images, refinements=None):
    scenes = [scene_of(replace(scene.job, photo=replace(scene.job.photo, radiance=image))) for image in images]
    return estimate(scenes[0], open_library(None), SETTINGS, material=WHITE, others=scenes[1:], refinements=refinements)


def off(found, truth) -> float:
    """Relative error of what the camera sees lit, with one free scale."""
    return off_as_seen(found.lighting.coefficients, truth)


def test_a_photo_that_is_explained_badly_spoils_no_good_one(photographed):
    scene, image, spoilt, truth = photographed
    alone, both = found_of(scene, [image]), found_of(scene, [image, spoilt])
    alike = found_of(scene, [image, spoilt], OTHERS)
    assert off(both, truth) < 0.4 * off(alike, truth)
    assert off(both, truth) < off(alone, truth) + 0.05
    good, bad = (p.counts for p in both.model.problems)
    assert good > 4 * bad and "of the mean" in both.choice["photographs"]
    assert "photographs" not in alike.choice and "photographs" not in alone.choice


def test_the_order_of_the_photos_does_not_matter(photographed):
    scene, image, spoilt, _ = photographed
    one, other = found_of(scene, [image, spoilt]), found_of(scene, [spoilt, image])
    x, y = one.lighting.coefficients, other.lighting.coefficients
    scale = (x * y).sum() / (y * y).sum()
    assert np.linalg.norm(x - scale * y) < 0.03 * np.linalg.norm(x)
    np.testing.assert_allclose(
        [p.counts for p in one.model.problems], [p.counts for p in other.model.problems[::-1]], rtol=0.2
    )


def test_photos_that_are_explained_alike_count_alike_and_by_the_pixel(photographed):
    scene, image, _, truth = photographed
    found = found_of(scene, [image, 3 * image])
    np.testing.assert_allclose([p.counts for p in found.model.problems], 1, atol=0.1)
    assert found.light.exposures[1] == pytest.approx(3, rel=1e-3)
    assert off(found, truth) < 0.06


def test_counts_are_of_mean_one_and_beside_what_else_pixels_weigh(photographed):
    scene, image, spoilt, _ = photographed
    found = found_of(scene, [image, spoilt])
    problems, light = found.model.problems, found.light
    own = all_weights(problems) / counts(problems)[:, None]
    assert np.average(precisions(problems, light)[of_photographs(problems)], weights=own.sum(1)) == pytest.approx(1)
    assert own.max() < 1.5 and own.min() > 0.3
    again = [p.counting(c).counting(p.counts) for p, c in zip(problems, (7.0, 0.1), strict=True)]
    np.testing.assert_allclose(all_weights(again), all_weights(problems))


def test_what_departs_and_is_explained_worse_may_depart_more(photographed):
    """The model's own error is a photograph's, larger where more is left over; another solver for each, none reused."""
    scene, image, spoilt, _ = photographed
    found = found_of(scene, [image, spoilt])
    problems = found.model.problems
    solver = light_solver(problems, found.settings)
    good, bad = (solver.departing[of_photographs(problems) == i] for i in (0, 1))
    assert (good == 1).all()
    np.testing.assert_allclose(bad, np.sqrt(problems[0].counts / problems[1].counts))
    own = solver.basis.smooth.reshape(len(solver.departing), 2, -1)
    number = of_photographs(problems)
    assert not own[number == 0, 1].any() and not own[number == 1, 0].any()
    np.testing.assert_allclose(np.square(own).sum((1, 2)), np.square(own).sum((1, 2))[0])
    assert light_solver(problems[:1], found.settings).departing is None
