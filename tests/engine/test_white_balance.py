# SPDX-License-Identifier: GPL-3.0-or-later
"""Free scales of recognised objects beside a known one."""

import numpy as np
import pytest

from btfsep_engine.fit.map_estimate import solve_map
from btfsep_engine.fit.white_balance import LIMITS, free_scales
from btfsep_engine.light.natural import natural_prior
from tests.engine.half_sphere import ORDER, half_sphere, off, side_light

TINT = np.array([1.6, 1.0, 0.6])


@pytest.fixture
def pair(rng):
    """A known sphere and one whose dye is another than the library's: basis, photos, blocks, prior, true light."""
    prior = natural_prior(ORDER)
    x = side_light()
    basis, blocks = zip(*(half_sphere(rng, pixels=700, albedo=a) for a in ((0.6,) * 3, (0.7, 0.5, 0.3))), strict=True)
    photos = [np.einsum("pmc,mc->pc", a, x) * s for a, s in zip(basis, (1, TINT), strict=True)]
    photos = [b * (1 + 0.02 * rng.normal(size=b.shape)) for b in photos]
    return list(basis), photos, [blocks[0], blocks[1] + 10**6], prior, x


def test_the_scale_of_another_dye_is_found_and_the_known_object_holds_the_light(pair):
    basis, photos, blocks, prior, x = pair
    scales = free_scales(basis, photos, blocks=blocks, prior=prior, order=ORDER, free=[False, True])
    np.testing.assert_array_equal(scales[0], 1)
    np.testing.assert_allclose(scales[1], TINT, rtol=0.03)
    stacked = np.concatenate(blocks)

    def light(factor):
        a = np.concatenate([basis[0], basis[1] * factor])
        return solve_map(a, np.concatenate(photos), blocks=stacked, prior=prior, order=ORDER)

    assert off(light(scales[1]), x) < 0.35 * off(light(1.0), x)


def test_scales_stay_within_their_limits(pair):
    basis, photos, blocks, prior, _ = pair
    scales = free_scales(
        basis, [photos[0], 1e4 * photos[1]], blocks=blocks, prior=prior, order=ORDER, free=[False, True]
    )
    assert (scales[1] == LIMITS[1]).all()


def test_an_object_has_to_hold_the_scale(pair):
    basis, photos, blocks, prior, _ = pair
    with pytest.raises(ValueError, match="hold the scale"):
        free_scales(basis, photos, blocks=blocks, prior=prior, order=ORDER, free=[True, True])
    assert (free_scales(basis, photos, blocks=blocks, prior=prior, order=ORDER, free=[False, False]) == 1).all()
