# SPDX-License-Identifier: GPL-3.0-or-later
"""A lamp whose direction is given: it stays there, its power is free, and the photo may be explained without it."""

from types import SimpleNamespace

import numpy as np
import pytest

from btfsep_engine import sh
from btfsep_engine.conventions import across
from btfsep_engine.fit.light_model import LightModel
from btfsep_engine.fit.log_normal import LightSolver
from btfsep_engine.fit.products import Basis, Photograph
from btfsep_engine.fit.search import LAMP_COST, solve
from btfsep_engine.fit.stated import Lamp
from btfsep_engine.job.model import KnownLamp
from btfsep_engine.light.log_field import even_field, natural_field
from btfsep_engine.pipeline.doubts import given_lamp_doubts
from btfsep_engine.pipeline.together import given_lamps
from tests.engine.half_sphere import FILL, SUN, even, half_sphere, lamp, off, shown

BACK = np.array([0.35, 0.9, 0.26]) / np.linalg.norm([0.35, 0.9, 0.26])  # behind the sphere, which is seen from -y
DIM = even((0.15,) * 3)


def turned(direction, degrees, towards=0):
    a = np.radians(degrees)
    return np.cos(a) * direction + np.sin(a) * across(direction)[towards]


def solved(rng, x, *given, noise=0.05, facing=0.0):
    """The fit of a photo of light x, given directions (to a degree), its solver and the photo.

    ``facing`` : cosine to the eye, of pixels that are looked at
    """
    basis, normals, _ = half_sphere(rng, pixels=1200, albedo=(0.5, 0.5, 0.5))
    basis, normals = basis[-normals[:, 1] > facing], normals[-normals[:, 1] > facing]
    solver = LightSolver(basis, normals=normals, order=4, given=[(d, 1.0) for d in given])
    b = shown(basis, x, rng, noise)
    return solver.solve(b), solver, b


def test_a_lamp_that_the_photo_hardly_shows_is_known_where_it_is_given(rng):
    """The truth is of the test's own making: a lamp of which next to nothing is seen."""
    x = even((0.3,) * 3) + lamp(BACK, [3.0] * 3)
    known, solver, b = solved(rng, x, BACK, facing=0.5)
    found = solver.without_given().solve(b)
    assert off(known, x) < 0.7 * off(found, x)
    (first,) = known.lamps[:1]
    assert first.given and first.irradiance.mean() == pytest.approx(3.0, rel=0.4)


def test_its_direction_is_the_given_one_in_every_digit_and_its_deviation_the_stated(rng):
    given = turned(SUN, 2.0)
    fit, _, _ = solved(rng, DIM + lamp(SUN, [3.0] * 3), given)
    (known,) = [each for each in fit.lamps if each.given]
    np.testing.assert_allclose(known.direction, given, atol=1e-12)
    assert known.degrees == 1.0 and not any(each.given for each in fit.lamps if each is not known)
    np.testing.assert_allclose(  # what is reported is this lamp, where it is said to stand, and the rest
        fit.election.sky + sum(lamp(d, e * fit.tint.gain) for d, e in fit.election.lamps),
        fit.all_coefficients,
        atol=1e-9,
    )


def test_in_samples_it_turns_by_what_is_stated(rng):
    """Its order-1 part turns with it, where there is nothing else."""
    spread = {}
    for degrees in (0.0, 8.0):
        basis, normals, _ = half_sphere(rng, pixels=1200, albedo=(0.5, 0.5, 0.5))
        solver = LightSolver(basis, normals=normals, order=4, given=[(SUN, degrees)])
        b = shown(basis, even((0.02,) * 3) + lamp(SUN, [3.0] * 3), rng, 0.02)
        samples = solver.solve(b).samples.mean(-1)
        vectors = -samples[:, [3, 1, 2]] * [1, 1, -1]
        vectors /= np.linalg.norm(vectors, axis=1, keepdims=True)
        spread[degrees] = float(np.degrees(np.sqrt(np.square(vectors @ across(SUN).T).sum(1).mean())))
    turns = np.sqrt(spread[8.0] ** 2 - spread[0.0] ** 2)
    assert turns == pytest.approx(8.0, rel=0.15)


def test_a_wrong_direction_leaves_the_photo_to_others(rng):
    for degrees in (40, 90):
        x = DIM + lamp(SUN, [3.0] * 3)
        fit, solver, b = solved(rng, x, turned(SUN, degrees))
        (known,) = [each for each in fit.lamps if each.given]
        assert known.share < 0.12
        right = [each for each in fit.lamps if not each.given and each.direction @ SUN > np.cos(np.radians(5))]
        assert right and right[0].share > 0.4
        assert off(fit, x) < 0.25 and fit.evidence < solver.without_given().solve(b, beside=fit).evidence


def test_two_are_known(rng):
    x = DIM + lamp(SUN, [3.0] * 3) + lamp(FILL, [1.5] * 3)
    fit, _, _ = solved(rng, x, FILL, SUN)
    first, second = fit.lamps[:2]
    assert first.given and second.given and first.direction @ SUN > 0.999999 and second.direction @ FILL > 0.999999
    np.testing.assert_allclose([first.irradiance.mean(), second.irradiance.mean()], [3.0, 1.5], rtol=0.2)


def test_what_several_photos_know_is_known_of_their_light_each_lamp_once():
    jobs = [SimpleNamespace(known_lamps=[KnownLamp(d, s) for d, s in each]) for each in ([(SUN, 2.0)], [(FILL, 3.0)])]
    jobs.append(SimpleNamespace(known_lamps=[KnownLamp(turned(SUN, 0.5), 1.0), KnownLamp(turned(FILL, 5.0), 4.0)]))
    directions, degrees = zip(*given_lamps(jobs), strict=True)
    np.testing.assert_array_equal(directions, [SUN, FILL, turned(FILL, 5.0)])
    assert degrees == (2.0, 3.0, 4.0)


def test_one_can_be_left_out_alone(rng):
    basis, normals, _ = half_sphere(rng, pixels=200)
    solver = LightSolver(basis, normals=normals, order=2, given=[(SUN, 1.0), (FILL, 2.0), (BACK, 3.0)])
    assert [degrees for _, degrees in solver.without_given(1).given] == [
        1.0,
        3.0,
    ] and solver.without_given().given == ()
    fit = solver.without_given(1).solve(shown(basis, DIM + lamp(SUN, [3.0] * 3), rng, 0.05))
    assert sum(each.given for each in fit.lamps) == 2


def test_where_none_is_given_nothing_is_other_than_without_the_word(rng):
    fit, solver, b = solved(rng, DIM + lamp(SUN, [3.0] * 3))
    again = solver.without_given().solve(b)
    np.testing.assert_array_equal(fit.all_coefficients, again.all_coefficients)
    np.testing.assert_array_equal(fit.stddev, again.stddev)


def test_a_given_lamp_costs_no_evidence_and_has_three_unknowns(rng):
    """A found lamp at the same place, its direction so tight that it cannot turn, has the same but for its cost."""
    basis, normals, _ = half_sphere(rng, pixels=600)
    photo = Photograph(Basis(basis, normals), shown(basis, DIM + lamp(SUN, [3.0] * 3), rng, 0.05))
    photo.learn_from((DIM + lamp(SUN, [3.0] * 3)).T / photo.level[:, None])
    held = solve(photo, LightModel(even_field(), (SUN,), (0.0,)))
    free = solve(photo, LightModel(even_field(), (SUN,)))
    columns = held.jacobian[:, held.model.field.unknowns :]
    assert not columns[:, :2].any() and np.abs(columns[:, 2:]).max() > 1
    assert held.model.found == 0 and free.model.found == 1
    # the free one loses the Occam factor of a direction that is known to 10 degrees beforehand, and far better after
    assert held.evidence - free.evidence > LAMP_COST + 1


def test_the_jacobian_with_a_given_lamp_is_that_of_finite_differences(rng):
    model = LightModel(natural_field(), (SUN, FILL), (0.0,))
    white = rng.normal(size=model.unknowns) * 0.3
    rows = [rng.normal(size=(4, model.field.terms)) for _ in range(3)]
    found = model.jacobian(white, model.light(white)[1], rows)
    for k in (*range(model.field.unknowns, model.unknowns), 0, 7):
        step = 1e-5 * np.eye(model.unknowns)[k]
        above, below = (
            np.concatenate([r @ x for r, x in zip(rows, model.light(white + s)[0], strict=True)]) for s in (step, -step)
        )
        np.testing.assert_allclose(found[:, k], (above - below) / 2e-5, rtol=2e-2, atol=2e-2)
    assert sh.order_of(model.field.terms) == 9


def test_a_small_error_of_direction_is_not_mended_by_a_lamp_beside_it(rng):
    """Of a matte sphere; gloss would show so well where the lamp stands that the photo has its way."""
    basis, normals, _ = half_sphere(rng, pixels=1200, albedo=(0.5, 0.5, 0.5), gloss=0.0)
    solver = LightSolver(basis, normals=normals, order=4, given=[(turned(SUN, 3.0), 1.0)])
    (known,) = solver.solve(shown(basis, DIM + lamp(SUN, [3.0] * 3), rng, 0.1)).lamps
    assert known.given and known.share > 0.5


def test_what_is_said_against_a_given_lamp():
    def said(share, gain, off=None, *, shown=True, beside=False):
        known = Lamp(SUN, np.ones(3), np.zeros(3), 1.0, share, 0.1, given=True)
        there = None if off is None else turned(SUN, off)
        doubts = given_lamp_doubts(known, gain=gain, instead=there, shown=shown, beside=beside)
        return "".join(doubts)

    assert said(0.5, -3.0) == said(0.5, 4.0, 20.0) == said(0.5, 9.0, 3.0) == ""
    assert "it would have it 20 degrees away" in said(0.5, 9.0, 20.0, shown=True)
    assert "it would have it 3 degrees away" in said(0.2, 9.0, 3.0, beside=True)
    assert "it has 50 % of the light; check" in said(0.5, 9.0) and "it has 2 % of the light" in said(0.02, -3.0)
    assert "little more than a guess: 40 to 60 % of the light" in said(0.5, 9.0, 20.0, shown=False)
