# SPDX-License-Identifier: GPL-3.0-or-later
"""Lamps whose direction is given, by the job or the command line: they stay, are named, and are doubted."""

import numpy as np
import pytest
import trimesh

from btfsep_engine.conventions import angles_of_direction, direction_of_angles
from btfsep_engine.imaging import images
from btfsep_engine.light.files import read_lighting
from tests.render.scenes import edited, looking_down, off_as_seen
from tests.render.test_frames import LAMP, OTHER, answer, assert_as_alone, lamp_light, photographed, shaded

SPEAKS, GUESS = "the photo speaks against the lamp whose direction is given", "little more than a guess"


@pytest.fixture
def lamplit(sphere_job_folder):
    """A job of a white sphere under an even sky and a lamp at `LAMP`, in closed form with some noise."""
    folder, _ = sphere_job_folder
    image = shaded(looking_down(), np.eye(4)) * np.random.default_rng(0).normal(1, 0.02, (96, 96, 1))
    images.write_exr(folder / "photo.exr", image.astype(np.float32))
    return folder


def known(folder, *directions, **more):
    """Has the job name lamps."""
    edited(folder, known_lamps=[{"direction": np.asarray(d).tolist()} for d in directions], **more)


def estimated(folder, capsys, *more):
    """The result, and its Lighting."""
    result = answer(capsys, "estimate", folder, "--no-report", *more)
    return result, read_lighting(result["lighting"])


def test_a_known_lamp_is_a_key_light_where_it_is_said_to_be(lamplit, capsys):
    said = 3 * LAMP  # of any length
    known(lamplit, said)
    result, light = estimated(lamplit, capsys)
    (sun,) = light.suns
    np.testing.assert_allclose(sun.direction, LAMP, atol=1e-9)
    assert sun.given and sun.direction_stddev_degrees == 1.0 and sun.irradiance.mean() == pytest.approx(2.5, rel=0.05)
    assert "as its direction is given" in result["choice"]["key_light"] and result["lamps"][0]["given"] is True
    assert not any(SPEAKS in w or GUESS in w for w in result["warnings"])
    # the command line says the same by angles, and goes over the job
    elevation, azimuth = angles_of_direction(LAMP)
    known(lamplit, OTHER)
    again, there = estimated(lamplit, capsys, "--sun", f"{elevation!r},{azimuth!r}")
    np.testing.assert_allclose(there.coefficients, light.coefficients, atol=1e-9)
    assert again["settings"]["sun"] == [[elevation, azimuth]] and again["key"] != result["key"]
    np.testing.assert_allclose(direction_of_angles(elevation, azimuth), LAMP, atol=1e-12)


def test_a_wrong_direction_is_doubted_and_the_right_one_is_named(lamplit, capsys):
    known(lamplit, OTHER)
    result, light = estimated(lamplit, capsys)
    (doubt,) = [w for w in result["warnings"] if SPEAKS in w]
    assert "of the light; check its direction" in doubt  # too far off for the lamp that is there to be meant
    (given,) = [lamp for lamp in result["lamps"] if lamp.get("given")]
    assert given["share"] < 0.05 and off_as_seen(light.coefficients, lamp_light()) < 0.1
    assert "it stays in the spherical harmonics" in result["choice"]["key_light"]
    (sun,) = light.suns
    assert not sun.given and sun.direction @ LAMP > np.cos(np.radians(5))

    elevation, azimuth = angles_of_direction(LAMP)
    result, _ = estimated(lamplit, capsys, "--sun", f"{elevation - 25},{azimuth}")
    (doubt,) = [w for w in result["warnings"] if SPEAKS in w]
    away, _, there = doubt.partition("it would have it ")[2].partition(" degrees away, at ")
    assert abs(float(away) - 25) < 4 and abs(float(there.split()[0]) - elevation) < 4

    result, light = estimated(lamplit, capsys, "--sun", f"{elevation - 4},{azimuth}")
    (sun,) = light.suns  # it is the lamp that is there, as well as it is known
    assert sun.given and not any(SPEAKS in w for w in result["warnings"])


def test_of_a_lamp_that_lights_nothing_seen_the_power_is_called_a_guess(lamplit, capsys):
    known(lamplit, (0.1, 0.2, -1.0))  # behind the sphere
    result, _ = estimated(lamplit, capsys)
    assert any(GUESS in w for w in result["warnings"]) and not any(SPEAKS in w for w in result["warnings"])


def test_of_a_lamp_in_the_shade_of_something_the_power_is_called_a_guess(lamplit, capsys):
    wall = trimesh.creation.cylinder(1.1, 0.03).apply_transform(trimesh.geometry.align_vectors([0, 0, 1], OTHER))
    wall.apply_translation(1.2 * OTHER).export(lamplit / "wall.ply")
    known(lamplit, OTHER, LAMP, occluders=[{"mesh": "wall.ply", "surface": {"base_color": [0, 0, 0]}}])
    photographed(lamplit, {"1.exr": 4 * lamp_light() + lamp_light(OTHER)})
    known(lamplit, OTHER, LAMP, image="frames/1.exr")
    result, light = estimated(lamplit, capsys)
    (doubt,) = [w for w in result["warnings"] if GUESS in w]
    assert f"azimuth {angles_of_direction(OTHER)[1]:.0f} degrees" in doubt
    assert any(sun.given and sun.direction @ LAMP > 0.9999 for sun in light.suns)
    assert not any(SPEAKS in w for w in result["warnings"])


def test_the_papers_way_says_that_it_leaves_them_out(lamplit, capsys):
    known(lamplit, LAMP)
    result, light = estimated(lamplit, capsys, "--estimator", "least-squares")
    assert not light.suns and any("lamps whose direction is given are left out" in w for w in result["warnings"])


def test_a_frame_of_a_sequence_has_them_as_an_estimate_has(lamplit, capsys):
    (lamplit / "frames").mkdir()
    camera, random = looking_down(), np.random.default_rng(1)
    for name, sky in (("1.exr", 1.0), ("2.exr", 1.3)):
        image = sky * shaded(camera, np.eye(4)) * random.normal(1, 0.02, (96, 96, 1))
        images.write_exr(lamplit / "frames" / name, image.astype(np.float32))
    known(lamplit, LAMP)
    frames = answer(capsys, "sequence", lamplit, "--images", lamplit / "frames" / "*")["frames"]
    assert all(frame["lamps"][0]["given"] for frame in frames)
    assert_as_alone(lamplit, frames, capsys)
