# SPDX-License-Identifier: GPL-3.0-or-later
"""A light with several key lights: in order, in the file, for readers that know of one only, and as a map."""

import json

import numpy as np
import pytest

from btfsep_engine import sh
from btfsep_engine.conventions import pixel_directions, pixel_solid_angles
from btfsep_engine.errors import InputError
from btfsep_engine.imaging.images import read_linear
from btfsep_engine.light.files import (
    MOST_LAMPS,
    Lighting,
    lighting_map,
    read_lighting,
    seen_lighting,
    write_lighting,
    write_lighting_exr,
)
from btfsep_engine.light.sun import Sun

ORDER = 4
LAMP = Sun((0.0, 0.6, -0.8), (1.0, 1.0, 0.5), (0.2, 0.2, 0.1), size_degrees=6.0, share_stddev=0.02)
SUN = Sun((0.48, -0.6, 0.64), (3.0, 2.5, 2.0), (0.3, 0.2, 0.2), direction_stddev_degrees=1.5)
FAINT = Sun((-1.0, 0.0, 0.0), (0.1, 0.1, 0.2), (0.1, 0.1, 0.1), size_degrees=0.5, share=0.01)


@pytest.fixture
def light(rng) -> Lighting:
    sky = rng.normal(size=(sh.term_count(ORDER), 3)) * 0.1
    sky[0] = 2.0
    x = sky + sum(s.coefficients(ORDER) for s in (LAMP, SUN, FAINT))
    spread = np.full_like(x, 0.1)
    return Lighting(
        ORDER,
        x,
        spread,
        np.ones(len(x), bool),
        suns=(LAMP, SUN, FAINT),
        interval=np.stack([x - 0.3, x + 0.2]),
        pattern=np.stack([x - 0.2, x - 0.1, x + 0.05, x + 0.15]),
    )


def written(path, light, **changes) -> dict:
    write_lighting(path, light)
    data = json.loads(path.read_text()) | changes
    path.write_text(json.dumps(data))
    return data


def test_the_brightest_is_first_and_each_knows_its_share(light):
    assert [s.irradiance[0] for s in light.suns] == [3.0, 1.0, 0.1]
    # the share is that of the mean radiance: the sun's own over that of all of the light, both from maps
    area = pixel_solid_angles(256, 512)[:, None, None]
    mean = [(area * m).sum((0, 1)).mean() for m in (SUN.to_map(256, 512), sh.to_map(light.coefficients, 256, 512))]
    assert light.suns[0].share == pytest.approx(mean[0] / mean[1], rel=1e-3)
    assert light.suns[2].share == 0.01  # told
    assert Sun((0, 0, 1), (1, 1, 1), (0, 0, 0)).share_of(np.zeros((4, 3))) == 0


def test_what_is_written_is_what_is_read(tmp_path, light):
    data = written(tmp_path / "l.json", light)
    back = read_lighting(tmp_path / "l.json")
    assert np.array_equal(back.coefficients, light.coefficients) and np.array_equal(back.interval, light.interval)
    assert np.array_equal(back.pattern, light.pattern)
    assert np.array_equal(data["pattern"]["high_68"], light.pattern[2])
    assert np.allclose(back.sky, light.sky, atol=1e-12) and len(back.suns) == 3
    for a, b in zip(back.suns, light.suns, strict=True):
        for key in ("direction", "irradiance", "stddev"):
            assert np.allclose(getattr(a, key), getattr(b, key), rtol=1e-15)
        for key in ("size_degrees", "direction_stddev_degrees", "share", "share_stddev"):
            assert getattr(a, key) == getattr(b, key)
    assert np.allclose(data["suns"]["sky"], light.sky)
    # who knows of one sun only has all of the light, too: the brightest, and the others in the sky
    assert set(data["sun"]) == {"direction", "irradiance", "stddev", "size_degrees", "sky"}
    assert np.allclose(data["sun"]["direction"], SUN.direction)
    assert np.allclose(data["sun"]["sky"] + SUN.coefficients(ORDER), light.coefficients)


def test_a_file_with_one_sun_from_before_there_could_be_several(tmp_path, light):
    data = written(tmp_path / "l.json", light)
    del data["suns"]
    data["sun"] |= {"widest_degrees": 6.0, "evidence": -42.0}
    (tmp_path / "l.json").write_text(json.dumps(data))
    back = read_lighting(tmp_path / "l.json")
    (sun,) = back.suns
    assert np.allclose(sun.irradiance, SUN.irradiance) and sun.share == pytest.approx(light.suns[0].share)
    assert np.allclose(back.sky, light.coefficients - SUN.coefficients(ORDER))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"direction": [0.0, 0.0, 2.0]}, r"suns.lamps\[1\].direction; its length is not 1"),
        ({"direction": [1e200, 0.0, 0.0]}, "its length is not 1"),
        ({"irradiance": [1.0, -1.0, 1.0]}, r"suns.lamps\[1\].irradiance"),
        ({"irradiance": [5.0, 2.5, 2.0]}, "do not add up"),
        ({"irradiance": [1.7e308] * 3}, "do not add up"),
        ({"size_degrees": 200.0}, "size_degrees"),
        ({"direction_stddev_degrees": -1.0}, "direction_stddev_degrees"),
        ({"share": float("inf")}, "share"),
        ({"share_stddev": -1.0}, "share_stddev"),
        ({"evidence": 1.0}, "evidence"),
    ],
)
def test_a_lamp_that_makes_no_sense_is_refused_in_words(tmp_path, light, change, words):
    data = written(tmp_path / "l.json", light)
    data["suns"]["lamps"][1] |= change
    (tmp_path / "l.json").write_text(json.dumps(data))
    with pytest.raises(InputError, match=words):
        read_lighting(tmp_path / "l.json")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"sky": [[1.0, 1.0, 1.0]]}, "suns.sky; it has 1 rows"),
        ({"lamps": []}, "suns.lamps"),
        ({"lamps": 3}, "suns.lamps"),
        ({"moon": 1}, "moon"),
    ],
)
def test_suns_that_make_no_sense_are_refused_in_words(tmp_path, light, change, words):
    data = written(tmp_path / "l.json", light)
    data["suns"] |= change
    (tmp_path / "l.json").write_text(json.dumps(data))
    with pytest.raises(InputError, match=words):
        read_lighting(tmp_path / "l.json")


def test_as_many_lamps_as_a_file_may_have_and_one_more(tmp_path, light):
    data = written(tmp_path / "l.json", light)
    dark = data["suns"]["lamps"][1] | {"irradiance": [0.0, 0.0, 0.0]}
    lamps = data["suns"]["lamps"] + [dark] * (MOST_LAMPS - 3)
    written(tmp_path / "l.json", light, suns=data["suns"] | {"lamps": lamps})
    assert len(read_lighting(tmp_path / "l.json").suns) == MOST_LAMPS
    written(tmp_path / "l.json", light, suns=data["suns"] | {"lamps": [*lamps, dark]})
    with pytest.raises(InputError, match=r"suns\.lamps"):
        read_lighting(tmp_path / "l.json")


def test_infinities_of_two_lamps_do_not_cancel(tmp_path):
    """Of order 7 the harmonics at the poles are above 1, and below -1: infinity less infinity is no number."""
    sun = Sun((0, 0, 1), (1, 1, 1), (0, 0, 0))
    light = Lighting(7, sun.coefficients(7), np.zeros((64, 3)), np.ones(64, bool), suns=(sun,))
    data = written(tmp_path / "l.json", light)
    lamps = [{"direction": [0, 0, z], "irradiance": [1.7e308] * 3, "stddev": [0, 0, 0]} for z in (1, -1)]
    written(tmp_path / "l.json", light, suns=data["suns"] | {"lamps": lamps})
    with pytest.raises(InputError, match="do not add up"):
        read_lighting(tmp_path / "l.json")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"low": None}, "write both"),
        ({"high": [[-9.0, 9.0, 9.0]] * 25}, "low <= high"),
        ({"high": [[9.0, 9.0, 9.0]] * 24}, "high; it has 24 rows"),
        ({"low": [[-9.0, float("-inf"), -9.0]] * 25}, "low"),
        ({"pattern": {f"{end}_{share}": [[1, 1, 1]] * 24 for end in ("low", "high") for share in (68, 95)}}, "as many"),
        ({"pattern": dict.fromkeys(("low_68", "high_68", "high_95"), [[0, 0, 0]] * 25)}, "low_95"),
        (
            {
                "pattern": dict.fromkeys(("low_68", "high_68", "high_95"), [[0, 0, 0]] * 25)
                | {"low_95": [[1, 1, 1]] * 25}
            },
            "low_95 <= low_68",
        ),
    ],
)
def test_ranges_that_are_none_are_refused_in_words(tmp_path, light, change, words):
    written(tmp_path / "l.json", light, **change)
    with pytest.raises(InputError, match=words):
        read_lighting(tmp_path / "l.json")
    with pytest.raises(ValueError, match="interval"):
        Lighting(ORDER, light.coefficients, light.stddev, light.determined, interval=light.interval[::-1])
    with pytest.raises(ValueError, match="pattern"):
        Lighting(ORDER, light.coefficients, light.stddev, light.determined, pattern=light.pattern[::-1])


def test_nothing_that_is_not_finite_is_written(tmp_path, light):
    infinite = light.interval + np.array([0, np.inf])[:, None, None]
    with pytest.raises(ValueError, match="finite"):
        write_lighting(
            tmp_path / "l.json",
            Lighting(ORDER, light.coefficients, light.stddev, light.determined, interval=infinite),
        )
    assert not list(tmp_path.iterdir())


def test_the_map_and_what_surfaces_see_have_all_of_them(light):
    image = lighting_map(light, 256, 512)
    assert np.abs(sh.project_map(image, ORDER) - light.coefficients).max() < 0.01
    for sun in light.suns[:2]:
        near = pixel_directions(256, 512) @ sun.direction > np.cos(np.radians(1))
        assert image[near].mean() > 5 * np.median(image)
    whole, sky = seen_lighting(light)
    assert np.allclose(whole.coefficients, light.coefficients) and np.allclose(sky.coefficients, light.sky)


def test_a_sky_that_is_known_better_than_its_series_is_drawn_as_it_is(tmp_path, light):
    """Half of the sky lit, an edge that no series of order 4 has; the discs are on it."""

    def radiance(directions):
        assert directions.shape[-1] == 3 and np.allclose(np.linalg.norm(directions, axis=-1), 1)
        return np.where(directions[..., :1] > 0.1, [1.0, 2.0, 3.0], 0.25)

    write_lighting_exr(tmp_path / "l.exr", light, radiance=radiance, height=64, width=128)
    image = read_linear(tmp_path / "l.exr").pixels
    d = pixel_directions(64, 128)
    expected = np.where(d[..., :1] > 0.1, [1.0, 2.0, 3.0], 0.25) + sum(s.to_map(64, 128) for s in light.suns)
    np.testing.assert_allclose(image, expected, rtol=1e-6)
    away = np.all([d @ s.direction < np.cos(np.radians(10)) for s in light.suns], 0)
    assert set(np.unique(image[away])) == {0.25, 1.0, 2.0, 3.0}
