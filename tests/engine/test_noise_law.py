# SPDX-License-Identifier: GPL-3.0-or-later
"""How misfits go with the brightness: found from draws of known noise, and nothing made of what has none."""

import numpy as np

from btfsep_engine.fit.noise_law import SHARES, precision

COUNT = 3000
ALL, NO_FLOOR = np.ones(COUNT, bool), np.full(3, 1e-12)


def photographed(seed=0):
    """Brightnesses (p, 3), and normal numbers beside them."""
    random = np.random.default_rng(seed)
    return random.uniform(0.05, 2, (COUNT, 1)) * [1.0, 0.8, 0.5], random.standard_normal((COUNT, 3))


def found(predicted, left, of=ALL, given=None, floor=NO_FLOOR):
    return precision(predicted, left, of=of, given=np.ones((COUNT, 3)) if given is None else given, floor=floor)


def test_noise_of_all_pixels_alike_changes_nothing():
    predicted, noise = photographed()
    np.testing.assert_allclose(found(predicted, 0.1 * noise), 1)


def test_a_factor_of_the_brightness_makes_the_dark_count_for_more():
    predicted, noise = photographed()
    own = found(predicted, 0.2 * predicted * noise)
    np.testing.assert_allclose(own.mean(0), 1)
    expected = 1 / (1 - SHARES[-1] + SHARES[-1] * np.square(predicted) / np.square(predicted).mean(0))
    np.testing.assert_allclose(own, expected / expected.mean(0))


def test_both_together_are_told_apart():
    predicted, noise = photographed()
    half = np.sqrt(0.5 + 0.5 * np.square(predicted) / np.square(predicted).mean(0))
    own = found(predicted, 0.1 * half * noise)
    ratio = own[predicted[:, 0].argmin(), 0] / own[predicted[:, 0].argmax(), 0]
    true = np.square(half[:, 0].max() / half[:, 0].min())
    assert 0.6 * true < ratio < 1.6 * true


def test_other_pixels_keep_their_share():
    predicted, noise = photographed()
    of = np.arange(COUNT) % 2 == 0
    left = np.where(of[:, None], 0.2 * predicted, 0.2) * noise
    own = found(predicted, left, of=of)
    assert np.ptp(own[~of], axis=0).max() == 0 and own[of].std() > 0.1
    np.testing.assert_allclose(own.mean(0), 1)


def test_what_is_given_weighs_in_the_mean():
    predicted, noise = photographed()
    given = np.where(predicted > 1, 0.25, 1.0)
    own = found(predicted, 0.2 * predicted * noise / np.sqrt(given), given=given)
    np.testing.assert_allclose((given * own).sum(0), given.sum(0))


def test_misfits_below_the_floor_say_nothing():
    predicted, noise = photographed()
    np.testing.assert_allclose(found(predicted, 0.01 * predicted * noise, floor=np.full(3, 0.05**2)), 1)
    assert found(predicted, 0.01 * predicted * noise).std() > 0.5
