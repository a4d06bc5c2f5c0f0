# SPDX-License-Identifier: GPL-3.0-or-later
"""A wall of which the job does not say the colour, and the photo shows it: against the path tracer."""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh

from btfsep_engine.btf.library import open_library
from btfsep_engine.btf.model import Lambertian
from btfsep_engine.btf.surfaces import Surface
from btfsep_engine.fit.stated import shown_error, widened
from btfsep_engine.job.model import Occluder, Photo
from btfsep_engine.light.lightings import SHBasis
from btfsep_engine.pipeline.checks import all_doubts
from btfsep_engine.pipeline.estimation import estimate
from btfsep_engine.pipeline.following import Follower
from btfsep_engine.pipeline.refine import said_surface
from btfsep_engine.pipeline.refine.said_surface import (
    DIFFERS,
    ERROR,
    OTHERWISE,
    UNLIKE,
    WIDEST,
    called,
    log_brighter,
    said_and_shown,
    unlike_surroundings,
)
from btfsep_engine.pipeline.refine.seen_colour import BRIGHTEST, LEAST_COSINE, seen_colours, seen_places, sent
from btfsep_engine.pipeline.settings import choose
from btfsep_engine.progress import Reporter
from btfsep_engine.render.reference import Reference
from btfsep_engine.render.surface import surface_points
from tests.render.scenes import (
    as_mesh,
    ball,
    job_of,
    looking_down,
    off_as_reaching,
    positive_light,
    scene_of,
    with_photo,
)

SIZE = 64
COLOUR = np.array([0.8, 0.25, 0.05])
WHITE = Lambertian("test/white", np.full(3, 0.8))  # as the library's reference
TRUTH = positive_light(2)
SETTINGS = choose("draft", pixels=700)


def job_with(surface, *, focal=60.0):
    """A unit ball beside a large wall with its face to +x, in a camera that looks along it."""
    box = trimesh.creation.box([0.02, 8, 8]).apply_translation([-1.06, 0, 0])
    return job_of([ball()], looking_down(SIZE, focal), occluders=[Occluder(as_mesh(box, flat=True), surface)])


@pytest.fixture(scope="module")
def shown():
    """(h, w, 9, 3): the pixels of the ball and the orange wall under each light, and which show the wall."""
    job = job_with(Surface(tuple(COLOUR), roughness=1.0, specular=0.0))
    scene = scene_of(job)
    pixels = np.argwhere(scene.view.mesh >= 0)
    reference = Reference(job, scene.tracer, [WHITE], bounces=8, textured=False)
    image = np.zeros((SIZE, SIZE, 9, 3), np.float32)
    image[tuple(pixels.T)] = reference.radiance(pixels, SHBasis(2), samples=256).radiance
    return image, scene.view.mesh == 1


def photo_of(shown, light=TRUTH):
    image = np.einsum("hwtc,tc->hwc", shown[0], light)
    return image * np.random.default_rng(1).normal(1, 0.01, image.shape)


def estimated(image, surface=None, *, usable=None, mask=None, others=()):
    def scene_with(image):
        job = with_photo(job_with(surface), image, usable)
        return scene_of(replace(job, objects=(replace(job.objects[0], mask=mask),)))

    scenes = [scene_with(each) for each in (image, *others)]
    return estimate(scenes[0], open_library(None), SETTINGS, material="reference/white-diffuse", others=scenes[1:])


def grey_photo(job):
    return with_photo(job, np.full((SIZE, SIZE, 3), 0.3))


@pytest.fixture(scope="module")
def found(shown):
    return estimated(photo_of(shown))


@pytest.fixture(scope="module")
def known(shown):
    """The estimate where the job says what the wall is like."""
    return estimated(photo_of(shown), Surface(tuple(COLOUR), roughness=1.0, specular=0.0))


@pytest.fixture(scope="module")
def unseen(shown):
    """The estimate without the pixels that show the wall."""
    return estimated(photo_of(shown), usable=~shown[1])


def test_the_colour_is_read_and_the_light_is_that_beside_a_known_wall(found, known, unseen):
    np.testing.assert_allclose(found.scene.colours[0], COLOUR, rtol=0.07)
    assert found.scene.greys is None and not found.scene.has_unknown
    assert "of 1 of 1 occluders the photo shows the colour: red, green, blue (0." in found.choice["surroundings"]
    errors = [off_as_reaching(f.fit, TRUTH) for f in (known, found, unseen)]
    assert errors[1] < 1.1 * errors[0] + 0.003 and errors[2] > 2 * errors[1]


def test_of_permuted_channels_the_colour_is_permuted(shown, found):
    problem, order = found.model.problems[0], [2, 0, 1]
    problem = replace(problem, scene=problem.scene.with_colours({0: COLOUR}))
    places = seen_places(problem.scene)
    ((straight, left),) = seen_colours(problem, places, TRUTH, SETTINGS).values()
    scene = problem.scene.with_colours({0: COLOUR[order]})
    permuted = {0: (places[0][0], places[0][1][:, order])}
    ((other, _),) = seen_colours(replace(problem, scene=scene), permuted, TRUTH[:, order], SETTINGS).values()
    np.testing.assert_allclose(other, straight[order], rtol=1e-5)
    np.testing.assert_allclose(straight, COLOUR, rtol=0.03)
    assert 0.005 < left < 0.06
    again = estimated(photo_of(shown)[..., order])
    np.testing.assert_allclose(again.scene.colours[0], found.scene.colours[0][order], rtol=0.1)


def test_places_count_by_what_the_middle_of_the_objects_receives_of_them():
    """cos / r^2 of the piece of surface that a pixel shows, its area from where the corners' rays meet the wall."""
    scene = scene_of(job_with(None, focal=100.0))
    points = surface_points(scene.view, scene.job, 1, region=scene.view.mesh == 1)
    x, camera = -1.05, scene.job.camera
    corners = []
    for right, down in ((0, 0), (1, 0), (0, 1)):
        origins, directions = camera.rays(points.pixels[:, 1] + right, points.pixels[:, 0] + down)
        corners.append(origins + directions * ((x - origins[:, :1]) / directions[:, :1]))
    area = np.linalg.norm(np.cross(corners[1] - corners[0], corners[2] - corners[0]), axis=1)
    way = np.zeros(3) - points.position  # the ball's middle
    distance = np.linalg.norm(way, axis=1)
    cosine = way[:, 0] / distance
    usual = (cosine > LEAST_COSINE) & (distance > 1.2 * scene.tracer.radius)
    share = sent(points, scene.tracer)[usual] / (cosine * area / distance**2)[usual]
    assert usual.sum() > 100
    np.testing.assert_allclose(share / np.median(share), 1, atol=0.1)


def test_a_colour_is_the_mean_of_its_places_as_they_count_and_what_is_known_is_not_read(found):
    """It is linear in the photo: what the half that counts most adds, is its share of the light that is received."""
    problem = found.model.problems[0]
    problem = replace(problem, scene=problem.scene.with_colours({0: COLOUR}))
    ((points, photo),) = seen_places(problem.scene).values()
    weight = sent(points, problem.scene.tracer)
    most = weight > np.median(weight)

    def read(values):
        return seen_colours(problem, {0: (points, values)}, 2 * TRUTH, SETTINGS)[0][0]  # too bright: nothing is bounded

    part = (weight[most, None] * photo[most]).sum(0) / (weight[:, None] * photo).sum(0)
    assert (part[:2] > 0.6).all()
    np.testing.assert_allclose((read(photo * most[:, None]) / read(photo))[:2], part[:2], rtol=1e-6)
    known = Surface(tuple(COLOUR), roughness=1.0, specular=0.0)
    job = replace(problem.scene.job, occluders=(replace(problem.scene.job.occluders[0], surface=known),))
    assert seen_places(scene_of(job)) == {}


def test_under_a_light_taken_too_dark_the_hue_stays(found):
    problem = found.model.problems[0]
    ((colour, _),) = seen_colours(problem, seen_places(problem.scene), 0.2 * TRUTH, SETTINGS).values()
    assert colour.max() == pytest.approx(BRIGHTEST)
    np.testing.assert_allclose(colour[1:] / colour[0], COLOUR[1:] / COLOUR[0], rtol=0.1)


def test_where_the_photo_does_not_show_it_nothing_is_read(shown, unseen):
    image, wall = photo_of(shown), shown[1]
    cut_out = estimated(np.where(wall[..., None], 0, image))
    masked = estimated(image, mask=np.ones_like(wall))
    for each in (unseen, cut_out, masked):
        assert not each.scene.colours and "by evidence a grey of" in each.choice["surroundings"]
        assert np.array_equal(each.fit.samples, unseen.fit.samples)
    outside = scene_of(job_with(None, focal=300.0))
    assert not (outside.view.mesh == 1).any() and seen_places(outside) == {}


@pytest.mark.parametrize("painted", ["half", "blue"])
def test_what_does_not_go_with_the_objects_is_not_believed(shown, unseen, painted):
    image, wall = photo_of(shown), shown[1]
    upper = wall & (np.arange(SIZE)[:, None] < SIZE / 2)
    paint = {"half": (upper, [0.0, 0.0, 12.0]), "blue": (wall, [0.02, 0.3, 12.0])}[painted]
    image[paint[0]] *= paint[1]
    found = estimated(image)
    assert found.fit.evidence >= unseen.fit.evidence - 1
    assert off_as_reaching(found.fit, TRUTH) < 1.05 * off_as_reaching(unseen.fit, TRUTH)


def test_each_photo_is_read_in_its_own_exposure(shown):
    both = estimated(photo_of(shown), others=[3 * photo_of(shown)])
    one, other = (problem.scene.colours[0] for problem in both.model.problems)
    np.testing.assert_allclose(one, COLOUR, rtol=0.07)
    np.testing.assert_allclose(other, one, rtol=0.02)


def test_a_further_frame_keeps_the_colour(shown, found):
    follower = Follower(found, open_library(None))
    image = photo_of(shown, positive_light(2, seed=5))
    scene = scene_of(job_with(None))
    scene = follower.scene_of(scene, Photo(image.astype(np.float32), np.ones((SIZE, SIZE), bool), 0), Reporter())
    frame = follower.estimate(scene)
    assert frame.how != "model chosen"
    assert np.array_equal(frame.estimate.scene.colours[0], found.scene.colours[0])
    assert off_as_reaching(frame.estimate.fit, positive_light(2, seed=5)) < 0.08


@pytest.mark.parametrize("said", [(0.0,) * 3, (0.8,) * 3], ids=["black", "a stand-in's grey"])
def test_a_wall_that_the_photo_shows_in_another_colour_than_the_job_says_is_as_the_photo_shows_it(shown, found, said):
    otherwise = estimated(photo_of(shown), Surface(said, roughness=1.0, specular=0.0))
    np.testing.assert_allclose(otherwise.scene.colours[0], COLOUR, rtol=0.1)
    words = "occluder 1 is said to reflect {:.2f}, {:.2f}, {:.2f} (red, green, blue)".format(*said)
    assert words in otherwise.choice[OTHERWISE] and "(by evidence)" in otherwise.choice[OTHERWISE]
    assert any(words in doubt for doubt in all_doubts(otherwise))
    assert "the surface of" not in otherwise.choice["surroundings"]
    assert off_as_reaching(otherwise.fit, TRUTH) < 1.2 * off_as_reaching(found.fit, TRUTH) + 0.003


def test_a_wall_that_is_as_the_job_says_is_neither_doubted_nor_read(known):
    assert OTHERWISE not in known.choice and not known.scene.colours
    assert not any("occluder" in doubt for doubt in all_doubts(known))


def test_what_the_objects_speak_against_stays_as_it_is_said_and_is_doubted(shown):
    """A wall that was painted over in the photo: its pixels say one thing, the ball's another."""
    image = photo_of(shown)
    image[shown[1]] = image[shown[1]].mean() * np.array([0.05, 0.3, 1.5])
    known = estimated(image, Surface(tuple(COLOUR), roughness=1.0, specular=0.0))
    assert OTHERWISE not in known.choice and not known.scene.colours
    (doubt,) = (doubt for doubt in all_doubts(known) if "occluder" in doubt)
    assert "is said to reflect 0.80, 0.25, 0.05" in doubt and "what is said is wrong" in doubt


@pytest.mark.parametrize(
    "surface",
    [Surface((0.1,) * 3, metallic=1.0), Surface((0.1,) * 3, emission=(0.2, 0, 0))],
    ids=["metal", "what shines"],
)
def test_of_what_shows_no_colour_of_its_own_nothing_is_read(surface):
    assert seen_places(scene_of(grey_photo(job_with(surface))), said=True) == {}
    assert seen_places(scene_of(grey_photo(job_with(Surface((0.1,) * 3)))), said=True)


def test_of_a_wall_brighter_than_the_light_makes_it_half_of_the_samples_are_of_a_light_that_errs_so(
    shown, known, monkeypatch
):
    """As where a light is wrong and the wall is as it is said to be; the others as where the wall is wrong."""
    for times, way in ((0.8, "brighter"), (1.15, "darker"), (1.0, "")):
        said = Surface(tuple(COLOUR * times), roughness=1.0, specular=0.0)
        found = known if times == 1 else estimated(photo_of(shown), said)
        assert OTHERWISE not in found.choice
        problem, x = found.model.problems[0], found.fit.all_coefficients
        ((_, name, *colours),) = said_and_shown(problem, x, found.settings)
        named = replace(problem.scene.job.occluders[0], name="Wall")
        job = replace(problem.scene.job, occluders=(named,))
        assert (name, called(SimpleNamespace(job=job), 0)) == ("occluder 1", "occluder 'Wall'")
        seen = log_brighter(*colours)
        assert np.exp(seen) == pytest.approx(1 / times, rel=0.06)
        sure = replace(found.light, fit=widened(found.fit, 0.1))
        _, light, words = unlike_surroundings(found.model, sure)
        assert (UNLIKE in words) is bool(way)
        if way:
            told = re.search(rf"(\d+) % {way} in the photo than its 'surface'", words[UNLIKE])
            assert int(told[1]) == pytest.approx(100 * abs(np.exp(seen) - 1), abs=0.51)
            before = shown_error(sure.fit)["order_2"]["median"]
            factor = min(ERROR * abs(seen) / before, WIDEST)
            wider = (light.fit.samples - x) / (sure.fit.samples - x)
            np.testing.assert_allclose(np.sort(wider[:, 0, 0]), np.repeat([1, factor], len(wider) // 2), rtol=1e-3)
            assert np.ptp(wider, axis=(1, 2)).max() < 0.01
            both = widened(sure.fit, factor)
            stated, wrong = (shown_error(fit)["order_2"]["median"] for fit in (light.fit, both))
            assert 1.1 * before < stated < 0.8 * wrong and "in half of the cases" in words[UNLIKE]
            with monkeypatch.context() as patched:
                patched.setattr(said_surface, "STAND_IN", DIFFERS)  # so far off is no stand-in
                _, certain, told = unlike_surroundings(found.model, sure)
            assert shown_error(certain.fit)["order_2"]["median"] == wrong and "in half" not in told[UNLIKE]
            said = replace(found, choice=found.choice | words)
            assert any(words[UNLIKE] in doubt for doubt in all_doubts(said))
        else:
            assert light is sure
