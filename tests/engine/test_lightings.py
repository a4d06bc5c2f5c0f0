# SPDX-License-Identifier: GPL-3.0-or-later
"""Lightings: energy, caps, turns; and the natural lights that come with the engine."""

import hashlib

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from btfsep_engine import sh
from btfsep_engine.conventions import (
    REC709_LUMINANCE,
    equirect_to_direction,
    fibonacci_sphere,
    pixel_directions,
    pixel_solid_angles,
)
from btfsep_engine.light import lightings as li
from btfsep_engine.light.maps import FOLDER, read_map, training_lights
from scripts.studies.makers.prepare_lights import normalised


@pytest.fixture
def sunny(rng):
    """Two maps, one with a sun of one pixel that carries most of the light."""
    maps = rng.random((2, 32, 64, 3)) * 0.2
    maps[1, 9, 50] = [4000, 3000, 2000]
    return li.EnvironmentMaps(maps, ("sky", "sun"))


def energy(maps):
    return (maps * pixel_solid_angles(*maps.shape[1:3])[:, None, None]).sum((1, 2))


@pytest.mark.parametrize("n", [6, 50, 128, 700, 5000])
def test_cell_averages_keep_the_energy_exactly(sunny, n):
    values = sunny.cell_averages(fibonacci_sphere(n))
    assert values.shape == (n, 2, 3) and (values >= 0).all()
    np.testing.assert_allclose(values.sum(0) * 4 * np.pi / n, energy(sunny.maps), rtol=1e-9)


def test_cell_averages_keep_the_place_of_the_sun(sunny):
    """Its order-1 vector stays where it is, although no direction is there."""
    d = fibonacci_sphere(200)
    sun = sunny.cell_averages(d)[:, 1, 0]
    truth = pixel_directions(32, 64)[9, 50]
    assert np.degrees(np.arccos((d @ truth).max())) > 3  # so far off is the nearest direction
    mean = (sun[:, None] * d).sum(0)
    assert np.degrees(np.arccos(mean @ truth / np.linalg.norm(mean))) < 0.5
    assert (sun > 0.05 * sun.max()).sum() <= 3


@pytest.mark.parametrize("n", [12, 200, 3000])
def test_the_shares_of_a_direction_add_up_to_it(n):
    d, samples = fibonacci_sphere(n), fibonacci_sphere(7919)
    indices, shares = li._around(d, samples)
    mean = (shares[..., None] * d[indices]).sum(1)
    np.testing.assert_allclose(mean / np.linalg.norm(mean, axis=-1, keepdims=True), samples, atol=1e-9)
    assert (shares >= 0).all()
    np.testing.assert_allclose(shares.sum(-1), 1)


def test_cell_averages_integrate_low_orders(sunny):
    d = fibonacci_sphere(2048)
    values = sunny.cell_averages(d)
    x = np.einsum("nt,nmc->mtc", sh.evaluate(2, d), values) * 4 * np.pi / len(d)
    truth = sunny.coefficients(2)
    assert np.linalg.norm(x - truth) < 0.01 * np.linalg.norm(truth)


def test_cell_averages_of_few_directions_go_to_the_nearest():
    d = np.array([[0, 0, 1.0], [0, 0, -1.0]])
    maps = np.zeros((1, 8, 16, 3))
    maps[0, :4] = 1
    values = li.EnvironmentMaps(maps, ("up",)).cell_averages(d)
    np.testing.assert_allclose(values[:, 0, 0], [1, 0], atol=1e-12)


def test_coefficients_are_those_of_each_map(sunny):
    x = sunny.coefficients(4)
    for i in range(2):
        np.testing.assert_allclose(x[i], sh.project_map(sunny.maps[i], 4))


def test_radiance_is_the_pixel_at_its_centre_and_bilinear_between(rng):
    maps = rng.random((3, 8, 16, 3))
    lights = li.EnvironmentMaps(maps, "abc")
    at_centres = lights.radiance(pixel_directions(8, 16).reshape(-1, 3))
    np.testing.assert_allclose(at_centres.reshape(8, 16, 3, 3), np.moveaxis(maps, 0, 2), atol=1e-12)
    between = equirect_to_direction(np.array([1.0, 8.0]) / 16, np.array([1 - 3 / 8, 1 - 3.5 / 8]))
    got = lights.radiance(between)
    np.testing.assert_allclose(got[0], maps[:, 2:4, 0:2].mean((1, 2)), atol=1e-12)
    np.testing.assert_allclose(got[1], maps[:, 3, 7:9].mean(1), atol=1e-12)


def test_radiance_goes_around_the_seam(rng):
    maps = rng.random((1, 8, 16, 3))
    at_seam = equirect_to_direction(np.array([0.0, 1.0]), np.array([1 - 3.5 / 8] * 2))
    got = li.EnvironmentMaps(maps, "a").radiance(at_seam)
    np.testing.assert_allclose(got[:, 0], np.tile(maps[0, 3, [0, 15]].mean(0), (2, 1)), atol=1e-9)


def test_cap_factors_against_quadrature():
    node, weight = np.polynomial.legendre.leggauss(64)
    for solid_angle in (0.3, 2.0, 9.0):
        c = 1 - solid_angle / (2 * np.pi)
        cosine, share = c + (1 - c) * (node + 1) / 2, weight / 2
        expected = share @ np.polynomial.legendre.legvander(cosine, 9)
        np.testing.assert_allclose(li.cap_factors(9, solid_angle), expected, atol=1e-12)
    np.testing.assert_array_equal(li.cap_factors(3, 0), 1)


def test_the_basis_and_a_light_made_of_it(rng):
    d = fibonacci_sphere(50)
    x = rng.normal(size=(25, 3))
    basis = li.SHBasis(4)
    assert basis.count == 25 == len(basis.names) and basis.names[3] == "Y 1 1"
    values = basis.radiance(d)
    assert values.shape == (50, 25, 1)
    light = li.SHLighting(x, "made")
    assert light.count == 1 and light.names == ("made",)
    np.testing.assert_allclose(values[..., 0] @ x, light.radiance(d)[:, 0])
    np.testing.assert_allclose(light.cell_averages(d)[:, 0], sh.evaluate(4, d) @ x)


def test_shrink_keeps_the_energy(rng):
    a = rng.random((24, 48, 3))
    small = li.shrink(a, 4)
    assert small.shape == (6, 12, 3)
    np.testing.assert_allclose(energy(small[None]), energy(a[None]))
    with pytest.raises(ValueError, match="divide"):
        li.shrink(a, 7)


@pytest.mark.parametrize("degrees", [0, 90, -45, 360, 191.25])
def test_turned_moves_light_counter_clockwise_seen_from_above(degrees):
    a = np.zeros((16, 64, 3))
    a[6, 20] = 1
    turned = li.turned(a, degrees)
    row, column = np.argwhere(turned[..., 0])[0]
    spin = Rotation.from_euler("z", degrees, degrees=True).as_matrix()
    expected = spin @ pixel_directions(16, 64)[6, 20]
    np.testing.assert_allclose(pixel_directions(16, 64)[row, column], expected, atol=1e-9)


def test_maps_need_a_shape_and_names():
    for maps, names in (
        (np.zeros((2, 4, 8, 3)), ("a",)),
        (np.zeros((4, 8, 3)), ("a",)),
        (np.zeros((1, 4, 8, 4)), ("a",)),
    ):
        with pytest.raises(ValueError, match="names"):
            li.EnvironmentMaps(maps, names)


def test_selected(sunny):
    one = sunny.selected([1])
    assert one.names == ("sun",) and one.count == 1
    np.testing.assert_array_equal(one.maps[0], sunny.maps[1])


def test_training_lights_are_what_the_readme_says():
    lights = training_lights()
    assert lights.maps.shape == (28, 64, 128, 3) and len(set(lights.names)) == 28
    assert np.isfinite(lights.maps).all() and (lights.maps >= 0).all()
    mean = energy(lights.maps) @ REC709_LUMINANCE / (4 * np.pi)
    np.testing.assert_allclose(mean, 1 / np.pi, rtol=1e-3)
    readme = (FOLDER.parent / "README.md").read_text()
    for file in FOLDER.glob("*.exr"):
        assert f"`{file.name}`" in readme


def test_training_lights_stand_upright():
    """In all of them most light comes from above: a map upside down would show."""
    vectors = np.array([[-x[3], -x[1], x[2]] for x in training_lights(1).coefficients(1) @ REC709_LUMINANCE])
    assert (vectors[:, 2] > 0).all()


def test_training_lights_are_turned_and_the_same_each_time():
    lights = training_lights(4)
    digest = hashlib.sha256(lights.maps.tobytes()).hexdigest()
    training_lights.cache_clear()
    again = training_lights(4)
    assert hashlib.sha256(again.maps.tobytes()).hexdigest() == digest and again.names == lights.names
    azimuth = []
    for i in range(0, 28, 7):  # one map at its four turns
        x = lights.coefficients(1)[i] @ REC709_LUMINANCE
        azimuth.append(np.degrees(np.arctan2(-x[1], -x[3])))
    np.testing.assert_allclose(np.diff(azimuth) % 360, 90, atol=1e-6)
    assert not lights.maps.flags.writeable


def test_normalised(rng):
    a = rng.random((8, 16, 3))
    np.testing.assert_allclose(normalised(7 * a), normalised(a))
    with pytest.raises(ValueError, match="black"):
        normalised(0 * a)


def test_the_small_maps_are_the_real_ones(test_data):
    sources = {file: test_data / "hdri" / f"{file.stem}_1k.hdr" for file in FOLDER.glob("*.exr")}
    there = {file: source for file, source in sources.items() if source.is_file()}
    if not there:
        pytest.skip("the test data have none of these maps")
    for file, source in there.items():
        x, full = sh.project_map(read_map(file), 4), sh.project_map(normalised(read_map(source)), 4)
        assert np.linalg.norm(x - full) < 0.03 * np.linalg.norm(full)
