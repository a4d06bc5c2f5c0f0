# SPDX-License-Identifier: GPL-3.0-or-later
"""When the scene's own light is modelled: never for what cannot light itself, always where it changes the estimate."""

import gc
import json
import weakref
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from btfsep_engine.btf.model import Lambertian
from btfsep_engine.btf.surfaces import Surface
from btfsep_engine.cli import main
from btfsep_engine.job.model import Occluder
from btfsep_engine.light.files import exactly, write_lighting
from btfsep_engine.light.lightings import SHBasis
from btfsep_engine.pipeline.basis import basis_images
from btfsep_engine.pipeline.model import Model
from btfsep_engine.pipeline.problem import make_problem
from btfsep_engine.pipeline.refine import interreflection
from btfsep_engine.pipeline.refine.interreflection import carried_over, even_sky_bound, own_light, with_own_light
from btfsep_engine.pipeline.settings import choose
from btfsep_engine.pipeline.together import fit_together
from btfsep_engine.render import radiosity
from btfsep_engine.render.sampling import spread
from btfsep_engine.render.tracer import Tracer
from btfsep_engine.storage.kept import STORE
from tests.render.scenes import answer, as_mesh, ball, bowl, job_of, looking_down, positive_light, scene_of, with_photo

BRIGHT, GREY, DARK = (Lambertian(f"test/{a}", np.full(3, a)) for a in (0.85, 0.3, 0.02))
STRAIGHT = choose("draft", bounces=1, directions=256)
MODELLED = replace(STRAIGHT, bounces=20)


def photographed(meshes, materials, *, settings=STRAIGHT, occluders=(), count=500):
    """A problem whose photo has all interreflections, by the kernel, with noise; fitted without any."""
    scene = scene_of(job_of(meshes, looking_down(), occluders=occluders))
    points = [scene.points(i, textured=False) for i in range(len(meshes))]
    points = [p.take(spread(p, count)) for p in points]
    full, _ = basis_images(scene, materials, points, SHBasis(2), choose("draft", bounces=20, directions=1024))
    image = np.zeros((96, 96, 3), np.float32)
    noise = np.random.default_rng(1)
    for p, a in zip(points, full, strict=True):
        values = np.einsum("ptc,tc->pc", a, positive_light(2))
        image[p.pixels[:, 0], p.pixels[:, 1]] = values * noise.normal(1, 0.03, values.shape)
    scene.job = with_photo(scene.job, image)
    return make_problem(scene, materials, points, settings)


def decision(problem, settings=STRAIGHT):
    light = fit_together([problem], settings)
    return own_light(Model(settings, {"mean": [problem]}), light, bounces=20), light.fit


@pytest.mark.parametrize("settings", [STRAIGHT, replace(STRAIGHT, estimator="least-squares", order=2)])
def test_a_bright_bowl_is_modelled_and_a_dark_one_is_not(settings):
    bright, _ = decision(photographed([bowl()], [BRIGHT], settings=settings), settings)
    assert bright.modelled and bright.share > 0.1 and bright.change is None
    assert bright.why.startswith("interreflections are modelled")
    dark, _ = decision(photographed([bowl()], [DARK], settings=settings), settings)
    assert not dark.modelled and 0.001 < dark.share < interreflection.WORTH and 0 < dark.change < interreflection.MOVES
    assert dark.why.startswith("interreflections are left out")


def test_the_share_is_what_modelling_adds():
    problem = photographed([bowl()], [GREY])
    found, fit = decision(problem)
    brighter = with_own_light(problem, MODELLED)
    added = brighter.predicted(fit.shown) - problem.predicted(fit.shown)
    assert found.share == pytest.approx(np.linalg.norm(added) / np.linalg.norm(problem.radiance()), rel=0.05)


def test_that_little_is_known_of_the_light_does_not_make_it_worthless():
    """Of light from below a table a photo shows nothing: what is stated is wide, whatever the table sends."""
    problem = photographed([bowl()], [GREY])
    light = fit_together([problem], STRAIGHT)
    stated = light.fit.state()
    vague = replace(light.fit, state=lambda: replace(stated, stddev=100 * stated.stddev))
    assert own_light(Model(STRAIGHT, {"mean": [problem]}), replace(light, fit=vague), bounces=20).modelled


def test_little_that_moves_the_estimate_is_modelled_all_the_same():
    problem = photographed([bowl()], [DARK])
    light = fit_together([problem], STRAIGHT)
    stated = light.fit.state()
    sure = replace(light.fit, state=lambda: replace(stated, stddev=stated.stddev / 100))
    found = own_light(Model(STRAIGHT, {"mean": [problem]}), replace(light, fit=sure), bounces=20)
    assert found.modelled and found.share < interreflection.WORTH and found.change > interreflection.MOVES


def test_what_it_moves_is_what_a_fit_of_the_rest_says(monkeypatch):
    """By the light's own slopes it is known at a part of the time."""
    problem = photographed([bowl()], [DARK])
    light = fit_together([problem], STRAIGHT)
    rests, again = [], light.solver.again
    monkeypatch.setattr(light.solver, "again", lambda rest, *fits: rests.append(rest) or again(rest, *fits))
    found = own_light(Model(STRAIGHT, {"mean": [problem]}), light, bounces=20)
    (rest,) = rests
    anew = light.solver.solve(rest, weights=problem.weights, start=light.fit)
    moved = np.abs(anew.coefficients - light.fit.coefficients) / light.fit.stddev
    assert found.change == pytest.approx(moved.max(), rel=0.1)


def test_modelling_it_takes_the_error_away():
    problem = photographed([bowl()], [BRIGHT])
    fit, after = (fit_together([p], STRAIGHT).fit for p in (problem, with_own_light(problem, MODELLED)))
    truth = positive_light(2)
    left = [np.linalg.norm(f.coefficients[:9] - truth) for f in (fit, after)]
    assert left[1] < 0.5 * left[0]


def test_a_ball_needs_no_light_to_be_decided(monkeypatch):
    problem = photographed([ball()], [BRIGHT])
    monkeypatch.setattr(interreflection, "carried_over", None)  # would be called if the scene's light were looked at
    found, _ = decision(problem)
    assert not found.modelled and found.share is None and found.bound < interreflection.NEGLIGIBLE


def test_a_bright_neighbour_counts_and_a_black_one_does_not():
    wall = trimesh.creation.box([0.1, 4, 4]).apply_translation([1.3, 0, 0])
    beside = photographed([ball(), as_mesh(wall, flat=True)], [BRIGHT, BRIGHT])
    assert decision(beside)[0].modelled
    black = Occluder(as_mesh(wall, flat=True), Surface((0.0,) * 3, specular=0.0))
    occluded = photographed([ball()], [BRIGHT], occluders=[black])
    found, _ = decision(occluded)
    assert found.bound > interreflection.NEGLIGIBLE  # it cannot be told from the rays alone
    assert not found.modelled and found.share < 0.01


def test_the_bound_holds_under_an_even_sky():
    problem = photographed([bowl()], [BRIGHT])
    sky = np.zeros((1, 3))
    sky[0] = 1
    straight, _ = basis_images(problem.scene, [BRIGHT], problem.points, SHBasis(0), STRAIGHT)
    full, _ = basis_images(problem.scene, [BRIGHT], problem.points, SHBasis(0), replace(STRAIGHT, bounces=40))
    added = (full[0].sum() - straight[0].sum()) / straight[0].sum()
    bound = even_sky_bound(problem.scene, [BRIGHT], problem.points)
    assert 0.1 < added <= 1.1 * bound
    assert even_sky_bound(problem.scene, [DARK], problem.points) < 0.06 * bound / 0.85 * 1.5


def test_smooth_values_are_carried_over():
    problem = photographed([bowl()], [BRIGHT], count=2000)
    points = problem.points[0]
    value = points.normal[:, :1] + points.position[:, 1:2] + np.zeros(3)
    probe = spread(points, 400)
    carried = carried_over(points.take(probe), value[probe], points)
    assert np.abs(carried - value).mean() < 0.05 * np.ptp(value)
    one = carried_over(points.take(probe[:1]), value[probe[:1]], points)
    assert np.allclose(one, value[probe[0]])


def test_the_command_decides_by_itself_and_says_so(sphere_job_folder, capsys):
    folder, _ = sphere_job_folder
    command = ["estimate", str(folder), "--material", "reference/white-diffuse", "--order", "2", "--no-report"]
    result = answer(capsys, *command, "--pixels", "500")
    assert result["choice"]["interreflections"].startswith("interreflections are left out: they are at most 0.0 %")
    assert result["transport"]["bounces"] == result["settings"]["bounces"] == 1
    result = answer(capsys, *command, "--pixels", "500", "--bounces", "3")
    assert "interreflections" not in result["choice"] and result["transport"]["bounces"] == 3
    assert main([*command, "--bounces", "0"]) != 0


def test_estimates_of_a_scene_make_one_network_by_its_seed(sphere_job_folder, monkeypatch, capsys):
    """The trial, the model, the report and the next estimate share the surface samples; what is forgotten is gone."""
    folder, truth = sphere_job_folder
    shape = trimesh.load(folder / "sphere.ply")
    shape.update_faces(shape.triangles_center[:, 2] < 0.1)
    shape.export(folder / "sphere.ply")
    write_lighting(folder / "light.json", exactly(truth))
    common = [str(folder), "--material", "reference/white-diffuse", "--preset", "draft", "--seed", "5", "--json"]
    photo = ["--lighting", str(folder / "light.json"), "--out", str(folder / "photo.exr")]
    assert main(["relight", *common, *photo]) == 0
    STORE.forget()
    gc.collect()
    before = sum(isinstance(o, Tracer) for o in gc.get_objects())
    made, networks, real = [], [], radiosity.Network

    def counted(tracer, **how):
        network = real(tracer, **how)
        made.append(how)
        networks.append(weakref.ref(network))
        return network

    monkeypatch.setattr(radiosity, "Network", counted)
    capsys.readouterr()
    assert main(["estimate", *common]) == 0 and main(["estimate", *common]) == 0
    result = json.loads(capsys.readouterr().out.splitlines()[-1])["result"]
    assert result["choice"]["interreflections"].startswith("interreflections are modelled")
    assert made == [{"samples": result["settings"]["surface_samples"], "seed": 5}]
    STORE.forget()
    gc.collect()
    assert networks[0]() is None and sum(isinstance(o, Tracer) for o in gc.get_objects()) == before


def test_the_seed_places_the_surface_samples():
    tracer = Tracer([bowl()])
    same, again, other = (radiosity.Network(tracer, samples=50, seed=n)._tree.data for n in (1, 1, 2))
    assert np.array_equal(same, again) and not np.isclose(same, other).all(1).any()
