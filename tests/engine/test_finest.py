# SPDX-License-Identifier: GPL-3.0-or-later
"""What a photo has kept of the finest detail, and renderings that have kept as much."""

import cv2
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from btfsep_engine.imaging.srgb import linear_to_srgb, srgb_to_linear
from btfsep_engine.pipeline.verification import Photographed
from btfsep_engine.recognise.contrast import contrast_of, unlike
from btfsep_engine.recognise.finest import as_kept, finest, judged_as
from btfsep_engine.recognise.masked import Masked

MASK = np.hypot(*(np.indices((160, 160)) - 80.0)) < 70
SEEN = Masked(MASK, MASK)


def texture(rng, sigma, strength):
    """A surface whose log2 radiance varies by ``strength`` over about ``sigma`` pixels."""
    grain = gaussian_filter(rng.standard_normal(MASK.shape), sigma)
    return 2.0 ** (strength * grain[..., None] / grain.std() * np.ones(3))


def noisy(image, strength, rng):
    """With shot noise of so much of the mean."""
    return image + strength * np.sqrt(image * image[MASK].mean()) * rng.standard_normal(image.shape)


def values(image):
    return SEEN.values_of(np.asarray(image, np.float32))


def difference(a, b):
    """How unlike two pictures (n, 3) are."""
    return sum(unlike(contrast_of(a, SEEN), contrast_of(b, SEEN)).values())


def coded(image, quality):
    """The image as JPEG keeps it."""
    code = (linear_to_srgb(np.clip(image / 4, 0, 1)) * 255).round().astype(np.uint8)
    code = cv2.imencode(".jpg", code, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
    return 4 * srgb_to_linear(cv2.imdecode(code, cv2.IMREAD_COLOR) / 255)


def test_a_photo_that_has_lost_its_finest_detail_is_spoilt(rng):
    """By blur, and by JPEG's blocks, wherever in the photo the window begins; noise over it is another matter."""
    image = texture(rng, 0.5, 0.3)
    blurred = gaussian_filter(image, (1.2, 1.2, 0))
    noisy = image * (1 + 0.1 * rng.standard_normal(image.shape))
    assert [judged_as(each, MASK) for each in (image, noisy, blurred)] == ["verified", "grainy", "spoilt"]
    assert judged_as(coded(image, 98), MASK) == "verified"
    for begin in (0, 3):
        assert judged_as(coded(image, 15)[begin:, begin:], MASK[begin:, begin:]) == "spoilt"


def test_colours_of_a_texture_and_how_8_bits_are_rounded_are_no_noise(rng):
    image = texture(rng, 0.8, 0.3)
    rounded = srgb_to_linear((linear_to_srgb(np.clip(image / 4, 0, 1)) * 255).round() / 255)
    assert [judged_as(each, MASK) for each in (rounded, image ** np.linspace(0.7, 1.3, 3))] == ["verified"] * 2


@pytest.mark.parametrize("sigma", (0.8, 1.0, 1.4))
def test_a_rendering_is_blurred_as_the_photo_is_and_no_further(sigma, rng):
    """The texture comes from another draw: nothing but its statistics can be found again."""
    photo, rendering = texture(rng, 0.5, 0.3), values(texture(rng, 0.5, 0.3))
    photo = values(gaussian_filter(photo, (sigma, sigma, 0)))
    found = as_kept(rendering, SEEN, finest(photo, SEEN))
    assert finest(found, SEEN).sharp == pytest.approx(finest(photo, SEEN).sharp, rel=0.1)
    assert difference(found, photo) < 0.2 * difference(rendering, photo)
    softer = values(gaussian_filter(texture(rng, 0.5, 0.3), (2.5, 2.5, 0)))
    assert as_kept(softer, SEEN, finest(photo, SEEN)) is softer


@pytest.mark.parametrize("strength", (0.08, 0.2))
def test_a_rendering_is_as_grainy_as_the_photo(strength, rng):
    photo, rendering = values(noisy(texture(rng, 0.8, 0.2), strength, rng)), values(texture(rng, 0.8, 0.2))
    of_photo = finest(photo, SEEN)
    found = as_kept(rendering, SEEN, of_photo)
    assert of_photo.model == "grainy" and finest(found, SEEN).grain == pytest.approx(of_photo.grain, rel=0.1)
    assert difference(found, photo) < 0.5 * difference(rendering, photo)
    assert np.array_equal(as_kept(rendering, SEEN, of_photo), found)  # the same at every run


def test_noise_is_never_laid_on_noise_of_its_own(rng):
    """A rendering that is as grainy already, its texture's colours, stays."""
    photo = values(noisy(texture(rng, 0.8, 0.2), 0.1, rng))
    assert np.allclose(as_kept(photo, SEEN, finest(photo, SEEN)), photo)


def test_beside_a_clear_photo_renderings_are_as_they_are(rng):
    photo, soft = values(texture(rng, 0.5, 0.3)), values(texture(rng, 2.0, 0.3))
    for rendering in (photo, soft, values(noisy(texture(rng, 0.5, 0.3), 0.2, rng))):
        assert as_kept(rendering, SEEN, finest(photo, SEEN)) is rendering


def test_an_even_photo_and_an_even_rendering_are_no_stumbling_block(rng):
    """As of a photo of 8 bits out of focus, or of a rendering that is dark in most places."""
    even = np.ones((SEEN.valid.sum(), 3), np.float32)
    nearly = values(np.where(np.indices(MASK.shape)[1][..., None] < 50, texture(rng, 0.5, 0.3), 1.0))
    for photo in (even, nearly):
        for rendering in (even, nearly, values(texture(rng, 0.5, 0.3))):
            assert np.isfinite(as_kept(rendering, SEEN, finest(photo, SEEN))).all()


def test_of_few_pixels_nothing_is_said(rng):
    few = np.zeros_like(MASK)
    few[60:80, 60:80] = True
    seen = Masked(few, few)
    blurred = gaussian_filter(texture(rng, 0.5, 0.3), (2, 2, 0))[few].astype(np.float32)
    assert finest(blurred, seen).model == "verified" and as_kept(blurred, seen, finest(blurred, seen)) is blurred


@pytest.mark.parametrize("flaw", ("blurred", "noisy"))
def test_candidates_are_compared_as_the_photos_camera_would_have_kept_them(flaw, rng):
    """Of two textures that differ in grain, the photo's own is the more alike for it, and the other hardly."""

    def spoilt(image):
        return gaussian_filter(image, (1.1, 1.1, 0)) if flaw == "blurred" else noisy(image, 0.15, rng)

    photo, own, coarser = (
        values(image) for image in (spoilt(texture(rng, 0.5, 0.3)), *(texture(rng, sigma, 0.3) for sigma in (0.5, 1.5)))
    )
    photographed = Photographed(SEEN, contrast_of(photo, SEEN), finest(photo, SEEN))
    as_it_is, as_kept_there = (
        [sum(unlike(look(picture), photographed.contrast).values()) for picture in (own, coarser)]
        for look in (lambda picture: contrast_of(picture, SEEN), photographed.beside)
    )
    assert as_kept_there[0] < 0.5 * as_it_is[0] and as_kept_there[0] < 0.4 * as_kept_there[1]
