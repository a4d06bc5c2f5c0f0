# SPDX-License-Identifier: GPL-3.0-or-later
"""Clipped pixels as inequalities, against a light that is known and Tobin's likelihood written out."""

import numpy as np
import pytest
from scipy.stats import norm

from btfsep_engine.errors import InputError
from btfsep_engine.fit import censored
from btfsep_engine.fit.censored import working_values
from btfsep_engine.fit.log_normal import LightSolver
from tests.engine.half_sphere import SUN, even, half_sphere, lamp, off, shown, side_light


@pytest.fixture
def photographed(rng):
    """solver, b with noise of 2 %, true light."""
    basis, normals, _ = half_sphere(rng)
    x = side_light()
    return LightSolver(basis, normals=normals, order=2), shown(basis, x, rng, 0.02), x


def cut(b, quantile):
    """The photo clipped at a quantile of its pixels' brightest channels, and where."""
    limit = np.quantile(b.max(1), quantile)
    return np.minimum(b, limit), b >= limit


def test_inequalities_recover_what_exclusion_loses(photographed):
    solver, b, x = photographed
    values, clipped = cut(b, 0.5)
    working, weights = working_values(solver, values, clipped)
    found = solver.solve(working, weights=weights)
    excluded = solver.solve(values, weights=(~clipped).astype(float))
    taken_at_the_limit = solver.solve(values)
    assert off(found, x) < 0.9 * off(excluded, x)
    assert off(found, x) < 0.5 * off(taken_at_the_limit, x)
    np.testing.assert_array_equal(working[~clipped], values[~clipped])
    assert (weights[~clipped] == 1).all() and (weights >= 0).all() and (weights <= 1).all()


def test_an_inequality_stops_light_that_the_clipped_pixels_contradict(photographed):
    """Pixels that are clipped although the rest of the photo explains less pull the light up to the limit."""
    solver, b, _ = photographed
    values, clipped = cut(b, 0.6)

    def bright(limited):
        working, weights = working_values(solver, limited, clipped)
        return solver.basis.predicted(solver.solve(working, weights=weights).all_coefficients)[clipped].mean(), weights

    (plain, few), (pulled, many) = bright(values), bright(np.where(clipped, 2 * values, values))
    assert pulled > 1.15 * plain and many[clipped].mean() > 2 * few[clipped].mean()


def test_without_clipping_nothing_changes(photographed):
    solver, b, _ = photographed
    working, weights = working_values(solver, b, np.zeros(b.shape, bool))
    np.testing.assert_array_equal(working, b)
    assert (weights == 1).all()


def test_a_photo_that_is_clipped_everywhere_is_refused(photographed):
    solver, b, _ = photographed
    with pytest.raises(InputError, match="clipped"):
        working_values(solver, b, np.ones(b.shape, bool))


def test_a_clipped_lamp_is_brighter_than_as_if_measured(rng):
    basis, normals, _ = half_sphere(rng)
    b = shown(basis, even(0.2 * np.ones(3)) + lamp(SUN, [4.0, 4.0, 4.0]), rng, 0.02)
    solver = LightSolver(basis, normals=normals, order=2)
    values, clipped = cut(b, 0.7)
    working, weights = working_values(solver, values, clipped)
    found, measured = solver.solve(working, weights=weights), solver.solve(values)
    assert found.lamps[0].irradiance.mean() == pytest.approx(4.0, rel=0.1)
    assert not measured.lamps or measured.lamps[0].irradiance.mean() < 0.9 * found.lamps[0].irradiance.mean()


def test_working_values_have_the_slope_and_curvature_of_tobins_likelihood(photographed, monkeypatch):
    """One measurement for each clipped channel: weight times misfit, and weight, are log Phi's derivatives at p."""
    solver, b, _ = photographed
    values, clipped = cut(b, 0.5)
    monkeypatch.setattr(censored, "ROUNDS", 1)  # so that p, the first fit's prediction, is known here
    working, weights = working_values(solver, values, clipped)
    p = solver.basis.predicted(solver.solve(values, weights=(~clipped).astype(float)).shown)
    left = np.where(clipped, 0.0, values - p)
    s = np.sqrt(np.square(left).sum(0) / (~clipped).sum(0))
    z = (values - p) / s
    spoken = clipped & (weights > censored.LIGHTEST) & (weights < 1) & (np.abs(z) < censored.FARTHEST)
    assert spoken.sum() > 100

    def likelihood(at):
        return norm.logcdf((at - values) / s)

    step = 1e-4 * s
    slope = (likelihood(p + step) - likelihood(p - step)) / (2 * step)
    curvature = (likelihood(p + step) - 2 * likelihood(p) + likelihood(p - step)) / step**2
    by_squares = weights * (working - p) / s**2
    np.testing.assert_allclose(by_squares[spoken], slope[spoken], rtol=1e-4)
    np.testing.assert_allclose((weights / s**2)[spoken], -curvature[spoken], rtol=1e-3)


def test_pixels_that_count_for_nothing_say_nothing_of_clipped_ones(photographed):
    solver, b, _ = photographed
    values, clipped = cut(b, 0.6)
    wrong = np.zeros(len(b), bool)
    wrong[::5] = True
    known = np.where(wrong, 0.0, 1.0)[:, None] * np.ones(3)
    spoilt = np.where(wrong[:, None] & ~clipped, 20 * values, values)
    (working, weights), (again, same) = (working_values(solver, each, clipped, known) for each in (values, spoilt))
    np.testing.assert_allclose(working[clipped], again[clipped])
    np.testing.assert_array_equal(weights, same)
    assert not weights[wrong[:, None] & ~clipped].any() and (weights[~wrong[:, None] & ~clipped] == 1).all()
    assert weights[clipped].any()
