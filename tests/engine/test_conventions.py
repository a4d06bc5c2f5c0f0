# SPDX-License-Identifier: GPL-3.0-or-later
"""Axes, maps and angles: round trips over the whole sphere, and fixed points that name the convention."""

import numpy as np
import pytest

from btfsep_engine import conventions as c

EVERYWHERE = np.concatenate([c.fibonacci_sphere(500), np.eye(3), -np.eye(3)])


def test_equirect_round_trip_over_the_whole_sphere():
    u, v = c.direction_to_equirect(EVERYWHERE)
    assert (u >= 0).all() and (u <= 1).all() and (v >= 0).all() and (v <= 1).all()
    np.testing.assert_allclose(c.equirect_to_direction(u, v), EVERYWHERE, atol=1e-7)


@pytest.mark.parametrize(
    ("direction", "u", "v"),
    [
        ((1, 0, 0), 0.5, 0.5),  # the middle of the map is +X
        ((0, 1, 0), 0.25, 0.5),  # +Y is to the left of it
        ((0, -1, 0), 0.75, 0.5),
        ((-1, 0, 0), 0.0, 0.5),  # -X is the seam
        ((np.sqrt(0.5), 0, np.sqrt(0.5)), 0.5, 0.75),
    ],
)
def test_where_the_axes_are_in_a_map(direction, u, v):
    np.testing.assert_allclose(c.direction_to_equirect(np.array(direction, float)), (u, v), atol=1e-12)


def test_row_0_is_up_and_columns_run_from_plus_y_to_minus_y():
    d = c.pixel_directions(8, 16)
    assert d[0, :, 2].min() > 0.9 and d[-1, :, 2].max() < -0.9
    assert d[4, 4, 1] > 0.9 and d[4, 12, 1] < -0.9 and d[4, 8, 0] > 0.9
    np.testing.assert_allclose(np.linalg.norm(d, axis=-1), 1)


def test_solid_angles_sum_to_the_sphere_and_integrate_z_squared():
    for h, w in ((1, 2), (7, 13), (64, 128)):
        assert c.pixel_solid_angles(h, w).sum() * w == pytest.approx(4 * np.pi)
    weight = c.pixel_solid_angles(256, 512)[:, None, None]
    second = (c.pixel_directions(256, 512) ** 2 * weight).sum((0, 1))
    np.testing.assert_allclose(second, 4 * np.pi / 3, rtol=1e-4)


def test_local_direction_is_theta_from_the_normal_phi_from_the_tangent():
    np.testing.assert_allclose(c.local_direction(0, 1.0), [0, 0, 1], atol=1e-15)
    np.testing.assert_allclose(c.local_direction(np.pi / 2, 0), [1, 0, 0], atol=1e-15)
    np.testing.assert_allclose(c.local_direction(np.pi / 2, np.pi / 2), [0, 1, 0], atol=1e-15)


@pytest.mark.parametrize("n", [64, 500, 4096])
def test_fibonacci_directions_share_out_the_sphere(n):
    d = c.fibonacci_sphere(n)
    np.testing.assert_allclose(np.linalg.norm(d, axis=-1), 1)
    np.testing.assert_allclose(d.mean(0), 0, atol=2 / n)
    np.testing.assert_allclose(d.T @ d / n, np.eye(3) / 3, atol=8 / n)
