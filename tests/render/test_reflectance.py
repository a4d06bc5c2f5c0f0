# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether an object is its material or nearly so, by evidence: photos made with each."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh

from btfsep_engine.btf.departures import departures
from btfsep_engine.btf.model import Lambertian
from btfsep_engine.btf.surfaces import Surface
from btfsep_engine.light.lightings import SHLighting
from btfsep_engine.pipeline.model import Model
from btfsep_engine.pipeline.problem import make_problem
from btfsep_engine.pipeline.refine import reflectance
from btfsep_engine.pipeline.refine.reflectance import is_simpler, nearer_materials
from btfsep_engine.pipeline.settings import choose
from btfsep_engine.pipeline.together import fit_together
from btfsep_engine.render.homogeneous import homogeneous
from tests.engine.half_sphere import even, lamp
from tests.render.scenes import (
    as_mesh,
    job_of,
    looking_down,
    off_as_seen,
    picture,
    positive_light,
    scene_of,
    with_photo,
)

GREY = Lambertian("test/grey", np.full(3, 0.5))
SETTINGS = choose("draft", bounces=1, directions=256, appearance="mean", order=2)
DIRECTION = np.array([0.6, -0.2, 0.77]) / np.linalg.norm([0.6, -0.2, 0.77])
WINDOW = (
    even((0.3,) * 3)
    + lamp(DIRECTION, (3.0, 3.0, 3.0)) * np.repeat(np.exp(-0.02 * np.arange(10) ** 2), 2 * np.arange(10) + 1)[:, None]
)


def photographed(material, light, noise=0.01):
    """The problems with the grey material of a ball's photo that ``material`` made, and their SolvedLight."""
    scene = scene_of(job_of([as_mesh(trimesh.creation.icosphere(4, radius=0.45))], looking_down()))
    points = scene.points(0, textured=False)
    values = scene.radiance(points, material, SHLighting(light), directions=512)[:, 0]
    scene.job = with_photo(scene.job, picture(points, values, noise=noise))
    problems = [make_problem(scene, [GREY], [points.take(np.arange(0, len(points), 3))], SETTINGS)]
    return problems, fit_together(problems, SETTINGS)


def found_for(material, light, noise=0.01, **changes):
    """The fits with the grey material and with what is nearer, of a ball's photo that ``material`` made; and why."""
    problems, light = photographed(material, light, noise)
    _, nearer, words = nearer_materials(Model(replace(SETTINGS, **changes), {"mean": problems}), light)
    return light.fit, nearer.fit, words["reflectance"]


def test_a_rough_ball_is_found_to_be_rough_and_the_light_is_nearer():
    rough = departures(GREY)[1]
    fit, near, why = found_for(rough.material, WINDOW)
    assert "roughness" in why and "'object 0'" in why
    assert near.evidence > fit.evidence + 3
    assert off_as_seen(near.coefficients, WINDOW[:9]) < off_as_seen(fit.coefficients, WINDOW[:9])


def test_nothing_near_is_tried_where_it_is_not_asked_for():
    fit, near, why = found_for(departures(GREY)[1].material, WINDOW, departures="never")
    assert near is fit and "--departures never" in why


def test_a_ball_as_lambert_has_it_is_left_as_it_is_under_a_lamp():
    fit, near, _ = found_for(GREY, WINDOW)
    assert off_as_seen(near.coefficients, WINDOW[:9]) < off_as_seen(fit.coefficients, WINDOW[:9]) + 0.02


def test_a_ball_as_lambert_has_it_errs_no_more_under_nearly_even_light():
    x = positive_light(2)
    fit, near, _ = found_for(GREY, x)
    assert off_as_seen(near.coefficients, x) < off_as_seen(fit.coefficients, x) + 0.02


def test_what_is_improbable_beforehand_needs_more_evidence(monkeypatch):
    rough = departures(GREY)[1]
    problems, light = photographed(rough.material, WINDOW)
    model = Model(SETTINGS, {"mean": problems})
    monkeypatch.setattr(reflectance, "HOPEFUL", -np.inf)  # all pixels are asked
    monkeypatch.setattr(reflectance, "departures", lambda _: [rough])
    _, found, _ = nearer_materials(model, light)
    gained = found.fit.evidence - light.fit.evidence
    monkeypatch.setattr(reflectance, "departures", lambda _: [replace(rough, log_prior=-gained)])
    same, as_before, _ = nearer_materials(model, light)
    assert gained > reflectance.CLEARLY and same is model and as_before is light


def test_only_a_light_of_lamps_is_simpler_by_a_plain_field_or_far_fewer_unknowns():
    def fit(unknowns: float, *, lamps=(), order=2):
        model = SimpleNamespace(lamps=lamps, field=SimpleNamespace(order=order))
        solution = SimpleNamespace(model=model)
        return SimpleNamespace(effective_degrees_of_freedom=unknowns, election=SimpleNamespace(solution=solution))

    before = fit(10.0)
    assert is_simpler(fit(10.0, lamps=("lamp",), order=0), before) and is_simpler(fit(5.0, lamps=("lamp",)), before)
    assert not is_simpler(fit(10.0, lamps=("lamp",)), before)
    assert not is_simpler(fit(5.0), before) and not is_simpler(fit(5.0, order=0), before)


@pytest.mark.parametrize("dye", [None, (0.5, -0.2)])
def test_a_surface_whose_colour_was_taken_from_the_photo_is_not_doubted(dye, monkeypatch):
    """It was found by evidence already, its roughness with it."""
    (problem,), light = photographed(GREY, WINDOW)
    plastic, asked = replace(homogeneous(Surface((0.5,) * 3), "surface/plastic"), dye=dye), []
    monkeypatch.setattr(reflectance, "SPEAKS", -np.inf)
    monkeypatch.setattr(reflectance, "departures", lambda material: asked.append(material) or [])
    nearer_materials(Model(SETTINGS, {"mean": [replace(problem, materials=[plastic])]}), light)
    assert asked == ([plastic] if dye is None else [])
