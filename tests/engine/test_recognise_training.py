# SPDX-License-Identifier: GPL-3.0-or-later
"""What recognition is trained on and looks at: noise and blur, two scales, white balance, every window and the whole.

Each of these moves the accuracy on photos by a few points only, which no small test could see: they are looked at
themselves.
"""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from btfsep_engine.imaging.srgb import linear_to_srgb
from btfsep_engine.recognise import descriptors as dense
from btfsep_engine.recognise import training, vlad
from btfsep_engine.recognise.classifier import Nearest, scores
from btfsep_engine.recognise.masked import smoothed
from btfsep_engine.recognise.recogniser import Recogniser

SIDE = 64
STEP = np.where(np.arange(SIDE) < SIDE // 2, 0.5, 1.5)[None, :, None] * np.ones((SIDE, 1, 3))
MASK = np.ones((SIDE, SIDE), bool)


@pytest.fixture
def described(monkeypatch):
    """train(method) -> the images that a training describes, of 40 images of one flat step each."""
    seen, extract = [], dense.extract

    def spy(image, mask, **options):
        seen.append(np.array(image))
        return extract(image, mask, **options)

    monkeypatch.setattr(dense, "extract", spy)

    def run(name):
        method = training.METHODS[name]
        small = replace(method.encoding, colour_words=4, sift_words=4)
        images = [training.TrainingImage("a/b"[: 3 - i % 2], f"light {i}", STEP, MASK) for i in range(40)]
        training.train(images, method=replace(method, encoding=small), classifier="nearest")
        return np.array(seen)

    return run


def test_training_images_have_the_noise_and_the_blur_of_photos(described):
    images = described("tuned")[..., 0]
    flat, mean = images[:, :, 5 : SIDE // 2 - 5], 1.0
    noise = flat.std((1, 2)) / np.sqrt(0.5 * mean)  # shot noise: of the root of the signal
    assert noise.min() < 0.03 and 0.13 < noise.max() < 0.16
    assert noise.mean() == pytest.approx(np.mean(training.NOISES), abs=0.02)
    assert np.corrcoef(flat[0].ravel(), flat[1].ravel())[0, 1] < 0.1
    edge = images.mean(1)  # along the edge noise averages out
    height = edge[:, SIDE // 2] - edge[:, SIDE // 2 - 1]
    assert height.max() > 0.93  # 1 where it is sharp ...
    assert 0.4 < height.min() < 0.6  # ... erf(1 / (2 sqrt 2 0.8)) = 0.47 under the widest blur


def test_the_paper_knows_of_neither(described):
    assert all(np.array_equal(image, STEP) for image in described("paper"))


def test_there_are_two_scales(rng):
    image = np.exp(0.3 * rng.normal(size=(160, 160, 3)))
    mask = np.ones((160, 160), bool)
    both = dense.extract(image, mask)
    parts = [dense.extract(image, mask, settings=replace(dense.DEFAULT, bins=(edge,))) for edge in (4, 7)]
    assert min(map(len, parts)) > 200
    for field in ("colour", "sift", "contrast", "xy"):
        np.testing.assert_array_equal(getattr(both, field), np.concatenate([getattr(p, field) for p in parts]))
    assert both.xy[: len(parts[0])].min() < both.xy[len(parts[0]) :].min()  # large patches keep off the border


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_so_much_of_a_cast_is_taken_out(rng, share):
    """Of a tint of the light by 2^t, 1 - share reaches the colour differences; 0.3 is what photos were best with."""
    assert dense.DEFAULT.white_balance == 0.3
    settings = replace(dense.DEFAULT, white_balance=share, floor=0.0)
    colours = rng.uniform(0.5, 1.5, (1600, 3))
    stops = np.array([0.4, 0.0, -0.6])
    plain, tinted = (dense.normalised(colours * 2**t, settings=settings) for t in (0 * stops, stops))
    change = (tinted - plain)[:, 1:].mean(0)
    assert change == pytest.approx((1 - share) * np.array([0.4, 0.2 + 0.6]), abs=0.01)


def test_the_papers_patches_are_what_a_display_shows(rng):
    colours = rng.uniform(0.5, 1.5, (1600, 3)) * [1.2, 1.0, 0.7]
    shown = dense.normalised(colours, settings=dense.PAPER)
    luminance = colours @ [0.2126, 0.7152, 0.0722]
    mean = luminance[luminance <= np.percentile(luminance, 98)].mean()
    np.testing.assert_allclose(shown, linear_to_srgb(0.18 * colours / mean), atol=1e-3)
    np.testing.assert_allclose(dense.normalised(64 * colours, settings=dense.PAPER), shown, atol=1e-5)


def test_windows_and_the_whole_object_vote_alike():
    """Two windows for each of two materials; the whole object decides, with one vote of five."""
    model = Nearest(("a/a", "b/b"), np.eye(2), np.array([0, 1]))
    recogniser = Recogniser(dense.DEFAULT, None, model)
    slanted = np.array([0.8, 0.6])
    vectors = np.array([slanted, slanted, slanted[::-1], slanted[::-1], [0.0, 1.0]])
    answer = recogniser.judged(vectors)
    assert answer.material == "b/b"
    own = np.array([0.8, 0.8, 0.6, 0.6, 0.0])  # cosines with the first; 1 - d^2 / 2
    votes = np.array([own, [0.6, 0.6, 0.8, 0.8, 1.0]]).mean(1)
    assert answer.candidates[0][1] == pytest.approx(scores(votes, model.sharpness)[1])
    assert recogniser.judged(vectors[:4]).candidates[0][1] == pytest.approx(0.5)


def test_the_paper_trains_an_svm_with_offsets_on_plain_vectors(rng):
    textures = {"a/a": 1.0, "b/b": 0.2}

    def photo(name):
        return np.exp(textures[name] * rng.normal(size=(SIDE, SIDE, 1))) * np.ones(3)

    images = [training.TrainingImage(name, f"light {k}", photo(name), MASK) for name in textures for k in range(4)]
    recogniser = training.train(images, method=training.METHODS["paper"])
    assert recogniser.model.bias.any() and recogniser.encoder.encoding == vlad.PAPER
    assert [d.words.shape for d in recogniser.encoder.dictionaries.values()] == [(150, 27), (250, 128)]
    for name in textures:
        assert recogniser.judged(recogniser.describe(photo(name), MASK)).material == name


@pytest.mark.parametrize("edge", [3, 4, 7])
def test_sift_is_opencvs(rng, edge):
    """On blurred noise, at places off the border: the same numbers, but for the window within a cell."""
    image = cv2.GaussianBlur(rng.normal(size=(160, 160)).astype(np.float32), (0, 0), 2.0)
    y, x = (a.ravel() for a in np.mgrid[40:120:9, 40:120:9])
    found = dense.dense_sift(dense.orientation_maps(image, 1.0), x, y, edge).astype(float)
    coded = np.clip(128 + 60 * image / image.std() / 2, 0, 255).round().astype(np.uint8)
    points = [cv2.KeyPoint(float(u), float(v), edge / 1.5, 0.0) for u, v in zip(x, y, strict=True)]
    _, expected = cv2.SIFT_create(nOctaveLayers=1, sigma=1.0).compute(coded, points)
    assert found.shape == expected.shape == (len(x), 128)
    cosine = (found * expected).sum(1) / (np.linalg.norm(found, axis=1) * np.linalg.norm(expected, axis=1))
    assert np.median(cosine) > 0.95 and cosine.min() > 0.9
    assert np.linalg.norm(found, axis=1) == pytest.approx(512, rel=0.02)


@pytest.mark.parametrize("sigma", [1.0, 6.0, 20.0])
def test_a_wide_blur_on_fewer_pixels_is_that_of_a_gaussian(rng, sigma):
    image = cv2.GaussianBlur(rng.normal(size=(130, 170, 4)).astype(np.float32), (0, 0), 2.0)
    expected = cv2.GaussianBlur(image, (0, 0), sigma)
    inner = np.s_[30:-30, 30:-30]
    difference = smoothed(image, sigma)[inner] - expected[inner]
    assert np.sqrt(np.square(difference).mean()) < 0.2 * expected[inner].std()
