# SPDX-License-Identifier: GPL-3.0-or-later
"""Dictionaries and VLAD against naive loops."""

from dataclasses import replace

import numpy as np
import pytest

from btfsep_engine.recognise import descriptors as dense
from btfsep_engine.recognise import vlad


def naive_vlad(points, words):
    out = np.zeros_like(words, dtype=np.float64)
    for x in points:
        j = min(range(len(words)), key=lambda k: float(((x - words[k]) ** 2).sum()))
        out[j] += x - words[j]
    return out


def test_aggregate_is_equation_2_in_every_group(rng):
    points, words = rng.normal(size=(300, 5)).astype(np.float32), rng.normal(size=(7, 5)).astype(np.float32)
    groups = rng.integers(0, 3, 300)
    sums = vlad.aggregate(points, words, groups, 4)
    assert sums.shape == (4, 7, 5)
    for g in range(3):
        np.testing.assert_allclose(sums[g], naive_vlad(points[groups == g], words), atol=1e-4)
    assert not sums[3].any()


def test_power_and_length():
    flat = vlad.normalise(np.array([[[4.0, -9.0]], [[0.0, 0.0]]]), 0.5)
    np.testing.assert_allclose(flat[0], np.array([2, -3]) / np.sqrt(13))
    assert not flat[1].any()
    plain = vlad.normalise(np.array([[[3.0, -4.0]]]), 1.0)
    np.testing.assert_allclose(plain[0], [0.6, -0.8])


def described(rng, n=600):
    return dense.Descriptors(
        rng.normal(size=(n, 27)).astype(np.float32),
        rng.integers(0, 200, (n, 128)).astype(np.uint8),
        rng.uniform(0, 1, n).astype(np.float32),
        rng.uniform(0, 100, (n, 2)).astype(np.float32),
    )


def test_dictionaries_have_the_papers_sizes(rng):
    encoder = vlad.learn_encoder(described(rng, 1500), half_contrast=0.05)
    assert encoder.dictionaries["colour"].words.shape == (150, 27)
    words = encoder.dictionaries["sift"].words
    assert words.shape[0] == 250 and len(np.unique(words, axis=0)) == 250


def test_words_are_means_of_their_points(rng):
    centres = np.array([[0, 0], [50, 0], [0, 50]])
    points = (centres[:, None] + rng.normal(size=(3, 200, 2))).reshape(-1, 2).astype(np.float32)
    words = vlad.learn_words(points, 3, seed=1)
    nearest = vlad.nearest_word(points, words)
    for j in range(3):
        np.testing.assert_allclose(words[j], points[nearest == j].mean(0), atol=0.1)


def test_fewer_points_than_words(rng):
    points = rng.normal(size=(4, 3)).astype(np.float32)
    words = vlad.learn_words(points, 9)
    assert words.shape == (9, 3)
    assert (vlad.nearest_word(points, words) == np.arange(4)).all()


def test_projection_keeps_the_distances_it_can(rng):
    sift = np.zeros((400, 128), np.uint8)
    sift[:, :6] = rng.integers(1, 200, (400, 6))
    ones = np.ones(400, np.float32)
    encoding = vlad.Encoding(colour_words=2, sift_words=2, sift_components=8)
    sample = replace(described(rng, 400), sift=sift, contrast=ones)
    encoder = vlad.learn_encoder(sample, half_contrast=0.05, encoding=encoding)
    roots, projected = vlad.weighted_sift(sift, ones, 0.05), encoder.projected(sample)["sift"]
    assert projected.shape == (400, 8)
    full = np.linalg.norm(roots[:50, None] - roots[None, :50], axis=-1)
    kept = np.linalg.norm(projected[:50, None] - projected[None, :50], axis=-1)
    np.testing.assert_allclose(kept, full, atol=1e-4)


def test_a_flat_patch_says_little(rng):
    sift = rng.integers(1, 200, (2, 128)).astype(np.uint8)
    lengths = np.linalg.norm(vlad.weighted_sift(sift, np.array([0.0, 5.0]), 0.05), axis=1)
    assert lengths[0] == 0 and lengths[1] == pytest.approx(5 / 5.05)


def test_the_last_vector_is_that_of_the_whole_object(rng):
    some, encoder = described(rng), vlad.learn_encoder(described(rng, 900), half_contrast=0.05)
    rows = encoder.encode(some)
    assert len(rows) == 5
    whole, same = replace(encoder, encoding=replace(encoder.encoding, windows=1)).encode(some)
    np.testing.assert_allclose(rows[-1], whole, atol=1e-4)
    np.testing.assert_array_equal(whole, same)
    np.testing.assert_allclose(np.linalg.norm(rows, axis=1), 1, atol=1e-5)
    assert np.abs(rows[:4] - rows[-1]).max() > 0.01


@pytest.mark.parametrize("weight", [0.5, 0.2])
def test_each_kind_has_its_share_of_a_vectors_length(rng, weight):
    encoding = replace(vlad.DEFAULT, colour_weight=weight)
    encoder = vlad.learn_encoder(described(rng, 900), half_contrast=0.05, encoding=encoding)
    colours, sift = np.split(encoder.encode(described(rng))[-1], [150 * 27])
    assert len(sift) == 250 * 40 and np.square(colours).sum() == pytest.approx(weight, abs=1e-4)


def test_the_shipped_words_are_of_the_default_encoding(rng):
    encoder = vlad.ready_encoder()
    assert encoder.half_contrast == 0.05 and encoder.encoding == vlad.DEFAULT
    shapes = {kind: (d.words.shape, d.axes.shape) for kind, d in encoder.dictionaries.items()}
    assert shapes == {"colour": ((150, 27), (27, 27)), "sift": ((250, 40), (128, 40))}
    assert all(np.isfinite(a).all() for d in encoder.dictionaries.values() for a in vars(d).values())
    assert encoder.encode(described(rng)).shape == (5, 14050)


def test_the_papers_vectors_are_equation_2_on_raw_sift_and_nothing_else(rng):
    some = described(rng)
    encoder = vlad.learn_encoder(described(rng, 900), half_contrast=0.0, encoding=vlad.PAPER)
    colour, sift = encoder.dictionaries.values()
    assert colour.words.shape == (150, 27) and sift.words.shape == (250, 128)
    parts = naive_vlad(some.colour, colour.words), naive_vlad(some.sift / 512.0, sift.words + sift.mean)
    expected = np.concatenate([p.ravel() / np.linalg.norm(p) for p in parts]) / np.sqrt(2)
    np.testing.assert_allclose(encoder.encode(some)[-1], expected, atol=1e-4)


@pytest.mark.parametrize("count", [1, 2, 4, 8])
def test_windows_are_even_and_local(rng, count):
    xy = rng.uniform(0, 100, (1000, 2))
    window = vlad.split_windows(xy, count)
    sizes = np.bincount(window, minlength=count)
    assert sizes.sum() == 1000 and np.ptp(sizes) <= 1
    if count == 4:  # quarters of a square: no window spans it
        assert all(np.ptp(xy[window == i], axis=0).max() < 60 for i in range(4))
