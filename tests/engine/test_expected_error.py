# SPDX-License-Identifier: GPL-3.0-or-later
"""The expected error: where it is known in closed form, and that errors really fall as stated."""

import numpy as np
import pytest

from btfsep_engine.fit.compare import relative_l2
from btfsep_engine.fit.expected_error import expected_error


def test_nothing_unknown_means_no_error_and_a_free_scale_costs_nothing(rng):
    x = rng.normal(size=(9, 3))
    assert expected_error(x, np.zeros((27, 27)))["order_2"]["median"] < 1e-7
    along = np.outer(x.ravel(), x.ravel()) * 0.04  # only how bright it is, is unknown
    assert expected_error(x, along)["order_2"]["high"] < 1e-7
    assert set(expected_error(x, along[:12, :12])) == {"order_1"}


def test_it_is_the_size_of_what_is_unknown_across(rng):
    """Small isotropic noise: |e| / |x| with one direction lost to the scale."""
    x = rng.normal(size=(9, 3))
    size = 0.01 * np.linalg.norm(x)
    found = expected_error(x, np.eye(27) * size**2)
    assert found["order_2"]["median"] == pytest.approx(0.01 * np.sqrt(26), rel=0.03)
    first = np.linalg.norm(x[:4])
    assert found["order_1"]["median"] == pytest.approx(size * np.sqrt(11) / first, rel=0.05)


def test_true_errors_fall_as_stated(rng):
    """Lights drawn from the posterior: 68 % of the true errors lie in the range, half of them under the median."""
    x = rng.normal(size=(9, 3))
    root = rng.normal(size=(27, 27)) * 0.1
    found = expected_error(x, root @ root.T)["order_2"]
    errors = []
    for _ in range(1000):
        truth = x + (root @ rng.normal(size=27)).reshape(9, 3)
        errors.append(relative_l2(x, truth)["relative_l2_free_scale"])
    errors = np.array(errors)
    assert np.mean((errors > found["low"]) & (errors < found["high"])) == pytest.approx(0.68, abs=0.08)
    assert np.mean(errors < found["median"]) == pytest.approx(0.5, abs=0.1)
