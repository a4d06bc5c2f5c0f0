# SPDX-License-Identifier: GPL-3.0-or-later
"""Whose colour a tint is: against numerical integration of the two hypotheses."""

import numpy as np
import pytest

from btfsep_engine.fit.colour import ANY, DYE, LIGHT, UNKNOWN, split, tint_of


def integrated(tint):
    """Mean (2,), covariance (2, 2) of the light's tint and the probability of an unknown colour, on a fine grid."""
    axes = [np.linspace(-8 * s, 8 * s, 1601) for s in LIGHT]
    a, b = np.meshgrid(*axes, indexing="ij")

    def density(x, y, spread):
        square = (x / spread[0]) ** 2 + (y / spread[1]) ** 2
        return np.exp(-0.5 * square) / (2 * np.pi * spread[0] * spread[1])

    light = density(a, b, LIGHT)
    known, unknown = (p * light * density(tint[0] - a, tint[1] - b, s) for p, s in ((1 - UNKNOWN, DYE), (UNKNOWN, ANY)))
    whole = known + unknown
    whole_sum = whole.sum()
    mean = np.array([(a * whole).sum(), (b * whole).sum()]) / whole_sum
    x, y = a - mean[0], b - mean[1]
    covariance = np.array(
        [[(x * x * whole).sum(), (x * y * whole).sum()], [(x * y * whole).sum(), (y * y * whole).sum()]]
    )
    return mean, covariance / whole_sum, unknown.sum() / whole_sum


@pytest.mark.parametrize(
    "colour", [(1, 1, 1), (1.2, 1, 0.9), (1.6, 1.1, 0.8), (2.2, 1, 0.6), (0.3, 1, 0.9), (1, 2.5, 1)]
)
def test_the_split_is_that_of_numerical_integration(colour):
    colour = 3 * np.array(colour)
    tint = tint_of(colour)
    np.testing.assert_allclose(
        tint, [np.log(colour[0] / colour[2]), np.log(colour[1] / np.sqrt(colour[0] * colour[2]))]
    )
    mean, covariance, unknown = integrated(tint)
    found = split(colour)
    np.testing.assert_allclose(tint - found.object_tint, mean, atol=1e-4)
    np.testing.assert_allclose(found.covariance, covariance, atol=1e-4 * covariance.max())
    assert found.unknown == pytest.approx(unknown, abs=1e-4)
    lights_own = colour * found.gain
    np.testing.assert_allclose(tint_of(lights_own), mean, atol=1e-4)
    assert lights_own.sum() == pytest.approx(colour.sum())


def test_factors_are_drawn_with_the_covariance_of_the_lights_tint(rng):
    found = split(np.array([2.0, 1.1, 0.9]))
    factors = np.log(found.draw(20000, rng))
    drawn = np.stack([factors[:, 0] - factors[:, 2], factors[:, 1] - (factors[:, 0] + factors[:, 2]) / 2])
    np.testing.assert_allclose(np.cov(drawn), found.covariance, atol=0.05 * found.covariance.max())
    np.testing.assert_allclose(factors.sum(1), 0, atol=1e-9)
