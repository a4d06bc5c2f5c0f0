# SPDX-License-Identifier: GPL-3.0-or-later
"""Whose colour a tint is: against numerical integration of the hypotheses."""

import numpy as np
import pytest

from btfsep_engine.fit.colour import ANY, DYE, FILTERED, LIGHT, MISSTATED, UNKNOWN, VIVID, split, tint_of
from btfsep_engine.fit.log_normal import LightSolver
from tests.engine.half_sphere import half_sphere, shown, side_light


def integrated(tint, hypotheses):
    """Mean (2,), covariance (2, 2) of the light's tint and the hypotheses' probabilities, on a fine grid.

    ``hypotheses`` : (probability, spread of the light, of the object) of each
    """
    axes = [np.linspace(-8 * s, 8 * s, 3201) for s in np.max([light for _, light, _ in hypotheses], 0)]
    a, b = np.meshgrid(*axes, indexing="ij")

    def density(x, y, spread):
        square = (x / spread[0]) ** 2 + (y / spread[1]) ** 2
        return np.exp(-0.5 * square) / (2 * np.pi * spread[0] * spread[1])

    each = [p * density(a, b, light) * density(tint[0] - a, tint[1] - b, own) for p, light, own in hypotheses]
    whole = sum(each)
    whole_sum = whole.sum()
    mean = np.array([(a * whole).sum(), (b * whole).sum()]) / whole_sum
    x, y = a - mean[0], b - mean[1]
    covariance = np.array(
        [[(x * x * whole).sum(), (x * y * whole).sum()], [(x * y * whole).sum(), (y * y * whole).sum()]]
    )
    return mean, covariance / whole_sum, [part.sum() / whole_sum for part in each]


USUAL = [(1 - UNKNOWN, LIGHT, DYE), (UNKNOWN, LIGHT, ANY)]
STATED = [(1 - MISSTATED - FILTERED, LIGHT, DYE), (MISSTATED, LIGHT, ANY), (FILTERED, VIVID, DYE)]
ON_STAGE = [(1 - UNKNOWN, VIVID, DYE), (UNKNOWN, VIVID, ANY)]


@pytest.mark.parametrize(
    "colour", [(1, 1, 1), (1.2, 1, 0.9), (1.6, 1.1, 0.8), (2.2, 1, 0.6), (0.3, 1, 0.9), (1, 2.5, 1)]
)
@pytest.mark.parametrize(("how", "hypotheses"), [({}, USUAL), ({"stated": True}, STATED), ({"vivid": True}, ON_STAGE)])
def test_the_split_is_that_of_numerical_integration(colour, how, hypotheses):
    colour = 3 * np.array(colour)
    tint = tint_of(colour)
    np.testing.assert_allclose(
        tint, [np.log(colour[0] / colour[2]), np.log(colour[1] / np.sqrt(colour[0] * colour[2]))]
    )
    mean, covariance, shares = integrated(tint, hypotheses)
    found = split(colour, **how)
    np.testing.assert_allclose(tint - found.object_tint, mean, atol=1e-4)
    np.testing.assert_allclose(found.covariance, covariance, atol=1e-4 * covariance.max())
    assert found.unknown == pytest.approx(shares[1], abs=1e-4)
    filtered = shares[2] if "stated" in how else shares[0] if "vivid" in how else 0
    assert found.filtered == pytest.approx(filtered, abs=1e-4)
    lights_own = colour * found.gain
    np.testing.assert_allclose(tint_of(lights_own), mean, atol=1e-4)
    assert lights_own.sum() == pytest.approx(colour.sum())


def test_a_filters_colour_is_the_lights_where_the_objects_is_stated_and_a_dyes_is_the_objects():
    magenta, teal = np.array([1.0, 0.03, 0.8]), np.array([0.1, 0.5, 0.4])
    of_light = [tint_of(c) - split(c, stated=True).object_tint for c in (magenta, teal)]
    assert of_light[0][1] < 0.9 * tint_of(magenta)[1] < 0
    assert np.abs(of_light[1]).max() < 0.35 * np.abs(tint_of(teal)).max()
    assert split(magenta).unknown > 0.99  # of what nobody said of


def test_a_tint_that_natural_light_has_is_the_lights_and_one_that_it_never_has_is_the_objects():
    night, owl = np.array([1.32, 1.09, 0.75]), np.array([1.68, 0.99, 0.54])  # the first as a real map, the second a toy
    of_light = [(tint_of(c) - split(c).object_tint) / tint_of(c) for c in (night, owl)]
    assert of_light[0][0] > 0.85 and split(night).unknown < 0.15
    assert of_light[1][0] < 0.3 and split(owl).unknown > 0.8
    assert split(owl, stated=True).unknown < split(owl).unknown  # who states a colour by numbers is believed longer


def test_factors_are_drawn_with_the_covariance_of_the_lights_tint(rng):
    found = split(np.array([2.0, 1.1, 0.9]))
    factors = np.log(found.draw(20000, rng))
    drawn = np.stack([factors[:, 0] - factors[:, 2], factors[:, 1] - (factors[:, 0] + factors[:, 2]) / 2])
    np.testing.assert_allclose(np.cov(drawn), found.covariance, atol=0.05 * found.covariance.max())
    np.testing.assert_allclose(factors.sum(1), 0, atol=1e-9)


def test_what_is_shown_is_the_photo_whoever_its_colour_is_given_to(rng):
    """An orange thing in the grey material's place: half of its colour goes to it, and none of the photo is lost."""
    basis, normals, _ = half_sphere(rng, albedo=(0.5, 0.5, 0.5))
    b = shown(basis, side_light(), rng, 0.02) * [1.68, 0.99, 0.54]
    fit = LightSolver(basis, normals=normals, order=4).solve(b)
    assert fit.tint.unknown > 0.8 and np.abs(fit.tint.object_tint).max() > 0.5

    def misfit(x):
        return np.linalg.norm(shown(basis, x) - b) / np.linalg.norm(b)

    assert misfit(fit.shown) < 0.04 < 0.2 < misfit(fit.all_coefficients)
