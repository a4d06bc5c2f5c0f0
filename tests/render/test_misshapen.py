# SPDX-License-Identifier: GPL-3.0-or-later
"""Paint that nobody told of: the light errs by more than the fit knows, and what is stated grows with what is left."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from btfsep_engine.btf.library import open_library
from btfsep_engine.btf.surfaces import GIVEN, Surface
from btfsep_engine.fit.stated import expected_error, widened
from btfsep_engine.light.lightings import SHLighting
from btfsep_engine.pipeline import estimation
from btfsep_engine.pipeline.refine import limb
from btfsep_engine.pipeline.refine.misshapen import (
    ERROR,
    MUCH,
    OF_ALL,
    UNEXPLAINED,
    WIDEST,
    lean,
    misshapen,
    patch_misfit,
)
from btfsep_engine.pipeline.settings import choose
from btfsep_engine.render.homogeneous import homogeneous
from tests.render.scenes import (
    as_mesh,
    egg_and_pebble,
    job_of,
    looking_down,
    picture,
    positive_light,
    scene_of,
    with_photo,
)

pytestmark = pytest.mark.usefixtures("no_parts_with_edges")
WHITE = "reference/white-diffuse"
SETTINGS = choose("draft", bounces=1, directions=256, key_light="never")


@pytest.fixture(scope="module")
def jobs():
    """Five white balls, their job with its photo, with a texture of noise; and with dark squares painted on them."""
    balls = [trimesh.creation.icosphere(4, radius) for radius in (0.6, 0.3, 0.3, 0.3, 0.3)]
    for ball, place in zip(balls[1:], ((0.3, 0.3), (-0.3, 0.3), (0.3, -0.3), (-0.3, -0.3)), strict=True):
        ball.apply_translation([*place, 0.4])
    scene = scene_of(job_of([as_mesh(trimesh.util.concatenate(balls))], looking_down()))
    points = scene.points(0, region=scene.view.mesh == 0, textured=False)
    light = SHLighting(positive_light(2))
    seen = scene.radiance(points, open_library(None).load(WHITE), light, directions=1024)[:, 0]
    image = picture(points, seen, noise=0.1)
    squares = np.where((np.indices(image.shape[:2]) // 12).sum(0) % 2, 1.0, 0.3)
    return with_photo(scene.job, image), with_photo(scene.job, image * squares[..., None])


def found(job, **how):
    return estimation.estimate(scene_of(job), open_library(None), SETTINGS, material=WHITE, **how)


@pytest.fixture(scope="module")
def good(jobs):
    """The estimate of the job in whose photo all is as the job says."""
    return found(jobs[0])


def test_what_is_stated_grows_with_what_patches_leave_over(jobs, good):
    bad = found(jobs[1])
    assert UNEXPLAINED not in good.choice and UNEXPLAINED in bad.choice
    assert not any("whole parts" in said for said in good.scene.reporter.warnings)
    assert any("whole parts" in said for said in bad.scene.reporter.warnings)
    plain = found(jobs[1], refinements=[r for r in estimation.REFINEMENTS if r is not misshapen])
    np.testing.assert_array_equal(bad.lighting.coefficients, plain.lighting.coefficients)
    assert (bad.lighting.stddev > 1.2 * plain.lighting.stddev).all()


def test_noise_is_not_of_patches(good):
    """Of pixels that scatter by a tenth hardly anything stays over a patch; of a part that is darker, all does."""
    misfit = patch_misfit(good.model.problems, good.light)
    assert misfit < 0.03 < 0.09 < good.fit.residual
    problem = good.model.problems[0]
    b = problem.radiance()
    half = problem.pixels[:, 1] > np.median(problem.pixels[:, 1])
    parted = replace(problem, measured=np.where(half[:, None], 0.5 * b, b))
    expected = np.sqrt(np.square(0.5 * b[half]).sum() / np.square(parted.radiance()).sum())
    np.testing.assert_allclose(patch_misfit([parted], good.light), expected, rtol=0.15)


def test_a_coarse_mesh_that_is_shaded_smoothly_is_said_and_counted(monkeypatch):
    monkeypatch.setattr(limb, "SPEAKS", np.inf)  # which explains half of it, and is as wide as what is stated then

    def waves(level):
        ball = trimesh.creation.icosphere(level, 1.0)
        ball.vertices *= 0.55 + 0.08 * np.sin(7 * ball.vertices).sum(1, keepdims=True)
        return scene_of(job_of([as_mesh(ball)], looking_down()))

    fine, coarse = waves(5), waves(1)
    points = fine.points(0, region=fine.view.mesh == 0, textured=False)
    seen = fine.radiance(points, open_library(None).load(WHITE), SHLighting(positive_light(2)), directions=1024)[:, 0]
    good, bad = (found(with_photo(scene.job, picture(points, seen))) for scene in (fine, coarse))
    assert "coarse" not in good.choice.get(UNEXPLAINED, "")
    assert "the mesh is coarse" in bad.choice[UNEXPLAINED] and bad.choice[UNEXPLAINED] in bad.scene.reporter.warnings
    assert lean(good.model.problems) < 0.06 < 0.15 < lean(bad.model.problems)
    assert bad.lighting.stddev.mean() > 1.25 * good.lighting.stddev.mean()


def test_of_what_is_alike_all_over_nothing_else_is_to_be_left_over():
    """Dark squares on gloss, smaller than patches: over these little of them stays, of the photo a half does."""
    scene = scene_of(job_of([egg_and_pebble()], looking_down()))
    points = scene.points(0, region=scene.view.mesh == 0, textured=False)
    gloss = Surface((0.5, 0.4, 0.3), roughness=0.25)
    seen = scene.radiance(points, homogeneous(gloss, GIVEN), SHLighting(positive_light(4)), directions=1024)[:, 0]
    squares = np.where((points.pixels // 7).sum(1) % 2, 1.0, 0.25)[:, None]
    jobs = [with_photo(scene.job, picture(points, values, noise=0.02)) for values in (seen, squares * seen)]
    of_gloss = [replace(job, objects=(replace(job.objects[0], surface=gloss),)) for job in jobs]
    without = [r for r in estimation.REFINEMENTS if r is not misshapen]

    def answered(job, **how):
        return estimation.estimate(scene_of(job), open_library(None), SETTINGS, **how)

    good, bad, plain = answered(of_gloss[0]), answered(of_gloss[1]), answered(of_gloss[1], refinements=without)
    assert UNEXPLAINED not in good.choice
    assert "alike all over" in bad.choice[UNEXPLAINED] and bad.choice[UNEXPLAINED] in bad.scene.reporter.warnings
    assert patch_misfit(bad.model.problems, bad.light) < 0.1 < bad.fit.residual
    stated = expected_error(bad.fit.all_coefficients, bad.fit.samples)["order_2"]["median"]
    assert stated == pytest.approx(OF_ALL * bad.fit.residual, rel=0.05)
    assert stated > 1.25 * expected_error(plain.fit.all_coefficients, plain.fit.samples)["order_2"]["median"]


def wider(good, monkeypatch, *, misfit: float, left: float = 0.0, material=None) -> float:
    """How many times as wide a light is stated that seemed to be known well, where so much is left over."""
    for name, value in {"patch_misfit": misfit, "lean": 0.0}.items():
        monkeypatch.setattr(f"{misshapen.__module__}.{name}", lambda *_, value=value: value)
    model = good.model
    if material is not None:
        model = model.changed(lambda problem: replace(problem, materials=[material]))
    light = replace(good.light, fit=replace(widened(good.light.fit, 0.1), residual=left))
    _, answer, words = misshapen(model, light)
    factor = np.ptp(answer.fit.interval, 0) / np.ptp(light.fit.interval, 0)
    np.testing.assert_allclose(factor, factor.mean(), rtol=1e-6)
    assert (UNEXPLAINED in words) is (answer is not light)
    return float(factor.mean())


def test_a_little_that_patches_leave_over_says_nothing_of_a_wrong_shape(good, monkeypatch):
    """As much is left over where geometry and paint are as the job says."""
    assert wider(good, monkeypatch, misfit=0.9 * MUCH) == 1
    assert wider(good, monkeypatch, misfit=1.1 * MUCH) > 1


def test_however_much_is_left_over_ranges_grow_to_an_end(good, monkeypatch):
    assert wider(good, monkeypatch, misfit=50.0) == pytest.approx(WIDEST, rel=1e-6)


def test_of_what_differs_from_place_to_place_much_may_be_left_over(good, monkeypatch):
    """That its texture leaves: only of a surface that the job says to be alike all over it says anything."""
    alike = homogeneous(Surface((0.5, 0.4, 0.3)), GIVEN)
    of_image = replace(alike, texels=np.array([[[0.5], [1.5]]], np.float32))
    of_library = replace(alike, name="leather/brown-grain")
    each = [wider(good, monkeypatch, misfit=0.5 * MUCH, left=0.5, material=m) for m in (alike, of_image, of_library)]
    assert each[0] > 1 and each[1:] == [1, 1]


def test_what_is_left_over_of_matte_things_says_more(good, monkeypatch):
    """Of gloss much of the photo is left over as a rule, of matte things some hundredths."""
    matte, wider_by = Surface((0.5, 0.4, 0.3), roughness=0.6), []
    others = [replace(matte, **change) for change in ({"roughness": 0.25}, {"metallic": 1.0})]
    for surface, left in ((matte, 0.055), *((each, 0.065) for each in (matte, *others))):
        monkeypatch.setattr(f"{misshapen.__module__}.surface_of", lambda *_, surface=surface: surface)
        material = homogeneous(surface, GIVEN)
        wider_by.append(wider(good, monkeypatch, misfit=0.5 * MUCH, left=left, material=material))
    assert wider_by[1] > 1 and wider_by[0] == wider_by[2] == wider_by[3] == 1


def test_ranges_grow_by_what_is_stated_of_the_light_that_reaches_the_photo(good, monkeypatch):
    """Of light from below a table next to nothing is known, whatever is left over."""
    whole = wider(good, monkeypatch, misfit=1.1 * MUCH)
    known = {"order_2": {"median": 1.1 * MUCH * ERROR / 2}}
    monkeypatch.setattr(f"{misshapen.__module__}.shown_error", lambda _: known)
    assert wider(good, monkeypatch, misfit=1.1 * MUCH) == pytest.approx(2, rel=1e-6) != whole
