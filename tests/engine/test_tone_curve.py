# SPDX-License-Identifier: GPL-3.0-or-later
"""The family of tone curves against its ends, and the choice by photographs that known curves coded."""

import numpy as np
import pytest
from scipy.special import softmax

from btfsep_engine import sh
from btfsep_engine.fit.log_normal import LightSolver
from btfsep_engine.fit.tone_curve import (
    CAMERAS,
    CANDIDATES,
    LARGEST_OFFSET,
    SRGB,
    ToneCurve,
    darkest_offset,
    importance,
    log_probability,
)
from btfsep_engine.imaging.srgb import srgb_to_linear
from tests.engine.half_sphere import half_sphere

CODES = np.linspace(0, 1.3, 3001)
LAMP = np.array([-0.5, -0.6, 0.62]) / np.linalg.norm([-0.5, -0.6, 0.62])


def test_the_ends_are_linear_and_srgb():
    np.testing.assert_allclose(ToneCurve(0.0).decode(CODES), CODES)
    np.testing.assert_allclose(ToneCurve(1.0).decode(CODES), srgb_to_linear(CODES), rtol=1e-5, atol=1e-12)


@pytest.mark.parametrize("curve", [*CANDIDATES, ToneCurve(0.5, 0.03), ToneCurve(1.0, 0.03)])
def test_every_curve_rises_from_black_to_white_by_its_slope(curve):
    values = curve.decode(CODES)
    assert (np.diff(values) > 0).all()
    assert curve.decode(curve.offset) == 0 and curve.decode(1.0) == pytest.approx(1)
    step = 1e-6
    slope = (curve.decode(CODES + step) - curve.decode(CODES - step)) / (2 * step)
    smooth = np.abs((CODES - curve.offset) / (1 - curve.offset) - 0.04045) > 1e-5
    np.testing.assert_allclose(np.exp(curve.log_slope(CODES))[smooth], slope[smooth], rtol=1e-4)


def test_an_offset_is_what_no_pixel_is_below_unless_it_is_large():
    codes = np.full((100, 100, 3), 0.5)
    codes[:20] = 0.03
    assert darkest_offset(codes) == pytest.approx(0.03)
    codes[:20] = 0.0
    assert darkest_offset(codes) == 0
    codes[:20] = LARGEST_OFFSET + 0.01
    assert darkest_offset(codes) == 0


def photographed(rng, *, lamp, sky=1.0):
    """Basis images of a half sphere, its normals, and its radiance under a sky (and a lamp), to 0.95, noise of 0.01."""
    basis, normals, _ = half_sphere(rng, pixels=1200, albedo=(0.7, 0.6, 0.5))
    x = np.zeros((100, 3))
    x[:4] = sky * np.array([[1.0, 1.1, 1.3], [0.1, 0.1, 0.1], [0.3, 0.4, 0.5], [-0.1, -0.1, -0.1]])
    if lamp:
        x += 3 * sh.evaluate(9, LAMP[None])[0][:, None] * [1.0, 0.9, 0.8]
    b = np.einsum("pmc,mc->pc", basis, x)
    b = 0.95 * b / b.max()
    return basis, normals, np.clip(b + 0.01 * rng.normal(size=b.shape), 0, 1)


def coded(radiance, curve):
    """8-bit codes, 0 to 1, of which ``curve`` makes the radiance."""
    codes = np.linspace(0, 1, 1 << 16)
    return np.round(np.interp(radiance, curve.decode(codes), codes) * 255) / 255


def logs_of(basis, normals, codes, curves):
    solver, weights = LightSolver(basis, normals=normals, order=4), importance(codes, codes >= 1)
    fits = [solver.solve(curve.decode(codes), weights=weights) for curve in curves]
    return np.array([log_probability(f, c.log_slope(codes), weights) for f, c in zip(fits, curves, strict=True)])


@pytest.mark.parametrize("lamp", [True, False])
@pytest.mark.parametrize("true", range(len(CANDIDATES) - 1))
def test_a_photo_finds_the_curve_that_coded_it_or_the_next(true, lamp):
    basis, normals, b = photographed(np.random.default_rng(7), lamp=lamp)
    logs = logs_of(basis, normals, coded(b, CANDIDATES[true]), CANDIDATES)
    assert abs(int(logs.argmax()) - true) <= 1
    near = np.abs(np.arange(len(CANDIDATES)) - true) <= 1
    shares = softmax(logs)
    assert shares[near].mean() > (2 if lamp else 1.2) * shares[~near].mean()


@pytest.mark.parametrize("true", [SRGB, *CAMERAS])
def test_a_photo_by_a_camera_is_told_from_srgb_alone(true):
    basis, normals, b = photographed(np.random.default_rng(7), lamp=True)
    curves = [SRGB, *CAMERAS]
    logs = logs_of(basis, normals, coded(b, true), curves)
    assert abs(int(logs.argmax()) - curves.index(true)) <= 1
    assert (logs[0] > logs[3]) == (true is SRGB or true.strength < 0.75)


@pytest.mark.parametrize("steepness", [0.0, 0.5])
def test_an_offset_is_found_where_there_is_one(steepness):
    basis, normals, b = photographed(np.random.default_rng(7), lamp=True, sky=0.05)
    two = ToneCurve(steepness), ToneCurve(steepness, 0.04)
    for true in two:
        logs = logs_of(basis, normals, coded(b, true), two)
        assert two[int(logs.argmax())] is true


def test_the_unit_of_the_codes_does_not_matter():
    """A photo in other units is as probable under each curve, up to what all have in common."""
    basis, normals, b = photographed(np.random.default_rng(7), lamp=True)
    codes = coded(b, ToneCurve(1.0))
    solver, weights = LightSolver(basis, normals=normals, order=4), importance(codes, codes >= 1)
    curve = ToneCurve(1.0)
    plain = log_probability(solver.solve(curve.decode(codes), weights=weights), curve.log_slope(codes), weights)
    fit = solver.solve(10 * curve.decode(codes), weights=weights)
    assert log_probability(fit, curve.log_slope(codes) + np.log(10), weights) == pytest.approx(plain, abs=1e-6)


def test_clipped_codes_count_nothing_and_bright_ones_little():
    codes = np.array([[0.2] * 3, [0.2] * 3, [0.9] * 3, [1.0] * 3])
    weights = importance(codes, codes >= 1)
    assert (weights[3] == 0).all() and (weights[2] < 0.1).all() and (weights[0] > 0.8).all()
