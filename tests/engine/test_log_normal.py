# SPDX-License-Identifier: GPL-3.0-or-later
"""The light of a photograph: lamps, skies and both are told apart; symmetries; what is stated; frames; derivatives."""

from dataclasses import replace

import numpy as np
import pytest

from btfsep_engine import sh
from btfsep_engine.conventions import fibonacci_sphere
from btfsep_engine.fit import elected, log_normal, posterior
from btfsep_engine.fit.election import decided, even_share, onward
from btfsep_engine.fit.light_model import LightModel
from btfsep_engine.fit.log_normal import LightSolver
from btfsep_engine.fit.posterior import hidden_lamps, posterior_samples
from btfsep_engine.fit.products import NEARLY_RIGHT
from btfsep_engine.fit.search import EXACT
from btfsep_engine.light.log_field import natural_field, natural_spread
from btfsep_engine.threads import one_thread
from tests.engine.half_sphere import FILL, SUN, even, half_sphere, lamp, off, project, shown, side_light


def sky(bright=4.0):
    """Smooth light from above, a little from the left: radiance falls by a factor exp(-2 bright / 3) to below."""
    axis = np.array([-0.3, -0.3, 0.9])
    return project(lambda d: np.exp(bright * (d @ axis - 1) / 3)[:, None] * [0.95, 1.0, 1.05])


def solved(rng, x, *, noise=0.03, pixels=1200, albedo=(0.5, 0.5, 0.5)):
    basis, normals, _ = half_sphere(rng, pixels=pixels, albedo=albedo)
    solver = LightSolver(basis, normals=normals, order=4)
    b = shown(basis, x, rng, noise)
    return solver.solve(b), solver, b


def apart(lamp_found, direction) -> float:
    """Degrees."""
    return float(np.degrees(np.arccos(np.clip(lamp_found.direction @ direction, -1, 1))))


def is_plain(fit) -> bool:
    return fit.election.solution.model.field.order == 0


def test_one_lamp_is_found_to_a_degree_and_is_all_that_there_is(rng):
    fit, _, _ = solved(rng, even((0.1,) * 3) + lamp(SUN, [3.0, 3.0, 3.0]))
    assert is_plain(fit) and len(fit.lamps) == 1
    assert apart(fit.lamps[0], SUN) < 1 and fit.lamps[0].degrees < 3
    np.testing.assert_allclose(fit.lamps[0].irradiance, 3, rtol=0.05)
    assert fit.lamps[0].share == pytest.approx(3 / (3 + 0.1 * 4 * np.pi), rel=0.05)


def test_two_lamps_are_found_to_five_degrees_the_brighter_one_first(rng):
    fit, _, _ = solved(rng, even((0.1,) * 3) + lamp(SUN, [3.0] * 3) + lamp(FILL, [1.5] * 3))
    assert is_plain(fit) and len(fit.lamps) == 2
    assert apart(fit.lamps[0], SUN) < 5 and apart(fit.lamps[1], FILL) < 5
    assert fit.lamps[1].irradiance.mean() == pytest.approx(1.5, rel=0.2)


def test_even_light_has_no_lamp(rng):
    for _ in range(3):
        fit, _, _ = solved(rng, even(), noise=0.1, pixels=300)
        assert is_plain(fit) and not fit.lamps
        np.testing.assert_allclose(fit.coefficients[0], np.sqrt(4 * np.pi), rtol=0.05)


def test_a_smooth_sky_has_no_lamp_and_is_a_free_one(rng):
    fit, _, _ = solved(rng, sky())
    assert not is_plain(fit) and not fit.lamps
    assert off(fit, sky()) < 0.08


def test_a_weak_lamp_beside_much_light_is_found_where_it_is_worth_its_cost(rng):
    """Between 5 and 50 of the logarithm of the evidence."""
    fit, _, _ = solved(rng, even() + lamp(SUN, [0.7] * 3), noise=0.08, pixels=300)
    assert is_plain(fit) and len(fit.lamps) == 1 and apart(fit.lamps[0], SUN) < 12


@pytest.mark.parametrize("dark", [False, True])
def test_bright_even_light_with_lamps_that_leaves_much_over_is_a_field_s_whatever_its_evidence(rng, dark):
    fit, _, _ = solved(rng, even(((0.1 if dark else 1.0),) * 3) + lamp(SUN, [3.0] * 3))
    plain, rich, photo = fit.election.solution, fit.election.rival, fit.election.photo
    assert is_plain(fit) and even_share(plain) == pytest.approx(0.3 if dark else 0.81, abs=0.05)
    for brighter, stand in ((0.0, True), (0.02, True), (0.15, dark)):
        other = replace(plain, x=plain.x * (1 + brighter))
        assert (decided(other, rich, photo)[0] is other) is stand


@pytest.mark.parametrize(("noise", "brighter"), [(0.001, 0.035), (0.06, 0.065)], ids=["floor", "field's own"])
def test_what_no_material_explains_or_the_field_leaves_over_speaks_against_no_even_light(rng, noise, brighter):
    fit, _, _ = solved(rng, even() + lamp(SUN, [3.0] * 3), noise=noise)
    plain = replace(fit.election.solution, x=fit.election.solution.x * (1 + brighter))
    assert is_plain(fit) and decided(plain, fit.election.rival, fit.election.photo)[0] is plain


def test_of_lamps_in_the_dark_and_a_sky_the_more_probable_stands(rng):
    """And where it is the sky, by less than 3 of the logarithm of the evidence, the lamps are in what is stated."""
    fit, _, _ = solved(rng, even((0.1,) * 3) + lamp(SUN, [3.0] * 3))
    lamps, sky_too = fit.election.solution, fit.election.rival
    assert even_share(lamps) == pytest.approx(4 * np.pi * 0.1 / (4 * np.pi * 0.1 + 3), rel=0.1)
    for more, stands, rival in ((0.1, True, True), (-2.9, False, True), (-3.1, False, False)):
        plain = replace(lamps, evidence=sky_too.evidence + more)
        assert decided(plain, sky_too, fit.election.photo) == (
            (plain, sky_too) if stands else (sky_too, plain if rival else None)
        )


def test_even_light_without_a_lamp_stands_by_evidence_alone(rng):
    fit, _, _ = solved(rng, even(), noise=0.1, pixels=300)
    alone, rich = fit.election.solution, fit.election.rival
    for more, stand in ((0.1, True), (-0.1, False)):
        plain = replace(alone, evidence=rich.evidence + more)
        assert decided(plain, rich, fit.election.photo) == ((plain, rich) if stand else (rich, None))


def test_a_sun_in_a_sky_is_told_from_it(rng):
    x = sky() + lamp(SUN, [1.5] * 3)
    fit, _, _ = solved(rng, x, noise=0.02)
    assert apart(fit.lamps[0], SUN) < 5
    assert off(fit, x) < 0.12
    share = 1.5 / (np.sqrt(4 * np.pi) * x[0].mean())
    assert fit.lamps[0].share == pytest.approx(share, rel=0.3)


def test_exposure_scales_the_light_and_reflectance_its_inverse(rng):
    fit, solver, b = solved(rng, side_light(), pixels=400)
    np.testing.assert_allclose(solver.solve(5 * b).all_coefficients, 5 * fit.all_coefficients, rtol=1e-5, atol=1e-6)
    darker = LightSolver(solver.basis.images / 2, normals=half_normals(rng, solver), order=4)
    np.testing.assert_allclose(darker.solve(b).all_coefficients, 2 * fit.all_coefficients, rtol=1e-5, atol=1e-6)


def half_normals(rng, solver):
    """The sphere's normals again, from the cosines in its basis images."""
    first = solver.basis.smooth[:, :3]  # Y_1: y, z, x
    return first[:, [2, 0, 1]] / np.linalg.norm(first, axis=1, keepdims=True)


def test_red_and_blue_are_alike(rng):
    fit, solver, b = solved(rng, side_light(), pixels=400, albedo=(0.7, 0.5, 0.3))
    swapped = LightSolver(solver.basis.images[..., ::-1], normals=half_normals(rng, solver), order=4)
    found = swapped.solve(b[:, ::-1])
    np.testing.assert_allclose(
        found.all_coefficients[:, ::-1], fit.all_coefficients, atol=0.01 * np.abs(fit.all_coefficients).max()
    )
    assert found.evidence == pytest.approx(fit.evidence, abs=0.5)


def test_a_field_is_found_from_that_of_another_basis_on(rng):
    """In no other place than from even light, to what a search is good for."""
    fit, solver, b = solved(rng, side_light(), pixels=400)
    normals = half_normals(rng, solver)
    other = LightSolver(solver.basis.images * (1 + 0.35 * normals[:, :1, None]), normals=normals, order=4)
    one = solver.field_alone(b, beside=fit)
    far, near = (other.field_alone(b, beside=fit, start=start) for start in (None, one))
    assert near.evidence == pytest.approx(far.evidence, abs=1) and abs(far.evidence - one.evidence) > 3
    assert not np.array_equal(near.white, far.white)


def test_a_usual_tint_is_the_lights_and_an_unusual_one_the_objects(rng):
    usual = np.array([1.12, 1.0, 0.88])
    fit, _, _ = solved(rng, side_light() * usual)
    colour = fit.coefficients[0] / fit.coefficients[0].mean()
    truth = (side_light() * usual)[0]
    np.testing.assert_allclose(colour, truth / truth.mean(), rtol=0.03)
    assert fit.tint.unknown < 0.1
    dyed = np.array([3.0, 1.0, 0.3])
    fit, solver, b = solved(rng, side_light() * dyed)
    colour = fit.coefficients[0] / fit.coefficients[0].mean()
    assert fit.tint.unknown > 0.9 and colour[0] / colour[2] < 2  # of ten
    # the photo is what it is: who multiplies by the object's own colour sees it again
    left = b - solver.basis.predicted(fit.shown)
    assert np.linalg.norm(left) / np.linalg.norm(b) == pytest.approx(fit.residual, rel=1e-3) and fit.residual < 0.06
    np.testing.assert_allclose(fit.shown * fit.tint.gain, fit.all_coefficients)


def test_the_reflectance_of_a_piece_is_known_to_a_tenth(rng):
    """However well a photo is explained, what is stated of the light's level holds that."""
    fit, _, _ = solved(rng, even((0.1,) * 3) + lamp(SUN, [3.0] * 3), noise=0.01)
    level = np.log(fit.samples[:, 0].mean(1))
    assert 0.09 < level.std() < 0.16
    assert ((fit.stddev[0] / fit.coefficients[0]) > 0.09).all()


def test_what_is_stated_are_the_ends_and_the_middle_of_the_samples(rng):
    fit, _, _ = solved(rng, sky(3.0), noise=0.1, pixels=60)
    few = fit.samples[:, :25]
    np.testing.assert_allclose(fit.interval, np.percentile(few, [2.5, 97.5], axis=0))
    assert (fit.interval[0] <= fit.interval[1]).all() and fit.samples.shape == (200, 100, 3)
    wide = np.sqrt((np.maximum(fit.stddev**2 - (0.1 * fit.coefficients) ** 2, 0)).mean(1))
    natural = natural_spread()[:25] * fit.coefficients[0].mean()
    size = np.sqrt(np.square(fit.coefficients).mean(1))
    assert 0 < fit.determined.sum() < 25
    np.testing.assert_array_equal(fit.determined, wide < 0.5 * np.maximum(natural, size))


def test_the_order_that_is_reported_changes_no_number(rng):
    basis, normals, _ = half_sphere(rng, pixels=300)
    b = shown(basis, side_light(), rng, 0.03)
    low, high = (LightSolver(basis, normals=normals, order=order).solve(b) for order in (1, 4))
    np.testing.assert_array_equal(low.coefficients, high.coefficients[:4])
    np.testing.assert_array_equal(low.stddev, high.stddev[:4])


def test_evidences_of_one_photo_by_two_bases_can_be_compared(rng):
    """A photo without noise, whose misfit is rounding: what its channels have in common is chance."""
    basis, normals, _ = half_sphere(rng, pixels=800, gloss=0)
    b = shown(basis, side_light(), rng, 0.0)
    fit = LightSolver(basis, normals=normals, order=4).solve(b)
    nearly = LightSolver(basis * (1 + 1e-3 * rng.standard_normal(basis.shape)), normals=normals, order=4)
    beside, alone = nearly.solve(b, beside=fit), nearly.solve(b)
    assert beside.evidence == pytest.approx(fit.evidence, abs=2) != alone.evidence
    assert beside.election.photo.coarsening == fit.election.photo.coarsening != alone.election.photo.coarsening


@pytest.mark.parametrize("light", [side_light(), even((0.2,) * 3) + lamp(SUN, [3.0] * 3)], ids=["rich", "lamp"])
def test_from_its_own_light_on_a_photo_has_the_same_light(rng, light):
    fit, solver, b = solved(rng, light)
    again = solver.solve(b, start=fit)
    assert np.linalg.norm(again.all_coefficients - fit.all_coefficients) < 0.01 * np.linalg.norm(fit.all_coefficients)
    assert again.election.solution.model is fit.election.solution.model
    doubled = solver.solve(2 * b, start=fit)
    np.testing.assert_allclose(doubled.all_coefficients, 2 * again.all_coefficients, rtol=1e-3, atol=1e-3)


def test_where_nothing_but_light_is_missing_the_model_is_taken_for_exact(rng):
    """And where the material reflects a tenth more or less, smoothly over the normals, it is not."""
    fit, solver, b = solved(rng, sky(), noise=0.02)
    assert fit.election.solution.discrepancy == EXACT
    misfit = solver.basis.smooth @ rng.normal(size=24)
    assert solver.solve(b * (1 + 0.1 * misfit[:, None])).election.solution.discrepancy == NEARLY_RIGHT


def test_samples_predict_what_the_photo_says(rng):
    """An exponential's mean is above its middle: without a correction the lights would be a fifth too bright."""
    fit, solver, b = solved(rng, sky(), noise=0.1)
    brightness = np.array([solver.basis.predicted(x).mean() for x in fit.samples / fit.tint.gain])
    assert np.median(brightness) == pytest.approx(b.mean(), rel=0.03)


def test_of_lamps_behind_the_object_the_range_knows(rng):
    """Behind a matte sphere nothing is lit: one lamp in ten or twenty samples is there, and nowhere else."""
    basis, normals, _ = half_sphere(rng, pixels=4000, albedo=(0.5,) * 3, gloss=0)
    seen = rng.random(len(normals)) < -normals[:, 1]  # as a camera sees it
    solver = LightSolver(basis[seen], normals=normals[seen], order=4)
    fit = solver.solve(shown(basis[seen], sky(), rng, 0.1))
    alone, lamps = (hidden_lamps(solver.basis, 2000, np.random.default_rng(1), lamps=k) for k in (0, 2))
    lit = lamps[:, 0, 0] > 0
    assert 0.02 < (alone[:, 0, 0] > 0).mean() < 0.1 and 3.5 < lit.mean() / (alone[:, 0, 0] > 0).mean() < 5.5
    bright = np.log(lamps[lit, 0, 0] * np.sqrt(4 * np.pi))  # of what irradiance
    assert abs(np.median(bright) - np.log(2 * np.pi)) < 0.2 and 0.9 < bright.std() < 1.1
    towards = lamps[lit][:, [3, 1, 2], 0] * [-1, -1, 1]
    assert (towards[:, 1] > 0.7 * np.linalg.norm(towards, axis=1)).all()  # the camera looks along +y
    photographed = np.array([solver.basis.predicted(x).mean() for x in lamps[lit]])
    unlit = solver.basis.predicted(even()).mean()
    assert np.median(photographed) < 0.04 * unlit
    without = np.percentile(fit.samples[:, 0].mean(-1), 90)
    assert fit.interval[1, 0].mean() > 1.1 * without


@pytest.mark.parametrize("light", [side_light(), even((0.2,) * 3) + lamp(SUN, [3.0] * 3)], ids=["rich", "lamp"])
@pytest.mark.parametrize("tint", [(1, 1, 1), (2.5, 1, 0.4)])
def test_what_light_can_imitate_is_the_fits_derivative(rng, light, tint):
    fit, solver, b = solved(rng, light * np.array(tint), noise=0.05, pixels=600)
    change = b * (1 + rng.normal(size=(1, 3)) * half_normals(rng, solver))
    up, down = (solver.solve(b + sign * 0.01 * change, start=fit) for sign in (1, -1))
    numerical = solver.basis.predicted((up.shown - down.shown) / 0.02)
    imitated = change - solver.smoother(fit)(change)
    assert np.linalg.norm(imitated - numerical) < 0.08 * np.linalg.norm(numerical)


def test_of_a_fit_that_goes_on_from_another_the_rival_is_looked_for_when_it_is_asked_for(rng, monkeypatch):
    """From the latest one that is known, to its most probable light for this photograph."""
    fit, solver, b = solved(rng, even((0.1,) * 3) + lamp(SUN, [3.0] * 3))
    asked = []
    for module in (log_normal, elected):
        monkeypatch.setattr(module, "onward", lambda photo, s: asked.append(s.model) or onward(photo, s))
    first = solver.solve(1.1 * b, start=fit)
    last = solver.follow(1.2 * b, first)
    assert asked == [fit.election.solution.model] * 2  # of both, and of no rival
    assert last.election.latest_rival is fit.election.rival
    with one_thread():
        by_hand = onward(last.election.photo, fit.election.rival)
    np.testing.assert_array_equal(last.election.rival.white, by_hand.white)
    assert last.election.latest_rival is last.election.rival is not fit.election.rival
    _ = last.samples, last.stddev
    assert asked[2:] == [fit.election.rival.model]  # once
    anew = solver.solve(1.2 * b)
    np.testing.assert_allclose(last.stddev, anew.stddev, rtol=0.25, atol=0.05 * anew.stddev.max())


@pytest.mark.parametrize("bright", [0.0, 1e-9, 1e3])
def test_a_lamps_share_is_of_the_light_that_it_is_in(rng, monkeypatch, bright):
    """Whatever the light of the rival is, which need not have the lamp."""

    def drawn(solution, count, random, *, model):
        whites, lights = posterior_samples(solution, count, random)
        return whites, lights * bright if solution.model.field.order else lights

    monkeypatch.setattr(log_normal, "posterior_samples", drawn)
    fit, _, _ = solved(rng, even((0.1,) * 3) + lamp(SUN, [3.0, 3.0, 3.0]))
    assert is_plain(fit) and fit.election.rival is not None
    assert 0 < fit.lamps[0].share_stddev < 0.1


def test_samples_are_laplaces(rng, monkeypatch):
    """The lights' scatter about the most probable one is that of (I + J^T J)^-1, where it is small."""
    monkeypatch.setattr(posterior, "WIDER", SMALL := 0.3)
    basis, normals, _ = half_sphere(rng, pixels=2000, albedo=(0.5,) * 3)
    cap = normals @ [0.6, -0.6, 0.5] > 0.5  # a part of the sphere: its unknowns go together
    solver = LightSolver(basis[cap], normals=normals[cap], order=2)
    fit = solver.solve(shown(basis[cap], sky(), rng, 0.03))
    best, model = fit.election.solution, fit.election.solution.model
    assert isinstance(model, LightModel) and model.field is natural_field()
    values, vectors = np.linalg.eigh(best.factor @ best.factor.T)
    drawn = best.white + SMALL * (rng.normal(size=(600, len(values))) / np.sqrt(values)) @ vectors.T
    by_hand = np.array([model.light(white)[0][1] for white in drawn])

    def ratios(lights):  # what pixels show over the level, so that scale and tint, which are not Laplace's, are gone
        return (lights @ solver.basis.images[::16, :, 1].T) / lights[:, :1]

    found = ratios(posterior_samples(best, 600, rng)[1][:, :, 1]).std(0) / ratios(by_hand).std(0)
    assert np.median(found) == pytest.approx(1, abs=0.08) and np.max(found) < 1.15 and np.min(found) > 0.8


def test_no_sample_runs_away(rng):
    """A lamp known to some degrees only: a sample far from it is brought back, not to nothing or all."""
    basis, normals, _ = half_sphere(rng, pixels=400, albedo=(0.5,) * 3)
    solver = LightSolver(basis, normals=normals, order=2)
    fit = solver.solve(shown(basis, lamp(SUN, [3.0, 3.0, 3.0]), rng, 0.6))
    for solution in filter(None, (fit.election.solution, fit.election.rival)):
        whites, lights = posterior_samples(solution, 400, rng)
        size = lights[:, 0].mean(1)
        assert 0.3 * np.median(size) < size.min() and size.max() < 4 * np.median(size)
        assert np.abs(whites - solution.white).max() < 12


def test_light_from_where_none_reaches_the_photo_is_natural_light_s_and_explains_nothing(rng):
    """Basis images that ring where nothing comes from, as those of a horizon do, and a photo with more than light."""
    basis, normals, _ = half_sphere(rng, pixels=600)
    up = fibonacci_sphere(400)
    y = sh.evaluate(9, up).astype(float)
    reaching = up[:, 1] < 0.2
    cut = y[reaching].T @ y[reaching] * (4 * np.pi / len(up))  # what of a light comes from there, to order 9
    basis = np.einsum("pmc,mn->pnc", basis, cut)
    truth = side_light() + project(lambda d: np.where(d[:, 1:2] > 0.6, 60.0, 0.0) * np.ones(3))
    b = shown(basis, truth, rng, 0.02)
    fits = {}
    for hidden in (None, ~reaching):
        solver = LightSolver(basis, normals=normals, order=4, hidden=hidden)
        fit = solver.solve(b)
        back = fit.election.radiance(up[~reaching]).mean() / fit.election.radiance(up[reaching]).mean()
        fits[hidden is None] = fit, back
    (fit, back), (loose, far) = fits[False], fits[True]
    assert not is_plain(fit) and not is_plain(loose)
    assert far > 30 and back < far / 3
    np.testing.assert_allclose(fit.shown, fit.election.solution.x.T * fit.election.photo.level)
    behind = fit.all_coefficients / fit.tint.gain - fit.shown
    assert np.abs(behind).max() > 0.02  # it is in what is reported, and in what is stated
    from_behind = y[up[:, 1] > 0.5] @ np.moveaxis(fit.samples, 1, 0).reshape(100, -1)
    assert np.median(from_behind.mean(0)) > 1
    photo, loosely = (each.election.photo for each in (fit, loose))
    assert not (photo.reaches(photo.fields[0]) & ~photo.fields[0].reaching).any()  # no lamp is sought there
    assert (loosely.reaches(loosely.fields[0]) & ~photo.fields[0].reaching).any()
    np.testing.assert_array_equal(loose.shown, loose.all_coefficients / loose.tint.gain)
