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
from btfsep_engine.render import radiosity
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


@pytest.mark.parametrize("coloured", [False, True])
def test_reflections_that_add_next_to_nothing_are_not_followed(scene, coloured, monkeypatch):
    """Radiosity is that of endless reflections, B = a (E + G B), to a thousandth, and found before so many are made."""
    asked = []
    own = radiosity._little
    monkeypatch.setattr(radiosity, "_little", lambda *parts: asked.append(own(*parts)) or asked[-1])
    albedo = np.array([0.7, 0.4, 0.7]) if coloured else np.full(3, 0.7)
    found = radiosity.Indirect(scene.tracer, [albedo], SHBasis(2), bounces=64, samples=300)
    net = radiosity.network(scene.tracer, samples=300, seed=0)
    straight = net.sky @ SHBasis(2).cell_averages(net.directions)[..., 0]
    assert len(found._radiosity) == (3 if coloured else 1)
    for light, a in zip(found._radiosity, albedo, strict=False):
        endless = np.linalg.solve(np.eye(len(straight)) - a * net.gather.toarray(), a * straight)
        assert np.linalg.norm(light - endless) < 3e-3 * np.linalg.norm(endless)
        assert np.linalg.norm(light - a * straight) > 0.1 * np.linalg.norm(endless)
    assert asked.count(True) == len(found._radiosity)
    assert len(asked) < 20 * len(found._radiosity)


def test_surfaces_of_several_colours_send_light_on_as_one_of_their_own(scene, monkeypatch):
    """What is alike all over goes by white surfaces' light, which is kept; what is not, step by step."""
    by = {"bounces": 5, "samples": 300}
    alike = radiosity.Indirect(scene.tracer, [np.full(3, 0.5)], SHBasis(2), **by)._radiosity[0]
    net = radiosity.network(scene.tracer, samples=300, seed=0)
    several = radiosity.Indirect(scene.tracer, [np.full(3, 0.5)], SHBasis(2), **by)
    colours = np.full((len(net.mesh), 3), 0.5, np.float32)
    colours[0] = 0.5001
    monkeypatch.setattr(several._network, "albedos", lambda of_meshes: colours, raising=False)
    np.testing.assert_allclose(several._radiosity[0], alike, rtol=2e-3, atol=1e-4)
