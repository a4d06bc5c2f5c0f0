# SPDX-License-Identifier: GPL-3.0-or-later
"""Several objects, of one photo or of two: each counts by how it is explained, and a bad one spoils no good one."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from btfsep_engine.btf.library import open_library
from btfsep_engine.light.lightings import SHLighting
from btfsep_engine.pipeline.estimation import estimate, refinements_of
from btfsep_engine.pipeline.refine.each_object import MOST, each_object_by_itself, precisions
from btfsep_engine.pipeline.settings import choose
from btfsep_engine.pipeline.together import all_weights, counts, light_solver, parts_of, things_of
from tests.render.scenes import as_mesh, egg_and_pebble, in_white, job_of, looking_down, off_as_seen, picture, scene_of

WHITE = "reference/white-diffuse"
SETTINGS = choose("draft", bounces=1, directions=512, align="never")
OTHERS = tuple(r for r in refinements_of(SETTINGS) if r is not each_object_by_itself)


@pytest.fixture(scope="module")
def photographed():
    """An egg and a pebble, their photo with a camera's noise, the same of things that are painted, and the light."""
    scene, image, truth = in_white(egg_and_pebble())
    return scene, image, paint(image), truth


def paint(image):
    """What is painted in pieces, and darker to a side."""
    y, x = np.mgrid[: image.shape[0], : image.shape[1]]
    pieces = 1 + 0.6 * np.sign(np.sin(x / 5) * np.sin(y / 7 + 1))
    return (image * (pieces * (1.6 - 1.2 * x / image.shape[1]))[..., None]).astype(np.float32)


@pytest.fixture(scope="module")
def two_balls():
    """Two white balls in one photo, which of them each pixel shows, and the light of `photographed`."""
    balls = [trimesh.creation.icosphere(4, 0.3).apply_translation((x, 0, 0)) for x in (-0.35, 0.35)]
    scene = scene_of(job_of([as_mesh(ball) for ball in balls], looking_down()))
    truth = np.zeros((9, 3))
    truth[0], truth[1], truth[2], truth[3], truth[6] = 3.0, 0.9, 1.2, -1.1, 0.5
    image, white = np.zeros((96, 96, 3), np.float32), open_library(None).load(WHITE)
    for i in (0, 1):
        points = scene.points(i, region=scene.view.mesh == i, textured=False)
        image += picture(points, scene.radiance(points, white, SHLighting(truth), directions=2048)[:, 0])
    return scene, image * np.random.default_rng(0).normal(1, 0.02, image.shape).astype(np.float32), truth


def found_of(scene, images, refinements=None):
    scenes = [scene_of(replace(scene.job, photo=replace(scene.job.photo, radiance=image))) for image in images]
    return estimate(scenes[0], open_library(None), SETTINGS, material=WHITE, others=scenes[1:], refinements=refinements)


def off(found, truth) -> float:
    """Relative error of what the camera sees lit, with one free scale."""
    return off_as_seen(found.lighting.coefficients, truth)


def counts_of(found) -> list:
    """Of each object of each photo."""
    return [count for problem in found.model.problems for count in problem.counts_of_each]


def test_a_photo_that_is_explained_badly_spoils_no_good_one(photographed):
    scene, image, spoilt, truth = photographed
    alone, bad_alone, both = (found_of(scene, images) for images in ([image], [spoilt], [image, spoilt]))
    alike = found_of(scene, [image, spoilt], OTHERS)
    assert off(both, truth) < 0.6 * off(bad_alone, truth) and off(both, truth) < 0.9 * off(alike, truth)
    assert off(both, truth) < off(alone, truth) + 0.05
    good, bad = counts_of(both)
    assert good > 4 * bad and "of the mean" in both.choice["counts"]
    assert "counts" not in alike.choice and "counts" not in alone.choice


@pytest.mark.parametrize("painted", [0, 1])
def test_of_two_objects_in_a_photo_likewise(two_balls, painted):
    scene, image, truth = two_balls
    spoilt = np.where((scene.view.mesh == painted)[..., None], paint(image), image)
    found, alike = found_of(scene, [spoilt]), found_of(scene, [spoilt], OTHERS)
    assert counts_of(found)[1 - painted] > 4 * counts_of(found)[painted]
    assert off(found, truth) < 0.6 * off(alike, truth) and off(found, truth) < 0.1


def test_no_object_counts_for_as_good_as_nothing(two_balls):
    scene, image, _ = two_balls
    noise = np.random.default_rng(1).lognormal(0, 2, image.shape)
    found = found_of(scene, [np.where((scene.view.mesh == 1)[..., None], noise * image, image).astype(np.float32)])
    good, bad = counts_of(found)
    assert bad > 0.9 * good * (0.05 / MOST) ** 2 and bad < 0.1 * good


def test_the_order_of_the_photos_does_not_matter(photographed):
    scene, image, spoilt, _ = photographed
    one, other = found_of(scene, [image, spoilt]), found_of(scene, [spoilt, image])
    x, y = one.lighting.coefficients, other.lighting.coefficients
    scale = (x * y).sum() / (y * y).sum()
    assert np.linalg.norm(x - scale * y) < 0.03 * np.linalg.norm(x)
    np.testing.assert_allclose(counts_of(one), counts_of(other)[::-1], rtol=0.2)


def test_photos_that_are_explained_alike_count_alike_and_by_the_pixel(photographed):
    scene, image, _, truth = photographed
    found = found_of(scene, [image, 3 * image])
    np.testing.assert_allclose(counts_of(found), 1, atol=0.1)
    assert found.light.exposures[1] == pytest.approx(3, rel=1e-3)
    assert off(found, truth) < 0.06


def test_counts_are_of_mean_one_and_beside_what_else_pixels_weigh(photographed):
    scene, image, spoilt, _ = photographed
    found = found_of(scene, [image, spoilt])
    problems, light = found.model.problems, found.light
    own = all_weights(problems) / counts(problems)[:, None]
    now = np.concatenate(precisions(problems, light))[parts_of(problems)]
    assert np.average(now, weights=own.sum(1)) == pytest.approx(1)
    assert own.max() < 4 and own.min() > 0.2
    again = [p.counting([c]).counting(p.counts) for p, c in zip(problems, (7.0, 0.1), strict=True)]
    np.testing.assert_allclose(all_weights(again), all_weights(problems))


def test_what_departs_and_is_explained_worse_may_depart_more(photographed):
    """The model's own error is an object's, larger where more is left over; another solver for each, none reused."""
    scene, image, spoilt, _ = photographed
    found = found_of(scene, [image, spoilt])
    problems = found.model.problems
    solver = light_solver(problems, found.settings)
    good, bad = (solver.departing[parts_of(problems) == i] for i in (0, 1))
    assert (good == 1).all()
    np.testing.assert_allclose(bad, np.sqrt(counts_of(found)[0] / counts_of(found)[1]))
    assert light_solver(problems[:1], found.settings).departing is None


def test_what_a_model_misses_is_the_same_of_an_object_wherever_it_is_seen_and_another_of_another(two_balls):
    scene, image, _ = two_balls
    (one,) = found_of(scene, [image], OTHERS).model.problems
    moved = [replace(o, mesh=replace(o.mesh, vertices=o.mesh.vertices + 0.1)) for o in scene.job.objects]
    there = replace(one, scene=scene_of(replace(scene.job, objects=tuple(moved))))
    number = things_of([one, there])
    np.testing.assert_array_equal(number, np.tile(things_of([one]), 2))
    assert set(number) == {0, 1} and len(set(parts_of([one, there]))) == 4
    other = replace(moved[0], name="another")
    beside = replace(one, scene=scene_of(replace(scene.job, objects=(other, moved[1]))))
    assert set(things_of([one, beside])[len(one.pixels) :]) == {1, 2}
    own = light_solver([one], SETTINGS).basis.smooth.reshape(len(one.pixels), 2, -1)
    assert not own[number[: len(own)] == 0, 1].any() and not own[number[: len(own)] == 1, 0].any()
    np.testing.assert_allclose(np.square(own).sum((1, 2)), np.square(own).sum((1, 2))[0])
