# SPDX-License-Identifier: GPL-3.0-or-later
"""Fisher vectors and flat textures of the study of descriptors."""

from dataclasses import replace

import numpy as np
import pytest

from btfsep_engine.btf.library import open_library
from btfsep_engine.recognise import descriptors as dense
from btfsep_engine.recognise import vlad
from scripts.studies import fisher
from scripts.studies.descriptors import compared, flattened


def nudged(of, j, axis, mean=0.0, deviation=0.0):
    """A mixture with one Gaussian's mean and deviation moved along an axis, in its own deviations."""
    made = fisher.GaussianMixture(len(of.means_), covariance_type="diag")
    sigma = np.sqrt(of.covariances_)
    made.weights_, made.means_ = of.weights_, of.means_.copy()
    made.means_[j, axis] += mean * sigma[j, axis]
    sigma[j, axis] *= 1 + deviation
    made.covariances_, made.precisions_cholesky_ = sigma**2, 1 / sigma
    return made


def test_the_vector_is_the_gradient_of_the_likelihood(rng):
    """Against differences of scikit-learn's own log-likelihood, over the roots of w and of 2 w."""
    points = rng.normal(size=(900, 4)) * [1, 2, 0.5, 1] + 2 * rng.integers(0, 3, (900, 1))
    of = fisher.mixture(points, vlad.learn_words(points, 5))
    assert of.weights_.sum() == pytest.approx(1) and of.weights_.min() > 0.01
    some, group, step = rng.normal(size=(60, 4)) + 2, rng.integers(0, 2, 60), 1e-5
    found = fisher.gradients(some, of, group, 2)
    for j, axis, g in ((0, 1, 0), (2, 3, 1), (4, 0, 0)):
        for row, what, factor in ((0, "mean", 1), (1, "deviation", 2)):
            up, down = (nudged(of, j, axis, **{what: s}).score_samples(some[group == g]).sum() for s in (step, -step))
            slope = (up - down) / (2 * step) / np.sqrt(factor * of.weights_[j])
            assert found[g, row, j, axis] == pytest.approx(slope, abs=1e-4 * np.abs(found).max())


def test_fisher_vectors_are_laid_out_as_those_of_vlad(rng):
    encoding = vlad.Encoding(colour_words=4, sift_words=6, sift_components=8, colour_weight=0.3)
    sample = dense.Descriptors(
        rng.normal(size=(700, 27)).astype(np.float32),
        rng.integers(0, 200, (700, 128)).astype(np.uint8),
        rng.uniform(0, 1, 700).astype(np.float32),
        rng.uniform(0, 90, (700, 2)).astype(np.float32),
    )
    rows = fisher.learn_encoder(sample, half_contrast=0.05, encoding=encoding).encode(sample)
    assert rows.shape == (5, 2 * (4 * 27 + 6 * 8))
    np.testing.assert_allclose(np.linalg.norm(rows, axis=1), 1, atol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(rows[:, : 2 * 4 * 27], axis=1) ** 2, 0.3, atol=1e-5)


@pytest.mark.parametrize("gloss", [False, True])
def test_a_flat_texture_has_the_colours_and_the_same_angles_everywhere(gloss):
    material = open_library().load("fabric/denim-twill")
    flat = flattened(material, gloss=gloss)
    texel = flat.texels.reshape(-1, 3)[[0, 777]]
    a, b = (flat.angular * t @ np.ones(3) for t in texel)
    np.testing.assert_allclose(a / texel[0], b / texel[1], rtol=1e-4)  # of two places only the factor differs
    front = int(np.argmax(material.views[:, 2]))
    np.testing.assert_allclose(
        replace(flat, texels=flat.texels[:1, :1]).directional_albedo()[front],
        replace(material, texels=material.texels[:1, :1]).directional_albedo()[front],
        rtol=1e-3,
    )
    spread = a.std((0, 1)) / a.mean((0, 1))
    assert (spread > 0.05).all() if gloss else (spread < 1e-5).all()


def test_two_ways_are_compared_by_what_only_one_has_right():
    first, second = np.repeat([True, False, True], [9, 1, 10]), np.repeat([False, True, True], [9, 1, 10])
    only, p, by_mesh = compared(first, second, [f"mesh {i % 4 if i < 9 else 4}" for i in range(20)])
    assert only == "9 : 1"
    assert float(p) == pytest.approx(22 / 1024, rel=0.03)  # at most 1 of 10 on either side
    # the meshes' sums are 3, 2, 2, 2 and -1: as far as their 8 are the first four alike, whatever the last
    assert float(by_mesh) == pytest.approx(4 / 32, rel=0.05)
