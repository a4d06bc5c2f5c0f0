# SPDX-License-Identifier: GPL-3.0-or-later
"""What is made of a series that is negative somewhere: light of the same amount, and of the right hue."""

import numpy as np
import pytest

from btfsep_engine import sh
from btfsep_engine.conventions import fibonacci_sphere, luminance, pixel_directions, pixel_solid_angles
from btfsep_engine.fit.compare import FRONT, sphere_normals
from btfsep_engine.light.files import exactly, lighting_map, seen_lighting
from btfsep_engine.light.lightings import EnvironmentMaps, SHLighting
from btfsep_engine.light.positivity import positive_radiance, positive_share
from btfsep_engine.light.sun import Sun

SIZE = (64, 128)
DIRECTIONS, AREA = pixel_directions(*SIZE), pixel_solid_angles(*SIZE)[:, None]


def lamp_and_sky(azimuth=-60.0, elevation=40.0, width=25.0, strength=30.0, lamp=(1.0, 0.75, 0.5)):
    """A warm lamp on a blue sky that darkens towards the ground: (64, 128, 3)."""
    e, a = np.radians([elevation, azimuth])
    cosine = DIRECTIONS @ [np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)]
    z = DIRECTIONS[..., 2]
    sky = np.where(z > 0, 0.4 + 0.6 * z, 0.12)[..., None] * [0.6, 0.8, 1.0]
    spot = strength * np.exp((cosine - 1) / (1 - np.cos(np.radians(width / 2))))
    return sky + spot[..., None] * np.array(lamp)


def hue_error(seen, truth) -> float:
    """Mean angle in degrees between the colours of a mirror ball under two maps (64, 128, 3), where both have light."""
    normals, inside = sphere_normals(64)
    n, eye = normals[inside], -np.array(FRONT)
    mirrored = 2 * (n @ eye)[:, None] * n - eye
    a, b = (EnvironmentMaps(m[None], ("",)).radiance(mirrored)[:, 0] for m in (seen, truth))
    lit = (a.max(-1) > 1e-6) & (b.max(-1) > 1e-6)
    across = np.linalg.norm(np.cross(a[lit], b[lit]), axis=-1)
    return float(np.degrees(np.arctan2(across, (a[lit] * b[lit]).sum(-1))).mean())


@pytest.mark.parametrize("how", [{}, {"azimuth": 150}, {"width": 40}, {"strength": 60, "width": 15}])
def test_a_warm_lamp_on_a_blue_sky_keeps_its_hues(how):
    truth = lamp_and_sky(**how)
    x = sh.project_map(truth, 4)
    series = sh.to_map(x, *SIZE)
    clamped = np.maximum(series, 0) * x[0] / sh.project_map(np.maximum(series, 0), 0)[0]  # a gain for each channel
    error = hue_error(positive_radiance(x, DIRECTIONS), truth)
    assert error < 8 and error < 0.5 * hue_error(clamped, truth)


@pytest.mark.parametrize("order", [0, 1, 2, 4, 9, 20])
def test_it_is_light_and_as_much(order):
    for x in (sh.project_map(lamp_and_sky(), order), np.random.default_rng(order).normal(size=((order + 1) ** 2, 3))):
        x[0] = np.abs(x[0])
        found = positive_radiance(x, DIRECTIONS)
        assert found.min() >= 0
        whole = luminance(x[0]) * np.sqrt(4 * np.pi)
        assert (AREA * luminance(found)).sum() == pytest.approx(whole, rel=5e-3)


def test_a_light_that_is_nowhere_negative_stays_as_it_is():
    x = sh.project_map(lamp_and_sky(width=90, strength=3), 9)
    series = sh.to_map(x, *SIZE)
    assert series.min() > 0 and positive_share(x) == (0, 1)
    np.testing.assert_allclose(positive_radiance(x, DIRECTIONS), series, rtol=1e-12)


def test_a_light_that_dips_a_little_changes_a_little():
    """Nothing jumps as a light goes below zero: what changes goes to nothing with the dip."""
    x = sh.project_map(lamp_and_sky(), 4)
    lowest = sh.to_map(x, *SIZE).min((0, 1)).min()
    changes = []
    for dip in (0.1, 0.01, 0.001):
        lifted = x.copy()
        lifted[0] -= (lowest + dip) * np.sqrt(4 * np.pi)
        series = sh.to_map(lifted, *SIZE)
        assert series.min() == pytest.approx(-dip, rel=1e-6)
        changes.append(np.abs(positive_radiance(lifted, DIRECTIONS) - series).max() / dip)
    assert 1 <= min(changes) and max(changes) < 30


def test_what_is_no_light_is_black_and_finite():
    directions = fibonacci_sphere(100)
    for x in (np.zeros((25, 3)), -np.ones((25, 3)), np.eye(25)[:, 6:9]):
        found = positive_radiance(x, directions)
        assert np.isfinite(found).all() and found.min() >= 0
    assert positive_radiance(-np.ones((1, 3)), directions).max() == 0


def test_surfaces_see_the_light_that_the_map_shows():
    ringing, even = exactly(sh.project_map(lamp_and_sky(), 4)), exactly(sh.project_map(lamp_and_sky(), 0))
    for seen in seen_lighting(ringing):
        np.testing.assert_allclose(seen.maps[0], lighting_map(ringing, 128, 256))
    whole, sky = seen_lighting(even)
    assert isinstance(whole, SHLighting) and np.array_equal(whole.coefficients, sky.coefficients)
    sun = Sun((0, 0.6, 0.8), (3, 2, 1), (0, 0, 0), size_degrees=5)
    sunny = exactly(ringing.coefficients + sun.coefficients(4))
    whole, sky = seen_lighting(type(sunny)(4, sunny.coefficients, sunny.stddev, sunny.determined, 0.0, (sun,)))
    np.testing.assert_allclose(sky.maps[0], lighting_map(ringing, 128, 256), atol=1e-9)
    np.testing.assert_allclose(whole.maps[0] - sky.maps[0], sun.to_map(128, 256), atol=1e-9)
