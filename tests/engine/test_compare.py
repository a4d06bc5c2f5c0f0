# SPDX-License-Identifier: GPL-3.0-or-later
"""Error measures: values known by construction, and spheres against brute-force integration."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from btfsep_engine import sh
from btfsep_engine.cli import main, words
from btfsep_engine.conventions import fibonacci_sphere
from btfsep_engine.fit import compare as c
from btfsep_engine.light.files import Lighting, exactly


@pytest.fixture
def light(rng):
    """A light of order 4 that is bright enough never to be negative, from above and the left."""
    x = rng.normal(size=(25, 3)) * 0.03
    x[0] += 4
    x[2] += 0.8
    return exactly(x)


def test_a_light_against_itself(light):
    result = c.compare(light, light)
    for band in result["coefficients"]:
        assert band["relative_l2"] == 0 and band["scale"] == pytest.approx(1)
    assert [b["order"] for b in result["coefficients"]] == [1, 2, 3, 4]
    assert result["main_direction_degrees"] == pytest.approx(0, abs=1e-6)
    for errors in result["band_limited_spheres"].values():
        for value in errors.values():
            assert value == pytest.approx(0, abs=1e-6)
    assert json.loads(json.dumps(result)) == result


def test_a_scale_is_free_where_it_says_so(light):
    result = c.compare(exactly(2 * light.coefficients), light)
    for band in result["coefficients"]:
        assert band["relative_l2"] == pytest.approx(1)
        assert band["relative_l2_free_scale"] == pytest.approx(0, abs=1e-12)
        assert band["scale"] == pytest.approx(0.5)
    for errors in result["band_limited_spheres"].values():
        assert max(errors.values()) == pytest.approx(0, abs=1e-6)


def test_the_scale_is_one_for_all_channels(light):
    """A coloured cast is no scale: it stays as an error, and the angle is the one between the colours."""
    cast = np.array([2.0, 1.0, 0.5])
    grey = light.coefficients @ np.full((3, 3), 1 / 3)
    result = c.compare(exactly(grey * cast), exactly(grey))
    angle = np.degrees(np.arccos(cast.sum() / np.linalg.norm(cast) / np.sqrt(3)))
    s = cast.sum() / (cast @ cast)
    for band in result["coefficients"]:
        assert band["relative_l2_free_scale"] == pytest.approx(np.linalg.norm(s * cast - 1) / np.sqrt(3))
    for errors in result["band_limited_spheres"].values():
        assert errors["angular_degrees"] == pytest.approx(angle, abs=1e-6)
        assert errors["si_rmse"] > 0.1


def test_orders_add_up_one_after_the_other(light):
    x = light.coefficients.copy()
    x[9:16] += 1  # wrong at order 3 only
    bands = c.compare(exactly(x), light)["coefficients"]
    assert [b["relative_l2"] > 0 for b in bands] == [False, False, True, True]
    assert bands[2]["relative_l2"] == pytest.approx(np.sqrt(21) / np.linalg.norm(light.coefficients[:16]))


@pytest.mark.parametrize("degrees", [0.5, 12, 90, 179])
@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 1, 0), (0, 0, 1)])
def test_the_main_direction_turns_with_the_light(axis, degrees):
    x = np.zeros((9, 3))
    x[0], x[1:4] = 1, [[0.1, 0.2, 0.1], [0.3, 0.1, 0.2], [-0.2, 0.1, 0.3]]
    spin = Rotation.from_rotvec(np.radians(degrees) * np.array(axis, float)).as_matrix()
    turned = sh.rotation_matrix(2, spin) @ x
    before, after = c.main_direction(x), c.main_direction(turned)
    np.testing.assert_allclose(after, spin @ before, atol=1e-9)
    expected = np.degrees(np.arccos(np.clip(before @ spin @ before, -1, 1)))
    assert c.direction_error(turned, x) == pytest.approx(expected, abs=1e-5)


def test_the_main_direction_is_where_a_lamp_is():
    d = fibonacci_sphere(20000)
    lamp = np.array([0.48, -0.6, 0.64])
    x = sh.evaluate(3, d).T @ np.exp(20 * (d @ lamp - 1))[:, None].repeat(3, 1)
    np.testing.assert_allclose(c.main_direction(x), lamp, atol=1e-3)


def test_different_orders_compare_up_to_the_smaller(light):
    result = c.compare(exactly(light.coefficients[:9]), light)
    assert result["order"] == 2 and result["coefficients"][-1]["relative_l2"] == 0


def test_what_is_undefined_is_none():
    black, flat = exactly(np.zeros((4, 3))), exactly(np.ones((1, 3)))
    result = c.compare(flat, black)
    assert result["coefficients"] == [{"order": 0, "relative_l2": None, "relative_l2_free_scale": None, "scale": None}]
    assert result["main_direction_degrees"] is None
    assert result["band_limited_spheres"]["mirror"] == {
        "si_rmse": None,
        "angular_degrees": None,
        "normalised_rmse": None,
    }
    result = c.compare(black, exactly(np.ones((4, 3))))
    assert (
        result["coefficients"][0]["relative_l2"] == 1
        and result["band_limited_spheres"]["diffuse"]["angular_degrees"] is None
    )
    assert json.loads(json.dumps(result, allow_nan=False)) == result


def test_within_two_sigma(light, rng):
    sigma = np.full((25, 3), 0.1)
    noisy = light.coefficients + rng.normal(size=(25, 3)) * 0.1
    share = c.compare(Lighting(4, noisy, sigma, np.ones(25, bool)), light)["within_two_sigma"]
    assert share > 0.85
    assert c.compare(Lighting(4, noisy + 1, sigma, np.ones(25, bool)), light)["within_two_sigma"] < 0.1
    assert c.compare(exactly(noisy), light)["within_two_sigma"] is None


def test_a_wrong_light_is_seen_by_every_measure(light):
    other = exactly(sh.rotation_matrix(4, Rotation.from_euler("x", 90, degrees=True).as_matrix()) @ light.coefficients)
    result = c.compare(other, light)
    assert result["main_direction_degrees"] > 45
    for errors in result["band_limited_spheres"].values():
        assert errors["si_rmse"] > 0.02 and errors["normalised_rmse"] > 0.2


def test_normals_of_the_sphere():
    for view in ((0, 1, 0), (1, 0, 0), (0, 0, -1), (0.3, 0.4, -0.5)):
        n, inside = c.sphere_normals(65, view)
        np.testing.assert_allclose(np.linalg.norm(n[inside], axis=-1), 1)
        assert not n[~inside].any() and (n[inside] @ np.array(view) <= 0).all()
        np.testing.assert_allclose(n[32, 32], -np.array(view) / np.linalg.norm(view), atol=1e-9)
    n, _ = c.sphere_normals(65)
    assert n[3, 32, 2] > 0.85 and n[32, 61, 0] > 0.85  # from the front: up is +Z, right is +X


@pytest.mark.parametrize("kind", ["diffuse", "silver", "mirror"])
def test_spheres_against_brute_force(light, kind):
    """Each sphere at a few pixels, by summing the light over 40,000 directions."""
    picture = c.spheres(light.coefficients, size=33)[kind]
    normals, inside = c.sphere_normals(33)
    d = fibonacci_sphere(40000)
    radiance = sh.evaluate(4, d) @ light.coefficients
    eye = np.array([0, -1.0, 0])
    for row, column in ((16, 16), (5, 14), (20, 27), (28, 9)):
        n = normals[row, column]
        mirrored = 2 * (n @ eye) * n - eye
        if kind == "diffuse":
            weight = np.maximum(d @ n, 0) * c.GREY / np.pi * (4 * np.pi / len(d))
        elif kind == "mirror":
            weight = np.zeros(len(d))
            weight[np.argmax(d @ mirrored)] = 1
        else:
            cosine = d @ mirrored
            half = (d + mirrored) / np.linalg.norm(d + mirrored, axis=-1, keepdims=True)
            ggx = 1 / ((half @ mirrored) ** 2 * (c.SILVER_ROUGHNESS**4 - 1) + 1) ** 2
            weight = np.where(cosine > 0, ggx * cosine, 0)
            weight /= weight.sum()
        np.testing.assert_allclose(picture[row, column], weight @ radiance, rtol=5e-3)
    assert np.isnan(picture[~inside]).all() and (picture[inside] >= 0).all()


def test_silver_is_between_mirror_and_diffuse():
    factors = c.silver_factors(9)
    assert factors[0] == pytest.approx(1) and (np.diff(factors) < 0).all() and factors[-1] > 0
    np.testing.assert_allclose(c.silver_factors(4, 0.05), 1, atol=0.03)


def test_image_errors_in_numbers():
    b = np.array([[[1.0, 0, 0], [0, 1, 0], [0, 0, 1], [np.nan] * 3]])
    a = np.array([[[0, 1.0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]]])
    errors = c.image_errors(a, b)
    assert errors["angular_degrees"] == pytest.approx(30)  # one of three pixels is 90 degrees off
    s = 2 / 3  # best scale: <a, b> = 2, |a|^2 = 3
    rms = np.sqrt((s**2 + 1 + 2 * (1 - s) ** 2) / 9)
    assert errors["si_rmse"] == pytest.approx(rms, rel=0.01)


def stated(x, deviation):
    """A Lighting of coefficients with one standard deviation for all."""
    x = np.asarray(x, np.float64)
    return Lighting(sh.order_of(len(x)), x, np.full_like(x, deviation), np.ones(len(x), bool))


def test_two_estimates_agree_as_often_as_they_should(light, rng):
    """Both are off by what they state, one of them at another exposure."""
    truth, shares = light.coefficients, []
    for factor in (1.0, 3.0):
        lights = [stated(truth + 0.15 * rng.normal(size=truth.shape), 0.15) for _ in range(400)]
        pairs = zip(lights[::2], lights[1::2], strict=True)
        found = [c.agreement(stated(factor * a.coefficients, factor * 0.15), b) for a, b in pairs]
        shares.append(np.mean([f["agree"] for f in found]))
        ratio = np.sqrt(np.mean([(f["difference"] / f["stated"]) ** 2 for f in found]))
        assert ratio == pytest.approx(1, abs=0.1)
        turned = np.sqrt(np.mean([(f["degrees"] / f["stated_degrees"]) ** 2 for f in found]))
        assert 0.5 < turned < 1.1  # channels that err together would make it 1
    assert min(shares) > 0.95


def test_two_estimates_that_state_too_little_disagree(light, rng):
    truth = light.coefficients
    a, b = (stated(truth + 0.15 * rng.normal(size=truth.shape), 0.03) for _ in range(2))
    assert not c.agreement(a, b)["agree"]
    turned = stated(sh.rotation_matrix(4, Rotation.from_euler("x", 40, degrees=True).as_matrix()) @ truth, 0.03)
    found = c.agreement(turned, stated(truth, 0.03))
    assert found["degrees"] == pytest.approx(c.direction_error(turned.coefficients, truth))
    assert not found["agree"]
    other = truth.copy()
    other[4:9] += 0.5  # the direction stays
    found = c.agreement(stated(other, 0.03), stated(truth, 0.03))
    assert found["degrees"] < 1e-5
    assert not found["agree"]
    unsure = replace(turned, stddev=np.where(np.arange(75).reshape(25, 3) < 12, 0.03, 1.0))
    found = c.agreement(unsure, stated(truth, 0.03))
    assert found["difference"] < found["stated"]
    assert not found["agree"]


def test_what_two_estimates_say_of_one_another_is_said_in_words(light):
    a, b = stated(light.coefficients, 0.03), stated(light.coefficients, 0.02)
    assert words.compare(c.compare(a, b)).splitlines()[-1].startswith("the two agree (they differ by 0 % up to order 2")
    wrong = stated(light.coefficients[[0, 2, 1, *range(3, 25)]], 0.03)
    assert "DISAGREE" in words.compare(c.compare(wrong, b)).splitlines()[-1]
    assert "agree" not in words.compare(c.compare(exactly(a.coefficients), exactly(b.coefficients))).splitlines()[-1]


def test_a_light_without_a_direction_agrees_by_its_difference(light):
    even = np.zeros((9, 3))
    even[0] = 4
    found = c.agreement(stated(even, 0.1), stated(even, 0.1))
    assert found["agree"]
    assert found["degrees"] is None
    assert c.agreement(exactly(even), light) is None


def test_the_measures_are_told_in_words_and_for_an_order_that_there_is(light, capsys):
    said = words.compare(c.compare(light, light))
    assert "coefficients:\n    order 1, relative_l2 0, relative_l2_free_scale 0, scale 1\n" in said and "{" not in said
    for order in ("-1", "0", "65"):
        assert main(["compare", "a.json", "b.json", "--order", order]) == 2
        assert "--order" in capsys.readouterr().err
