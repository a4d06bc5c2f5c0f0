# SPDX-License-Identifier: GPL-3.0-or-later
"""A key light: as harmonics, as a disc, in the file."""

import json

import numpy as np
import pytest

from btfsep_engine import sh
from btfsep_engine.conventions import pixel_directions, pixel_solid_angles
from btfsep_engine.errors import InputError
from btfsep_engine.light.files import Lighting, exactly, lighting_map, read_lighting, write_lighting
from btfsep_engine.light.sun import Sun, cap_around

DIRECTION = np.array([0.48, -0.6, 0.64])


def sunny(order=4, size=2.0) -> Lighting:
    rng = np.random.default_rng(3)
    sun = Sun(DIRECTION, [3.0, 2.5, 2.0], [0.3, 0.2, 0.2], size_degrees=size)
    sky = rng.normal(size=(sh.term_count(order), 3)) * 0.1
    sky[0] = 2.0
    x = sky + sun.coefficients(order)
    return Lighting(order, x, np.full_like(x, 0.1), np.ones(len(x), bool), 0.0, (sun,))


@pytest.mark.parametrize("size", [0.0, 2.0, 20.0])
def test_a_sun_as_harmonics_is_its_disc_projected(size):
    """Against a fine map: a cap of even radiance, its integral the irradiance on what faces it (nearly, when small)."""
    sun = Sun(DIRECTION, [1.0, 2.0, 3.0], np.zeros(3), size_degrees=size)
    height = 512
    half = np.radians(max(size, 3.0)) / 2
    cosine = pixel_directions(height, 2 * height) @ DIRECTION
    inside = cosine > np.cos(half)
    part = inside / (inside * pixel_solid_angles(height, 2 * height)[:, None]).sum()
    truth = sh.project_map(part[..., None] * sun.irradiance, 4)
    assert np.abs(sun.coefficients(4) - truth).max() < 0.012 * np.abs(truth).max()


def test_the_disc_of_a_map_gives_a_surface_that_faces_it_the_irradiance():
    sun = Sun(DIRECTION, [1.0, 2.0, 3.0], np.zeros(3), size_degrees=0.5)
    for height in (64, 256):
        image = sun.to_map(height, 2 * height)
        weight = np.clip(pixel_directions(height, 2 * height) @ DIRECTION, 0, 1)
        weight = weight * pixel_solid_angles(height, 2 * height)[:, None]
        assert np.allclose(np.einsum("hw,hwc->c", weight, image), sun.irradiance, rtol=1e-9)
        brightest = np.unravel_index(image[..., 0].argmax(), image.shape[:2])
        assert pixel_directions(height, 2 * height)[brightest] @ DIRECTION > np.cos(np.radians(3 * 180 / height))


def test_the_file_holds_all_of_the_light_and_the_sun_beside_it(tmp_path):
    light = sunny()
    write_lighting(tmp_path / "l.json", light)
    data = json.loads((tmp_path / "l.json").read_text())
    assert np.allclose(data["coefficients"], light.coefficients)  # who knows of no sun reads all of the light
    assert np.allclose(data["sun"]["sky"], light.sky)
    back = read_lighting(tmp_path / "l.json")
    assert np.allclose(back.sky, light.sky) and back.suns[0].size_degrees == 2
    for key in ("direction", "irradiance", "stddev"):
        assert np.allclose(getattr(back.suns[0], key), getattr(light.suns[0], key))
    # the map is the same light: projected, it has the coefficients again
    assert np.abs(sh.project_map(lighting_map(back, 256, 512), 4) - light.coefficients).max() < 0.01
    # without one there is none in the file
    write_lighting(tmp_path / "plain.json", exactly(light.coefficients))
    assert not {"sun", "suns"} & set(json.loads((tmp_path / "plain.json").read_text()))
    assert read_lighting(tmp_path / "plain.json").suns == ()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"direction": [0.0, 0.0, 2.0]}, "its length is not 1"),
        ({"direction": [0.0, 1.0]}, "direction"),
        ({"irradiance": [1.0, -1.0, 1.0]}, "irradiance"),
        ({"irradiance": [5.0, 2.5, 2.0]}, "do not add up"),
        ({"size_degrees": 200.0}, "size_degrees"),
        ({"sky": [[1.0, 1.0, 1.0]]}, "it has 1 rows"),
        ({"moon": 1}, "moon"),
    ],
)
def test_a_sun_that_makes_no_sense_is_refused_in_words(tmp_path, change, words):
    write_lighting(tmp_path / "l.json", sunny())
    data = json.loads((tmp_path / "l.json").read_text())
    data["sun"] |= change
    (tmp_path / "l.json").write_text(json.dumps(data))
    with pytest.raises(InputError, match=words):
        read_lighting(tmp_path / "l.json")


def test_directions_of_a_cap_are_spread_evenly_over_it():
    around = cap_around(DIRECTION, 0.3, 200)
    cosine = around @ DIRECTION
    assert np.allclose(np.linalg.norm(around, axis=1), 1) and cosine.min() > np.cos(0.3)
    assert np.allclose(np.sort((1 - cosine) / (1 - np.cos(0.3))), (np.arange(200) + 0.5) / 200)  # even in area
    assert np.linalg.norm(around.mean(0) - DIRECTION * cosine.mean()) < 0.01
