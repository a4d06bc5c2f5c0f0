# SPDX-License-Identifier: GPL-3.0-or-later
"""Clipped pixels as inequalities, against a light that is known."""

import numpy as np
import pytest

from btfsep_engine.errors import InputError
from btfsep_engine.fit.censored import HIDDEN, solve_censored, with_hidden_light
from btfsep_engine.fit.map_estimate import solve_map
from btfsep_engine.light.natural import natural_prior
from tests.engine.half_sphere import ORDER, half_sphere, off, side_light


@pytest.fixture
def photographed(rng):
    """basis, b with noise of 2 %, blocks, prior, true light."""
    prior = natural_prior(ORDER)
    basis, blocks = half_sphere(rng)
    x = side_light()
    b = np.einsum("pmc,mc->pc", basis, x)
    return basis, b * (1 + 0.02 * rng.normal(size=b.shape)), blocks, prior, x


def test_inequalities_recover_what_exclusion_loses(photographed):
    basis, b, blocks, prior, x = photographed
    limit = np.quantile(b.max(1), 0.5)
    clipped, cut = b >= limit, np.minimum(b, limit)
    how = {"prior": prior, "order": ORDER}
    found = solve_censored(basis, cut, clipped, blocks=blocks, **how)
    whole = ~clipped.any(1)
    excluded = solve_map(basis[whole], cut[whole], blocks=blocks[whole], **how)
    taken_at_the_limit = solve_map(basis, cut, blocks=blocks, **how)
    assert off(found.fit, x) < 0.8 * off(excluded, x)
    assert off(found.fit, x) < 0.7 * off(taken_at_the_limit, x)
    assert (found.radiance[clipped] >= limit - 1e-12).all()
    assert np.array_equal(found.radiance[~clipped], cut[~clipped])
    assert not found.active[~clipped].any()


def test_an_inequality_stops_light_that_the_clipped_pixels_contradict(photographed):
    """A pixel that is clipped although the rest of the photo explains less pulls the light up to the limit."""
    basis, b, blocks, prior, _ = photographed
    limit = np.quantile(b.max(1), 0.6)
    clipped, cut = b >= limit, np.minimum(b, limit)
    # a brighter light on what is clipped alone: nothing of that is in the other pixels
    found = solve_censored(basis, np.where(clipped, 3 * limit, cut), clipped, blocks=blocks, prior=prior, order=ORDER)
    plain = solve_censored(basis, cut, clipped, blocks=blocks, prior=prior, order=ORDER)

    def bright(fit):
        return np.einsum("pmc,mc->pc", basis, fit.coefficients)[clipped].mean()

    assert found.active.sum() > plain.active.sum()
    assert bright(found.fit) > 1.15 * bright(plain.fit)


def test_without_clipping_it_is_the_plain_fit(photographed):
    basis, b, blocks, prior, _ = photographed
    found = solve_censored(basis, b, np.zeros(b.shape, bool), blocks=blocks, prior=prior, order=ORDER)
    plain = solve_map(basis, b, blocks=blocks, prior=prior, order=ORDER)
    assert found.rounds == 1 and found.used.all()
    np.testing.assert_array_equal(found.fit.coefficients, plain.coefficients)


def test_a_photo_that_is_clipped_everywhere_is_refused(photographed):
    basis, b, blocks, prior, _ = photographed
    with pytest.raises(InputError, match="clipped"):
        solve_censored(basis, b, np.ones(b.shape, bool), blocks=blocks, prior=prior, order=ORDER)


def test_a_clipped_channel_enters_as_what_is_expected_of_it(photographed):
    """The fixed point against drawn normal numbers: their mean above the limit."""
    basis, b, blocks, prior, _ = photographed
    limit = np.quantile(b.max(1), 0.7)
    clipped, cut = b >= limit, np.minimum(b, limit)
    found = solve_censored(basis, cut, clipped, blocks=blocks, prior=prior, order=ORDER, rounds=60)
    predicted = np.einsum("pmc,mc->pc", basis, found.fit.all_coefficients)
    spread = np.sqrt(np.square(cut - predicted)[~clipped.any(1)].mean(0))
    p, c = np.argwhere(clipped & (np.abs(predicted - limit) < spread))[0]
    draws = np.random.default_rng(1).normal(predicted[p, c], spread[c], 400_000)
    assert found.radiance[p, c] == pytest.approx(draws[draws >= limit].mean(), rel=0.01)


def test_clipping_widens_what_is_stated_by_a_part_of_natural_light(photographed):
    basis, b, blocks, prior, _ = photographed
    limit = np.quantile(b.max(1), 0.4)
    clipped = b >= limit
    found = solve_censored(basis, np.minimum(b, limit), clipped, blocks=blocks, prior=prior, order=ORDER).fit
    share = float(clipped.mean())
    wider = with_hidden_light(found, share, prior)
    natural = found.coefficients[0].mean() * prior.deviation
    grown = wider.stddev**2 - found.stddev**2
    np.testing.assert_allclose(grown, np.broadcast_to((HIDDEN**2 * share * natural**2)[:, None], grown.shape))
    few = len(found.covariance) // 3
    np.testing.assert_allclose(
        (wider.covariance - found.covariance), np.diag(np.repeat(HIDDEN**2 * share * natural[:few] ** 2, 3)), atol=1e-12
    )
    assert np.linalg.eigvalsh(wider.covariance).min() > 0
    assert wider.determined.sum() < found.determined.sum() and not (wider.determined & ~found.determined).any()
    np.testing.assert_array_equal(wider.coefficients, found.coefficients)
    assert with_hidden_light(found, 0.0, prior) is found
