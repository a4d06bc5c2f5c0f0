# SPDX-License-Identifier: GPL-3.0-or-later
"""Direction lists, interpolation between them, and quadrature over them."""

import numpy as np

from btfsep_engine.btf.directions import (
    cosine_weights,
    hemisphere_quadrature,
    interpolator,
    ubo2003_directions,
    ubo2014_angles,
    ubo2014_directions,
)
from btfsep_engine.conventions import fibonacci_sphere, local_direction
from btfsep_engine.sh import cosine_lobe, evaluate

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


def test_the_list_of_ubo2003_has_81_directions_in_its_rings():
    d = ubo2003_directions()
    theta = np.degrees(np.arccos(d[:, 2]))
    assert len(d) == 81
    for ring, count, step in ((0, 1, 360), (15, 6, 60), (30, 12, 30), (45, 18, 20), (60, 20, 18), (75, 24, 15)):
        here = np.isclose(theta, ring)
        phi = np.degrees(np.arctan2(d[here, 1], d[here, 0])) % 360
        assert here.sum() == count
        np.testing.assert_allclose(phi, np.arange(count) * step, atol=1e-6)


def test_quadrature_is_exact_for_harmonics():
    nodes, weights = hemisphere_quadrature()
    assert np.isclose(weights.sum(), 2 * np.pi, rtol=1e-13)
    # over the hemisphere, Y_l0 cos(theta) integrates to the clamped cosine's coefficients (closed form)
    found = (evaluate(9, nodes) * (weights * nodes[:, 2])[:, None]).sum(0)
    expected = np.zeros(100)
    for l in range(10):
        expected[l * l + l] = cosine_lobe(9)[l] * np.sqrt((2 * l + 1) / (4 * np.pi))
    np.testing.assert_allclose(found, expected, atol=1e-12)


def test_beyond_the_outermost_ring_the_value_is_held():
    d = ubo2014_directions()
    steps = np.radians(np.arange(0, 360, 1.0))
    rim = np.stack([np.cos(steps), np.sin(steps), np.zeros_like(steps)], -1)
    hull = 1 + d[:, 0] * 0.5
    index, weight = interpolator(d).weights(rim)
    found = (weight * hull[index]).sum(1)
    assert (d[index[weight > 1e-9 * np.ones_like(weight)]][:, 2] < np.cos(np.radians(74))).all()  # only the ring
    assert np.abs(found - (1 + 0.5 * np.sin(np.radians(75)) * np.cos(steps))).max() < 0.02


def test_directions_without_a_triangle_give_the_nearest():
    line = local_direction(np.radians([60.0, 0, 60, 30]), np.radians([0.0, 0, 180, 0]))
    for few in (line, line[:2], line[:1]):
        index, weight = interpolator(few).weights(few)
        found = index[np.arange(len(few)), weight.argmax(1)]
        assert (found == np.arange(len(few))).all() and np.allclose(weight.sum(1), 1)
