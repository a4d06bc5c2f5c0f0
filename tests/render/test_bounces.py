# SPDX-License-Identifier: GPL-3.0-or-later
"""As many reflections as are asked for, and no more: each multiplies the light once more by the albedo."""

from dataclasses import replace

import numpy as np
import pytest

from btfsep_engine.btf.model import Lambertian
from btfsep_engine.light.lightings import SHBasis
from btfsep_engine.pipeline.basis import basis_images
from btfsep_engine.pipeline.problem import make_problem
from btfsep_engine.pipeline.refine.interreflection import with_own_light
from btfsep_engine.pipeline.settings import choose
from btfsep_engine.render.sampling import spread
from tests.render.scenes import bowl, job_of, looking_down, scene_of

SETTINGS = choose("draft", directions=128, estimator="least-squares", order=0, samples=64)


@pytest.fixture(scope="module")
def scene():
    return scene_of(job_of([bowl()], looking_down()))


def brightness(scene, how, albedo, bounces) -> float:
    """Mean radiance of the bowl's inside under an even sky."""
    points = scene.points(0, textured=False)
    points, materials = [points.take(spread(points, 200))], [Lambertian("test/grey", np.full(3, albedo))]
    settings = replace(SETTINGS, bounces=bounces, transport="reference" if how == "reference" else "kernel")
    if how == "added later":
        straight = make_problem(scene, materials, points, replace(settings, bounces=1))
        return float(with_own_light(straight, settings).basis[0].mean(dtype=np.float64))
    return float(basis_images(scene, materials, points, SHBasis(0), settings)[0][0].mean(dtype=np.float64))


@pytest.mark.parametrize(
    ("how", "bounces"),
    [*((how, n) for how in ("kernel", "reference") for n in (1, 2, 3)), ("added later", 2), ("added later", 3)],
)
def test_radiance_is_a_polynomial_of_the_albedo_of_the_degree_that_was_asked_for(scene, how, bounces):
    """L / a = G_1 + a G_2 + ... + a^(n - 1) G_n after n reflections: its differences of order n vanish."""
    albedos = 0.2 * np.arange(1, bounces + 2)
    values = np.array([brightness(scene, how, a, bounces) / a for a in albedos])
    assert abs(np.diff(values, bounces)[0]) < 2e-4 * values.mean()
    highest = np.diff(values, bounces - 1)
    assert (highest > 5e-3 * values.mean()).all()  # and the last reflection is there
