# SPDX-License-Identifier: GPL-3.0-or-later
"""Light that is nowhere negative: the kernel, and the constrained maximum against a general optimiser."""

import numpy as np
import pytest
from scipy.optimize import minimize

from btfsep_engine import sh
from btfsep_engine.conventions import fibonacci_sphere
from btfsep_engine.fit.map_estimate import LightSolver
from btfsep_engine.fit.positive import positive_light
from btfsep_engine.light.natural import natural_prior
from btfsep_engine.light.positivity import blurred_basis, darkest_share, positive_window


@pytest.mark.parametrize("order", range(10))
def test_every_light_blurred_is_nowhere_negative_and_keeps_its_amount(order):
    """A single far lamp is the hardest light: its truncated series rings, its blurred series is the kernel."""
    window = positive_window(order)
    assert window[0] == 1 and (window[1:] < 1).all()
    kernel = np.polynomial.legendre.legval(np.linspace(-1, 1, 4001), window * (2 * np.arange(order + 1) + 1))
    assert kernel.min() > -1e-9 * kernel.max()
    if order > 1:
        ringing = np.polynomial.legendre.legval(np.linspace(-1, 1, 4001), 2 * np.arange(order + 1) + 1.0)
        assert ringing.min() < -0.1 * ringing.max()


def test_no_kernel_of_the_order_is_narrower():
    """The mean cosine of the narrowest positive kernel is the largest Gauss node of the next order."""
    for order in (2, 4, 8):
        node, _ = np.polynomial.legendre.leggauss(order // 2 + 1)
        assert positive_window(order)[1] == pytest.approx(node.max(), abs=1e-12)


def random_posterior(order, seed):
    random = np.random.default_rng(seed)
    terms = sh.term_count(order)
    mean = random.normal(size=(terms, 3)) * 1.2
    mean[0] = 1.0
    factor = random.normal(size=(3 * terms, 3 * terms)) * 0.1
    return mean, factor


@pytest.mark.parametrize("seed", range(3))
def test_it_is_the_closest_light_that_keeps_the_floor(seed):
    """Against SciPy's SLSQP on the same inequalities, a method that shares nothing with the dual."""
    mean, factor = random_posterior(2, seed)
    basis, floor = blurred_basis(2), 0.05
    least = floor * 0.5 / np.sqrt(np.pi) * mean[0].mean()
    assert (basis @ mean).min() < least
    found = positive_light(mean, factor, floor=floor)
    assert (basis @ found).min() > least - 1e-9
    rows = np.concatenate([basis @ factor[c * 9 : (c + 1) * 9] for c in range(3)])
    start = (basis @ mean).T.ravel() - least
    other = minimize(
        lambda z: z @ z,
        np.zeros(27),
        jac=lambda z: 2 * z,
        constraints={"type": "ineq", "fun": lambda z: start + rows @ z, "jac": lambda z: rows},
        options={"ftol": 1e-12, "maxiter": 500},
    )
    z = np.linalg.solve(factor, (found - mean).T.ravel())
    assert z @ z == pytest.approx(other.x @ other.x, rel=1e-4)


@pytest.mark.parametrize("seed", range(3))
def test_many_inequalities_at_once_are_kept_and_none_binds_without_need(seed):
    """The conditions of an optimum: z is R^T B^T of weights that are not negative and zero where there is room."""
    mean, factor = random_posterior(5, seed)
    basis = blurred_basis(5)
    least = 0.3 * 0.5 / np.sqrt(np.pi) * mean[0].mean()
    found = positive_light(mean, factor, floor=0.3)
    room = (basis @ found - least).T.ravel()
    size = np.abs(basis @ mean).max()
    assert room.min() > -1e-8 * size
    rows = np.concatenate([basis @ factor[c * 36 : (c + 1) * 36] for c in range(3)])
    tight = rows[room < 1e-7 * size]
    assert 10 < len(tight) < 108
    z = np.linalg.solve(factor, (found - mean).T.ravel())
    weights = np.linalg.lstsq(tight.T, z, rcond=None)[0]
    assert np.allclose(tight.T @ weights, z, atol=1e-6 * np.abs(z).max())
    assert weights.min() > -1e-6 * weights.max()


def test_a_light_that_keeps_the_floor_is_left_alone():
    mean, factor = random_posterior(3, 0)
    mean[1:] *= 0.05
    assert positive_light(mean, factor) is mean or np.array_equal(positive_light(mean, factor), mean)


def test_what_the_photo_determines_moves_less_than_what_it_does_not():
    mean, _ = random_posterior(3, 1)
    mean[1:4] *= 0.1
    well = np.diag(np.concatenate([np.where(np.arange(16) < 4, 1e-6, 1.0)] * 3))
    moved = np.abs(positive_light(mean, well) - mean)
    assert moved[:4].max() < 1e-6 < 1e-3 < moved[4:].max()


def test_a_floor_that_no_light_keeps_changes_nothing():
    mean, _ = random_posterior(2, 0)
    nothing = np.zeros((27, 27))
    assert np.array_equal(positive_light(mean, nothing), mean)


def test_the_training_lights_keep_the_floor_and_touch_it():
    from btfsep_engine.light.maps import training_lights

    floor = darkest_share(9)
    assert 0 < floor < 0.2
    x = training_lights(rotations=1).coefficients(9)
    dense = sh.evaluate(9, fibonacci_sphere(3000)) * np.repeat(positive_window(9), 2 * np.arange(10) + 1)
    shares = [(dense @ m).min() / (0.5 / np.sqrt(np.pi) * m[0].mean()) for m in x]
    assert min(shares) == pytest.approx(floor, abs=0.01)


def test_the_solver_gives_the_constrained_light_with_its_own_residual():
    """A lamp from one side on a sphere: the free estimate is negative opposite to it, the positive one keeps the floor
    and explains the photo almost as well; both residuals are those of the light that they name."""
    rng = np.random.default_rng(3)
    normals = rng.normal(size=(600, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    normals[:, 1] = -np.abs(normals[:, 1])
    lobe = np.repeat(sh.cosine_lobe(9), 2 * np.arange(10) + 1) / np.pi
    basis = (sh.evaluate(9, normals) * lobe)[..., None] * np.array([0.8, 0.6, 0.4])
    lamp = sh.evaluate(9, np.array([[0.8, -0.6, 0.0]]))[0][:, None] * np.array([3.0, 2.5, 2.0])
    lamp[0] += 0.2
    photo = np.einsum("pmc,mc->pc", basis, lamp) + rng.normal(size=(600, 3)) * 0.02
    blocks = np.arange(600) // 10
    free, positive = (
        LightSolver(basis, blocks=blocks, prior=natural_prior(9), order=4, positive=p).solve(photo)
        for p in (False, True)
    )
    blurred = blurred_basis(9)
    least = darkest_share(9) * 0.5 / np.sqrt(np.pi) * free.all_coefficients[0].mean()
    assert (blurred @ free.all_coefficients).min() < least - 0.01
    assert (blurred @ positive.all_coefficients).min() > least - 1e-6
    for fit, x in ((free, free.all_coefficients), (positive, positive.all_coefficients)):
        left = photo - np.einsum("pmc,mc->pc", basis, x)
        assert fit.residual == pytest.approx(np.linalg.norm(left) / np.linalg.norm(photo), rel=1e-3)
    assert positive.free_residual == pytest.approx(free.residual, rel=1e-6) and free.free_residual is None
    assert np.allclose(positive.free_coefficients, free.coefficients)
    assert free.residual < positive.residual < 1.5 * free.residual
    wrong = [np.linalg.norm(f.coefficients[:9] - lamp[:9]) for f in (free, positive)]
    assert wrong[1] < wrong[0]
