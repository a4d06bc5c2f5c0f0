# SPDX-License-Identifier: GPL-3.0-or-later
"""Spherical harmonics against SciPy's, closed forms and brute force, over the whole sphere."""

import numpy as np
import pytest
import scipy.special
from scipy.spatial.transform import Rotation

from btfsep_engine import sh
from btfsep_engine.conventions import fibonacci_sphere, pixel_directions

AXES = np.concatenate([np.eye(3), -np.eye(3)])
SEAM = np.array([[-np.cos(t), s * 1e-12, np.sin(t)] for t in (-1.2, 0.0, 1.2) for s in (-1, 0, 1)])
EVERYWHERE = np.concatenate([fibonacci_sphere(700), AXES, SEAM, pixel_directions(6, 12).reshape(-1, 3)])
TURNS = [Rotation.from_euler(axes, angles, degrees=True).as_matrix() for axes, angles in (
    ("x", [37]), ("y", [-62]), ("z", [141]), ("xyz", [20, 50, -80]), ("zyx", [170, 12, 95]),
)]  # fmt: skip


def complex_harmonic(l, m, directions):
    """SciPy's Y_l^m, which includes the Condon-Shortley sign; its name changed in SciPy 1.15."""
    x, y, z = directions.T
    theta, phi = np.arctan2(np.hypot(x, y), z), np.arctan2(y, x)
    if hasattr(scipy.special, "sph_harm_y"):
        return scipy.special.sph_harm_y(l, m, theta, phi)
    return scipy.special.sph_harm(m, l, phi, theta)


@pytest.mark.parametrize("l", range(10))
def test_every_term_to_order_9_agrees_with_scipy(l):
    ours = sh.evaluate(9, EVERYWHERE)
    for m in range(-l, l + 1):
        y = complex_harmonic(l, abs(m), EVERYWHERE)
        theirs = y.real if m == 0 else np.sqrt(2) * (y.real if m > 0 else y.imag)
        np.testing.assert_allclose(ours[:, l * l + l + m], theirs, atol=1e-12)


def test_the_signs_of_orders_0_to_2_in_closed_form():
    x, y, z = EVERYWHERE.T
    one, two = np.sqrt(3 / (4 * np.pi)), np.sqrt(15 / (4 * np.pi))
    closed = [
        np.full_like(x, np.sqrt(1 / (4 * np.pi))),
        *(-one * y, one * z, -one * x),
        *(two * x * y, -two * y * z, two / np.sqrt(12) * (3 * z * z - 1), -two * x * z, two / 2 * (x * x - y * y)),
    ]
    np.testing.assert_allclose(sh.evaluate(2, EVERYWHERE), np.stack(closed, -1), atol=1e-12)
    assert abs(one - 0.4886) < 1e-4


def test_orthonormal_under_exact_quadrature():
    z, weight = np.polynomial.legendre.leggauss(12)
    phi = 2 * np.pi * np.arange(24) / 24
    r = np.sqrt(1 - z * z)
    d = np.stack([np.outer(r, np.cos(phi)), np.outer(r, np.sin(phi)), np.outer(z, np.ones(24))], -1)
    basis = sh.evaluate(9, d)
    gram = np.einsum("t,tpi,tpj->ij", weight * 2 * np.pi / 24, basis, basis)
    np.testing.assert_allclose(gram, np.eye(100), atol=1e-12)


def test_shapes_and_orders():
    assert sh.evaluate(3, np.ones((4, 5, 3)) / np.sqrt(3)).shape == (4, 5, 16)
    assert [sh.order_of(n) for n in (1, 4, 9, 100)] == [0, 1, 2, 9]
    for terms in (0, 2, 8, 99):
        with pytest.raises(ValueError, match="for any order"):
            sh.order_of(terms)


def test_project_undoes_to_map(rng):
    x = rng.normal(size=(25, 3))
    np.testing.assert_allclose(sh.project_map(sh.to_map(x, 128, 256), 4), x, atol=2e-3)


@pytest.mark.parametrize("rotation", TURNS)
def test_rotation_turns_the_function(rng, rotation):
    x = rng.normal(size=(49, 3))
    turned = sh.rotation_matrix(6, rotation) @ x
    # light that came from d comes from R d
    np.testing.assert_allclose(
        sh.evaluate(6, EVERYWHERE @ rotation.T) @ turned, sh.evaluate(6, EVERYWHERE) @ x, atol=1e-9
    )


@pytest.mark.parametrize("rotation", TURNS)
def test_rotation_equals_projecting_a_turned_map(rng, rotation):
    """The map is made by evaluating a function that is no spherical harmonic at turned directions."""

    def light(d):
        lobes = [np.exp(6 * (d @ v - 1)) for v in ([1, 0, 0], [0, 0.6, 0.8], [0, -1, 0])]
        return np.stack(lobes, -1)

    d = pixel_directions(96, 192)
    still, turned = sh.project_map(light(d), 5), sh.project_map(light(d @ rotation), 5)
    np.testing.assert_allclose(sh.rotation_matrix(5, rotation) @ still, turned, atol=3e-4)


def test_rotations_compose_and_are_orthogonal():
    for one in TURNS:
        d = sh.rotation_matrix(7, one)
        np.testing.assert_allclose(d @ d.T, np.eye(64), atol=1e-9)
        for two in TURNS:
            np.testing.assert_allclose(sh.rotation_matrix(7, one @ two), d @ sh.rotation_matrix(7, two), atol=1e-9)


def test_rotation_keeps_orders_apart():
    d = sh.rotation_matrix(3, TURNS[3])
    for l in range(4):
        outside = np.ones(16, bool)
        outside[l * l : (l + 1) ** 2] = False
        assert not d[np.ix_(outside, ~outside)].any()


def test_irradiance_against_brute_force(rng):
    x = rng.normal(size=(64, 3))
    d = fibonacci_sphere(60000)
    light = sh.evaluate(7, d) @ x
    normals = EVERYWHERE[::40]
    brute = np.maximum(normals @ d.T, 0) @ light * (4 * np.pi / len(d))
    np.testing.assert_allclose(sh.irradiance(x, normals), brute, atol=2e-3)


def test_cosine_lobe_in_numbers():
    np.testing.assert_allclose(
        sh.cosine_lobe(6), [np.pi, 2 * np.pi / 3, np.pi / 4, 0, -np.pi / 24, 0, np.pi / 64], atol=1e-12
    )


@pytest.mark.parametrize("order", [0, 1, 9])
def test_a_map_is_the_same_by_rows_and_columns_as_by_directions(order):
    directions = pixel_directions(96, 192)
    x = np.random.default_rng(order).normal(size=(sh.term_count(order), 2))
    for some in (directions, np.roll(directions, 50, 1), directions[10:70, 3:120]):
        by_directions = sh.series(x, some.reshape(-1, 3)).reshape(*some.shape[:2], 2)
        assert np.abs(sh.series(x, some) - by_directions).max() < 1e-12
    bent = directions.copy()
    bent[40, 30] = bent[41, 90]  # no map any more
    assert np.abs(sh.series(x, bent).reshape(-1, 2) - sh.series(x, bent.reshape(-1, 3))).max() < 1e-12
