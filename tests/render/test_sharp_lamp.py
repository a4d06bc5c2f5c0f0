# SPDX-License-Identifier: GPL-3.0-or-later
"""A sun on gloss has an image of its own; light without one has not."""

from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

from btfsep_engine import sh
from btfsep_engine.btf.library import open_library
from btfsep_engine.btf.model import Lambertian
from btfsep_engine.fit.products import Basis
from btfsep_engine.fit.sharp_lamp import Sharpened
from btfsep_engine.light.lightings import SHLighting
from btfsep_engine.light.sun import Sun
from btfsep_engine.pipeline.estimation import estimate
from btfsep_engine.pipeline.model import Model, view_problem
from btfsep_engine.pipeline.refine import sharp
from btfsep_engine.pipeline.refine.lamp_search import LampSearch
from btfsep_engine.pipeline.settings import choose
from btfsep_engine.pipeline.together import SolvedLight, fit_together
from scripts.studies.measures import order2
from tests.render.scenes import egg_and_pebble, job_of, looking_down, picture, scene_of, with_photo

pytestmark = pytest.mark.usefixtures("no_parts_with_edges")
GLOSS = "wood/walnut-lacquered"
SETTINGS = choose("draft", refine="all", bounces=1, directions=512)
TOWARDS = np.array([-0.45, 0.3, 0.84]) / np.linalg.norm([-0.45, 0.3, 0.84])
SECOND = np.array([0.7, 0.2, 0.69]) / np.linalg.norm([0.7, 0.2, 0.69])


@pytest.fixture(scope="module")
def prepared():
    """The scene, its points, its material, and the light of a sky: coefficients (9, 3)."""
    scene = scene_of(job_of([egg_and_pebble(5)], looking_down()))
    sky = np.zeros((9, 3))
    sky[0], sky[1], sky[2], sky[3] = 1.5, 0.3, 0.5, -0.2
    points = scene.points(0, region=scene.view.mesh == 0, textured=False)
    return scene, points, open_library(None).load(GLOSS), sky


def photographed(prepared, irradiance: float, *, limit=np.inf, towards=(TOWARDS,)):
    """The scene under its sky and suns, with a camera's noise, clipped at a limit; and all of the light."""
    scene, points, material, sky = prepared
    seen = scene.radiance(points, material, SHLighting(sky), directions=4096)[:, 0]
    suns = [Sun(d, np.full(3, irradiance), np.zeros(3)) for d in towards]
    seen = seen + scene.sun_radiance(points, material, *suns)
    image = picture(points, seen, noise=0.02)
    clipped = image >= limit
    job = with_photo(scene.job, np.minimum(image, limit), ~clipped.any(-1), clipped=clipped if clipped.any() else None)
    return scene_of(job), sky + sum(sh.evaluate(2, d)[:, None] * irradiance for d in towards)


def found_in(scene, truth, settings=SETTINGS):
    found = estimate(scene, open_library(None), settings, material=GLOSS)
    return found, order2(found.fit.coefficients, truth)


@pytest.fixture(scope="module")
def clipped(prepared):
    """The estimate of a photo of one sun whose highlight is clipped, its error, and the true light."""
    scene, truth = photographed(prepared, 4.0, limit=0.5)
    return *found_in(scene, truth), truth


def test_a_sun_whose_highlight_is_clipped_is_found_as_sharp_as_it_is(prepared, clipped, monkeypatch):
    found, error, truth = clipped
    assert "sharp" in found.choice and found.model.problems[0].correction is not None
    (lamp,) = found.light.suns
    assert np.degrees(np.arccos(lamp.direction @ TOWARDS)) < 2 and error < 0.12
    monkeypatch.setattr(sharp, "CLEARLY", np.inf)
    as_harmonics, without = found_in(photographed(prepared, 4.0, limit=0.5)[0], truth)
    assert "sharp" not in as_harmonics.choice and without > 1.3 * error


def test_a_draft_does_not_look_for_lamps_that_are_sharper_and_says_so(prepared, clipped):
    scene, truth = photographed(prepared, 4.0, limit=0.5)
    quick, _ = found_in(scene, truth, replace(SETTINGS, refine="quick"))
    assert "sharp" not in quick.choice and "lamps sharper" in quick.choice["refine"]
    assert "refine" not in clipped[0].choice
    assert choose("draft").refine == "quick" and choose("balanced").refine == "all"


def test_two_bare_lamps_are_found_as_sharp_as_they_are(prepared, monkeypatch):
    scene, truth = photographed(prepared, 3.0, towards=(TOWARDS, SECOND))
    found, error = found_in(scene, truth)
    assert found.choice["sharp"].startswith("2 lamps")
    off = [min(np.arccos(np.clip(sun.direction @ d, -1, 1)) for sun in found.light.suns) for d in (TOWARDS, SECOND)]
    assert np.degrees(max(off)) < 3 and error < 0.12
    monkeypatch.setattr(sharp, "MOST", 0)
    assert found_in(photographed(prepared, 3.0, towards=(TOWARDS, SECOND))[0], truth)[1] > 1.3 * error


def test_of_several_lamps_those_that_gain_nothing_are_not_kept(prepared):
    scene, _ = photographed(prepared, 3.0, towards=(TOWARDS, SECOND))
    problem = view_problem(scene, [prepared[2]], SETTINGS)
    pursuit = sharp.Pursuit(Model(SETTINGS, {"mean": [problem]}), fit_together([problem], replace(SETTINGS, order=2)))
    lamps = tuple(sharp.image_from_afar([problem], d) for d in (TOWARDS, -SECOND, SECOND))
    found = sharp.OwnImages(lamps).at(np.array([[3.0], [0.1], [3.0]]) * np.ones(3), pursuit.rms, pursuit.known)
    assert pursuit.kept(found).lamps == (lamps[0], lamps[2])


def test_a_search_goes_on_from_the_light_of_lamps_nearby_in_any_order(prepared):
    scene, _ = photographed(prepared, 3.0, towards=(TOWARDS, SECOND))
    problem = view_problem(scene, [prepared[2]], SETTINGS)
    light = fit_together([problem], replace(SETTINGS, order=2))
    own = [sharp.image_from_afar([problem], d) for d in (TOWARDS, SECOND)]
    excess, weights = np.stack([lamp.excess for lamp in own], 1), np.ones(own[0].excess.shape)
    solve = partial(light.solver.sharp_lamps, problem.radiance(), light.fit, weights=weights)
    directions = np.array([TOWARDS, SECOND])
    anew = solve(directions, excess)
    assert anew.irradiances.mean(1) == pytest.approx(3, rel=0.25)
    assert np.array_equal(anew.reordered([1, 0]).reordered([1, 0]).white, anew.white)
    assert np.array_equal(anew.reordered([1, 0]).white[-5:], anew.white[-10:-5])
    turned = solve(directions[::-1], excess[:, ::-1], start=anew.reordered([1, 0]))
    assert turned.evidence == pytest.approx(anew.evidence, abs=1)  # noise settles to a twentieth
    np.testing.assert_allclose(turned.irradiances[::-1], anew.irradiances, rtol=0.02)
    np.testing.assert_allclose(turned.x, anew.x, atol=0.02 * np.abs(anew.x).max())


def test_lamps_are_sought_all_around_where_gloss_leaves_much_over(prepared, monkeypatch):
    scene, _ = photographed(prepared, 0.0)
    for material, much, sought in (
        (prepared[2], -1, True),
        (prepared[2], 1, False),
        (Lambertian("w", np.ones(3)), -1, False),
    ):
        monkeypatch.setattr(sharp, "MISSED", much)
        problem = view_problem(scene, [material], SETTINGS)
        light = fit_together([problem], replace(SETTINGS, order=2))
        assert sharp.Pursuit(Model(SETTINGS, {"mean": [problem]}), light).seeks is sought


def test_a_lamp_is_sought_where_what_is_left_over_has_its_image(prepared):
    scene, _, material, _ = prepared
    problem = view_problem(scene, [material], SETTINGS)
    lamp = sharp.image_from_afar([problem], SECOND)
    search = LampSearch([problem], known=np.ones(lamp.excess.shape))
    likely = search.likeliest(2 * lamp.excess, beside=np.zeros((0, 3)))
    assert np.degrees(np.arccos(likely.direction @ SECOND)) < 3 and likely.part > 0.5
    assert likely.irradiance == pytest.approx(2, rel=0.3)
    other = search.likeliest(2 * lamp.excess, beside=SECOND[None])  # what is near to it is it once more
    assert other is None or (other.direction @ SECOND < np.cos(np.radians(9)) and other.part < likely.part)
    assert search.likeliest(np.zeros(lamp.excess.shape), beside=np.zeros((0, 3))) is None


def test_light_without_a_sun_has_no_sharp_lamp(prepared):
    scene, truth = photographed(prepared, 0.0)
    found, _ = found_in(scene, truth)
    assert "sharp" not in found.choice and found.model.problems[0].correction is None


def test_an_image_of_its_own_is_the_beam_and_its_excess_what_order_9_lacks(prepared):
    scene, _, material, _ = prepared
    problem = view_problem(scene, [material], SETTINGS)
    lamp = sharp.image_from_afar([problem], TOWARDS)
    sun = Sun(TOWARDS, np.ones(3), np.zeros(3))
    own = np.concatenate([scene.sun_radiance(p, problem.materials[0], sun) for p in problem.points])
    calm = (lamp.spread < 0.05 * own).all(1)  # away from the highlight and from shadows
    assert calm.mean() > 0.3
    np.testing.assert_allclose(lamp.image[calm], own[calm], rtol=0.05)
    smooth = np.einsum("ptc,t->pc", problem.all_basis, sh.evaluate(9, TOWARDS))
    np.testing.assert_allclose(lamp.image - lamp.excess, smooth, atol=1e-4 * smooth.max())
    # the slopes say what it changes by as it turns
    turned = sharp.image_from_afar([problem], TOWARDS + 0.01 * sharp.across(TOWARDS)[0])
    change = turned.image - lamp.image
    assert np.corrcoef(change[calm].ravel(), lamp.slopes[0][calm].ravel())[0, 1] > 0.95
    assert (change[calm] * lamp.slopes[0][calm]).sum() / np.square(lamp.slopes[0][calm]).sum() == pytest.approx(
        0.01, rel=0.2
    )


def test_a_sharp_lamp_is_sought_where_the_misfit_looks_like_its_image(prepared):
    scene, _ = photographed(prepared, 4.0)
    problem = view_problem(scene, [prepared[2]], SETTINGS)
    lamp = sharp.image_from_afar([problem], TOWARDS)
    x = np.pad(prepared[3], ((0, 91), (0, 0))) + 4 * sh.evaluate(9, TOWARDS)[:, None]
    noise = np.random.default_rng(2).normal(1, 0.02, lamp.image.shape)
    by_harmonics = replace(problem, measured=problem.predicted(x) * noise)
    for seen, sharper in ((problem, True), (by_harmonics, False)):
        light = fit_together([seen], replace(SETTINGS, order=2))
        assert sharp.looks_sharp(light, [seen], 4 * lamp.excess, np.ones(lamp.image.shape)) == sharper


def test_one_more_image_beside_a_basis_is_as_if_it_had_been_there(prepared):
    scene, _, material, _ = prepared
    problem = view_problem(scene, [material], SETTINGS)
    more = np.random.default_rng(1).random((len(problem.pixels), 3))
    whole = Basis(np.concatenate([problem.all_basis, more[:, None].astype(np.float32)], 1), problem.normals)
    first = Basis(problem.all_basis, problem.normals)
    wider = first.with_images(more[:, None])
    assert wider.terms == first.terms + 1 == len(first.grams[0]) + 1
    np.testing.assert_allclose(wider.grams, whole.grams)
    np.testing.assert_allclose(wider.mean_response, whole.mean_response)


def test_only_a_beam_from_its_own_direction_has_the_lamps_image(prepared):
    scene, _, material, sky = prepared
    problem = view_problem(scene, [material], SETTINGS)
    basis = Basis(problem.all_basis, problem.normals)
    excess = np.zeros((len(problem.pixels), 2, 3))
    photo = Sharpened(basis, problem.predicted(np.pad(sky, ((0, 91), (0, 0)))), [TOWARDS, SECOND], excess)
    for field in photo.fields:
        images = [field.of_beam(d)[-2:].tolist() for d in (TOWARDS, SECOND, -TOWARDS)]
        assert images == [[1, 0], [0, 1], [0, 0]]
        assert not field.to_coefficients[-2:].any() and len(field.to_coefficients) == basis.terms + 2


def test_each_photograph_is_less_what_its_own_exposure_shows_of_the_lamp(prepared):
    scene, _ = photographed(prepared, 4.0)
    problem = view_problem(scene, [prepared[2]], SETTINGS)
    problems = [problem, problem.subset(np.arange(len(problem.pixels)) % 2 == 0)]
    model = Model(SETTINGS, {"mean": problems})
    light = SolvedLight(None, None, [1.0, 3.0])
    lamps = [sharp.image_from_afar(problems, d) for d in (TOWARDS, SECOND)]
    irradiances = np.array([[1.0, 2.0, 3.0], [0.5, 0.2, 0.1]])
    weights = np.random.default_rng(0).random(lamps[0].excess.shape)
    free = sharp.model_beside(model, light, sharp.OwnImages(tuple(lamps), irradiances, weights)).problems
    first = len(problem.pixels)
    excess = sum(e * lamp.excess for e, lamp in zip(irradiances, lamps, strict=True))
    np.testing.assert_allclose(problems[0].radiance() - free[0].radiance(), excess[:first])
    np.testing.assert_allclose(problems[1].radiance() - free[1].radiance(), 3 * excess[first:])
    np.testing.assert_array_equal(np.concatenate([p.weights for p in free]), weights)
    each = [p.slopes for p in free]
    assert [s.shape for s in each] == [(len(p.pixels), 6, 3) for p in problems]
    for i, (irradiance, lamp) in enumerate(zip(irradiances, lamps, strict=True)):
        own = np.concatenate(each)[:, 3 * i : 3 * i + 3]
        np.testing.assert_allclose(own[:, 0], sharp.BRIGHTER * irradiance * lamp.excess)
        np.testing.assert_allclose(own[:, 1:], sharp.ASIDE * irradiance * lamp.slopes.swapaxes(0, 1))


def test_a_lamp_is_moved_to_where_its_misfit_has_it(prepared):
    scene, _, material, _ = prepared
    problem = view_problem(scene, [material], SETTINGS)
    lamp = sharp.image_from_afar([problem], TOWARDS)
    weights = np.ones(lamp.image.shape)
    for step in (np.array([0.01, -0.02]), np.array([0.2, 0.1])):
        left = np.einsum("a,apc->pc", step, lamp.slopes)
        allowed = step * min(1, sharp.FARTHEST / np.linalg.norm(step))
        np.testing.assert_allclose(sharp.asked_move(left, lamp.slopes, weights), allowed, rtol=1e-4)


def test_a_sharp_lamp_stands_in_the_light_where_that_costs_little():
    lamp, aside = (SimpleNamespace(direction=d) for d in (TOWARDS, -TOWARDS))
    sky = SimpleNamespace(lamps=(), evidence=100.0)

    def taken(fit, other):
        light = SolvedLight(fit, SimpleNamespace(with_lamp=lambda _: other), [1.0])
        return sharp.with_its_lamp(light, TOWARDS).fit

    cheap, dear, elsewhere = (
        SimpleNamespace(lamps=(at,), evidence=100.0 - cost)
        for at, cost in ((lamp, 0.9 * sharp.CHEAP), (lamp, 1.1 * sharp.CHEAP), (aside, 0.0))
    )
    assert taken(sky, cheap) is cheap and taken(sky, dear) is sky and taken(sky, elsewhere) is sky
    assert taken(dear, cheap) is dear  # it has one already
