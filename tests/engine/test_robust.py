# SPDX-License-Identifier: GPL-3.0-or-later
"""Robust weights against outliers of known place."""

import numpy as np

from btfsep_engine.fit.map_estimate import solve_map
from btfsep_engine.fit.robust import TUNING, solve_robust, weights_of
from btfsep_engine.light.natural import natural_prior
from tests.engine.half_sphere import ORDER, half_sphere, off, side_light


def test_things_in_front_lose_their_weight(rng):
    prior = natural_prior(ORDER)
    basis, blocks = half_sphere(rng)
    x = side_light()
    b = np.einsum("pmc,mc->pc", basis, x)
    b *= 1 + 0.02 * rng.normal(size=b.shape)
    covered = rng.random(len(b)) < 0.15
    b[covered] = 4 * b.mean()
    found = solve_robust(basis, b, blocks=blocks, prior=prior, order=ORDER, kind="tukey")
    plain = solve_map(basis, b, blocks=blocks, prior=prior, order=ORDER)
    assert off(found.fit, x) < 0.35 * off(plain, x)
    assert np.median(found.weights[covered]) < 0.2 < 0.8 < np.median(found.weights[~covered])


def test_weights_by_block_are_the_same_in_a_block(rng):
    prior = natural_prior(ORDER)
    basis, blocks = half_sphere(rng, pixels=600)
    b = np.einsum("pmc,mc->pc", basis, side_light()) * (1 + 0.05 * rng.normal(size=(600, 3)))
    b[blocks == 3] *= 3
    found = solve_robust(basis, b, blocks=blocks, prior=prior, order=ORDER, kind="tukey", by="block")
    for each in np.unique(blocks):
        assert np.ptp(found.weights[blocks == each]) == 0
    assert found.weights[blocks == 3].max() < 0.1


def test_weights_are_those_of_the_published_functions():
    sizes = np.concatenate([np.ones(101), [2.0, 4.0, 20.0]])  # their median is 1, so the spread is 1.4826
    u = sizes / 1.4826
    huber, tukey = (weights_of(sizes, kind=k) for k in ("huber", "tukey"))
    np.testing.assert_allclose(huber, np.minimum(1, 1.345 / u))
    np.testing.assert_allclose(tukey, np.where(u < 4.685, (1 - (u / 4.685) ** 2) ** 2, 0))
    assert tukey[-1] == 0 < huber[-1] and set(TUNING) == {"huber", "tukey"}
    assert (weights_of(np.zeros(5), kind="tukey") == 1).all()


def test_a_pixel_of_small_weight_counts_as_a_measurement_of_large_noise(rng):
    """The fixed point: the fit is that of rows scaled by the roots of the weights of its own residuals."""
    prior = natural_prior(ORDER)
    basis, blocks = half_sphere(rng, pixels=800)
    b = np.einsum("pmc,mc->pc", basis, side_light()) * (1 + 0.03 * rng.standard_t(2, size=(800, 3)))
    found = solve_robust(basis, b, blocks=blocks, prior=prior, order=ORDER, kind="huber")
    root = np.sqrt(found.weights)
    assert np.ptp(found.weights) > 0.5
    how = dict(blocks=blocks, prior=prior, order=ORDER, coarsening=found.solver.coarsening)
    again = solve_map(basis * root[:, None, None], b * root[:, None], **how)
    plain = solve_map(basis, b, **how)
    gap = np.linalg.norm(found.fit.coefficients - again.coefficients)
    assert gap < 0.05 * np.linalg.norm(found.fit.coefficients - plain.coefficients)
