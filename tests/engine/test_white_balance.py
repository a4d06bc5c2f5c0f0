# SPDX-License-Identifier: GPL-3.0-or-later
"""Free scales of recognised objects beside a known one."""

import numpy as np
import pytest

from btfsep_engine.fit.log_normal import LightSolver
from btfsep_engine.fit.white_balance import LIMITS, free_scales
from tests.engine.half_sphere import half_sphere, off, shown, side_light

TINT = np.array([1.6, 1.0, 0.6])


@pytest.fixture
def pair(rng):
    """A known sphere and one whose dye is another than the library's: basis, photos, how (normals, blocks), light."""
    x = side_light()
    basis, normals, blocks = zip(
        *(half_sphere(rng, pixels=700, albedo=a) for a in ((0.6,) * 3, (0.7, 0.5, 0.3))), strict=True
    )
    photos = [shown(a, x, rng, 0.02) * s for a, s in zip(basis, (1, TINT), strict=True)]
    return list(basis), photos, {"normals": list(normals), "blocks": [blocks[0], blocks[1] + 10**6]}, x


def test_the_scale_of_another_dye_is_found_and_the_known_object_holds_the_light(pair):
    basis, photos, how, x = pair
    scales = free_scales(basis, photos, **how, free=[False, True])
    np.testing.assert_array_equal(scales[0], 1)
    np.testing.assert_allclose(scales[1], TINT, rtol=0.05)

    def light(factor):
        a = np.concatenate([basis[0], basis[1] * factor])
        return LightSolver(a, normals=np.concatenate(how["normals"]), order=2).solve(np.concatenate(photos))

    assert off(light(scales[1]), x) < 0.5 * off(light(1.0), x)


def test_scales_stay_within_their_limits(pair):
    basis, photos, how, _ = pair
    assert (free_scales(basis, [photos[0], 30 * photos[1]], **how, free=[False, True])[1] == LIMITS[1]).all()


def test_an_object_has_to_hold_the_scale(pair):
    basis, photos, how, _ = pair
    with pytest.raises(ValueError, match="hold the scale"):
        free_scales(basis, photos, **how, free=[True, True])
    assert (free_scales(basis, photos, **how, free=[False, False]) == 1).all()
