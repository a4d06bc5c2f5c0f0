# SPDX-License-Identifier: GPL-3.0-or-later
"""Direction lists, interpolation between them, and quadrature over them."""

import numpy as np

from btfsep_engine.btf.directions import cosine_weights, interpolator, ubo2014_angles, ubo2014_directions
from btfsep_engine.conventions import fibonacci_sphere

UPPER = fibonacci_sphere(4000)[fibonacci_sphere(4000)[:, 2] > 0]


def test_the_list_has_the_rings_of_ubo2014():
    theta, phi = np.degrees(ubo2014_angles().T)
    assert len(theta) == 151 and theta.max() == 75
    assert (phi > -180).all() and (phi <= 180).all()
    assert (theta == 67.5).sum() == 24
    for ring, offset in ((11, 15), (23.5, 0), (30, 15), (37.5, 0), (45, 0), (52.5, 7.5), (60, 0), (67.5, 7.5), (75, 0)):
        here = phi[np.isclose(theta, ring)]
        assert np.isclose(here[0], offset)
        np.testing.assert_allclose(np.diff(here) % 360, 360 / len(here), atol=1e-9)


def test_interpolation_gives_back_its_nodes_and_is_smooth_between():
    d = ubo2014_directions()
    index, weight = interpolator(d).weights(UPPER)
    assert (weight >= 0).all()
    np.testing.assert_allclose(weight.sum(1), 1)
    inside = UPPER[:, 2] > np.cos(np.radians(74))
    smooth = lambda w: 1 + 0.5 * w[..., 0] - 0.3 * w[..., 1] * w[..., 2]  # noqa: E731
    found = (weight * smooth(d[index])).sum(1)
    assert np.abs(found - smooth(UPPER))[inside].max() < 0.03
    index, weight = interpolator(d).weights(d)
    nearest = np.take_along_axis(index, weight.argmax(1)[:, None], 1)[:, 0]
    assert (weight.max(1) > 0.95).all() and (nearest == np.arange(151)).all()


def test_cosine_weights_integrate():
    d = ubo2014_directions()
    w = cosine_weights(d)
    assert np.isclose(w.sum(), np.pi) and (w >= 0).all()
    # integral of z * z over the hemisphere is 2 pi / 3; holding z beyond 75 degrees adds a little
    assert abs(w @ d[:, 2] - 2 * np.pi / 3) < 0.02 * 2 * np.pi / 3
    assert abs(w @ (d[:, 0] ** 2) - np.pi / 4) < 0.02 * np.pi / 4
