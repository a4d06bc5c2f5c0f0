# SPDX-License-Identifier: GPL-3.0-or-later
"""The procedural maps: the same at every resolution, another with another variation; and the noise under them.

What holds for each of the 42 is in test_btf_procedural_all.py.
"""

import numpy as np
import pytest

from btfsep_engine.btf import procedural
from btfsep_engine.btf.procedural import noise


@pytest.mark.parametrize("name", ["felt/grey-melange", "wood/oak-boards"])
def test_resolution_changes_nothing_but_detail(name):
    coarse, fine = procedural.maps(name, 128), procedural.maps(name, 1024)
    averaged = fine.base_colour.reshape(128, 8, 128, 8, 3).mean((1, 3))
    assert np.corrcoef(averaged.ravel(), coarse.base_colour.ravel())[0, 1] > 0.97
    averaged = fine.height_mm.reshape(128, 8, 128, 8).mean((1, 3))
    assert np.corrcoef(averaged.ravel(), coarse.height_mm.ravel())[0, 1] > 0.97


@pytest.mark.parametrize("name", ["stone/granite-grey", "fabric/denim-twill", "wallpaper/woodchip-white"])
def test_variations_are_other_instances_of_the_same_material(name):
    first, again, other = (procedural.maps(name, 64, variation=v) for v in (0, 0, 7))
    np.testing.assert_array_equal(first.base_colour, again.base_colour)
    assert np.abs(first.height_mm - other.height_mm).mean() > 0.05 * first.height_mm.std()
    means = [m.base_colour.mean((0, 1)) for m in (first, other)]
    ratio = means[1] / means[0]
    assert 0.005 < np.abs(ratio - 1).max() < 0.35
    assert np.std(first.height_mm) == pytest.approx(np.std(other.height_mm), rel=0.4)


def test_noise_is_periodic_and_bounded():
    u, v = np.random.default_rng(1).uniform(0, 1, (2, 500))
    a, b = (noise.fbm(u + s, v - s, 3, 5, 4, np.random.default_rng(0)) for s in (0, 1))
    np.testing.assert_allclose(a, b, atol=1e-9)
    assert np.abs(a).max() < 1.2 and a.std() > 0.1


def test_nearest_is_that_of_the_torus():
    rng = np.random.default_rng(2)
    points, (u, v) = rng.uniform(0, 1, (20, 2)), rng.uniform(0, 1, (2, 50))
    distance, index, offset = noise.nearest(u, v, points)
    away = np.stack([u, v], -1)[:, None] - points[None]
    away -= np.round(away)
    expected = np.sort(np.linalg.norm(away, axis=-1), 1)[:, :2]
    np.testing.assert_allclose(distance, expected, atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(offset, axis=-1), expected[:, 0], atol=1e-9)
    np.testing.assert_array_equal(index[:, 0], np.linalg.norm(away, axis=-1).argmin(1))
