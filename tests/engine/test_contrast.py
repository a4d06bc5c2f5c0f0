# SPDX-License-Identifier: GPL-3.0-or-later
"""Statistics of a texture: which size, strength, form and direction it has, whatever the light's level and slow
changes."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from btfsep_engine.recognise.contrast import SIGMAS, contrast, unlike

MASK = np.hypot(*(np.indices((160, 160)) - 80.0)) < 70


def texture(rng, sigma, strength):
    """A surface whose log2 radiance varies by ``strength`` over about ``sigma`` pixels."""
    grain = gaussian_filter(rng.standard_normal(MASK.shape), sigma)
    return 2.0 ** (strength * grain[..., None] / grain.std() * np.ones(3))


def test_a_band_shows_the_texture_of_its_size(rng):
    """Noise that is blurred by so many pixels is strongest, beside white noise, in ever coarser bands."""
    white = contrast(texture(np.random.default_rng(1), 0, 0.3), MASK).deviation[:, 0]
    sizes = [contrast(texture(rng, sigma, 0.3), MASK).deviation[:, 0] for sigma in (0.3, 0.8, 1.6, 3.5)]
    beside = [(size[0] / size[-1]) / (white[0] / white[-1]) for size in sizes]
    assert beside[0] > 0.9 and (np.diff(beside) < -0.02).all() and len(sizes[0]) == len(SIGMAS) - 1
    fine, coarse = (contrast(texture(rng, sigma, 0.3), MASK) for sigma in (3.0, 8.0))
    assert fine.coarse[0] > 1.2 * fine.coarse[1] and coarse.coarse[1] > 1.2 * coarse.coarse[0]


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
    dark, _, _, bright = np.abs([pits.tails[-1], grains.tails[-1]]).T
    assert dark[0] > bright[0] + 0.5 and bright[1] > dark[1] + 0.5 and unlike(pits, grains)["tails"] > 0.03
    assert (pits.tails[:, 0] < pits.tails[:, 1]).all() and (pits.tails[:, 2] < pits.tails[:, 3]).all()
    faint = contrast(2.0 ** (-0.02 * bumps), MASK), contrast(2.0 ** (0.02 * bumps), MASK)
    assert unlike(*faint)["tails"] < 0.003


def test_threads_have_a_direction_whichever_it_is_and_noise_has_none(rng):
    rows, columns = np.indices(MASK.shape)
    across, slanted = (np.sin(2 * np.pi / 7 * place) for place in (columns, (rows + 2 * columns) / np.sqrt(5)))
    across, slanted = (contrast(2.0 ** (0.2 * wave[..., None] * np.ones(3)), MASK) for wave in (across, slanted))
    noise = contrast(texture(rng, 1.0, 0.2), MASK)
    assert min(across.directed[:2].min(), slanted.directed[:2].min()) > 0.9 and noise.directed.max() < 0.6
    assert unlike(across, slanted)["directed"] < 0.02 < 0.3 < unlike(across, noise)["directed"]


def test_an_edge_is_in_all_bands_at_one_place_and_noise_is_not(rng):
    spots = np.zeros(MASK.shape)
    spots[tuple(rng.integers(0, 160, (2, 150)))] = 1.0
    spots = gaussian_filter(spots, 0.7)
    spots = contrast(2.0 ** (2 * spots / spots.max())[..., None] * np.ones(3), MASK)
    noise = contrast(texture(rng, 0.7, 0.3), MASK)
    assert (spots.together > noise.together + 0.08).all() and unlike(spots, noise)["together"] > 0.1


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
    assert unlike(red, grey)["correlation"] > 0.3
