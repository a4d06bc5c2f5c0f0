# SPDX-License-Identifier: GPL-3.0-or-later
"""The expected error: where it is known in closed form, and that errors really fall as stated."""

import numpy as np
import pytest

from btfsep_engine.fit.compare import relative_l2
from btfsep_engine.fit.stated import expected_error, pattern_ranges, stated_by


def test_nothing_unknown_means_no_error_and_a_free_scale_costs_nothing(rng):
    x = rng.normal(size=(9, 3))
    assert expected_error(x, np.broadcast_to(x, (50, 9, 3)))["order_2"]["high"] < 1e-7
    along = x * np.exp(rng.normal(size=(50, 1, 1)))  # only how bright it is, is unknown
    assert expected_error(x, along)["order_2"]["high"] < 1e-7
    assert set(expected_error(x[:4], along)) == {"order_1"}  # samples have more orders than are reported


def test_it_is_the_size_of_what_is_unknown_across(rng):
    """Small isotropic noise: |e| / |x| with one direction lost to the scale."""
    x = rng.normal(size=(9, 3))
    size = 0.01 * np.linalg.norm(x)
    found = expected_error(x, x + size * rng.normal(size=(2000, 9, 3)))
    assert found["order_2"]["median"] == pytest.approx(0.01 * np.sqrt(26), rel=0.03)
    first = np.linalg.norm(x[:4])
    assert found["order_1"]["median"] == pytest.approx(size * np.sqrt(11) / first, rel=0.05)


def test_true_errors_fall_as_stated(rng):
    """Lights drawn from the same: 68 % of the true errors lie in the range, half of them under the median."""
    x = rng.normal(size=(9, 3))
    root = rng.normal(size=(27, 27)) * 0.1
    lights = x + (rng.normal(size=(1500, 27)) @ root.T).reshape(-1, 9, 3)
    found = expected_error(x, lights[:500])["order_2"]
    errors = np.array([relative_l2(x, truth)["relative_l2_free_scale"] for truth in lights[500:]])
    assert np.mean((errors > found["low"]) & (errors < found["high"])) == pytest.approx(0.68, abs=0.08)
    assert np.mean(errors < found["median"]) == pytest.approx(0.5, abs=0.1)


def test_ranges_of_the_pattern_know_of_no_scale_and_hold_what_they_say(rng):
    x = 0.3 * rng.normal(size=(16, 3))
    x[0] += 2
    lights = x + 0.1 * rng.normal(size=(2000, 16, 3))
    ranges = pattern_ranges(x, lights[:1000])
    dimmed = lights[:1000] * np.exp(rng.normal(size=(1000, 1, 1)))
    np.testing.assert_allclose(pattern_ranges(x, dimmed), ranges, rtol=1e-9)
    assert (np.diff(ranges, axis=0) >= 0).all()
    np.testing.assert_allclose(pattern_ranges(x, x * np.linspace(0.5, 2, 50)[:, None, None]), [x] * 4, atol=1e-12)
    truths = lights[1000:]  # in the scale that `relative_l2` finds for the estimate
    scales = [relative_l2(x[:9], t[:9])["scale"] for t in truths]
    own = truths / np.array(scales)[:, None, None]
    for (low, high), share in ((ranges[1:3], 0.682), (ranges[::3], 0.95)):
        assert ((low <= own) & (own <= high)).mean() == pytest.approx(share, abs=0.02)
    stated = stated_by(x, dimmed)
    np.testing.assert_allclose(stated.pattern, ranges, rtol=1e-9)
    assert (np.ptp(stated.interval, 0) > np.ptp(ranges[::3], 0)).all()


def test_the_opposite_of_a_light_is_as_wrong_as_none(rng):
    """The best factor is not negative."""
    x = rng.normal(size=(4, 3))
    assert expected_error(x, -x[None])["order_1"]["median"] == pytest.approx(1)
