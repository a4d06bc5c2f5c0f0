# SPDX-License-Identifier: GPL-3.0-or-later
"""The one-pass factorisation against exact linear algebra."""

import numpy as np
import pytest

from btfsep_engine.btf.factorise import StreamingFactoriser


def low_rank(rank, *, texels=900, columns=600, noise=0.0, seed=0):
    """Positive, mean 1 a column, deviations below the clip: (texels, columns)."""
    rng = np.random.default_rng(seed)
    left = rng.normal(0, 1, (texels, rank)).clip(-2, 2)
    left -= left.mean(0)
    right = rng.normal(0, 1, (rank, columns)) * (0.25 * 0.75 ** np.arange(rank))[:, None]
    m = 1 + left @ right + noise * rng.normal(0, 1, (texels, columns))
    return m.astype(np.float32)


def factorise(m, components, *, blocks=40, seed=0):
    factoriser = StreamingFactoriser(len(m), components, seed=seed)
    for block in np.array_split(m, blocks, axis=1):
        factoriser.add(block)
    return factoriser.finish()


def error(m, factors):
    return np.linalg.norm(m - factors.texels @ factors.angular.T) / np.linalg.norm(m)


def test_exact_rank_is_recovered():
    m = low_rank(6)
    factors = factorise(m, 7)
    assert error(m, factors) < 1e-4
    assert factors.relative_error < 1e-3


@pytest.mark.parametrize("components", [3, 6])
def test_truncation_is_nearly_the_best_one(components):
    m = low_rank(12, noise=0.05)
    centred = m - m.mean(0)
    singular = np.linalg.svd(centred.astype(float), compute_uv=False)
    best = np.sqrt((singular[components - 1 :] ** 2).sum()) / np.linalg.norm(m)
    factors = factorise(m, components)
    assert best <= error(m, factors) < 1.06 * best
    assert factors.relative_error == pytest.approx(error(m, factors), rel=0.05)


def test_mean_is_exact_and_patterns_are_normalised():
    m = low_rank(8, noise=0.1)
    factors = factorise(m, 5)
    np.testing.assert_array_equal(factors.texels[:, 0], 1)
    np.testing.assert_allclose(factors.angular[:, 0], m.mean(0), rtol=1e-5)
    np.testing.assert_allclose(factors.texels[:, 1:].mean(0), 0, atol=1e-5)
    np.testing.assert_allclose((factors.texels[:, 1:] ** 2).mean(0), 1, rtol=1e-4)
    weight = (factors.angular[:, 1:] ** 2).sum(0)
    assert (np.diff(weight) < 0.05 * weight[0]).all()


def test_noise_is_averaged_out():
    clean = low_rank(3, texels=2500, columns=3000)
    noisy = clean + np.random.default_rng(9).normal(0, 0.3, clean.shape).astype(np.float32)
    factors = factorise(noisy, 4)
    assert error(clean, factors) < 0.15 * np.linalg.norm(noisy - clean) / np.linalg.norm(clean)


def test_a_glint_does_not_take_over():
    """One column a hundred times brighter in one texel must not cost the pattern of all others."""
    m = low_rank(1)
    m[17, 5] += 500
    factors = factorise(m, 2)
    rest = np.delete(np.arange(m.shape[1]), 5)
    assert np.linalg.norm((m - factors.texels @ factors.angular.T)[:, rest]) < 0.02 * np.linalg.norm(m[:, rest] - 1)


def test_seed_and_small_input():
    m = low_rank(4, noise=0.1)
    a, b, c = factorise(m, 3, seed=1), factorise(m, 3, seed=1), factorise(m, 3, seed=2)
    np.testing.assert_array_equal(a.angular, b.angular)
    assert not np.array_equal(a.angular, c.angular)
    tiny = factorise(np.full((1, 4), 0.5, np.float32), 5, blocks=2)
    np.testing.assert_allclose(tiny.texels @ tiny.angular.T, 0.5)
