# SPDX-License-Identifier: GPL-3.0-or-later
"""The inverses of Blender's views, against AgX's published approximation, forward formulas and their derivatives."""

import cv2
import numpy as np
import pytest

from btfsep_engine.fit.tone_curve import AGX, LINEAR, SRGB
from btfsep_engine.imaging import blender_views, images
from btfsep_engine.imaging.blender_views import log_volume, to_linear
from btfsep_engine.imaging.srgb import linear_to_srgb, srgb_to_linear

# AgX as other renderers approximate it (B. Wrensch; Filament and three.js, there "based on Blender's implementation")
TO_2020 = np.array([[0.6274, 0.3293, 0.0433], [0.0691, 0.9195, 0.0113], [0.0164, 0.0880, 0.8956]])
INSET = np.array(
    [
        [0.856627153315983, 0.0951212405381588, 0.0482516061458583],
        [0.137318972929847, 0.761241990602591, 0.101439036467562],
        [0.11189821299995, 0.0767994186031903, 0.811302368396859],
    ]
)
OUTSET = np.array(
    [
        [1.1271005818144368, -0.11060664309660323, -0.016493938717834573],
        [-0.1413297634984383, 1.157823702216272, -0.016493938717834257],
        [-0.14132976349843826, -0.11060664309660294, 1.2519364065950405],
    ]
)
CURVE = [15.5, -40.14, 31.96, -6.868, 0.4298, 0.1191, -0.00232]


def approximately(radiance):
    """sRGB codes (n, 3) of linear Rec.709 (n, 3)."""
    x = np.log2(np.maximum(radiance @ TO_2020.T @ INSET.T, 1e-10))
    x = np.polyval(CURVE, np.clip((x + 12.47393) / 16.5, 0, 1))
    return linear_to_srgb(np.maximum(x @ OUTSET.T, 0) ** 2.2 @ np.linalg.inv(TO_2020).T)


def test_greys_stay_grey_and_brighter_codes_are_brighter():
    codes = np.repeat(np.linspace(0, 1, 256)[:, None], 3, 1)
    grey = to_linear(codes)
    assert (np.ptp(grey, axis=1) < 0.04 * grey.max(1))[20:].all()
    assert (np.diff(grey[:, 1]) > 0).all() and grey[0, 1] < 1e-3 and 15 < grey[-1, 1] < 18


def off(found, radiance) -> np.ndarray:
    """Relative, with one free scale."""
    found = found * np.median(radiance.sum(1) / found.sum(1))
    return np.linalg.norm(found - radiance, axis=1) / np.linalg.norm(radiance, axis=1)


def test_it_undoes_the_published_approximation_as_nearly_as_that_is_right():
    bright = np.random.default_rng(0).uniform(-5, 1, (4000, 1))
    radiance = 2.0**bright * np.random.default_rng(1).uniform(0.2, 1, (4000, 3))
    codes = np.clip(approximately(radiance), 0, 1)
    assert np.median(off(to_linear(codes), radiance)) < 0.1
    assert np.percentile(off(to_linear(codes), radiance), 95) < 0.15
    assert np.median(off(srgb_to_linear(codes), radiance)) > 1.5 * np.median(off(to_linear(codes), radiance))


def neutral(radiance):
    """Khronos PBR Neutral as its specification has it (GLSL), linear, of linear Rec.709 (3,)."""
    least = radiance.min()
    radiance = radiance - (least - 6.25 * least**2 if least < 0.08 else 0.04)
    peak = radiance.max()
    if peak < 0.76:
        return radiance
    new = 1 - 0.24**2 / (peak + 0.24 - 0.76)
    white = 1 - 1 / (0.15 * (peak - new) + 1)
    return radiance * new / peak * (1 - white) + white * new


def test_the_neutral_view_is_undone():
    random = np.random.default_rng(6)
    radiance = 2.0 ** random.uniform(-6, 4, (500, 1)) * random.uniform(0.1, 1, (500, 3))
    shown = np.array([neutral(each) for each in radiance])
    assert (shown.max(1) > 0.76).mean() > 0.3
    np.testing.assert_allclose(to_linear(linear_to_srgb(shown), "khronos"), radiance, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize(("name", "contrast"), [("agx-medium-high-contrast", 1.2), ("agx-high-contrast", 1.4)])
def test_more_contrast_is_that_many_stops_more_for_greys(name, contrast):
    grey = np.repeat(np.linspace(0.3, 0.8, 60)[:, None], 3, 1)
    stops, before = (np.log2(to_linear(grey, each)[:, 1]) for each in (name, "agx"))
    np.testing.assert_allclose(np.diff(before).sum() / np.diff(stops).sum(), contrast, rtol=1e-3)


@pytest.mark.parametrize("name", blender_views.VIEWS)
def test_its_volume_is_that_of_small_changes(name):
    random = np.random.default_rng(2)
    codes = (random.integers(2, 22, (50, 3)) + random.uniform(0.3, 0.7, (50, 3))) / 24  # within a cell of the table
    small = 1e-4 * np.eye(3)
    columns = np.stack([(to_linear(codes + s, name) - to_linear(codes - s, name)) / 2e-4 for s in small], -1)
    wrong = np.abs(log_volume(codes, name) - np.log(np.abs(np.linalg.det(columns))))
    assert np.percentile(wrong, 90) < 0.02  # views have kinks


def test_a_large_photo_is_undone_in_parts(monkeypatch):
    codes = np.random.default_rng(4).uniform(size=(7, 3, 3))
    whole = to_linear(codes)
    monkeypatch.setattr(blender_views, "AT_ONCE", 5)
    np.testing.assert_array_equal(to_linear(codes), whole)


def test_as_a_tone_curve_its_slopes_are_its_volume_and_it_is_a_seldom_one():
    codes = np.random.default_rng(5).uniform(0.1, 0.9, (40, 3))
    np.testing.assert_allclose(AGX.log_slope(codes).sum(-1), log_volume(codes))
    np.testing.assert_array_equal(AGX.decode(codes), to_linear(codes))
    assert AGX.log_prior < min(LINEAR.log_prior, SRGB.log_prior) and AGX.log_prior < 0


@pytest.mark.parametrize(("name", "kind"), [("p.png", np.uint8), ("p.png", np.uint16), ("grey.png", np.uint8)])
def test_pictures_are_read_by_it(tmp_path, name, kind):
    codes = np.random.default_rng(3).uniform(0.1, 0.9, (20, 30) if "grey" in name else (20, 30, 3))
    stored = np.round(codes * np.iinfo(kind).max).astype(kind)
    cv2.imwrite(str(tmp_path / name), stored if "grey" in name else stored[..., ::-1])
    read = images.read_linear(tmp_path / name, colorspace="agx")
    expected = to_linear(np.broadcast_to((stored / np.iinfo(kind).max).reshape(20, 30, -1), (20, 30, 3)))
    np.testing.assert_allclose(read.pixels, expected, rtol=1e-5, atol=1e-6)
    assert read.usable.all() and read.bits == (8 if kind is np.uint8 else 16)


@pytest.mark.parametrize(("name", "least"), [("agx", 240), ("agx-punchy", 200), ("filmic", 240), ("khronos", 245)])
def test_near_white_a_code_is_a_lower_bound(tmp_path, name, least):
    """A code more is much more light there; in the middle, and of a colour that is not bright, it is what it says."""
    stored = np.repeat(np.arange(100, 256, dtype=np.uint8)[:, None, None], 3, 2)
    cv2.imwrite(str(tmp_path / "p.png"), stored)
    read = images.read_linear(tmp_path / "p.png", colorspace=name)
    first = 100 + int(read.clipped[:, 0, 0].argmax())
    assert least < first < 254 and read.clipped[first - 100 :].all() and not read.clipped[: first - 100].any()
    assert (read.usable == ~read.clipped.any(-1)).all()
    red = np.full((1, 1, 3), [20, 60, 252], np.uint8)  # blue, green, red
    cv2.imwrite(str(tmp_path / "red.png"), red)
    read = images.read_linear(tmp_path / "red.png", colorspace="agx")
    assert read.clipped[0, 0].tolist() == [True, False, False]
