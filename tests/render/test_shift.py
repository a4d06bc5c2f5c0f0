# SPDX-License-Identifier: GPL-3.0-or-later
"""A photo a little beside the geometry: its shading says so, and its light is found nearly as well as in line."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from btfsep_engine.btf.library import open_library
from btfsep_engine.pipeline.estimation import estimate
from btfsep_engine.pipeline.model import view_problem
from btfsep_engine.pipeline.refine.shift import INNER, _moved, differences, shifted
from btfsep_engine.pipeline.settings import choose
from tests.render.scenes import as_mesh, egg_and_pebble, in_white, job_of, looking_down, off_as_seen, scene_of

WHITE = "reference/white-diffuse"
SETTINGS = choose("draft", bounces=1, directions=1024)


@pytest.fixture(scope="module")
def photographed():
    """An egg and a pebble, their photo with a camera's noise, and the light."""
    return in_white(egg_and_pebble())


def found_of(scene, image, right=0, down=0, *, in_place=False):
    photo = replace(scene.job.photo, radiance=np.roll(image, (down, right), (0, 1)))
    there = scene_of(replace(scene.job, photo=photo))
    there.in_place = in_place
    return estimate(there, open_library(None), SETTINGS, material=WHITE)


def test_differences_are_the_photo_moved_turned_and_magnified(photographed):
    """Of an image that is quadratic in its own place, whose slopes are known."""
    scene, _, _ = photographed
    problem = view_problem(scene, [open_library(None).load(WHITE)], SETTINGS)
    y, x = np.mgrid[:96, :96].astype(float) - 48
    image = np.stack([2 + 0.01 * x, 3 - 0.02 * y, 1 + 1e-4 * (x * x + x * y)], -1).astype(np.float32)
    there = replace(problem, scene=scene_of(replace(scene.job, photo=replace(scene.job.photo, radiance=image))))
    right, down, larger, turned = np.moveaxis(differences(there), 1, 0)
    well = problem.rings > 3
    y, x = (problem.pixels - 48.0)[well].T
    np.testing.assert_allclose(right[well], np.stack([0.01 + 0 * x, 0 * x, 1e-4 * (2 * x + y)], 1), atol=2e-4)
    np.testing.assert_allclose(down[well], np.stack([0 * x, -0.02 + 0 * x, 1e-4 * x], 1), atol=2e-4)
    cy, cx = problem.pixels.mean(0)
    far = np.sqrt(np.square(problem.pixels - [cy, cx]).sum(1).mean())
    x, y = (problem.pixels[well, 1] - cx)[:, None] / far, (problem.pixels[well, 0] - cy)[:, None] / far
    np.testing.assert_allclose(larger[well], x * right[well] + y * down[well])
    np.testing.assert_allclose(turned[well], x * down[well] - y * right[well])


def test_pixels_that_are_no_numbers_have_no_part_in_a_slope(photographed):
    scene, image, _ = photographed
    problem = view_problem(scene, [open_library(None).load(WHITE)], SETTINGS)
    holed = image.copy()
    holed[20:76:5, ::7] = np.nan
    photo = replace(scene.job.photo, radiance=holed)
    there = replace(problem, scene=scene_of(replace(scene.job, photo=photo)))
    assert np.isfinite(differences(there)).all() and np.abs(differences(there)).max() > 0


def test_a_photo_in_line_says_nothing_of_a_shift(photographed):
    scene, image, truth = photographed
    found = found_of(scene, image)
    assert found.model.problems[0].slopes is None and "shift" not in found.choice
    assert off_as_seen(found.lighting.coefficients, truth) < 0.05


@pytest.mark.parametrize(("right", "down"), [(2, 0), (0, -2), (-2, 1)])
def test_a_photo_beside_its_place_is_seen_to_be_and_loses_little(photographed, right, down, monkeypatch):
    scene, image, truth = photographed
    found = found_of(scene, image, right, down)
    assert "a little beside" in found.choice["shift"] and found.model.problems[0].slopes is not None
    monkeypatch.setattr("btfsep_engine.pipeline.refine.shift.SPEAKS", np.inf)
    fixed = found_of(scene, image, right, down)
    assert "shift" not in fixed.choice and fixed.fit.evidence < found.fit.evidence
    assert off_as_seen(found.lighting.coefficients, truth) < 0.75 * off_as_seen(fixed.lighting.coefficients, truth)


def test_where_edges_say_that_the_camera_is_in_place_the_shading_is_not_asked(photographed):
    scene, image, _ = photographed
    assert "shift" not in found_of(scene, image, 2, in_place=True).choice


def chi2_of(scene, images, exposures=(1, 1)):
    """What `_moved` says of two photographs of the scene, and their light."""
    scenes = []
    for image, e in zip(images, exposures, strict=True):
        photo = replace(scene.job.photo, radiance=np.float32(e) * image)
        scenes.append(scene_of(replace(scene.job, photo=photo)))
    found = estimate(scenes[0], open_library(None), SETTINGS, material=WHITE, others=scenes[1:])
    problems = [replace(p, slopes=None) for p in found.model.problems]
    return _moved(problems, [differences(p) for p in problems], found.light), found


def test_of_two_photos_each_is_moved_by_itself_and_the_order_does_not_matter(photographed):
    scene, image, _ = photographed
    beside = np.roll(image, (0, 2), (0, 1))
    each, _ = chi2_of(scene, (image, beside))
    np.testing.assert_allclose(chi2_of(scene, (beside, image))[0][::-1], each, rtol=0.1)
    assert each[1] > 1.5 * each[0]


@pytest.mark.parametrize("right", [0, 2])
def test_two_photos_of_other_exposures_are_explained_as_well_as_of_one(photographed, right):
    scene, image, _ = photographed
    images = image, np.roll(image, (0, right), (0, 1))
    found, brighter = (chi2_of(scene, images, (1, e))[1] for e in (1, 8))
    assert brighter.light.exposures[1] == pytest.approx(8 * found.light.exposures[1], rel=1e-3)
    assert brighter.fit.evidence == pytest.approx(found.fit.evidence, abs=1)
    np.testing.assert_allclose(brighter.fit.coefficients, found.fit.coefficients, atol=0.01)
    for one, other in zip(found.model.problems, brighter.model.problems, strict=True):
        assert (one.slopes is None) == (other.slopes is None) == (right == 0)
        if right:
            np.testing.assert_allclose(other.slopes, one.slopes, rtol=1e-3, atol=1e-4)


def test_slopes_are_half_a_pixels_in_the_unit_of_what_is_fitted(photographed, monkeypatch):
    """Of an object whose reflectance is not its material's the photo is fitted over that factor."""
    scene, image, _ = photographed
    problem = view_problem(scene, [open_library(None).load(WHITE)], SETTINGS)
    photo = replace(scene.job.photo, radiance=image)
    problem = replace(problem, scene=scene_of(replace(scene.job, photo=photo)))
    scales = np.array([[0.5, 1.0, 2.0]])
    found = estimate(problem.scene, open_library(None), SETTINGS, material=WHITE)
    scaled = replace(problem, scales=scales, measured=problem.radiance() / scales)
    for name in ("SPEAKS", "CLEARLY"):
        monkeypatch.setattr(f"btfsep_engine.pipeline.refine.shift.{name}", -np.inf)
    free, _, _ = shifted(replace(found.model, looks={"mean": [scaled]}), found.light)
    half_a_pixel = 0.5 * differences(problem) / scales
    np.testing.assert_allclose(free.problems[0].slopes, half_a_pixel)


def test_what_explains_no_more_is_not_kept(photographed, monkeypatch):
    """Wherever it is asked for: of a photo in line the evidence is against it."""
    scene, image, _ = photographed
    monkeypatch.setattr("btfsep_engine.pipeline.refine.shift.SPEAKS", -np.inf)
    assert "shift" not in found_of(scene, image).choice


def test_what_is_left_over_near_an_outline_says_nothing(photographed):
    scene, image, _ = photographed
    found = found_of(scene, image, 1)
    (problem,) = found.model.problems
    slopes = [differences(problem)]

    def chi2_with(changed):
        values = np.where(changed[:, None], 1.5 * problem.radiance(), problem.radiance())
        return _moved([replace(problem, measured=values)], slopes, found.light)

    before = chi2_with(np.zeros(len(problem.pixels), bool))
    assert chi2_with(problem.rings <= INNER) == before and chi2_with(problem.rings == INNER + 1) != before


def test_slopes_are_of_the_surface_itself_in_pixels_of_a_photo_of_any_size():
    """Two plates, one above the other and both beyond the picture: no slope has a part of a step between them."""
    for size in (96, 1200):
        low, high = (trimesh.creation.box((10.0, 10.0, 0.02)) for _ in range(2))
        high.apply_translation([5.1, 0.0, 0.5])
        camera = looking_down(size=size, focal=2.1 * size)
        scene = scene_of(job_of([as_mesh(trimesh.util.concatenate([low, high]), flat=True)], camera))
        problem = view_problem(scene, [open_library(None).load(WHITE)], choose("draft", bounces=1, directions=64))
        y, x = np.mgrid[:size, :size] / size
        image = np.stack([1 + x, 2 - 3 * y, x + y], -1) + 50.0 * (scene.view.distance < 3.8)[..., None]
        photo = replace(scene.job.photo, radiance=image.astype(np.float32))
        there = replace(problem, scene=scene_of(replace(scene.job, photo=photo)))
        right, down = np.moveaxis(differences(there), 1, 0)[:2] * size
        assert scene.outlines.edge == (1 if size == 96 else 3) and len(right) > 1500
        np.testing.assert_allclose(right, np.broadcast_to([1, 0, 1], right.shape), atol=0.05)
        np.testing.assert_allclose(down, np.broadcast_to([0, -3, 1], down.shape), atol=0.05)
