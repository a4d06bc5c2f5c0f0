# SPDX-License-Identifier: GPL-3.0-or-later
"""A lamp that stands near is found, with its distance, in photographs shaded in closed form; one far away is not."""

import json
from dataclasses import replace

import numpy as np
import pytest

from btfsep_engine import sh
from btfsep_engine.btf.library import open_library
from btfsep_engine.commands.report import pictures
from btfsep_engine.conventions import pixel_directions, pixel_solid_angles
from btfsep_engine.errors import InputError
from btfsep_engine.fit.near_lamp import MOUND
from btfsep_engine.light.files import Lighting, read_lighting, write_lighting
from btfsep_engine.light.sun import Near, Sun, cap_around
from btfsep_engine.pipeline.light_account import HALO, sky_radiance
from btfsep_engine.pipeline.refine import key_lights, near
from tests.render.near_balls import ALBEDO, WHERE, balls, estimated, found_at, off, photographed
from tests.render.scenes import job_of, looking_down, picture, scene_of, with_photo


@pytest.mark.parametrize("distance", [2.5, 5.0])
def test_a_lamp_nearby_is_found_with_its_distance(distance, monkeypatch):
    found, (scene, direction, centre, size, truth) = found_at(distance)
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


def test_a_lamp_far_away_stays_there():
    scene, direction, _, _, truth = photographed(60.0)
    found = estimated(scene)
    (sun,) = found.lighting.suns
    assert sun.near is None and found.model.problems[0].correction is None and "far away" in found.choice["near"]
    assert np.degrees(np.arccos(sun.direction @ direction)) < 3 and off(found, truth) < 0.08


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
