# SPDX-License-Identifier: GPL-3.0-or-later
"""What stands beside the objects reflects: against the path tracer and known solutions, and where it is unknown."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh

from btfsep_engine.btf.library import open_library
from btfsep_engine.btf.model import Lambertian
from btfsep_engine.btf.surfaces import Surface
from btfsep_engine.fit.stated import restated
from btfsep_engine.job.model import Occluder, TriangleMesh
from btfsep_engine.light.lightings import EnvironmentMaps, SHBasis
from btfsep_engine.pipeline.basis import basis_images
from btfsep_engine.pipeline.estimation import estimate
from btfsep_engine.pipeline.model import solve_model
from btfsep_engine.pipeline.refine import limb
from btfsep_engine.pipeline.refine.interreflection import contradicted, even_sky_bound
from btfsep_engine.pipeline.refine.surroundings import Greys, believed, with_other_greys
from btfsep_engine.pipeline.settings import choose
from btfsep_engine.render.reference import Reference
from btfsep_engine.render.sampling import spread
from tests.render.scenes import (
    as_mesh,
    ball,
    job_of,
    looking_down,
    off_as_reaching,
    picture,
    positive_light,
    scene_of,
    with_photo,
)

WHITE = Lambertian("test/white", np.full(3, 0.8))


def matte(*colour) -> Surface:
    return Surface(colour if len(colour) == 3 else colour * 3, roughness=1.0, specular=0.0)


def table(half, surface, *, thickness=0.02) -> Occluder:
    """A square plate just beside the unit ball, its face to +x; the camera looks down -z along it."""
    box = trimesh.creation.box([thickness, 2 * half, 2 * half]).apply_translation([-1.05 - thickness / 2, 0, 0])
    return Occluder(as_mesh(box, flat=True), surface)


def prepared(*occluders, mesh=None, count=150):
    scene = scene_of(job_of([mesh or ball()], looking_down(), occluders=occluders))
    points = scene.points(0, textured=False)
    return scene, points.take(spread(points, count))


def both(scene, points, lights, *, bounces=8):
    """The basis images by the kernel and by the reference, and what the kernel's second and later bounces add."""
    settings = choose("draft", bounces=bounces, directions=1024)
    found = basis_images(scene, [WHITE], [points], lights, settings)[0][0].astype(np.float64)
    straight = basis_images(scene, [WHITE], [points], lights, replace(settings, bounces=1))[0][0]
    reference = Reference(scene.job, scene.tracer, [WHITE], bounces=bounces, textured=False)
    right = reference.radiance(points.pixels, lights, samples=512, jitter=False).radiance
    return found, right, found - straight


@pytest.mark.parametrize(("half", "exact"), [(2.0, 0.04), (60.0, 0.08)])
def test_a_white_ball_above_a_table_is_that_of_the_path_tracer(half, exact):
    """A thin plate, small and very large: its inside is not seen, and the ball's shadow on it is resolved.

    Of a large scene the kernel's rays start a third of the gap off the plate.
    """
    scene, points = prepared(table(half, matte(0.8, 0.4, 0.2)))
    found, right, added = both(scene, points, SHBasis(1))
    share = np.abs(added).mean(0)
    assert share[0, 0] > 0.15 * found[:, 0, 0].mean() and share[0, 0] > 1.8 * share[0, 1] > 3.2 * share[0, 2]
    assert np.abs((found - right).mean(0)).max() < exact * share[0, 0]


def test_the_tables_part_in_the_balls_shadow_is_dark():
    """A lamp opposite the plate: most of what the ball's back could get from it lies in the ball's own shadow."""
    y, x = np.mgrid[:32, :64]
    lamp = np.exp(-(((x - 31.5) / 3) ** 2) - ((y - 15.5) / 3) ** 2)[None, ..., None] * np.ones(3)
    lights = EnvironmentMaps(lamp, ("lamp",))
    assert lights.radiance(np.array([[1.0, 0, 0]])).mean() > 0.9  # it stands over the plate
    scene, points = prepared(table(60.0, matte(0.8)))
    found, right, added = both(scene, points, lights)
    near = points.normal[:, 0] < -0.5
    assert added[near].mean() > 0.01 and np.abs((found - right)[near].mean()) < 0.06 * added[near].mean()


def test_a_small_ball_in_a_white_bowl_has_the_known_brightness():
    """Half a sphere under an even sky of 1 sends a / (2 - a) from everywhere; the ball's normals see both by halves."""
    shape = trimesh.creation.icosphere(5, 2.0)
    shape.update_faces(shape.triangles_center[:, 2] < 0)
    shape.remove_unreferenced_vertices()
    bowl = Occluder(as_mesh(shape), matte(0.8))
    scene, points = prepared(bowl, mesh=as_mesh(trimesh.creation.icosphere(4, 0.2)))
    settings = choose("draft", bounces=30, directions=2048)
    found = basis_images(scene, [WHITE], [points], SHBasis(0), settings)[0][0][:, 0, 0] * np.sqrt(4 * np.pi)
    up = (1 + points.normal[:, 2]) / 2
    np.testing.assert_allclose(found, 0.8 * (up + (1 - up) * 0.8 / (2 - 0.8)), rtol=0.03)


def test_an_image_on_a_table_is_as_two_tables_of_its_colours():
    """One half white and one black, by UV: u along y, v along z; row 0 is the largest v."""
    image = np.zeros((8, 8, 3), np.float32)
    image[:4, :, 0] = 0.9  # the upper half, red alone

    def quad(low, high):
        corners = np.array([[-1.05, -3, low], [-1.05, 3, low], [-1.05, 3, high], [-1.05, -3, high]])
        faces = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
        uv = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32)[faces]
        return TriangleMesh(corners, faces, np.tile([1, 0, 0], (2, 3, 1)).astype(np.float32), uv)

    lights, settings = SHBasis(0), choose("draft", bounces=4, directions=512)

    def of(*occluders):
        scene, points = prepared(*occluders)
        return basis_images(scene, [WHITE], [points], lights, settings)[0][0][:, 0]

    one = of(Occluder(quad(-3, 3), replace(matte(0.0), image=image)))
    two = of(Occluder(quad(-3, 0), matte(0.0)), Occluder(quad(0, 3), matte(0.9, 0.0, 0.0)))
    added = two[:, 0] - two[:, 2]
    assert added.mean() > 0.02 * two[:, 2].mean() and np.array_equal(one[:, 1], one[:, 2])
    assert np.abs(one - two).mean() < 0.05 * added.mean()


def test_the_bound_knows_what_stands_beside():
    dark = Lambertian("test/dark", np.full(3, 0.05))
    bounds = []
    for occluder in (table(4.0, matte(0.0)), table(4.0, matte(0.8)), table(4.0, None)):
        scene, points = prepared(occluder)
        bounds.append(even_sky_bound(scene, [dark], [points]))
    assert bounds[0] < 0.03 < 0.15 < bounds[1]
    scene.grey = 0.8
    assert even_sky_bound(scene, [dark], [points]) == pytest.approx(bounds[1], rel=0.01) and bounds[2] < bounds[1]


def estimated(occluder, truth):
    """The estimate of a noisy photograph of a ball on a table that reflects 0.6; the job says ``occluder``."""
    settings = choose("draft", pixels=700)
    scene, _ = prepared(table(4.0, matte(0.6)))
    points = scene.points(0, textured=False)
    full, _ = basis_images(scene, [WHITE], [points], SHBasis(2), replace(settings, bounces=8, directions=1024))
    values = np.einsum("ptc,tc->pc", full[0], truth)
    photographed = with_photo(scene.job, picture(points, values, noise=0.02, seed=1))
    job = replace(photographed, occluders=(occluder,))
    library = open_library(None)
    return estimate(scene_of(job), library, settings, material="reference/white-diffuse")


def test_a_table_that_is_not_known_is_found_grey_and_a_black_one_explains_nothing(monkeypatch):
    monkeypatch.setattr(limb, "SPEAKS", np.inf)  # what a black table does not throw back would pass for a brighter limb
    truth = positive_light(2)
    known, unknown, black = (estimated(table(4.0, s), truth) for s in (matte(0.6), None, matte(0.0)))
    assert off_as_reaching(known.fit, truth) < 0.05
    beside = solve_model(black.model, beside=known.fit)[1].fit
    assert beside.evidence < min(known.fit.evidence, unknown.fit.evidence) - 50
    assert off_as_reaching(beside, truth) > 0.1
    assert known.choice["surroundings"] == "the surface of 1 of 1 occluders is given"
    assert known.choice["interreflections"].startswith("interreflections are modelled")
    greys = unknown.scene.greys
    assert abs(greys.albedos[0] - 0.6) < 0.2 and greys.shares.sum() == pytest.approx(1)
    assert f"by evidence a grey of {greys.albedos[0]:.2f}" in unknown.choice["surroundings"]
    low, high = unknown.fit.interval[:, :9]
    assert ((low <= truth) & (truth <= high)).mean() > 0.85  # it is not known exactly, and that is stated


def test_a_photo_does_not_argue_a_table_that_is_there_away():
    """Evidence against light between surfaces may leave out what an object sends itself, but makes no table black."""
    worse, better = SimpleNamespace(evidence=0.0, residual=0.1), SimpleNamespace(evidence=100.0, residual=0.05)
    with_table, alone = (prepared(*o)[0] for o in ([table(4.0, matte(0.8))], []))
    assert contradicted([alone], worse, better, 0.1) and not contradicted([alone], better, worse, 0.1)
    assert not contradicted([with_table], worse, better, 0.1)


@pytest.mark.parametrize(
    ("share", "gain", "residual", "left_out"),
    [
        (0.1, 10, 0.2, True),
        (0.1, 10, 0.19, False),
        (0.1, 30, 0.2, False),
        (0.03, 10, 0.2, False),
        (0.1, 10, 0.21, True),
        (0.25, 10, 0.2, False),  # other light imitates it
    ],
)
def test_light_between_surfaces_that_a_photo_would_show_and_does_not_is_left_out(share, gain, residual, left_out):
    """Of a shape that was found without it, as by photometric stereo, evidence hardly moves: nothing is explained."""
    alone, _ = prepared()
    without = SimpleNamespace(evidence=400.0, residual=0.2)
    fit = SimpleNamespace(evidence=400.0 + gain, residual=residual)
    assert contradicted([alone], fit, without, share) is left_out


def test_what_is_stated_is_a_mixture_over_the_greys():
    found = estimated(table(4.0, None), positive_light(2))
    scene, one = found.scene, found.fit
    elsewhere = restated(one, 2 * one.samples)
    scene.greys = Greys((0.5, 0.3, 0.1), np.array([0.6, 0.37, 0.03]), (one.samples, elsewhere.samples, None))
    mixed = with_other_greys([SimpleNamespace(scene=scene)], one)
    assert len(mixed.samples) == len(one.samples) and np.array_equal(mixed.coefficients, one.coefficients)
    n = int(0.37 / 0.97 * len(one.samples))
    assert np.array_equal(mixed.samples[-n:], elsewhere.samples[-n:]) and not (mixed.samples[:-n] == 0).all()
    assert mixed.stddev[0].mean() > 1.5 * one.stddev[0].mean()


def test_the_reference_takes_what_is_not_known_for_grey():
    found = []
    for surface, grey in ((None, 0.8), (matte(0.8), 0.0), (None, 0.0)):
        scene, points = prepared(table(4.0, surface))
        reference = Reference(scene.job, scene.tracer, [WHITE], bounces=3, textured=False, grey=grey)
        found.append(reference.radiance(points.pixels, SHBasis(0), samples=256).radiance.mean())
    assert found[0] == pytest.approx(found[1], rel=0.01) and found[2] < 0.9 * found[0]


def test_light_of_any_strength_behind_a_table_is_not_believed():
    def answer(level, evidence):
        fit = SimpleNamespace(all_coefficients=np.full((4, 3), float(level)), evidence=evidence)
        return None, SimpleNamespace(fit=fit)

    trials = {0.3: answer(2, 10), 0.05: answer(1.5, 8), 0.8: answer(12, 30)}
    assert sorted(believed(trials)) == [0.05, 0.3]
