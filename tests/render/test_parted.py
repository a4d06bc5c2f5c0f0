# SPDX-License-Identifier: GPL-3.0-or-later
"""A shadow of what no job knows, and paint that it does not say: told apart, and the light is better for it."""

from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh
from scipy.ndimage import gaussian_filter

from btfsep_engine.btf.library import open_library
from btfsep_engine.btf.surfaces import GIVEN, Surface
from btfsep_engine.fit.two_kinds import neighbours
from btfsep_engine.job.model import KnownLamp
from btfsep_engine.light.sun import Sun
from btfsep_engine.pipeline.checks import all_doubts
from btfsep_engine.pipeline.estimation import REFINEMENTS, Estimate, estimate, refinements_of
from btfsep_engine.pipeline.following import Follower
from btfsep_engine.pipeline.model import Model, view_problem
from btfsep_engine.pipeline.refine import parted, sharp
from btfsep_engine.pipeline.refine import shaded as shaded_by
from btfsep_engine.pipeline.refine.misshapen import patch_misfit
from btfsep_engine.pipeline.refine.near import near_lamps
from btfsep_engine.pipeline.refine.parted import POOR, in_parts, left_over, likely
from btfsep_engine.pipeline.refine.pieces import Pieces, on_the_surface
from btfsep_engine.pipeline.refine.pixels import Pixels
from btfsep_engine.pipeline.refine.shaded import SHADOW, Shadows, beams_of, in_shadow
from btfsep_engine.pipeline.together import fit_together
from btfsep_engine.render.homogeneous import homogeneous
from tests.render.lit_things import (
    LAMP,
    SETTINGS,
    TOWARDS,
    TRUTH,
    beyond,
    degrees_off,
    lit_things,
    off,
    painted,
    photo_of,
    shaded,
    solved,
)
from tests.render.scenes import as_mesh, egg_and_pebble, job_of, looking_down, scene_of, with_photo

GLOSSY = Surface((0.15, 0.1, 0.06), roughness=0.25)
GREY, RED = (0.4, 0.4, 0.4), (0.7, 0.3, 0.2)  # of the other paint's reflectance


@pytest.fixture(scope="module")
def things():
    """Grey and matte ones."""
    return lit_things()


@pytest.fixture(scope="module")
def glossy_things():
    """Lacquered ones."""
    return lit_things(GLOSSY)


@pytest.fixture(scope="module")
def plain(things):
    """The model of a photo that is as the job says, and its light."""
    return solved(things, photo_of(things, things.sky + things.lamp))[:2]


@pytest.fixture(scope="module")
def in_the_dark(things):
    """The model of the photo with a shadow and its light, and the Estimate with the refinement."""
    scene = photo_of(things, shaded(things))
    found = estimate(scene, open_library(None), SETTINGS, refinements=(in_parts,))
    return *solved(things, scene)[:2], found


@pytest.fixture(scope="module")
def in_two_paints(things):
    """The model of the photo with another paint, grey, and its light, and both and the words with the refinement."""
    model, light, _ = solved(things, photo_of(things, painted(things, GREY)))
    return model, light, in_parts(model, light)


def sides(problem):
    """(p,) bool and (p,) bool, pixels beyond the line and before it."""
    return beyond(problem.pixels) > 0, beyond(problem.pixels) < 0


def away(problem):
    """(p,) bool, pixels that are not at the line."""
    return np.abs(beyond(problem.pixels)) > 4


def misfit(problem, values, at):
    """Median over some pixels of by how much values (p, 3) differ from what the true light makes of the objects."""
    exact = problem.predicted(TRUTH)
    return np.median(np.abs(values / exact - 1)[at])


def test_a_shadow_of_what_no_job_knows_is_found_and_the_light_is_better_for_it(in_the_dark):
    _, before, found = in_the_dark
    assert "casts a shadow" in found.choice[SHADOW] and "paint" not in found.choice
    assert degrees_off(found.light) < 3 and off(found.light) < 0.4 * off(before)
    assert found.fit.lamps[0].irradiance.mean() == pytest.approx(LAMP, rel=0.25)


def test_how_much_of_what_faces_the_lamp_is_in_its_shadow_is_said_as_a_doubt(in_the_dark, things):
    found = in_the_dark[2]
    facing = things.lamp.sum(1) > 0  # the objects' own shadows are in that
    share = 100 * (~things.half[facing]).mean()
    said = float(found.choice[SHADOW].split(" %")[0].split()[-1])
    assert said == pytest.approx(share, abs=3)
    assert found.choice[SHADOW] in all_doubts(found) and found.choice[SHADOW] in found.scene.reporter.warnings


def test_what_is_fitted_is_then_a_photo_that_all_of_the_lamp_reaches(in_the_dark):
    """As the basis images have it: what lies in the shadow gets what it lacks; the rest stays but for errors."""
    (before,), (after,) = in_the_dark[0].problems, in_the_dark[2].model.problems
    lit, dark = (side & away(before) for side in sides(before))
    assert misfit(before, before.radiance(), dark) > 0.3
    assert misfit(after, after.radiance(), dark) < 0.06 and misfit(after, after.radiance(), lit) < 0.06


def test_in_half_shade_pixels_count_for_less(in_the_dark):
    problem = in_the_dark[2].model.problems[0]
    faces = problem.normals @ TOWARDS > 0.5
    at, aside = np.abs(beyond(problem.pixels)) < 1, away(problem)
    assert np.median(problem.weights[faces & at]) < 0.5 * np.median(problem.weights[faces & aside])
    assert problem.slopes is not None and np.abs(problem.slopes[faces]).max() > 0


def test_after_a_shadow_no_lamp_is_sought_that_is_near_or_sharp(in_the_dark, monkeypatch):
    monkeypatch.setattr(sharp, "Pursuit", None)  # nothing that could be asked
    model, light = in_the_dark[2].model, in_the_dark[2].light
    near = near_lamps(model, light)
    assert near[0] is model and near[1] is light and "a shadow falls" in near[2]["near"]
    after = sharp.sharp_lamps(model, light)
    assert after[0] is model and after[1] is light and not after[2]


def test_what_the_photo_may_be_as_well_is_in_what_is_stated(in_the_dark, plain):
    model, light = plain
    other = in_the_dark[1].fit
    stated = Estimate(replace(model, otherwise=((other, 0.3),)), light, {}).fit
    count = len(light.fit.samples)
    np.testing.assert_array_equal(stated.coefficients, light.fit.coefficients)
    assert len(stated.samples) == count
    own = round(0.7 * count)
    np.testing.assert_array_equal(stated.samples[:own], light.fit.samples[:own])
    x, y = light.fit.all_coefficients, other.all_coefficients
    scale = (x * y).sum() / np.square(y).sum()
    np.testing.assert_allclose(stated.samples[own:], scale * other.samples[: count - own])
    without = Estimate(model, light, {}).fit
    np.testing.assert_array_equal(without.samples, light.fit.samples)


def test_a_further_photo_of_the_view_keeps_the_shadow_and_what_is_stated_beside_it(in_the_dark, things):
    first = in_the_dark[2]
    assert first.model.otherwise and 0 < sum(share for _, share in first.model.otherwise) < 0.5
    first = replace(first, model=replace(first.model, otherwise=((in_the_dark[1].fit, 0.3),)))
    again = Follower(first, None)._again(photo_of(things, shaded(things), seed=1))
    assert again.model.otherwise == () and again.model.problems[0].correction is not None
    unit = np.abs(first.fit.samples).max()
    np.testing.assert_allclose(again.fit.samples, first.fit.samples, atol=0.01 * unit)
    assert np.abs(first.light.fit.samples - first.fit.samples).max() > 0.1 * unit


def test_neither_a_lamps_shadow_nor_a_paint_is_followed_to_another_view(plain):
    model, light = plain
    ones = np.ones((len(model.problems[0].pixels), 3))
    for more, followed in (({}, True), ({"paint": ones}, False), ({"correction": 0 * ones}, False)):
        last = model.changed(lambda p, more=more: replace(p, **more))
        assert (Follower(Estimate(last, light, {}), None)._followed(model, None) is not None) is followed


def test_another_paint_is_found_and_the_light_is_better_for_it(in_two_paints):
    _, before, (model, light, words) = in_two_paints
    assert "two colours" in words["paint"] and SHADOW not in words and model.problems[0].correction is None
    assert degrees_off(light) < 5 and off(light) < 0.2 * off(before)
    (problem,) = model.problems
    true = np.where(beyond(problem.pixels)[:, None] > 0, 1, GREY)
    at = away(problem)
    assert (np.abs(problem.paint / (true / true.mean(0)) - 1)[at] < 0.1).mean() > 0.95
    np.testing.assert_allclose(problem.paint.mean(0), 1, rtol=0.01)  # the mean stays what the job says
    share = 100 * (beyond(problem.pixels) > 0).mean()
    assert (
        float(words["paint"].split(" %")[0].split()[-1]) == pytest.approx(share, abs=3) and "lighter" in words["paint"]
    )


def test_a_paint_of_another_colour_is_told_from_a_shadow(things):
    model, light, _ = solved(things, photo_of(things, painted(things, RED)))
    freed, better, words = in_parts(model, light)
    assert "paint" in words and SHADOW not in words and off(better) < 0.4 * off(light)
    (problem,) = freed.problems
    lighter, other = (np.median(problem.paint[s & away(problem)], 0) for s in sides(problem))
    np.testing.assert_allclose(other / lighter, RED, rtol=0.1)
    shares = [share for _, share in freed.otherwise]
    assert shares and 0 < sum(shares) < 0.5


def test_of_what_shows_highlights_no_paint_is_asked_but_shadows_are(glossy_things, monkeypatch):
    """Two paints imitate highlights, and the light is worse for it."""
    monkeypatch.setattr(Pieces, "found", None)
    model, light, _ = solved(glossy_things, photo_of(glossy_things, painted(glossy_things, GREY)))
    assert patch_misfit(model.problems, light) > parted.MUCH and light.fit.residual > POOR
    assert "paint" not in in_parts(model, light)[2]
    model, light, _ = solved(glossy_things, photo_of(glossy_things, shaded(glossy_things)))
    _, found, words = in_parts(model, light)
    assert SHADOW in words and degrees_off(found) < 5 and off(found) < 0.5 * off(light)


def test_at_the_edge_of_a_paint_pixels_count_for_less(in_two_paints):
    (problem,) = in_two_paints[2][0].problems
    at = np.abs(beyond(problem.pixels)) < 1
    assert np.median(problem.weights[at]) < 0.5 * np.median(problem.weights[away(problem)])
    np.testing.assert_array_equal(np.sign(problem.slopes[:, -1]), np.sign(np.log(problem.paint)))  # more or less so


def test_what_is_left_over_is_of_the_photo_whatever_that_is_divided_by(in_two_paints):
    model, light, _ = in_two_paints
    pixels = Pixels(model, light)
    paint = np.full((len(model.problems[0].pixels), 3), 2.0)
    halved = model.changed(lambda p: replace(p, paint=paint))
    half = replace(light, fit=replace(light.fit, seen=0.5 * light.fit.shown))
    one, other = left_over(pixels, [(model, light), (halved, half)])
    assert one == pytest.approx(other) and one == pytest.approx(light.share_left(model.problems))


def test_a_photo_that_is_as_the_job_says_is_left_as_it_is(plain):
    model, light = plain
    found = in_parts(model, light)
    assert found[0] is model and found[1] is light and not found[2]


@pytest.mark.parametrize("seed", [0, 1])
def test_stains_without_edges_are_neither_a_shadow_nor_a_paint(things, seed):
    stains = gaussian_filter(np.random.default_rng(seed).standard_normal((96, 96)), 7)
    factor = np.exp(0.35 * stains / stains.std())[tuple(things.points.pixels.T)][:, None]
    model, light, _ = solved(things, photo_of(things, factor * (things.sky + things.lamp)))
    assert light.fit.residual > POOR and patch_misfit(model.problems, light) > parted.MUCH
    found = in_parts(model, light)
    assert found[0] is model and found[1] is light and not found[2]


def test_noise_is_no_reason_to_ask(things, monkeypatch):
    monkeypatch.setattr(parted, "Pixels", None)
    model, light, _ = solved(things, photo_of(things, things.sky + things.lamp, noise=0.3))
    assert light.fit.residual > POOR and in_parts(model, light)[1] is light


def test_where_lamps_are_given_or_nothing_is_expected_of_light_none_is_sought(things, monkeypatch):
    monkeypatch.setattr(parted, "Pixels", None)
    for more, settings in (
        ({"known_lamps": (KnownLamp(TOWARDS, 1.0),)}, SETTINGS),
        ({}, replace(SETTINGS, estimator="least-squares", order=2)),
    ):
        model, light, _ = solved(things, photo_of(things, shaded(things), **more), settings=settings)
        found = in_parts(model, light)
        assert light.fit.residual > POOR and found[0] is model and found[1] is light and not found[2]


def test_a_draft_does_not_look_for_shadows_and_says_so(things):
    quick = replace(SETTINGS, refine="quick")
    assert in_parts in refinements_of(SETTINGS) and in_parts not in refinements_of(quick) and in_parts in REFINEMENTS
    found = estimate(photo_of(things, shaded(things)), open_library(None), quick)
    assert SHADOW not in found.choice and "shadows" in found.choice["refine"]


def test_the_least_is_light_between_surfaces_and_what_is_said_and_kept_of_it(things):
    few = replace(SETTINGS, refine="least")
    asked = [r.__name__ for r in refinements_of(few)]
    assert {"light_between_surfaces", "each_object_by_itself", "key_lights", "look_alike", "misplaced"} <= set(asked)
    assert not {"in_parts", "painted_surfaces", "shifted", "ground", "other_curves", "finished"} & set(asked)
    quick = refinements_of(replace(SETTINGS, refine="quick"))
    assert [r for r in quick if r.__name__ in asked] == [*refinements_of(few)]
    found = estimate(photo_of(things, shaded(things)), open_library(None), few)
    assert found.choice["refine"].startswith("least") and not {SHADOW, "shift", "near"} & set(found.choice)


def test_a_shadow_in_several_exposures_is_taken_off_in_each(things):
    """Each half of the objects is in the shadow once."""
    photos = [shaded(things), 2 * (things.sky + ~things.half * things.lamp)]
    model, light, _ = solved(things, *(photo_of(things, values, seed=i) for i, values in enumerate(photos)))
    freed, better, words = in_parts(model, light)
    assert SHADOW in words and off(better) < 0.8 * off(light)
    assert better.exposures[1] == pytest.approx(2, rel=0.1)
    for problem, exposure in zip(freed.problems, (1, 2), strict=True):
        assert misfit(problem, problem.radiance() / exposure, away(problem)) < 0.1


def test_in_a_shadow_a_lamp_has_a_part_of_its_image_and_the_basis_images_still_all(plain):
    """What they have of it lights all pixels, and goes with the light."""
    problems = plain[0].problems
    lamp = sharp.image_from_afar(problems, TOWARDS)
    seen = np.random.default_rng(0).random(len(lamp.image))
    dim = in_shadow(lamp, seen, np.full(len(seen), 0.2))
    np.testing.assert_allclose(dim.image, seen[:, None] * lamp.image)
    np.testing.assert_allclose(dim.slopes, seen[:, None] * lamp.slopes)
    np.testing.assert_allclose(dim.image - dim.excess, lamp.image - lamp.excess, atol=1e-6 * lamp.image.max())
    np.testing.assert_allclose(dim.spread**2, (seen[:, None] * lamp.spread) ** 2 + (0.2 * lamp.image) ** 2, rtol=1e-6)
    whole = in_shadow(lamp, np.ones(len(seen)), np.zeros(len(seen)))
    for what in ("direction", "image", "slopes", "spread", "excess"):
        np.testing.assert_array_equal(getattr(whole, what), getattr(lamp, what))


def test_lamps_that_are_tried_are_apart_and_the_likeliest_comes_first(in_the_dark):
    model, light, _ = in_the_dark
    tried = np.array([direction for direction, _ in Shadows(Pixels(model, light))._likely()])
    cosines = (tried @ tried.T)[np.triu_indices(len(tried), 1)]
    assert 1 < len(tried) <= shaded_by.BEST and cosines.max() < np.cos(shaded_by.ASIDE - 2 * shaded_by.AROUND)
    assert np.degrees(np.arccos(tried[0] @ TOWARDS)) < 6


def test_lamps_that_leave_more_over_or_are_one_or_are_half_seen_are_not_kept(monkeypatch):
    aside = np.array([0.0, 0.0, 1.0])
    tried = [(TOWARDS, 0.11, 0), (TOWARDS, 0.1, 0), (aside, 0.12, 0), (-aside, 0.13, 0), (-TOWARDS, 0.1, 0.1), None]
    tried = [
        one and SimpleNamespace(own=SimpleNamespace(direction=one[0]), left=one[1], half_seen=one[2]) for one in tried
    ]
    search = Shadows(SimpleNamespace(light=SimpleNamespace(solver=None, fit=SimpleNamespace(residual=0.0))))
    stand_ins = {"_settled": lambda one: one, "_onward": lambda one, _: one, "_half_seen": lambda one: one.half_seen}
    for name, stand_in in (stand_ins | {"_likely": lambda: tried}).items():
        monkeypatch.setattr(search, name, stand_in)
    assert search.found() == [tried[1], tried[2]]


def test_images_of_beams_are_suns_on_some_pixels_of_all_photographs(things, plain):
    (problem,) = plain[0].problems
    problems = [problem, problem.subset(np.arange(len(problem.pixels)) % 2 == 0)]
    some = np.random.default_rng(0).random(sum(len(p.pixels) for p in problems)) < 0.1
    directions = np.array([TOWARDS, [0.0, 0.0, 1.0]])
    found = beams_of(problems, directions, some)
    for i, d in enumerate(directions):
        sun = Sun(d, np.ones(3), np.zeros(3))
        exact = [things.scene.sun_radiance(p.points[0], problem.materials[0], sun) for p in problems]
        np.testing.assert_allclose(found[:, i], np.concatenate(exact)[some], atol=1e-5)


def test_pixels_of_each_object_are_apart_and_have_a_mean_of_their_own(things):
    balls = [trimesh.creation.icosphere(3, r).apply_translation((x, 0, 0)) for r, x in ((0.45, -0.3), (0.25, 0.4))]
    scene = scene_of(job_of([as_mesh(ball) for ball in balls], looking_down()))
    image = np.random.default_rng(0).random((96, 96, 3)).astype(np.float32)
    clipped = np.zeros(image.shape, bool)
    clipped[40:44, :, 1] = True
    problem = view_problem(
        scene_of(with_photo(scene.job, image, clipped=clipped)), [things.known.material] * 2, SETTINGS
    )
    light = fit_together([problem], replace(SETTINGS, order=2))
    pixels = Pixels(Model(SETTINGS, {"mean": [problem, problem]}), replace(light, exposures=[1.0, 2.0]))
    sizes = [len(p) for p in problem.points]
    ends = np.cumsum([0, *sizes, *sizes])
    around = pixels.around.toarray()
    for a, b in pairwise(ends):
        assert not around[a:b, :a].any() and not around[a:b, b:].any()
    factor = np.random.default_rng(1).random((ends[-1], 3)) + 1
    of_mean = pixels.of_mean(factor)
    for a, b in pairwise(ends):
        np.testing.assert_allclose(of_mean[a:b].mean(0), 1)
        np.testing.assert_allclose(of_mean[a:b] / factor[a:b], np.broadcast_to(of_mean[a] / factor[a], (b - a, 3)))
    np.testing.assert_allclose(pixels.b[ends[2] :], pixels.b[: ends[2]] / 2)  # in the first's exposure
    assert problem.clipped.any() and not pixels.known[: ends[2]][problem.clipped].any()
    assert (pixels.known[: ends[2]][~problem.clipped] == 1).all()
    nearest = pixels.of_all(np.flatnonzero(pixels.some)).astype(int)
    np.testing.assert_array_equal(nearest[pixels.some], np.flatnonzero(pixels.some))
    assert pixels.around_some.shape == neighbours(pixels.at[pixels.some]).shape
    assert np.linalg.norm(pixels.at[nearest] - pixels.at, axis=1).max() < 20  # none of another object


def test_what_a_surface_reflects_no_paint_changes():
    """A dielectric's image is that of its surface and, in the same proportion, of what is below."""
    scene = scene_of(job_of([egg_and_pebble(3)], looking_down(48, 100.0)))
    made = [homogeneous(Surface((c, 0.5 * c, c), roughness=0.4), GIVEN) for c in (0.8, 0.4)]
    light, dark = (view_problem(scene, [m], SETTINGS) for m in made)
    stub = SimpleNamespace(problems=[light], light=SimpleNamespace(solver=None))
    (above,) = Pieces(stub, SETTINGS)._above[0]
    whole, half = light.basis[0], dark.basis[0]
    assert np.abs(above).max() > 0.05 * np.abs(whole).max()
    np.testing.assert_allclose(half - above, 0.5 * (whole - above), atol=2e-3 * np.abs(whole).max())
    metal, matte = homogeneous(Surface(metallic=1.0), GIVEN), open_library(None).load("reference/white-diffuse")
    assert on_the_surface(metal) is metal and on_the_surface(matte) is None
    image = np.ones((4, 4, 3), np.float32)
    assert on_the_surface(SimpleNamespace(surface=Surface(image=image))) is None
    bare = Pieces(SimpleNamespace(problems=[replace(light, materials=[metal])], light=stub.light), SETTINGS)
    np.testing.assert_array_equal(bare._above[0][0], whole)  # nothing of a metal is below


def test_bare_metal_has_no_paint(in_two_paints, monkeypatch):
    """However much two paints would explain."""
    model, light, _ = in_two_paints
    pieces = Pieces(Pixels(model, light), model.modelled)
    assert pieces.found() is not None
    monkeypatch.setattr(pieces, "_above", [p.basis for p in model.problems])
    assert pieces.found() is None


def test_the_photo_is_divided_by_a_paint_and_so_is_some_of_it(plain):
    (problem,) = plain[0].problems
    rng = np.random.default_rng(0)
    paint, correction = rng.random((2, len(problem.pixels), 3)) + 0.5
    seen, veil = problem.radiance(), np.array([0.01, 0.02, 0.03])
    both = replace(problem, paint=paint, correction=correction, veil=veil)
    np.testing.assert_allclose(both.radiance(), (seen - veil) / paint - correction)
    measured = replace(problem, measured=2 * seen, paint=paint)
    np.testing.assert_allclose(measured.radiance(), 2 * seen / paint)
    some = rng.random(len(paint)) < 0.3
    np.testing.assert_array_equal(both.subset(some).radiance(), both.radiance()[some])


def test_lamps_that_leave_as_much_over_are_as_probable():
    shares = likely([SimpleNamespace(left=left) for left in (0.1, 0.1, 0.11, 0.2)])
    assert shares.sum() == pytest.approx(1) and shares[0] == shares[1] > shares[2] > shares[3] > 0
    assert shares[3] < 0.01 and not len(likely([]))
