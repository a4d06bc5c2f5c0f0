# SPDX-License-Identifier: GPL-3.0-or-later
"""Contrast by octaves: of which size and strength a texture is, whatever the light's level and slow changes."""

import cv2
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from btfsep_engine.imaging.srgb import linear_to_srgb, srgb_to_linear
from btfsep_engine.recognise.contrast import SIGMAS, contrast, spoilt, unlike

MASK = np.hypot(*(np.indices((160, 160)) - 80.0)) < 70


def texture(rng, sigma, strength):
    """A surface whose log2 radiance varies by ``strength`` over about ``sigma`` pixels."""
    grain = gaussian_filter(rng.standard_normal(MASK.shape), sigma)
    return 2.0 ** (strength * grain[..., None] / grain.std() * np.ones(3))


def test_an_octave_shows_the_texture_of_its_size(rng):
    sizes = [contrast(texture(rng, sigma, 0.4), MASK).deviation[:, 0].argmax() for sigma in (0.7, 1.6, 3.5, 7.0)]
    assert sizes == [0, 1, 2, 3] and len(SIGMAS) == 5


def test_the_strength_is_measured_and_neither_exposure_nor_outline_matters(rng):
    weak, strong = (contrast(texture(np.random.default_rng(3), 1.6, s), MASK) for s in (0.15, 0.3))
    assert strong.deviation[1, 0] / weak.deviation[1, 0] == pytest.approx(2, rel=0.1)
    image = texture(rng, 1.6, 0.3)
    around = np.where(MASK[..., None], image, 1e4)
    cast = 5 * image * [1.3, 1.0, 0.6]
    assert max(unlike(contrast(cast, MASK), contrast(around, MASK)).values()) < 0.02


def test_pits_and_grains_are_unlike_and_noise_is_not(rng):
    """Log radiance with a heavy tail down, or up; and of two nearly even surfaces, which have only noise."""
    bumps = np.maximum(gaussian_filter(rng.standard_normal(MASK.shape), 2), 0) ** 2
    bumps = (1.2 * bumps / bumps.max())[..., None] * np.ones(3)
    pits, grains = contrast(2.0**-bumps, MASK), contrast(2.0**bumps, MASK)
    assert pits.skewness[1] < -0.5 < 0.5 < grains.skewness[1] and unlike(pits, grains)["skewness"] > 0.3
    faint = contrast(2.0 ** (-0.02 * bumps), MASK), contrast(2.0 ** (0.02 * bumps), MASK)
    assert unlike(*faint)["skewness"] < 0.02


def test_unusable_pixels_have_no_say(rng):
    image = texture(rng, 1.6, 0.3)
    spoilt = image.copy()
    spoilt[60:70, 60:70] = np.nan
    assert max(unlike(contrast(image, MASK), contrast(spoilt, MASK)).values()) < 0.05


def test_the_colours_of_a_texture_and_how_they_go_with_its_lightness_are_told(rng):
    """Threads of two colours: as strong in lightness, the bright ones red, or blue, or all of them grey."""
    grain = gaussian_filter(rng.standard_normal(MASK.shape), 1.6)[..., None]
    grain = 0.3 * grain / grain.std()
    red, blue, grey = (contrast(2.0 ** (grain * np.array(c)), MASK) for c in ([2, 1, 0.5], [0.5, 1, 2], [1, 1, 1]))
    assert red.correlation[1, 0] > 0.95 and blue.correlation[1, 0] < -0.95
    assert unlike(red, blue)["correlation"] > 5 * unlike(red, red)["correlation"] + 0.3
    assert unlike(red, grey)["chroma"] > 0.5 and unlike(red, grey)["chroma"] > 2 * unlike(red, blue)["chroma"]


def coded(image, quality):
    """The image as JPEG keeps it."""
    code = (linear_to_srgb(np.clip(image / 4, 0, 1)) * 255).round().astype(np.uint8)
    code = cv2.imencode(".jpg", code, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
    return 4 * srgb_to_linear(cv2.imdecode(code, cv2.IMREAD_COLOR) / 255)


def test_a_photo_that_has_lost_its_finest_detail_is_spoilt(rng):
    """By blur, and by JPEG's blocks, wherever in the photo the window begins; noise alone is no loss."""
    image = texture(rng, 0.5, 0.3)
    blurred = gaussian_filter(image, (1.2, 1.2, 0))
    noisy = image * (1 + 0.1 * rng.standard_normal(image.shape))
    assert [spoilt(each, MASK) for each in (image, noisy, blurred)] == [False, False, True]
    assert not spoilt(coded(image, 98), MASK)
    for begin in (0, 3):
        assert spoilt(coded(image, 15)[begin:, begin:], MASK[begin:, begin:])
