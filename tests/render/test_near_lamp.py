# SPDX-License-Identifier: GPL-3.0-or-later
"""A lamp that stands near is found, with its distance, in photographs shaded in closed form; one far away is not."""

import json
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from btfsep_engine import sh
from btfsep_engine.btf.library import open_library
from btfsep_engine.commands.report import pictures
from btfsep_engine.errors import InputError
from btfsep_engine.fit.near_lamp import CLOSEST, nearness
from btfsep_engine.light.files import Lighting, read_lighting, write_lighting
from btfsep_engine.light.sun import Near, Sun
from btfsep_engine.pipeline.estimation import estimate
from btfsep_engine.pipeline.refine import near, parted
from btfsep_engine.pipeline.refine.near import moved
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
    monkeypatch.setattr("btfsep_engine.pipeline.refine.near.SPEAKS", np.inf)
    far = estimated(photographed(distance)[0])
    assert all(s.near is None for s in far.lighting.suns) and off(far, truth) > 2 * off(found, truth)


@pytest.fixture(scope="module")
def far_answer():
    """The estimate of a photo of a lamp nearby that is taken to be far away."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(near, "SPEAKS", np.inf)
        return estimated(photographed(2.5)[0])


def test_the_opposite_of_nearness_does_not_speak_for_it(far_answer):
    scene = near.Photographed(far_answer.model, far_answer.light)
    direction = far_answer.light.solver.brightest_direction(far_answer.fit)
    added = scene.nearness(near.RADII[0] * direction)
    explained = scene.photo - far_answer.light.solver.basis.predicted(far_answer.fit.shown)
    for left, speaks in ((added, True), (-added, False)):  # what a photo would leave over that has so much of it
        assert (near.speaks_for_nearness(scene, far_answer.fit, explained - left, direction) > 0) == speaks


def test_what_was_found_before_stays_taken_off_and_no_more_is_than_the_lamp_sends(far_answer):
    scene, fit = near.Photographed(far_answer.model, far_answer.light), far_answer.fit
    fit = fit if fit.election.found else far_answer.light.solver.with_lamp(fit)
    lamp, others = fit.election.found[0], np.random.default_rng(0).uniform(0, 0.01, scene.photo.shape)
    direction, irradiance = fit.election.lamps[lamp]
    alone, beside = (scene.place(lamp, 4 * direction, 0.1, fit, o, turns=1).correction for o in (0.0, others))
    np.testing.assert_allclose(beside - alone, others, atol=1e-12)
    np.testing.assert_allclose(alone, np.exp(0.1) * irradiance * scene.nearness(4 * direction))


@pytest.mark.parametrize(("less", "is_followed"), [(0.0, True), (0.2, False)])
def test_a_place_that_explains_less_than_afar_is_not_followed(far_answer, monkeypatch, less, is_followed):
    scene, fit = near.Photographed(far_answer.model, far_answer.light), far_answer.fit
    fit = fit if fit.election.found else far_answer.light.solver.with_lamp(fit)

    def place(self, lamp, away, more, start, others, *, turns=2):
        """All explain as much, or less by what a place may be brighter."""
        return near.Place(lamp, away, more + less, start, np.zeros_like(scene.photo))

    monkeypatch.setattr(near.Photographed, "place", place)
    monkeypatch.setattr(near, "followed", lambda scene, at, others: "followed")
    found = near.search(scene, fit.election.found[0], fit, 0.0)
    assert (found == "followed") is is_followed


def test_how_bright_a_lamp_is_is_settled_at_the_best_distance_alone(far_answer, monkeypatch):
    scene, fit, asked = near.Photographed(far_answer.model, far_answer.light), far_answer.fit, []
    fit = fit if fit.election.found else far_answer.light.solver.with_lamp(fit)

    def place(self, lamp, away, more, start, others, *, turns=2):
        asked.append((round(float(np.linalg.norm(away)), 6), turns))
        better = {8.0: 0.0, 4.0: -5.0, 2.0: 5.0}[asked[-1][0]]  # 4 is the best
        return near.Place(lamp, away, near.MORE + better * 0.1, start, np.zeros_like(scene.photo))

    monkeypatch.setattr(near, "MORE", 0.0)
    monkeypatch.setattr(near.Photographed, "place", place)
    monkeypatch.setattr(near, "followed", lambda scene, at, others: at)
    assert near.search(scene, fit.election.found[0], fit, 0.0).radii == pytest.approx(8)
    assert asked == [(8.0, 1), (4.0, 1), (8.0, 2)]


def test_a_place_is_believed_where_the_evidence_is_clear_and_of_a_depth_clearer(far_answer, monkeypatch):
    assert near.Photographed(far_answer.model, far_answer.light).clearly == near.CLEARLY
    (problem,) = far_answer.model.problems
    scene = scene_of(problem.scene.job)
    scene.job = replace(scene.job, objects=(replace(scene.job.objects[0], unseen=balls()),))
    model = replace(far_answer.model, looks={"mean": [replace(problem, scene=scene)]})
    assert near.Photographed(model, far_answer.light).clearly == near.OF_A_DEPTH > near.CLEARLY
    monkeypatch.setattr(near, "CLEARLY", np.inf)
    monkeypatch.setattr(parted, "POOR", np.inf)  # without the place, a shadow explains some of it
    assert "no lamp nearby explains" in estimated(photographed(2.5)[0]).choice["near"]


def test_of_two_photos_each_loses_it_in_its_own_exposure():
    scene = photographed(2.5)[0]
    photo = replace(scene.job.photo, radiance=4 * scene.job.photo.radiance)
    both = estimated(scene, others=[scene_of(replace(scene.job, photo=photo))])
    one, other = (problem.correction for problem in both.model.problems)
    np.testing.assert_allclose(other, 4 * one, rtol=1e-3, atol=1e-6)
    assert all(photo.residuals[0] < 0.06 for photo in both.photos)


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
