# SPDX-License-Identifier: GPL-3.0-or-later
"""All procedural materials: seamless, within their ranges, deterministic, and no two of them alike."""

import functools
from collections import Counter
from itertools import pairwise

import numpy as np
import pytest

from btfsep_engine.btf import procedural
from btfsep_engine.btf.library import open_library

CLASSES = ("carpet", "fabric", "felt", "leather", "stone", "wallpaper", "wood")


@functools.cache
def full(name):
    return procedural.maps(name, 256)


@pytest.fixture
def small_work(monkeypatch):
    """Patterns on 128 pixels instead of 512, for tests that only compare."""
    monkeypatch.setattr(procedural, "WORK_PIXELS", 128)


def test_six_of_each_class():
    assert Counter(name.split("/")[0] for name in procedural.NAMES) == dict.fromkeys(CLASSES, 6)
    assert Counter(name.split("/")[0] for name in open_library().entries) == dict.fromkeys(CLASSES, 2)


@pytest.mark.parametrize("name", procedural.NAMES)
def test_shapes_and_ranges(name):
    maps = full(name)
    assert maps.base_colour.shape == (256, 256, 3)
    assert maps.height_mm.shape == maps.roughness.shape == (256, 256)
    for values in (maps.base_colour, maps.height_mm, maps.roughness):
        assert values.dtype == np.float32 and np.isfinite(values).all()
    assert 0 < maps.base_colour.min() and maps.base_colour.max() <= procedural.MAX_ALBEDO + 1e-6
    # a map that lies on a limit has been cut off there: an odd fibre may, a surface may not
    assert (maps.base_colour >= procedural.MAX_ALBEDO - 1e-6).mean() < 0.01
    assert 0.15 <= maps.roughness.min() and maps.roughness.max() <= 1
    assert abs(float(maps.height_mm.mean())) < 1e-4
    assert 0.05 < np.ptp(maps.height_mm) < 4.0
    assert 16 <= maps.size_mm <= 90 and 0.02 <= maps.f0 <= 0.05


@pytest.mark.parametrize("name", procedural.NAMES)
def test_borders_match(name):
    maps = full(name)
    for values in (maps.height_mm, maps.base_colour.mean(-1), maps.roughness):
        for axis in (0, 1):
            steps = np.abs(values - np.roll(values, 1, axis)).mean(1 - axis)
            # the step over the border is like the others (a groove may lie on it, so the largest, not the mean)
            assert steps[0] <= 1.25 * steps[1:].max(), (name, axis)


@pytest.mark.parametrize("name", procedural.NAMES)
def test_slopes_are_those_of_surfaces(name):
    maps = full(name)
    h, cell = maps.height_mm, maps.size_mm / 256
    slope = np.hypot((np.roll(h, -1, 1) - h) / cell, (np.roll(h, -1, 0) - h) / cell)
    assert 0.002 < np.median(slope) < 2  # polished marble; matted hairs
    assert np.percentile(slope, 99) < 8  # sides of holes and of strands are steep, but few


@pytest.mark.parametrize("name", procedural.NAMES)
def test_the_same_again_and_another_with_a_variation(name, small_work):
    first, again, other = (procedural.maps(name, 64, variation=v) for v in (0, 0, 3))
    for key in ("base_colour", "height_mm", "roughness"):
        np.testing.assert_array_equal(getattr(first, key), getattr(again, key))
    # laid out by a person or a machine (dots, a printed pattern), only the small things and the tint differ
    change = np.abs(first.height_mm - other.height_mm).mean() / first.height_mm.std()
    assert change > 0.01
    ratio = other.base_colour.mean((0, 1)) / first.base_colour.mean((0, 1))
    assert 0.003 < np.abs(ratio - 1).max() < 0.5
    assert first.size_mm == other.size_mm and first.f0 == other.f0


@pytest.mark.parametrize("name", procedural.NAMES)
def test_the_measured_directions_can_hold_the_gloss(name):
    """Mean normals of texels and GGX on 151 directions 15 degrees apart: more light out than in is a table's error."""
    from btfsep_engine.btf.directions import cosine_weights, ubo2014_directions

    maps, lights = full(name), ubo2014_directions()
    view = lights[np.argmin(lights[:, 2])]  # one of the outermost ring, where the error is worst
    h, cell = maps.height_mm.astype(float), maps.size_mm / 256
    slopes = [(np.roll(h, -1, axis) - h)[::4, ::4].ravel() / cell for axis in (1, 0)]
    normal = np.stack([-slopes[0], -slopes[1], np.ones_like(slopes[0])], -1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    alpha = maps.roughness[::4, ::4].ravel().astype(float) ** 2
    half = lights + view
    half /= np.linalg.norm(half, axis=-1, keepdims=True)
    nh = np.clip(normal @ half.T, 0, 1)
    spread = alpha[:, None] ** 2 / (np.pi * (1 - nh**2 * (1 - alpha[:, None] ** 2)) ** 2)
    fresnel = maps.f0 + (1 - maps.f0) * (1 - half @ view) ** 5
    # Schlick-Smith masking; weights hold the cosine to the plane: for facets the projected areas cancel in it
    k = alpha[:, None] / 2
    g = [1 / (np.clip(normal @ d.T, 0.05, 1) * (1 - k) + k) for d in (view[None], lights)]
    gloss = (spread * fresnel * g[0] * g[1] / 4).mean(0) @ cosine_weights(lights)
    assert gloss < 0.75


def look(name):
    """What tells materials apart: colour and its spread, gloss, and how strong the relief is at six sizes in mm."""
    maps = full(name)
    flat = np.log(maps.base_colour.reshape(-1, 3) + 0.01)
    power = np.abs(np.fft.fft2(maps.height_mm)) ** 2 / maps.height_mm.size**2
    waves = np.hypot(*np.meshgrid(*[np.fft.fftfreq(256, maps.size_mm / 256)] * 2))  # 1/mm
    edges = [1 / 40, 1 / 12, 1 / 5, 1 / 2.5, 1 / 1.2, 1 / 0.6, 1 / 0.3]
    bands = [power[(waves >= a) & (waves < b)].sum() for a, b in pairwise(edges)]
    relief = 0.5 * np.log10(np.array(bands) + 1e-6)
    return np.concatenate([flat.mean(0), flat.std(0), 3 * [np.log(np.median(maps.roughness))], relief])


def test_no_two_are_alike():
    looks = np.array([look(name) for name in procedural.NAMES])
    apart = np.linalg.norm(looks[:, None] - looks[None], axis=-1)
    np.fill_diagonal(apart, np.inf)
    a, b = np.unravel_index(apart.argmin(), apart.shape)
    assert apart.min() > 0.5, (procedural.NAMES[a], procedural.NAMES[b], apart.min())


def test_gloss_and_relief_vary_as_in_life():
    rough = [float(np.median(full(name).roughness)) for name in procedural.NAMES]
    relief = [float(np.ptp(full(name).height_mm)) for name in procedural.NAMES]
    assert min(rough) < 0.32 and max(rough) >= 0.9
    assert min(relief) < 0.1 and max(relief) > 2.5
    assert len({procedural.RECIPES[name][1] for name in procedural.NAMES}) > 10  # sizes
