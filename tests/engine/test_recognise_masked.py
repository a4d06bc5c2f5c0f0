# SPDX-License-Identifier: GPL-3.0-or-later
"""What images of the same pixels share: means of usable pixels, what is filled, places; none has a part in another."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from btfsep_engine.recognise import descriptors
from btfsep_engine.recognise.contrast import contrast, contrast_of
from btfsep_engine.recognise.masked import Masked

SIDE = 119
FROM_CENTRE = np.hypot(*(np.indices((SIDE, SIDE)) - SIDE // 2))
MASK = FROM_CENTRE < 60  # as large as the image: `extract` looks at no more


@pytest.fixture
def holed(rng):
    """A usable disk with a large hole and single pixels that are not."""
    valid = MASK & (rng.random(MASK.shape) > 0.01)
    valid[50:75, 40:55] = False
    return Masked(MASK, valid)


def image(rng, sigma=1.5) -> np.ndarray:
    grain = np.stack([gaussian_filter(rng.standard_normal(MASK.shape), sigma) for _ in range(3)], -1)
    return np.float32(2.0 ** (0.5 * grain / grain.std()))


@pytest.mark.parametrize("sigma", [0.8, 3.2])
def test_means_are_those_of_usable_pixels(rng, holed, sigma):
    pixels = np.flatnonzero(MASK)[::7]
    values = holed.values_of(image(rng))
    found = holed.mean(holed.image(values), sigma, pixels)
    weighted = gaussian_filter(holed.image(values).astype(float), (sigma, sigma, 0))
    share = gaussian_filter(holed.valid.astype(float), sigma)
    known = share.ravel()[pixels] > 0.3
    expected = (weighted / np.maximum(share, 1e-9)[..., None]).reshape(-1, 3)[pixels]
    assert np.sqrt(np.square(found - expected)[known].mean()) < 0.1 * expected[known].std()
    plane = np.ascontiguousarray(holed.image(values)[..., 1])
    np.testing.assert_allclose(holed.mean(plane, sigma).ravel()[pixels], found[:, 1], rtol=1e-4)


def test_what_is_filled_is_like_its_neighbours_and_the_rest_as_it_was(rng, holed):
    even = np.float32([0.2, 0.5, 0.9])
    of_one_colour = holed.image(np.tile(even, (len(holed.pixels), 1)))
    holed.fill(of_one_colour, 20)
    near = FROM_CENTRE < 75
    np.testing.assert_allclose(of_one_colour[near], np.broadcast_to(even, (near.sum(), 3)), rtol=1e-3)
    values = holed.values_of(image(rng))
    filled = holed.image(values)
    holed.fill(filled, 20)
    np.testing.assert_array_equal(holed.values_of(filled), values)


def test_images_of_the_same_pixels_are_described_as_if_each_were_alone(rng, holed):
    """After another image has been there."""
    for picture in (image(rng), image(rng, 0.8), 3 * image(rng, 4.0)):
        radiance = np.where(holed.valid[..., None], picture, np.nan)
        alone, values = descriptors.extract(radiance, MASK), holed.values_of(picture)
        found = descriptors.described(values, holed)
        np.testing.assert_array_equal(found.xy, alone.xy)
        np.testing.assert_allclose(found.colour, alone.colour, atol=1e-4)
        assert np.abs(found.sift.astype(int) - alone.sift).max() <= 1  # they are rounded
        np.testing.assert_allclose(found.contrast, alone.contrast, atol=1e-5)
        one, other = contrast_of(values, holed), contrast(radiance, MASK)
        for name, value in vars(one).items():
            np.testing.assert_array_equal(value, getattr(other, name))


def test_what_is_shared_is_that_of_the_same_pixels(rng, holed):
    shared: dict = {}
    for picture, valid in ((image(rng), holed.valid), (image(rng), MASK), (image(rng), MASK)):
        radiance = np.where(valid[..., None], picture, np.nan)
        one, other = (descriptors.extract(radiance, MASK, **how) for how in ({"shared": shared}, {}))
        for name, value in vars(one).items():
            np.testing.assert_array_equal(value, getattr(other, name))
    assert len(shared) == 1


@pytest.mark.parametrize("settings", [descriptors.DEFAULT, descriptors.PAPER])
def test_no_patch_looks_farther_than_is_filled(rng, monkeypatch, holed, settings):
    values = holed.values_of(image(rng))
    usual = descriptors.described(values, holed, settings=settings)
    monkeypatch.setattr(descriptors, "_reach", lambda _: SIDE)
    farther = descriptors.described(values, Masked(holed.mask, holed.valid), settings=settings)
    np.testing.assert_array_equal(usual.sift, farther.sift)
    np.testing.assert_array_equal(usual.colour, farther.colour)
    np.testing.assert_allclose(usual.contrast, farther.contrast, atol=1e-6)
