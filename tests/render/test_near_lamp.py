# SPDX-License-Identifier: GPL-3.0-or-later
"""A lamp that stands near is found, with its distance, in photographs shaded in closed form; one far away is not."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh

from btfsep_engine import sh
from btfsep_engine.btf.library import open_library
from btfsep_engine.btf.surfaces import Surface
from btfsep_engine.commands.report import pictures
from btfsep_engine.conventions import across, pixel_directions, pixel_solid_angles
from btfsep_engine.errors import InputError
from btfsep_engine.fit.near_lamp import CLOSEST, MOUND, Mound, mounds, nearness
from btfsep_engine.light.files import Lighting, read_lighting, write_lighting
from btfsep_engine.light.lightings import cap_factors
from btfsep_engine.light.sun import Near, Sun, cap_around
from btfsep_engine.pipeline.estimation import estimate
from btfsep_engine.pipeline.light_account import HALO, sky_radiance
from btfsep_engine.pipeline.refine import key_lights, near, near_places, parted
from btfsep_engine.pipeline.refine.near_places import moved
from btfsep_engine.pipeline.settings import choose
from scripts.studies.measures import order2
from tests.render.scenes import as_mesh, job_of, looking_down, picture, scene_of, with_photo

ALBEDO, FIRST, SECOND = 0.8, np.array([-0.55, 0.1, 0.0]), np.array([0.5, -0.25, 0.15])
RADIUS = 0.42  # of each ball; a single one would do: its normal says where a point is
WHERE = np.array([-0.1, -0.8, 0.6])


def balls():
    two = [trimesh.creation.icosphere(4, RADIUS).apply_translation(at) for at in (FIRST, SECOND)]
    return as_mesh(trimesh.util.concatenate(two))


def photographed(distance: float, *, sky=0.25):
    """Two white balls under an even sky and a lamp at a distance from their middle, without their own reflections."""
    job = job_of([balls()], looking_down())
    scene = scene_of(job)
    points = scene.points(0, textured=False)
    low, high = job.objects[0].mesh.vertices.min(0), job.objects[0].mesh.vertices.max(0)
    centre, size = (low + high) / 2, np.linalg.norm(high - low) / 2
    direction = WHERE / np.linalg.norm(WHERE)
    to_lamp = centre + distance * size * direction - points.position
    away = np.linalg.norm(to_lamp, axis=1)
    cosine = np.maximum((points.normal * to_lamp).sum(1) / away, 0)
    seen = ALBEDO / np.pi * (np.pi * cosine * (distance * size / away) ** 2 + np.pi * sky)
    image = picture(points, seen[:, None], noise=0.02)
    truth = sh.evaluate(4, direction)[:, None] * np.full(3, np.pi)
    truth[0] += sky * np.sqrt(4 * np.pi)
    return scene_of(with_photo(job, image)), direction, centre, size, truth


def off(found, truth) -> float:
    return order2(found.fit.coefficients, truth)


def estimated(scene, others=()):
    settings = choose("draft", refine="all", bounces=1, directions=1024)
    return estimate(scene, open_library(None), settings, material="reference/white-diffuse", others=others)


@pytest.mark.parametrize("distance", [2.5, 5.0])
def test_a_lamp_nearby_is_found_with_its_distance(distance, monkeypatch):
    scene, direction, centre, size, truth = photographed(distance)
    found = estimated(scene)
    (sun,) = found.lighting.suns
    assert np.degrees(np.arccos(sun.direction @ direction)) < 5
    assert sun.near.low < distance * size < sun.near.high < 1.8 * sun.near.low
    np.testing.assert_allclose(sun.near.centre, centre)
    assert sun.near.distance == pytest.approx(np.sqrt(sun.near.low * sun.near.high), rel=1e-6)  # in the scene's unit
    assert f"{0.05 * sun.near.distance:.2g} m away" in found.choice["key_light"]
    assert off(found, truth) < 0.08
    assert not any("nearby" in text for text in scene.reporter.warnings)
    # the photo is fitted less what the lamp's nearness makes of it, in its report's numbers, too
    assert found.photos[0].residuals[0] < 0.06 and found.model.problems[0].correction is not None
    again, photo = pictures(found, found.scene)[0], scene.job.photo.radiance
    shown = np.isfinite(again).all(-1) & (photo > 0).all(-1)
    assert np.linalg.norm((again - photo)[shown]) < 0.1 * np.linalg.norm(photo[shown])
    monkeypatch.setattr(near, "speak_for_nearness", lambda scene, lamps: False)
    far = estimated(photographed(distance)[0])
    assert all(s.near is None for s in far.lighting.suns) and off(far, truth) > 2 * off(found, truth)


@pytest.fixture(scope="module")
def far_answer():
    """The estimate of a photo of a lamp nearby that is taken to be far away."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(near, "speak_for_nearness", lambda scene, lamps: False)
        return estimated(photographed(2.5)[0])


@pytest.mark.parametrize("parts", [(1,), (1, -10), (-1, 2)])
def test_the_opposite_of_nearness_does_not_speak_for_it(far_answer, monkeypatch, parts):
    """Nearness does, of all that may be lamps, or of the brightest where that of the others explains nothing."""
    scene, fit = near_places.Photographed(far_answer.model, far_answer.light), far_answer.fit
    lamps = near.bright_lamps(scene)
    added = scene.placed(lamps, fit, turns=1).correction
    explained = far_answer.light.solver.basis.predicted(fit.shown)
    for left, speaks in ((added, True), (-added, False)):  # what a photo leaves over that has so much of it
        scene.photo = explained + left
        scene.light = replace(scene.light, fit=scene.solve(0.0, fit))
        assert near.speak_for_nearness(scene, lamps) == speaks
        monkeypatch.setattr(scene, "nearness_of", lambda lamps, mounds, left=left: [part * left for part in parts])
        assert near.speak_for_nearness(scene, lamps)
        monkeypatch.setattr(scene, "nearness_of", lambda lamps, mounds, left=left: [-abs(p) * left for p in parts])
        assert not near.speak_for_nearness(scene, lamps)
        monkeypatch.undo()


def test_pixels_that_do_not_count_do_not_speak_against_nearness(far_answer):
    scene, fit = near_places.Photographed(far_answer.model, far_answer.light), far_answer.fit
    added = scene.placed(near.bright_lamps(scene), fit, turns=1).correction
    scene.photo = far_answer.light.solver.basis.predicted(fit.shown) + added
    without = near.rest(scene, added)
    scene.photo[::2] += 0.5 * scene.photo.max()
    assert near.rest(scene, added) > 0.5 + without / 2
    scene.weights = np.ones_like(scene.photo)
    scene.weights[::2] = 0
    assert near.rest(scene, added) == pytest.approx(without, rel=0.05)


def test_what_is_taken_off_is_the_nearness_of_all_lamps_as_bright_as_the_fit_has_them(far_answer):
    scene, fit = near_places.Photographed(far_answer.model, far_answer.light), far_answer.fit
    lamps = near_places.Lamp(4 * WHERE / np.linalg.norm(WHERE)), near_places.Lamp(np.array([0.0, 3.0, 0.0]))
    expected = 0.0
    for lamp, own in zip(lamps, scene.mounds(fit, lamps), strict=True):
        expected = expected + own.irradiance * scene.nearness(lamp.away, own.profile)
    np.testing.assert_allclose(scene.placed(lamps, fit, turns=1).correction, expected, atol=1e-12)
    assert np.abs(expected).max() > 0.01 * scene.photo.max()


def test_where_a_lamp_takes_all_of_a_photo_no_place_is(far_answer):
    scene, fit = near_places.Photographed(far_answer.model, far_answer.light), far_answer.fit
    lamp = near_places.Lamp(1.2 * WHERE / np.linalg.norm(WHERE))
    scene.photo = 1e-6 * scene.photo
    assert scene.placed((lamp,), fit).evidence == -np.inf


def a_placed(lamps, start, *, better=0.0, middles=None):
    """Lamps that explain as much as ``start`` does, or ``better``."""
    middles = middles or [lamp.direction for lamp in lamps]
    own = tuple(Mound(np.ones(3), np.ones(10), middle, np.zeros(3)) for middle in middles)
    election = SimpleNamespace(evidence_of_photo=start.election.evidence_of_photo + better)
    return near_places.Placed(tuple(lamps), SimpleNamespace(election=election), None, own)


def test_what_is_unlikely_of_lamps(far_answer):
    """Elsewhere than the fit has them, farther away than the first one."""
    towards, aside = np.array([0.0, 0.0, 1.0]), np.array([np.sin(0.1), 0.0, np.cos(0.1)])
    likely = a_placed([near_places.Lamp(3 * towards)], far_answer.fit).evidence
    assert likely == far_answer.fit.election.evidence_of_photo
    beside = a_placed([near_places.Lamp(3 * towards)], far_answer.fit, middles=[aside])
    assert likely - beside.evidence == pytest.approx(0.5 * (0.1 / near_places.SPREADS[0]) ** 2, rel=0.01)
    there = moved(2 * towards, np.array([*beside.off[0], 0])) / 2  # where it ought to move
    np.testing.assert_allclose(there @ aside, 1, atol=1e-5)
    farther = a_placed([near_places.Lamp(3 * towards), near_places.Lamp(np.array([6.0, 0, 0]))], far_answer.fit)
    assert likely - farther.evidence == pytest.approx(0.5 * (np.log(2) / near_places.SPREADS[2]) ** 2)


@pytest.mark.parametrize(("better", "is_followed"), [(0.0, True), (-1.0, False)])
def test_a_place_that_explains_less_than_afar_is_not_followed(far_answer, monkeypatch, better, is_followed):
    scene, fit = near_places.Photographed(far_answer.model, far_answer.light), far_answer.fit
    monkeypatch.setattr(scene, "placed", lambda lamps, start, *, turns=2: a_placed(lamps, fit, better=better))
    monkeypatch.setattr(near, "followed", lambda scene, at: "followed")
    assert (near.search(scene, [(near_places.Lamp(WHERE),)], fit) == "followed") is is_followed


def test_how_bright_a_lamp_is_is_settled_at_the_best_distance_alone(far_answer, monkeypatch):
    scene, fit, asked = near_places.Photographed(far_answer.model, far_answer.light), far_answer.fit, []

    def placed(lamps, start, *, turns=2):
        asked.append((round(lamps[-1].radii, 6), turns))
        return a_placed(lamps, fit, better={8.0: 3.0, 4.0: 2.0, 2.0: 5.0}[asked[-1][0]])  # worse at 4

    monkeypatch.setattr(scene, "placed", placed)
    monkeypatch.setattr(near, "followed", lambda scene, at: at)
    assert near.search(scene, [(near_places.Lamp(WHERE),)], fit).lamps[0].radii == pytest.approx(8)
    assert asked == [(8.0, 1), (4.0, 1), (8.0, 2)]


def test_a_lamp_that_explains_nothing_is_dropped_and_one_that_does_is_added(far_answer, monkeypatch):
    scene, fit = near_places.Photographed(far_answer.model, far_answer.light), far_answer.fit
    lamps = [near_places.Lamp(3 * np.eye(3)[i]) for i in range(3)]
    worth = [30.0, near.FURTHER - 0.5, near.FURTHER + 0.5]

    def placed(lamps_there, start, *, turns=2):
        much = sum(w for w, lamp in zip(worth, lamps, strict=True) if any(lamp is other for other in lamps_there))
        return a_placed(lamps_there, fit, better=much)

    monkeypatch.setattr(scene, "placed", placed)
    monkeypatch.setattr(scene, "solve", lambda correction, start: None)
    monkeypatch.setattr(near, "followed", lambda scene, at: at)
    assert near.without_idle(scene, placed(tuple(lamps), fit)).lamps == (lamps[0], lamps[2])
    left = list(lamps[1:])
    monkeypatch.setattr(near, "too_dark", lambda scene, fit, lamps: lamps[-1] is None)
    monkeypatch.setattr(near, "brightest_left", lambda fit, lamps: np.eye(3)[0])
    monkeypatch.setattr(near, "Lamp", lambda away: left.pop(0) if left else None)
    assert near.with_further(scene, placed((lamps[0],), fit)).lamps == (lamps[0], lamps[2])


def test_what_may_be_a_lamp_is_apart_from_others_and_not_too_dark(far_answer, monkeypatch):
    scene = near_places.Photographed(far_answer.model, far_answer.light)
    towards = [np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.8, 0.6]), np.array([0.8, 0.0, -0.6])]
    light = sum(w * sh.evaluate(9, d) for w, d in zip((3, 2, 1), towards, strict=True))
    fit = SimpleNamespace(all_coefficients=np.repeat(light[:, None], 3, 1))
    found = ()
    for expected in towards:
        direction = near.brightest_left(fit, found)
        assert direction @ expected > np.cos(np.radians(8))
        found = (*found, near_places.Lamp(5 * direction))
    much = [Mound(np.full(3, m), np.ones(10), towards[0], np.zeros(3)) for m in (1.0, near.LEAST + 0.01)]
    monkeypatch.setattr(scene, "mounds", lambda fit, lamps: tuple(much))
    assert not near.too_dark(scene, fit, found[:2])
    much[1] = replace(much[1], irradiance=np.full(3, near.LEAST - 0.01))
    assert near.too_dark(scene, fit, found[:2])


def test_places_move_together_as_long_as_the_evidence_rises(far_answer, monkeypatch):
    scene, fit, steps = near_places.Photographed(far_answer.model, far_answer.light), far_answer.fit, []
    lamps = near_places.Lamp(3 * WHERE / np.linalg.norm(WHERE)), near_places.Lamp(np.array([0.0, 4.0, 0.0]))

    def placed(lamps, start, *, turns=2):
        steps.append([lamp.radii for lamp in lamps])
        return a_placed(lamps, fit, better=10.0 if len(steps) == 1 else 0.0)

    monkeypatch.setattr(near_places, "SPREADS", near_places.SPREADS * np.inf)
    step = np.array([0, 0, np.log(1.2), 0, 0, -np.log(1.1)])
    monkeypatch.setattr(scene, "placed", placed)
    monkeypatch.setattr(scene, "next_step", lambda at: (step, None))
    after = near_places.followed(scene, a_placed(lamps, fit))
    np.testing.assert_allclose([lamp.radii for lamp in after.lamps], [3.6, 4 / 1.1])
    assert len(steps) == 3  # the second step is worse, and so is a third of it


def test_a_place_is_believed_where_the_evidence_is_clear_and_of_a_depth_clearer(far_answer, monkeypatch):
    assert near.clearly(far_answer.model.problems) == near.CLEARLY
    (problem,) = far_answer.model.problems
    scene = scene_of(problem.scene.job)
    scene.job = replace(scene.job, objects=(replace(scene.job.objects[0], unseen=balls()),))
    model = replace(far_answer.model, looks={"mean": [replace(problem, scene=scene)]})
    assert near.clearly(model.problems) == near.OF_A_DEPTH > near.CLEARLY
    monkeypatch.setattr(near, "CLEARLY", np.inf)
    monkeypatch.setattr(parted, "POOR", np.inf)  # without the place, a shadow explains some of it
    assert "no lamp nearby explains" in estimated(photographed(2.5)[0]).choice["near"]


@pytest.mark.parametrize("second", [(0.75, 0.5, 0.45), (0.3, 0.9, 0.6)])
def test_of_two_lamps_nearby_each_has_its_distance(second):
    lamps = (WHERE, 2.5), (np.array(second), 3.5)
    job = job_of([balls()], looking_down())
    points = scene_of(job).points(0, textured=False)
    low, high = job.objects[0].mesh.vertices.min(0), job.objects[0].mesh.vertices.max(0)
    centre, size, seen, truth = (low + high) / 2, np.linalg.norm(high - low) / 2, 0.15 * ALBEDO, np.zeros((25, 3))
    truth[0] = 0.15 * np.sqrt(4 * np.pi)
    for where, distance in lamps:
        direction = where / np.linalg.norm(where)
        to_lamp = centre + distance * size * direction - points.position
        away = np.linalg.norm(to_lamp, axis=1)
        cosine = np.maximum((points.normal * to_lamp).sum(1) / away, 0)
        seen = seen + ALBEDO * cosine * (distance * size / away) ** 2
        truth += sh.evaluate(4, direction)[:, None] * np.full(3, np.pi)
    found = estimated(scene_of(with_photo(job, picture(points, seen[:, None], noise=0.02))))
    assert off(found, truth) < 0.12 and "2 lamps stand" in found.choice["near"]
    for where, distance in lamps:
        ((_, how),) = [(d, how) for d, how in found.light.near if d @ where > np.cos(0.2) * np.linalg.norm(where)]
        assert 0.8 < how.distance / (distance * size) < 1.25


@pytest.fixture(scope="module")
def under_a_softbox():
    """The estimate of a photo of a disc of 40 degrees, 3 radii away; its direction, its distance, and the truth."""
    job, distance, count = job_of([balls()], looking_down()), 3.0, 60
    points = scene_of(job).points(0, textured=False)
    low, high = job.objects[0].mesh.vertices.min(0), job.objects[0].mesh.vertices.max(0)
    centre, size = (low + high) / 2, np.linalg.norm(high - low) / 2
    seen, truth, direction = 0.1 * ALBEDO, np.zeros((25, 3)), WHERE / np.linalg.norm(WHERE)
    truth[0] = 0.1 * np.sqrt(4 * np.pi)
    for each in cap_around(direction, np.radians(20), count):
        to_lamp = centre + distance * size * each - points.position
        away = np.linalg.norm(to_lamp, axis=1)
        cosine = np.maximum((points.normal * to_lamp).sum(1) / away, 0)
        seen = seen + ALBEDO / count * cosine * (distance * size / away) ** 2
        truth += sh.evaluate(4, each)[:, None] * np.full(3, np.pi / count)
    found = estimated(scene_of(with_photo(job, picture(points, seen[:, None], noise=0.02))))
    return found, direction, distance * size, truth


def test_a_softbox_nearby_has_its_place_and_about_its_width(under_a_softbox):
    found, direction, distance, truth = under_a_softbox
    (sun,) = found.lighting.suns
    assert not any(lamp.share > 0.2 for lamp in found.fit.lamps)  # the sky holds it
    assert np.degrees(np.arccos(sun.direction @ direction)) < 5 and off(found, truth) < 0.1
    assert sun.near.low < distance < sun.near.high
    assert 25 < sun.size_degrees < 50 and 0 < sun.direction_stddev_degrees < 5
    assert 0.5 < sun.share < 0.75 and 0 < sun.share_stddev < 0.15  # 0.71, of which some stays in the sky around it
    assert "a key light is told apart" in found.choice["key_light"] and " m away" in found.choice["key_light"]


def test_what_is_a_lamp_nearby_is_no_more_in_the_sky(under_a_softbox):
    found = under_a_softbox[0]
    (sun,) = found.lighting.suns
    sky, whole = sky_radiance(found.fit, found.lighting), sky_radiance(found.fit, replace(found.lighting, suns=()))
    height = 64
    directions, area = pixel_directions(height, 2 * height), pixel_solid_angles(height, 2 * height)[:, None, None]
    within = directions @ sun.direction > np.cos(np.radians(MOUND))
    around = directions @ sun.direction > np.cos(np.radians(MOUND + HALO))
    np.testing.assert_array_equal(sky(directions)[~around], whole(directions)[~around])
    assert sky(directions)[within].max() < 0.2 * whole(directions)[within].max()
    taken = (area * (whole(directions) - sky(directions))).sum((0, 1))
    np.testing.assert_allclose(taken, sun.irradiance, rtol=0.1)  # as much as the lamp has, and its halo


def test_the_shadow_of_a_wide_lamp_nearby_is_soft():
    """Of one ball upon the other: some points see a part of the lamp."""
    scene = scene_of(job_of([balls()], looking_down()))
    points, white = scene.points(0, textured=False), open_library(None).load("reference/white-diffuse")
    lamp = Sun([0.97, -0.35, 0.1], np.ones(3), np.zeros(3), near=Near(np.zeros(3), 2.0, 1.5, 2.5))
    lit = scene.sun_radiance(points, white, lamp)[:, 0] > 0
    wide = scene.sun_radiance(points, white, replace(lamp, size_degrees=20.0))[:, 0]
    assert ((wide > 0) & ~lit).sum() > 20  # where the middle is hidden
    sharp = scene.sun_radiance(points, white, lamp)[:, 0]
    assert wide.sum() == pytest.approx(sharp.sum(), rel=0.15)


def test_a_lamp_that_the_sky_holds_and_that_is_little_stays_there(under_a_softbox, monkeypatch):
    found = under_a_softbox[0]
    light = replace(found.light, suns=())
    (sun,) = key_lights.broad_lamps(light, ())
    assert sun.size_degrees == found.lighting.suns[0].size_degrees
    assert key_lights.broad_lamps(light, [Sun(sun.direction, np.ones(3), np.zeros(3))]) == []  # told apart already
    monkeypatch.setattr(key_lights, "NARROW", sun.direction_stddev_degrees / 2)
    assert key_lights.broad_lamps(light, ()) == []
    monkeypatch.setattr(key_lights, "NARROW", np.inf)
    monkeypatch.setattr(key_lights, "LEAST", sun.share + 0.01)
    assert key_lights.broad_lamps(light, ()) == []


def test_of_two_photos_each_loses_it_in_its_own_exposure():
    scene = photographed(2.5)[0]
    photo = replace(scene.job.photo, radiance=4 * scene.job.photo.radiance)
    both = estimated(scene, others=[scene_of(replace(scene.job, photo=photo))])
    one, other = (problem.correction for problem in both.model.problems)
    np.testing.assert_allclose(other, 4 * one, rtol=1e-3, atol=1e-6)
    assert all(photo.residuals[0] < 0.06 for photo in both.photos)


def test_of_a_metal_no_place_is_sought(far_answer, monkeypatch):
    light, plain = far_answer.light, far_answer.model.materials[0][0]
    metal, wood = (replace(plain, material=replace(plain.material, material_class=c)) for c in ("metal", "wood"))
    assert near.is_metal(metal, None) and not near.is_metal(wood, None)
    grey = (0.5, 0.5, 0.5)
    assert near.is_metal(wood, Surface(grey, roughness=0.4, metallic=1.0))
    assert not near.is_metal(replace(metal, surface=Surface(grey, roughness=0.4)), None)  # what it was found to be
    monkeypatch.setattr(near, "has_own_images", lambda model: False)
    model = replace(far_answer.model, materials=[[metal]])
    assert "a metal shows lamps sharper" in near.near_lamps(model, light)[2]["near"]


@pytest.mark.parametrize(("looks", "leaves", "believed"), [(13, 1.01, 1), (13, 1.03, 0), (11, 0.99, 0), (11, 0.89, 1)])
def test_places_that_only_make_the_light_plainer_are_not_believed(far_answer, monkeypatch, looks, leaves, believed):
    scene, fit = near_places.Photographed(far_answer.model, far_answer.light), far_answer.fit
    found = a_placed([near_places.Lamp(WHERE)], fit, better=near.CLEARLY + 1)
    found.fit.residual = leaves * fit.residual
    found = replace(found, correction=0.0)
    monkeypatch.setattr(near, "search", lambda scene, lamps, start: found)
    monkeypatch.setattr(scene, "placed", lambda lamps, start, *, turns=2: found)
    monkeypatch.setattr(scene, "solve", lambda correction, start: None)
    for name in ("followed", "with_further", "without_idle"):
        monkeypatch.setattr(near, name, lambda scene, at: at)
    monkeypatch.setattr(near, "looks_near", lambda scene, nearness: looks)
    assert (near.placed_lamps(scene, found.lamps) is not None) == bool(believed)


def test_what_is_left_over_may_look_like_a_lamps_nearness(far_answer):
    scene, fit = near_places.Photographed(far_answer.model, far_answer.light), far_answer.fit
    added = scene.placed(near.bright_lamps(scene)[:1], fit, turns=1).correction
    explained = far_answer.light.solver.basis.predicted(fit.shown)
    scene.photo = explained + added
    assert near.looks_near(scene, added) > 6 and near.rest(scene, added) < 0.9
    scene.photo = explained - added
    assert near.looks_near(scene, added) == 0 and near.rest(scene, added) > 1.1


@pytest.mark.parametrize(
    ("looks", "left", "speak"), [((13, 0), (0.9, 1), 1), ((0, 13), (1, 0.9), 1), ((13, 11), (1, 0.9), 0)]
)
def test_nearness_speaks_where_the_misfit_both_looks_like_it_and_has_it(far_answer, monkeypatch, looks, left, speak):
    """Of all that may be lamps, or of the brightest."""
    scene = near_places.Photographed(far_answer.model, far_answer.light)
    monkeypatch.setattr(scene, "nearness_of", lambda lamps, mounds: [1, -1])  # whose sum is 0
    monkeypatch.setattr(near, "looks_near", lambda scene, nearness: looks[nearness])
    monkeypatch.setattr(near, "rest", lambda scene, nearness: left[nearness])
    assert near.speak_for_nearness(scene, near.bright_lamps(scene)) == bool(speak)


def test_a_lamp_far_away_stays_there():
    scene, direction, _, _, truth = photographed(60.0)
    found = estimated(scene)
    (sun,) = found.lighting.suns
    assert sun.near is None and found.model.problems[0].correction is None and "far away" in found.choice["near"]
    assert np.degrees(np.arccos(sun.direction @ direction)) < 3 and off(found, truth) < 0.08


def test_what_nearness_adds_is_the_inverse_square_and_another_direction():
    """Of a surface that answers cos(theta), whose basis images are known in closed form."""
    random = np.random.default_rng(1)
    position, normal = random.normal(size=(50, 3)), random.normal(size=(50, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    lobe = np.repeat([np.pi, 2 * np.pi / 3, np.pi / 4], [1, 3, 5])  # of a clamped cosine, up to order 2
    basis = np.repeat((sh.evaluate(2, normal) * lobe)[:, :, None], 3, 2)
    place, centre = np.array([4.0, -3.0, 5.0]), np.array([0.5, 0.0, -0.5])

    def by_cosine(cosine):
        return lobe @ [1, 0, 0, 0, 0, 0, 0, 0, 0] / (4 * np.pi) + cosine / 2 + 5 / 16 * (3 * cosine**2 - 1) / 2

    away = place - position
    far = np.linalg.norm(away, axis=1)
    d = np.linalg.norm(place - centre)
    there = by_cosine((away * normal).sum(1) / far) * (d / far) ** 2
    expected = there - by_cosine(normal @ (place - centre) / d)
    np.testing.assert_allclose(nearness(basis, position, place, centre), np.repeat(expected[:, None], 3, 1), atol=1e-12)
    np.testing.assert_allclose(nearness(basis, position, 1e7 * place, centre), 0, atol=1e-5)
    (touching,) = nearness(basis[:1], [place], place, np.zeros(3))  # no nearer than a part of the lamp's distance
    assert np.isfinite(touching).all() and np.abs(touching).max() < 1.5 / CLOSEST**2


def test_a_wide_lamp_is_the_sum_of_its_points():
    random = np.random.default_rng(1)
    position, rough = random.normal(size=(20, 3)), 1 / (1 + sh.degrees(9)) ** 2
    basis = random.normal(size=(20, 100, 3)) * rough[:, None]
    place, width = np.array([4.0, -3.0, 30.0]), np.radians(12)
    around = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    ring = np.tan(width) * np.linalg.norm(place) * np.stack([np.cos(around), np.sin(around)], 1)
    points = [place + r @ across(place / np.linalg.norm(place)) for r in ring]
    distance = np.linalg.norm(points[0]) / np.linalg.norm(place)
    each = np.mean([nearness(basis, position, p / distance, np.zeros(3)) for p in points], 0)
    profile = np.polynomial.legendre.legvander(np.cos(width), 9)
    whole = nearness(basis, position, place, np.zeros(3), profile.ravel())
    assert np.linalg.norm(whole - each) < 0.1 * np.linalg.norm(each)
    assert np.linalg.norm(nearness(basis, position, place, np.zeros(3)) - each) > 0.3 * np.linalg.norm(each)


def an_election(discs, lamps=(), *, base=0.2):
    """Of a light of discs (direction, half width, radiance) and lamps, upon even light."""

    def radiance(white, directions):
        out = np.full((len(directions), 3), base)
        for direction, half, much in discs:
            out[directions @ direction > np.cos(half)] += much
        return out

    solution = SimpleNamespace(white=None, model=SimpleNamespace(radiance=radiance))
    photo = SimpleNamespace(level=np.array([1.0, 2.0, 3.0]))
    return SimpleNamespace(solution=solution, photo=photo, lamps=lamps)


def turned(direction, degrees: float):
    return np.cos(np.radians(degrees)) * direction + np.sin(np.radians(degrees)) * across(direction)[0]


def test_what_a_light_has_about_a_lamp():
    towards, half = np.array([0.0, 0.6, 0.8]), np.radians(15)
    area = 2 * np.pi * (1 - np.cos(half))
    (own,) = mounds(an_election([(towards, half, 5.0)]), [towards], 9)
    np.testing.assert_allclose(own.irradiance, 5 * area * np.array([1, 2, 3]), rtol=0.03)  # without the even light
    np.testing.assert_allclose(own.profile, cap_factors(9, area), atol=0.03)
    np.testing.assert_allclose(own.middle, towards, atol=0.01)
    aside = turned(towards, 12)
    (own,) = mounds(an_election([(aside, half / 2, 5.0)], [(aside, np.ones(3))]), [towards], 9)
    np.testing.assert_allclose(own.irradiance, 1 + 5 * 2 * np.pi * (1 - np.cos(half / 2)) * np.arange(1, 4), rtol=0.06)
    np.testing.assert_allclose(own.middle, aside, atol=0.02)
    far = turned(towards, 35)
    (own,) = mounds(an_election([], [(far, np.ones(3))]), [towards], 9)
    assert (own.irradiance == 0).all() and (own.middle == towards).all()


def test_of_two_lamps_each_has_what_is_nearer():
    one = np.array([0.0, 0.0, 1.0])
    other, between = turned(one, 40), turned(one, 22)  # within both cones
    election = an_election([], [(one, np.ones(3)), (between, np.full(3, 2.0)), (other, np.full(3, 4.0))], base=0.0)
    first, second = mounds(election, [one, other], 9)
    assert first.irradiance[0] == pytest.approx(1) and second.irradiance[0] == pytest.approx(6)


def test_a_place_is_turned_and_moved():
    away = np.array([0.0, 3.0, 4.0])
    turned = moved(away, np.array([0.01, -0.02, 0.0]))
    assert np.linalg.norm(turned) == pytest.approx(5)
    assert np.arccos(turned @ away / 25) == pytest.approx(np.hypot(0.01, 0.02), rel=1e-3)
    np.testing.assert_allclose(moved(away, np.array([0, 0, np.log(2)])), 2 * away)


def test_how_near_a_lamp_stands_is_in_the_file(tmp_path):
    sun = Sun([0, 0, 1], [1, 2, 3], np.zeros(3), near=Near([1, 2, 3], 4.0, 3.0, 5.0))
    light = Lighting(2, sun.coefficients(2), np.zeros((9, 3)), np.ones(9, bool), 0.0, (sun,))
    write_lighting(tmp_path / "a.json", light)
    there = read_lighting(tmp_path / "a.json").suns[0].near
    assert (there.distance, there.low, there.high) == (4, 3, 5) and there.centre.tolist() == [1, 2, 3]
    data = json.loads((tmp_path / "a.json").read_text())
    for wrong in ({"centre": [1, 2, 3]}, {"centre": [1, 2], "distance": 1}, {"centre": [1, 2, 3], "distance": -1}):
        data["suns"]["lamps"][0]["near"] = wrong
        (tmp_path / "b.json").write_text(json.dumps(data))
        with pytest.raises(InputError, match="near"):
            read_lighting(tmp_path / "b.json")
