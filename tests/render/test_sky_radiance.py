# SPDX-License-Identifier: GPL-3.0-or-later
"""The fit's own positive radiance: integrated over all directions, with the suns, it is the fit's coefficients."""

import numpy as np
import pytest

from btfsep_engine.fit.log_normal import LightSolver
from btfsep_engine.light.files import Lighting
from btfsep_engine.light.sun import Sun
from btfsep_engine.pipeline.light_account import sky_radiance
from tests.engine.half_sphere import FILL, SUN, even, half_sphere, lamp, project, shown, side_light

LIGHTS = {
    "sky": side_light(),
    "lamps": even((0.2,) * 3) + lamp(SUN, [3.0, 3.0, 3.0]) + lamp(FILL, [1.5] * 3),
}


@pytest.mark.parametrize("light", list(LIGHTS))
@pytest.mark.parametrize("split", [0, 1])
def test_it_integrates_to_the_fits_coefficients(light, split):
    rng = np.random.default_rng(2)
    basis, normals, _ = half_sphere(rng, pixels=800, albedo=(0.5,) * 3)
    fit = LightSolver(basis, normals=normals, order=2).solve(shown(basis, LIGHTS[light], rng, 0.02))
    assert len(fit.lamps) == (2 if light == "lamps" else 0)
    suns = tuple(Sun(each.direction, each.irradiance, each.stddev) for each in fit.lamps[:split])
    lighting = Lighting(2, fit.coefficients, fit.stddev, fit.determined, 0.0, suns=suns)
    radiance = sky_radiance(fit, lighting)
    found = project(radiance)
    for sun in suns:
        found += lamp(sun.direction, sun.irradiance)
    # lamps that are no suns are discs of 15 degrees: with K = 30, degree 1 is 1 - 1/K of a point's, degree 2 1 - 3/K
    kept = np.zeros((100, 3)) + sum(lamp(each.direction, each.irradiance) for each in fit.lamps[split:])
    broad = 1 - np.repeat([0, 1 / 30, 3 / 30 - 3 / 30**2], [1, 3, 5])
    stated = fit.all_coefficients[:9] - (1 - broad)[:, None] * kept[:9]
    np.testing.assert_allclose(found[:9], stated, atol=2e-3 * np.abs(stated).max())
    assert (radiance(normals) >= 0).all()
