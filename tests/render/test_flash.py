# SPDX-License-Identifier: GPL-3.0-or-later
"""A flash on the camera is found where the photo shows one, and nowhere else."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from btfsep_engine import sh
from btfsep_engine.btf.library import open_library
from btfsep_engine.btf.surfaces import GIVEN, Surface
from btfsep_engine.commands.report import pictures
from btfsep_engine.conventions import across
from btfsep_engine.light.lightings import SHLighting
from btfsep_engine.light.sun import Near, Sun
from btfsep_engine.pipeline import estimation
from btfsep_engine.pipeline.estimation import estimate
from btfsep_engine.pipeline.model import view_problem
from btfsep_engine.pipeline.own_image import image_from_afar, image_from_nearby
from btfsep_engine.pipeline.problem import Flash
from btfsep_engine.pipeline.refine import flash, near, near_between, roughness
from btfsep_engine.pipeline.settings import choose
from btfsep_engine.render.homogeneous import homogeneous
from scripts.studies.measures import order2
from tests.render import near_balls
from tests.render.scenes import egg_and_pebble, job_of, looking_down, picture, scene_of, with_photo

SETTINGS = choose("draft", refine="all", bounces=1, directions=512)
SATIN = Surface((0.4, 0.3, 0.2), roughness=0.4)
SKY = np.zeros((9, 3))
SKY[:4] = np.array([[1.0], [0.2], [0.3], [-0.15]])
IRRADIANCE = 2.5
AT = 0.03, 0.13  # right of the lens and above it: none of the places that are tried


@pytest.fixture(scope="module")
def satin():
    """A scene of satin things; its points, its material, the middle of the things, and where the flash stands."""
    job = job_of([egg_and_pebble(5)], looking_down())
    job = replace(job, objects=(replace(job.objects[0], surface=SATIN),))
    scene = scene_of(job)
    points, material = scene.points(0, region=scene.view.mesh == 0, textured=False), homogeneous(SATIN, GIVEN)
    corners, pose = job.objects[0].mesh.vertices, job.camera.to_world
    centre = (corners.min(0) + corners.max(0)) / 2
    place = pose[:3, 3] + np.linalg.norm(pose[:3, 3] - centre) * pose[:3, :2] @ AT
    return SimpleNamespace(scene=scene, points=points, material=material, centre=centre, place=place)


def lit(things, *lamps, surface=SATIN, **of_photo):
    """The scene as a camera sees it under its sky and lamps; all of the light: (100, 3)."""
    material = homogeneous(surface, GIVEN)
    seen = things.scene.radiance(things.points, material, SHLighting(SKY), directions=4096)[:, 0]
    seen = seen + things.scene.sun_radiance(things.points, material, *lamps)
    job = with_photo(things.scene.job, picture(things.points, seen, noise=0.02))
    truth = np.pad(SKY, ((0, 91), (0, 0))) + sum(sh.evaluate(9, s.direction)[:, None] * s.irradiance for s in lamps)
    return scene_of(replace(job, photo=replace(job.photo, **of_photo))), truth


def at(things, place, irradiance=IRRADIANCE) -> Sun:
    """A lamp at a place."""
    away = place - things.centre
    distance = float(np.linalg.norm(away))
    near = Near(things.centre, distance, distance, distance)
    return Sun(away / distance, np.full(3, irradiance), np.zeros(3), near=near)


def found_in(scene, **changes):
    return estimate(scene, open_library(None), replace(SETTINGS, **changes))


@pytest.fixture(scope="module")
def flashed(satin):
    """Photo, truth and estimate of the scene under a flash."""
    scene, truth = lit(satin, at(satin, satin.place))
    return scene, truth, found_in(scene)


def test_a_flash_is_found_and_no_light_is_bent_by_it(satin, flashed):
    _, truth, found = flashed
    assert found.choice["flash"].startswith("a light at the camera, as its flash would be, lights the objects from")
    (sun,) = found.lighting.suns
    towards, away = at(satin, satin.place).direction, np.linalg.norm(satin.place - satin.centre)
    assert np.degrees(np.arccos(sun.direction @ towards)) < 4
    assert sun.near.low < away < sun.near.high
    np.testing.assert_allclose(sun.irradiance, IRRADIANCE, rtol=0.2)
    every = estimation.REFINEMENTS
    less = [each for each in every if each is not flash.flash]
    without = estimate(lit(satin, at(satin, satin.place))[0], open_library(None), SETTINGS, refinements=less)
    error, before = (order2(each.fit.coefficients, truth[:9]) for each in (found, without))
    assert error < 0.08 and before > 1.5 * error


def test_the_photo_is_explained_in_its_report_too(flashed):
    scene, _, found = flashed
    assert found.photos[0].residuals[0] < 0.05
    again, photo = pictures(found, found.scene)[0], scene.job.photo.radiance
    shown = np.isfinite(again).all(-1) & (photo > 0).all(-1)
    assert np.linalg.norm((again - photo)[shown]) < 0.12 * np.linalg.norm(photo[shown])


def sharp_from_the_lens(things) -> Sun:
    """A bare lamp far away, from where the camera looks."""
    return Sun(at(things, things.place).direction, np.full(3, IRRADIANCE), np.zeros(3))


def nearby_elsewhere(things) -> Sun:
    """A bare lamp as near as the camera, from elsewhere."""
    away = np.linalg.norm(things.place - things.centre)
    return at(things, things.centre + away * np.array([-0.7, 0.2, 0.69]) / np.linalg.norm([-0.7, 0.2, 0.69]))


@pytest.mark.parametrize("lamp", [sharp_from_the_lens, nearby_elsewhere, None])
def test_no_flash_is_found_where_none_is(satin, lamp):
    lamps = [] if lamp is None else [lamp(satin)]
    found = found_in(lit(satin, *lamps)[0])
    assert "flash" not in found.choice and found.model.problems[0].flash is None


def test_two_lamps_nearby_are_no_flash_between_them():
    found = near_balls.found_at(2.5)[0]
    assert "flash" not in found.choice and found.lighting.suns[0].near is not None


@pytest.mark.parametrize(
    ("beside", "placed", "left", "more"),
    [(0.25, True, 0.08, True), (0.25, True, 0.2, False), (0.25, False, 0.08, False), (0.09, True, 0.01, False)],
)
def test_what_a_flash_leaves_over_lamps_elsewhere_may_explain(flashed, beside, placed, left, more, monkeypatch):
    """Then the photo has none."""
    model, light = flashed[-1].model, flashed[-1].light

    def with_misfit(misfit, **changes):
        return replace(light, fit=SimpleNamespace(residual=misfit), **changes)

    near_light = with_misfit(left, near=light.near if placed else ())
    monkeypatch.setattr(flash, "near_lamps", lambda model, light: (model, near_light, {}))
    assert flash.others_explain_more(model, light, with_misfit(beside)) is more


def test_a_lamp_nearby_above_the_camera_is_no_flash(satin):
    """Its image lies between a flash's and that of light from far away."""
    pose, (job_object,) = satin.scene.job.camera.to_world, satin.scene.job.objects
    radius = np.linalg.norm(job_object.mesh.vertices - satin.centre, axis=1).max()
    away = pose[:3, 3] - satin.centre
    turned = np.cos(np.radians(25)) * away / np.linalg.norm(away) + np.sin(np.radians(25)) * pose[:3, 1]
    scene, truth = lit(satin, at(satin, satin.centre + 2.5 * radius * turned, 4.0))
    found = found_in(scene)
    assert "flash" not in found.choice and found.choice["near"].startswith("a lamp stands")
    assert order2(found.fit.coefficients, truth[:9]) < 0.07


@pytest.mark.parametrize("changed", ["unfired", "far", "inside", "parallel", "twice", "given"])
def test_where_none_can_be_none_is_looked_for(satin, flashed, changed):
    scene, *_, found = flashed
    model = found.model
    light = replace(found.light, near=())
    plain = model.changed(lambda problem: replace(problem, flash=None, of_flash=None))
    assert flash.asked(plain, light)
    (problem,), job, pose = plain.problems, scene.job, scene.job.camera.to_world.copy()
    pose[:3, 3] *= 10
    inside = pose.copy()
    inside[:3, 3] = satin.centre
    others = {
        "unfired": replace(job, photo=replace(job.photo, flash=False)),
        "far": replace(job, camera=replace(job.camera, to_world=pose)),
        "inside": replace(job, camera=replace(job.camera, to_world=inside)),
        "parallel": replace(job, camera=replace(job.camera, orthographic=True)),
    }
    if changed in others:
        seen = SimpleNamespace(job=others[changed], mirrors=())
        plain = plain.changed(lambda problem: replace(problem, scene=seen))
    elif changed == "twice":
        plain = replace(plain, looks={plain.appearance: [problem, problem]})
    else:
        light = replace(light, solver=SimpleNamespace(given=((np.array([0, 0, 1.0]), 1.0),)))
    assert not flash.asked(plain, light)


def test_a_draft_does_not_look_for_one():
    assert flash.flash not in estimation.refinements_of(choose("draft"))
    assert flash.flash in estimation.refinements_of(choose("balanced"))


def test_a_flash_that_fired_is_looked_for_as_any(satin):
    scene, _ = lit(satin, at(satin, satin.place), flash=True)
    assert found_in(scene).choice["flash"].startswith("a flash on the camera lights the objects from")
    scene, _ = lit(satin, at(satin, satin.place), flash=False)
    assert "flash" not in found_in(scene).choice


@pytest.fixture(scope="module")
def problem(satin):
    return view_problem(satin.scene, [satin.material], replace(SETTINGS, order=9, appearance="mean"))


def test_a_lamp_far_enough_away_has_the_image_of_one_far_away(satin, problem):
    direction = at(satin, satin.place).direction
    near = image_from_nearby([problem], satin.centre + 1e4 * direction, satin.centre)
    afar = image_from_afar([problem], direction)
    scale = np.abs(afar.image).max()
    np.testing.assert_allclose(near.direction, afar.direction, atol=1e-9)
    for name in ("image", "excess"):
        assert np.abs(getattr(near, name) - getattr(afar, name)).mean() < 3e-3 * scale
    closer = image_from_nearby([problem], satin.place, satin.centre)
    assert np.abs(closer.image - afar.image).mean() > 0.02 * scale


def test_the_slopes_of_a_lamp_nearby_say_what_a_turn_changes(satin, problem):
    own, scale = image_from_nearby([problem], satin.place, satin.centre), 0.02
    away = satin.place - satin.centre
    aside = np.linalg.norm(away) * across(own.direction)
    for i in range(2):
        turned = [image_from_nearby([problem], satin.place + s * scale * aside[i], satin.centre).image for s in (1, -1)]
        changed = (turned[0] - turned[1]) / (2 * scale)
        good = np.corrcoef(own.slopes[i].ravel(), changed.ravel())[0, 1]
        assert good > 0.97 and np.linalg.norm(own.slopes[i]) == pytest.approx(np.linalg.norm(changed), rel=0.15)


def test_other_materials_are_lit_by_the_flash_as_they_reflect(satin, problem):
    own = Flash(satin.place, satin.centre, np.full(3, IRRADIANCE))
    under = problem.under(own)
    photo = np.ones((*satin.scene.job.photo.radiance.shape[:2], 3), np.float32)
    expected = 1 - IRRADIANCE * image_from_nearby([problem], satin.place, satin.centre).excess
    np.testing.assert_allclose(under.radiance(photo), expected, rtol=1e-6, atol=1e-6)
    matte = homogeneous(replace(SATIN, roughness=1.0, specular=0.0), GIVEN)
    other = under.of_materials([matte], replace(SETTINGS, order=9))
    np.testing.assert_array_equal(other.of_flash, image_from_nearby([other], satin.place, satin.centre).excess)
    assert np.abs(other.of_flash - under.of_flash).max() > 0.1 * np.abs(under.of_flash).max()
    used = np.arange(len(problem.pixels)) % 3 == 0
    np.testing.assert_array_equal(under.subset(used).of_flash, under.of_flash[used])


@pytest.mark.parametrize("times", [0.5, 2.0])
def test_how_bright_it_is_is_asked_once_more(flashed, times):
    found = flashed[-1]
    own = found.model.problems[0].flash
    off = replace(own, irradiance=times * own.irradiance)
    model = found.model.changed(lambda problem: replace(problem, flash=off))
    settled, light, words = flash.flash_settled(model, replace(found.light, near=()))
    np.testing.assert_allclose(settled.problems[0].flash.irradiance, IRRADIANCE, rtol=0.2)
    ((direction, near),) = light.near
    assert "a light at the camera" in words["flash"] and near.low < near.distance < near.high
    np.testing.assert_allclose(direction, own.direction)


def test_a_gloss_under_a_flash_is_as_rough_as_it_is(satin):
    """Its highlight, which light from afar does not have, makes a gloss rougher; beside a flash it does not."""
    gloss = replace(SATIN, roughness=0.2)
    scene, truth = lit(satin, at(satin, satin.place, 4.0), surface=gloss)
    job = replace(scene.job, objects=(replace(scene.job.objects[0], surface=gloss),))
    found = found_in(scene_of(job))
    assert "flash" in found.choice and "roughness" not in found.choice and "said_roughness" not in found.choice
    assert order2(found.fit.coefficients, truth[:9]) < 0.1


def tried(gain=50.0, share=0.3, evidence=100.0):
    """What `likeliest` sees of a flash."""
    return SimpleNamespace(gain=gain, share=share, light=SimpleNamespace(evidence=evidence))


@pytest.mark.parametrize(
    ("gains", "more", "afar", "found"),
    [
        ([50, 20], {}, 0, 50),
        ([4, 20, 30], {}, 0, 30),  # another place than the first
        ([2, 50], {}, 0, None),  # the first promises nothing
        ([9, 9.5], {}, 0, None),
        ([50], {"share": 0.04}, 0, None),
        ([50], {}, 95, None),  # as good from far away
        ([50], {}, 85, 50),
    ],
)
def test_a_flash_has_to_be_clear(satin, gains, more, afar, found, monkeypatch):
    left = [tried(float(gain), **more) for gain in gains]
    monkeypatch.setattr(flash, "image_from_nearby", lambda *of: None)
    monkeypatch.setattr(flash, "promises", lambda *of: True)
    monkeypatch.setattr(flash, "lit", lambda *of: left.pop(0) if left else None)
    monkeypatch.setattr(flash, "as_from_afar", lambda *of: SimpleNamespace(evidence=float(afar)))
    pursuit = SimpleNamespace(problems=[SimpleNamespace(scene=satin.scene)])
    best = flash.likeliest(pursuit, satin.centre)
    assert (best and best.gain) == found


@pytest.mark.parametrize(("chi2", "size", "looks"), [(20, 0.3, True), (20, -0.3, False), (5, 0.3, False)])
def test_what_does_not_look_like_one_is_not_tried(satin, flashed, problem, chi2, size, looks, monkeypatch):
    light, ones = flashed[-1].light, np.ones((len(problem.pixels), 3))
    monkeypatch.setattr(flash, "likeness", lambda *of: SimpleNamespace(chi2=chi2, size=np.array([size])))
    image = image_from_nearby([problem], satin.place, satin.centre)
    pursuit = SimpleNamespace(light=light, rms=np.ones(3), known=ones, problems=[problem])
    assert flash.promises(pursuit, image) == looks


def test_one_beside_the_lens_is_found_where_it_is(satin):
    pose, away = satin.scene.job.camera.to_world, satin.place - satin.centre
    place = pose[:3, 3] + 0.15 * np.linalg.norm(away) * pose[:3, 0]  # a camera that is held upright
    (sun,) = found_in(lit(satin, at(satin, place))[0]).lighting.suns
    assert np.degrees(np.arccos(sun.direction @ at(satin, place).direction)) < 4


def test_beside_a_flash_no_other_lamp_is_taken_to_stand_near(flashed, monkeypatch):
    found = flashed[-1]
    assert near.near_lamps(found.model, found.light) == (found.model, found.light, {})
    monkeypatch.setattr(near_between, "own_light", lambda *of, **how: pytest.fail("it was asked"))
    model = replace(found.model, settings=replace(found.settings, bounces="auto"))
    assert near_between.light_between_near_surfaces(model, found.light) == (model, found.light, {})


@pytest.mark.parametrize(("residual", "taken"), [(0.9, True), (1.1, False)])
def test_a_roughness_beside_a_flash_has_to_explain_what_counts(residual, taken, flashed, monkeypatch):
    """What is left over of its highlight counts for little, as its edge does."""
    found = flashed[-1]
    fit = SimpleNamespace(evidence=found.fit.evidence + 100, residual=residual * found.fit.residual)
    answer = SimpleNamespace(fit=fit, share_left=lambda problems: 0.0)
    monkeypatch.setattr(roughness, "_hopeful", lambda *of: 0.5)
    monkeypatch.setattr(roughness, "on_all", lambda *of: (found.model, answer))
    assert (roughness._rougher_or_smoother(found.model, found.light, 0, 0.4) is not None) == taken
