# SPDX-License-Identifier: GPL-3.0-or-later
"""The inverse of a triangular matrix, by halves, against its definition."""

import numpy as np
import pytest

from btfsep_engine.fit.linear_algebra import SMALL, triangular_inverse


@pytest.mark.parametrize("n", [1, 2, SMALL, SMALL + 1, 300])
@pytest.mark.parametrize("order", ["C", "F"])
def test_it_is_the_inverse_and_lower_triangular(rng, n, order):
    lower = np.array(np.tril(rng.normal(size=(n, n))) / n + np.eye(n), order=order)
    found = triangular_inverse(lower)
    assert np.allclose(found @ lower, np.eye(n), atol=1e-12) and np.array_equal(found, np.tril(found))
