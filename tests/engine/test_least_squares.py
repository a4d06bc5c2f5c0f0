# SPDX-License-Identifier: GPL-3.0-or-later
"""The fit against LAPACK's least squares, known answers and simulated noise."""

import numpy as np
import pytest

from btfsep_engine.errors import InputError
from btfsep_engine.fit.least_squares import block_labels, solve
from btfsep_engine.fit.stated import determined
from btfsep_engine.light.log_field import natural_field, natural_spread


def problem(rng, pixels=3000, terms=9):
    basis = rng.normal(size=(pixels, terms, 3)) + np.linspace(2, 0, terms)[:, None]
    return basis, rng.normal(size=(terms, 3)), np.arange(pixels) // 30


def test_exact_data_give_back_the_light(rng):
    basis, x, blocks = problem(rng)
    fit = solve(basis, np.einsum("pmc,mc->pc", basis, x), blocks=blocks)
    assert np.allclose(fit.coefficients, x, atol=1e-10)
    assert fit.residual < 1e-12


def test_noisy_data_give_lapacks_answer_and_condition(rng):
    basis, x, blocks = problem(rng)
    b = np.einsum("pmc,mc->pc", basis, x) + rng.normal(size=(len(basis), 3))
    fit = solve(basis, b, blocks=blocks)
    conditions = []
    for c in range(3):
        expected, _, _, singular = np.linalg.lstsq(basis[:, :, c], b[:, c], rcond=None)
        assert np.allclose(fit.coefficients[:, c], expected, atol=1e-9)
        conditions.append(singular[0] / singular[-1])
    assert fit.condition == pytest.approx(max(conditions), rel=1e-6)
    left = b - np.einsum("pmc,mc->pc", basis, fit.coefficients)
    assert fit.residual == pytest.approx(np.linalg.norm(left) / np.linalg.norm(b))


@pytest.mark.parametrize("correlated", [False, True])
def test_the_stated_spread_is_the_spread(rng, correlated):
    """Repeated noise, independent by pixel or shared within blocks: the estimates scatter as stated."""
    basis, x, blocks = problem(rng, pixels=1200, terms=4)
    truth = np.einsum("pmc,mc->pc", basis, x)
    errors, stated = [], []
    for _ in range(150):
        noise = rng.normal(size=(blocks.max() + 1, 3))[blocks] if correlated else rng.normal(size=truth.shape)
        fit = solve(basis, truth + noise, blocks=blocks)
        errors.append(fit.coefficients - x)
        stated.append(fit.stddev)
    ratio = np.std(errors, 0) / np.mean(stated, 0)
    assert 0.6 < ratio.min() and ratio.max() < 1.3  # rather too large than too small


def test_the_spread_grows_where_neighbours_err_together(rng):
    """A basis that varies slowly over the picture: correlated errors do not average out, and are not taken to."""
    blocks = np.arange(1200) // 30
    basis = rng.normal(size=(40, 4, 3))[blocks]
    noise = rng.normal(size=(40, 3))[blocks]
    together = solve(basis, noise, blocks=blocks).stddev
    apart = solve(basis, rng.permutation(noise), blocks=blocks).stddev
    assert np.median(together / apart) > 3  # sqrt(30) = 5.5 in the limit


def test_too_few_pixels_and_indistinguishable_lights_are_told():
    with pytest.raises(InputError, match="5 usable pixels for 9 unknowns"):
        solve(np.ones((5, 9, 3)), np.ones((5, 3)), blocks=np.zeros(5, int))
    twin = np.random.default_rng(0).normal(size=(100, 2, 3))[:, [0, 1, 1]]
    with pytest.raises(InputError, match="cannot tell 3 basis lights apart"):
        solve(twin, np.ones((100, 3)), blocks=np.zeros(100, int))
    with pytest.raises(InputError, match="reflects nothing"):
        solve(np.zeros((100, 2, 3)), np.ones((100, 3)), blocks=np.zeros(100, int))


def test_blocks_are_squares_of_the_picture():
    pixels = np.stack(np.mgrid[:64, :48], -1).reshape(-1, 2)
    labels = block_labels(pixels)
    assert len(np.unique(labels)) == 12
    assert (np.bincount(labels) == 256).all()


def test_determined_compares_with_what_nature_varies_by_or_its_own_size():
    coefficients = np.array([[2.0] * 3, [0.0] * 3, [0.0] * 3, [0.0] * 3])
    half = 0.5 * 2 * natural_spread()[1]
    stddev = half * np.array([[0.01] * 3, [0.9] * 3, [1.1] * 3, [0.9] * 3])
    assert determined(coefficients, stddev).tolist() == [True, True, False, True]
    coefficients[2] = 10 * half
    assert determined(coefficients, stddev).all()


def test_what_natural_light_alone_says_is_not_determined():
    """Of a photo that tells nothing: every light is as probable as nature has it."""
    field = natural_field()
    lights = field.coefficients(field.radiance(np.random.default_rng(1).standard_normal((200, field.unknowns))))
    relative = (lights / lights[..., :1]).transpose(0, 2, 1)
    assert not determined(np.median(relative, 0), relative.std(0))[1:].any()
