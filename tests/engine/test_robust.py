# SPDX-License-Identifier: GPL-3.0-or-later
"""Pixels that the light does not explain, of known place."""

import numpy as np

from btfsep_engine.fit.log_normal import LightSolver
from btfsep_engine.fit.robust import outliers, tukey_weights
from btfsep_engine.pipeline.real_photo import STIFF
from tests.engine.half_sphere import half_sphere, off, shown, side_light


def test_things_in_front_are_found_and_the_light_without_them_is_right(rng):
    basis, normals, _ = half_sphere(rng)
    x = side_light()
    b = shown(basis, x, rng, 0.02)
    covered = rng.random(len(b)) < 0.15
    b[covered] = 4 * b.mean()
    found = outliers(LightSolver(basis, normals=normals, order=2, coarsening=STIFF), b)
    assert found[covered].mean() > 0.95 and found[~covered].mean() < 0.03
    fooled = LightSolver(basis, normals=normals, order=2).solve(b)
    without = LightSolver(basis[~found], normals=normals[~found], order=2).solve(b[~found])
    assert off(without, x) < 0.35 * off(fooled, x)


def test_noise_alone_has_next_to_no_outliers(rng):
    basis, normals, _ = half_sphere(rng, pixels=800)
    b = shown(basis, side_light(), rng, 0.05)
    assert outliers(LightSolver(basis, normals=normals, order=2, coarsening=STIFF), b).mean() < 0.03


def test_weights_are_those_of_the_published_function():
    sizes = np.concatenate([np.ones(101), [2.0, 4.0, 20.0]])  # their median is 1, so the spread is 1.4826
    u = sizes / 1.4826
    np.testing.assert_allclose(tukey_weights(sizes), np.where(u < 4.685, (1 - (u / 4.685) ** 2) ** 2, 0))
    assert tukey_weights(sizes)[-1] == 0
    assert (tukey_weights(np.zeros(5)) == 1).all()


def test_a_pixel_of_no_weight_is_no_outlier_and_makes_none(rng):
    """What is clipped or hidden says nothing: neither does it stand apart, nor does it spoil what does."""
    basis, normals, _ = half_sphere(rng, pixels=800)
    b = shown(basis, side_light(), rng, 0.02)
    b[:80] *= 5
    weights = np.ones_like(b)
    weights[:80] = 0
    found = outliers(LightSolver(basis, normals=normals, order=2, coarsening=STIFF), b, weights=weights)
    assert not found[:80].any() and found[80:].mean() < 0.03
