# SPDX-License-Identifier: GPL-3.0-or-later
"""The estimate under a prior: against full covariance matrices, its limits, its calibration, truncation, turns."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import block_diag
from scipy.stats import binom

from btfsep_engine import sh
from btfsep_engine.errors import InputError
from btfsep_engine.fit import factorised, map_estimate
from btfsep_engine.fit.factorised import Factorised
from btfsep_engine.fit.least_squares import solve
from btfsep_engine.fit.map_estimate import Found, LightSolver, solve_map
from btfsep_engine.fit.tridiagonal import Tridiagonal, TridiagonalBlocks
from btfsep_engine.light.natural import held_out, learn, natural_prior, relative_coefficients


def view_of_a_sphere(rng, pixels=700, order=6):
    """A slightly glossy sphere from one side: basis images (p, terms, 3), and blocks that are patches of it."""
    n = rng.normal(size=(pixels, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    n[:, 1] = -np.abs(n[:, 1])  # the camera looks along +y
    eye = np.array([0.0, -1.0, 0.0])
    mirrored = 2 * (n @ eye)[:, None] * n - eye
    l = np.repeat(np.arange(order + 1), 2 * np.arange(order + 1) + 1)
    matte = sh.evaluate(order, n) * np.concatenate([sh.cosine_lobe(order)])[l] / np.pi
    gloss = 0.3 * sh.evaluate(order, mirrored) * np.exp(-l * (l + 1) * 0.03)
    blocks = np.unique((n[:, 0] // 0.25) * 100 + n[:, 2] // 0.25, return_inverse=True)[1].reshape(-1)
    return np.stack([albedo * matte + gloss for albedo in (0.7, 0.5, 0.3)], -1), blocks


def drawn(rng, prior, *, level=2.0, scale=1.0):
    """A light from the prior, (terms, 3), with its level given."""
    terms = len(prior.mean)
    channels = np.linalg.cholesky(np.full((3, 3), prior.correlation) + (1 - prior.correlation) * np.eye(3))
    x = prior.mean[:, None] + scale * prior.deviation[:, None] * (rng.normal(size=(terms, 3)) @ channels.T)
    x[0] = 1 + scale * prior.deviation[0] * rng.normal(size=3)
    return level * x


def photographed(rng, basis, x, blocks, *, noise, shared=0.0):
    """The photo of a light with noise of the model: independent by pixel, ``shared`` of its variance by block."""
    b = np.einsum("pmc,mc->pc", basis, x)
    size = noise * np.sqrt((b**2).mean())
    together = rng.normal(size=(blocks.max() + 1, 3))[blocks] * np.sqrt(shared)
    return b + size * np.sqrt((basis[:, 0] ** 2).mean(0)) * 2 * (rng.normal(size=b.shape) + together)


def by_noise(fit):
    """The stated spread without its parts for a wrong model and for the material's reflectance."""
    model = fit.shared_residual**2 * (fit.coefficients**2).mean(1, keepdims=True)
    return np.sqrt(fit.stddev**2 - model - (map_estimate.REFLECTANCE_SPREAD * fit.coefficients) ** 2)


def test_it_is_the_posterior_of_full_covariance_matrices(rng):
    """Gauss's formulas with every covariance written out: pixels by pixels, channels and blocks in it."""
    basis, blocks = view_of_a_sphere(rng, pixels=90, order=2)
    prior = natural_prior(2)
    b = photographed(rng, basis, drawn(rng, prior), blocks, noise=0.1)
    c, q, v = 0.4, 3.0, 0.02
    channels = np.array([[1.2, 0.5, 0.1], [0.5, 1.0, 0.3], [0.1, 0.3, 0.8]])
    solver = LightSolver(basis, blocks=blocks, prior=prior, order=2, coarsening=1)
    measured = solver.factorised.measure(b)
    fit = solver.fit(measured, Found(0.0, q, v, c, channels))
    x, stddev, freedom = fit.coefficients, by_noise(fit), 3 * fit.effective_degrees_of_freedom

    response = np.sqrt((basis[:, 0] ** 2).mean(0))
    a = np.zeros((3, 90, 3, 9))
    for i in range(3):
        a[i, :, i] = basis[:, :, i] / response[i]
    a, y = a.reshape(270, 27), (b / response).T.ravel()
    noise = v * np.kron(channels, np.eye(90) + c * (blocks[:, None] == blocks[None]))
    signal = q * v * prior.covariance()
    gain = signal @ a.T @ np.linalg.inv(a @ signal @ a.T + noise)
    covariance = signal - gain @ a @ signal
    assert np.allclose(x.T.ravel(), gain @ y, rtol=1e-6, atol=1e-9)
    assert np.allclose(stddev.T.ravel(), np.sqrt(np.diag(covariance)), rtol=1e-6)
    gram = a.T @ np.linalg.inv(noise) @ a
    hat = np.linalg.inv(gram + np.linalg.inv(signal)) @ gram
    assert freedom == pytest.approx(np.trace(hat), rel=1e-8)
    model = np.diag(np.repeat(fit.shared_residual**2 * (fit.coefficients**2).mean(1), 3))
    reflectance = map_estimate.REFLECTANCE_SPREAD * fit.coefficients.ravel()
    model += np.outer(reflectance, reflectance)
    by_term = covariance.reshape(3, 9, 3, 9).transpose(1, 0, 3, 2).reshape(27, 27)
    assert np.allclose(fit.covariance - model, by_term, rtol=1e-6, atol=1e-9 * by_term.max())
    left = y - a @ (gain @ y)
    assert fit.residual == pytest.approx(np.linalg.norm(left * np.repeat(response, 90)) / np.linalg.norm(b))
    spread = solver.posterior_factor(Found(0.0, q, v, c, channels))
    assert np.allclose(spread @ spread.T, covariance, rtol=1e-6, atol=1e-9 * covariance.max())
    # the evidence, up to a constant, is the density of y
    total = a @ signal @ a.T + noise
    inverse = np.linalg.inv(channels)
    f = solver.factorised
    reduced = Tridiagonal(f.whitened_gram(c, inverse), f.whitened_moments(measured, c, inverse))
    log_det, explained = reduced.log_det_and_explained(q)
    left = f.energy(measured, c, inverse) - explained
    mine = log_det + 270 * np.log(v) + f.log_determinant(c, channels) + left / v
    assert mine == pytest.approx(np.linalg.slogdet(total)[1] + y @ np.linalg.solve(total, y), rel=1e-8)


def test_priors_with_means_of_higher_orders_are_the_same_formulas(rng):
    """F F^T is the prior's covariance, whatever terms have a mean; root() and its squares turn back."""
    basis, blocks = view_of_a_sphere(rng, pixels=60, order=3)
    for mean_order in (0, 2):
        prior = learn(relative_coefficients(3), mean_order=mean_order)
        f = Factorised(basis, blocks, prior)
        by_channel = f.whitening.coefficients(np.eye(48)).transpose(1, 0, 2).reshape(48, 48)
        assert np.allclose(by_channel @ by_channel.T, prior.covariance(), atol=1e-12)
        white = rng.normal(size=(48, 50))
        white = white @ white.T
        full = (by_channel @ np.linalg.inv(white) @ by_channel.T).reshape(3, 16, 3, 16)
        root, trace = f.whitening.root(np.linalg.cholesky(white))
        assert trace == pytest.approx(np.trace(np.linalg.inv(white)), rel=1e-9)
        assert np.allclose(f.variances(root), np.einsum("ctct->tc", full), rtol=1e-9)
        few = full[:, :4, :, :4].transpose(1, 0, 3, 2).reshape(12, 12)
        assert np.allclose(f.covariance(root, 4), few, rtol=1e-8, atol=1e-9 * few.max())


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_what_blocks_of_pixels_share_of_the_misfit_is_told_from_what_each_has_for_itself(rng, share):
    """Of misfit of a known size, however large what pixels have for themselves is beside it."""
    basis, blocks = view_of_a_sphere(rng, pixels=4000, order=2)
    blocks = rng.integers(150, size=4000)
    f = Factorised(basis, blocks, learn(relative_coefficients(2)))
    x = f.prior.deviation[:, None] * rng.normal(size=(9, 3)) + f.prior.mean[:, None]
    b = np.einsum("pmc,mc->pc", basis, x)
    size = np.sqrt((b**2).mean())
    own, together = rng.normal(size=b.shape), rng.normal(size=(150, 3))[blocks]
    b = b + 0.3 * size * (own + np.sqrt(share) * together)
    left = f.shared_misfit(f.measure(b), x) * np.sqrt((b**2).mean()) / (0.3 * size)
    assert left == pytest.approx(np.sqrt(share), abs=0.06)
    assert f.block_correlation(f.measure(b), x, f.misfit(f.measure(b), x)) == pytest.approx(share, rel=0.25, abs=0.01)
    few = Factorised(basis, blocks // 30, f.prior)  # five blocks cannot say: all of it
    left = few.shared_misfit(few.measure(b), x) * np.sqrt((b**2).mean()) / (0.3 * size)
    assert left == pytest.approx(np.sqrt(1 + share), rel=0.1)
    assert few.block_correlation(few.measure(b), x, few.misfit(few.measure(b), x)) is None


@pytest.mark.parametrize("pixels", [1, 2, 499, 1001, 2600])
def test_the_products_of_strips_and_halves_are_those_of_all_pixels(rng, pixels):
    """Blocks lie across strips and across the two halves, and their numbers have gaps and no order."""
    basis, prior = rng.normal(size=(pixels, 9, 3)).astype(np.float32), natural_prior(2)
    blocks = rng.permutation(np.arange(pixels) // 130 * 7 - 3)
    f = Factorised(basis, blocks, prior)
    a = basis.astype(np.float64) * prior.deviation[:, None] / f.response
    a = a.transpose(0, 2, 1).reshape(pixels, 27)
    own = np.unique(blocks)[:, None] == blocks
    b = rng.normal(size=(pixels, 3))
    assert np.allclose(f.gram, a.T @ a, rtol=1e-12, atol=1e-12 * pixels)
    assert np.allclose(f.sums, own @ a) and np.array_equal(f.block_sizes, own.sum(1))
    found = f.products(b)
    assert np.allclose(found.sums, own @ b) and np.allclose(found.energies, b.T @ b)
    assert np.allclose(found.moments, (a.T @ b).reshape(3, 9, 3))


def test_the_first_fit_is_that_of_three_photos_of_one_channel_each(rng):
    """Independent in the channels: the Gram matrices, moments and light of dense algebra, channel by channel."""
    basis, blocks = view_of_a_sphere(rng, pixels=90, order=2)
    prior, c = natural_prior(2), map_estimate.FIRST_CORRELATION
    b = photographed(rng, basis, drawn(rng, prior), blocks, noise=0.05)
    solver = LightSolver(basis, blocks=blocks, prior=prior, order=2)
    f = solver.factorised
    measured = f.measure(b)
    noise = np.linalg.inv(np.eye(90) + c * (blocks[:, None] == blocks))
    near, x = solver._first_fit(measured)
    again, same = solver._first_fit(measured)  # with what is kept
    assert again == pytest.approx(near, abs=1e-9) and np.allclose(same, x)
    for k in range(3):
        a = basis[:, :, k] / f.response[k]
        signal = prior.covariance().reshape(3, 9, 3, 9)[k, :, k]
        factor = np.diag(np.sqrt(np.diag(signal)))
        assert np.allclose(f.grams_alone(c)[k], factor @ a.T @ noise @ a @ factor)
        assert np.allclose(f.moments_alone(measured, c)[k], factor @ a.T @ noise @ (b[:, k] / f.response[k]))
        q = np.exp(near) / solver.coarsening
        light = q * signal @ a.T @ np.linalg.solve(np.linalg.inv(noise) + q * a @ signal @ a.T, b[:, k] / f.response[k])
        assert np.allclose(x[:, k], light, rtol=1e-7, atol=1e-9)


def test_blocks_are_reduced_each_for_itself(rng):
    matrices = rng.normal(size=(3, 20, 30))
    matrices = matrices @ matrices.transpose(0, 2, 1)
    vectors, others = rng.normal(size=(3, 20)), rng.normal(size=(3, 20))
    whole = block_diag(*matrices)
    reduced = TridiagonalBlocks(matrices, vectors)
    for mine, h in ((reduced, vectors.ravel()), (reduced.with_vector(others), others.ravel())):
        for q in (1e-3, 1.0, 1e16):  # the last one by the eigenvalues
            log_det, explained = mine.log_det_and_explained(q)
            solved = q * np.linalg.solve(np.eye(60) + q * whole, h)
            assert log_det == pytest.approx(np.linalg.slogdet(np.eye(60) + q * whole)[1], rel=1e-8)
            assert explained == pytest.approx(h @ solved, rel=1e-5)
            assert np.allclose(mine.solved(q), solved, rtol=1e-4, atol=1e-6 * np.abs(solved).max())


def test_a_tridiagonal_reduction_serves_every_q(rng):
    for n, rank in ((3, 3), (40, 60), (40, 7)):
        a = rng.normal(size=(rank, n))
        m, h = a.T @ a, a.T @ rng.normal(size=rank)
        reduced = Tridiagonal(m.copy(), h)
        other = reduced.with_vector(2 * h)
        for q in (1e-3, 1.0, 1e6, 1e14, 1e18):
            log_det, explained = reduced.log_det_and_explained(q)
            values, vectors = np.linalg.eigh(m)
            values = np.where(np.arange(n) < n - rank, 0, values)  # of a known rank
            seen = vectors.T @ h
            seen[: max(n - rank, 0)] = 0
            if q > 1e12 and rank < n:  # there the null space's rounding is all that is seen
                assert log_det > np.log1p(q * values).sum() - 1 and np.isfinite(explained)
                continue
            assert log_det == pytest.approx(np.log1p(q * values).sum(), rel=1e-6)
            assert explained == pytest.approx((q * seen**2 / (1 + q * values)).sum(), rel=1e-6)
            if q <= 1e6:
                expected = q * np.linalg.solve(np.eye(n) + q * m, h)
                assert np.allclose(reduced.solved(q), expected, rtol=1e-5, atol=1e-8 * np.abs(expected).max())
                assert np.allclose(other.solved(q), 2 * reduced.solved(q))


def test_without_a_prior_it_is_least_squares(rng):
    basis, blocks = view_of_a_sphere(rng, order=2)
    prior = natural_prior(2)
    b = photographed(rng, basis, drawn(rng, prior), blocks, noise=0.1)
    solver = LightSolver(basis, blocks=blocks, prior=prior, order=2, coarsening=1)
    measured = solver.factorised.measure(b)
    plain = solve(basis, b, blocks=blocks).coefficients
    distance = []
    for q in (1e0, 1e3, 1e12):
        fit = solver.fit(measured, Found(0.0, q, 1.0, 0.0, np.eye(3)))
        freedom = 3 * fit.effective_degrees_of_freedom
        distance.append(np.linalg.norm(fit.coefficients - plain))
    assert distance[0] > distance[1] > distance[2] and distance[2] < 1e-6
    assert freedom == pytest.approx(27, abs=1e-4)


def test_the_stated_spread_covers_as_stated(rng, monkeypatch):
    """Lights and noise of the model, its correlated part too: 68 % and 95 % intervals hold what they say."""
    monkeypatch.setattr(map_estimate, "BLOCK_CORRELATIONS", (0.1, 0.3, 1.0))
    basis, blocks = view_of_a_sphere(rng, pixels=400, order=3)
    prior = natural_prior(3)
    inside = []
    for _ in range(60):
        x = drawn(rng, prior)
        b = photographed(rng, basis, x, blocks, noise=0.05, shared=0.3)
        photo_fit = solve_map(basis, b, blocks=blocks, prior=prior, order=3, coarsening=1)
        stddev = by_noise(photo_fit)  # there is no wrong model here
        # the terms of a photo fall together; the middle of the channels of every third counts as one try
        z = np.abs((photo_fit.coefficients - x)[::3, 1] / stddev[::3, 1])
        inside.append([z < 1, z < 1.96])
    inside = np.array(inside)
    tries = inside.shape[0] * inside.shape[2]
    for k, share in enumerate((0.683, 0.95)):
        low, high = binom.interval(0.999, tries, share)
        assert low - 0.03 * tries <= inside[:, k].sum() <= high + 0.03 * tries


def test_many_orders_under_a_prior_beat_a_series_cut_off(rng):
    """Light with all orders, order 2 reported: at most half of plain least squares' error at order 4, in the median."""
    basis, blocks = view_of_a_sphere(rng, order=9)
    prior = natural_prior(9)
    ratios = []
    for _ in range(15):
        x = drawn(rng, prior)
        b = photographed(rng, basis, x, blocks, noise=0.01)
        fit = solve_map(basis, b, blocks=blocks, prior=prior, order=2)
        plain = solve(basis[:, :25], b, blocks=blocks)
        assert fit.coefficients.shape == fit.stddev.shape == (9, 3) and fit.all_coefficients.shape == (100, 3)
        ratios.append(np.linalg.norm(fit.coefficients - x[:9]) / np.linalg.norm(plain.coefficients[:9] - x[:9]))
    assert np.median(ratios) < 0.5


def test_what_is_reported_does_not_depend_on_the_reported_order(rng):
    basis, blocks = view_of_a_sphere(rng, pixels=300, order=4)
    b = photographed(rng, basis, drawn(rng, natural_prior(4)), blocks, noise=0.05)
    low, high = (solve_map(basis, b, blocks=blocks, prior=natural_prior(4), order=k) for k in (1, 4))
    assert np.array_equal(low.coefficients, high.coefficients[:4]) and np.array_equal(low.stddev, high.stddev[:4])
    assert low.residual == high.residual and np.array_equal(low.determined, high.determined[:4])


def test_a_turn_about_the_vertical_turns_the_answer(rng):
    """World and light turned together: A D^T for A. A photo twice as bright: twice the light."""
    basis, blocks = view_of_a_sphere(rng, order=4)
    prior = learn(relative_coefficients(4), mean_order=2)  # with means, which only turns about the vertical keep
    x = drawn(rng, prior)
    b = photographed(rng, basis, x, blocks, noise=0.05)
    fit = solve_map(basis, b, blocks=blocks, prior=prior, order=4)
    c, s = np.cos(0.7), np.sin(0.7)
    turn = sh.rotation_matrix(4, [[c, -s, 0], [s, c, 0], [0, 0, 1]])
    turned = solve_map(np.einsum("pmc,nm->pnc", basis, turn), b, blocks=blocks, prior=prior, order=4)
    assert np.allclose(turned.coefficients, turn @ fit.coefficients, atol=1e-6 * np.abs(x).max())
    assert turned.effective_degrees_of_freedom == pytest.approx(fit.effective_degrees_of_freedom, rel=1e-6)
    bright = solve_map(basis, 2 * b, blocks=blocks, prior=prior, order=4)
    assert np.allclose(bright.coefficients, 2 * fit.coefficients) and np.allclose(bright.stddev, 2 * fit.stddev)


def test_misfit_that_neighbours_share_is_seen_and_makes_it_less_sure(rng):
    """Noise of one size: where blocks share it, the found correlation and the stated spread are larger."""
    basis, blocks = view_of_a_sphere(rng, pixels=2000, order=4)
    basis = np.repeat(basis[:100], 20, 0)  # neighbours see nearly the same
    blocks = np.repeat(np.arange(100), 20)
    prior = natural_prior(4)
    x = drawn(rng, prior)
    truth = np.einsum("pmc,mc->pc", basis, x)
    size = 0.05 * truth.std()
    apart = size * rng.normal(size=truth.shape)
    together = size * np.sqrt([0.5]) * (rng.normal(size=(100, 3))[blocks] + rng.normal(size=truth.shape))
    how = dict(blocks=blocks, prior=prior, order=2, coarsening=1)
    one, other = (solve_map(basis, truth + n, **how) for n in (apart, together))
    assert one.block_correlation <= 0.03 < 0.3 <= other.block_correlation
    best = np.unravel_index(one.stddev.argmin(), one.stddev.shape)  # the others are the prior's affair
    assert by_noise(other)[best] > 1.6 * by_noise(one)[best]


def test_what_the_camera_cannot_see_is_not_determined(rng):
    """A basis light without any effect keeps its prior's spread, is zero and not determined; the others are."""
    basis, blocks = view_of_a_sphere(rng, order=2)
    basis[:, 4:] = 0
    prior = natural_prior(2)
    x = drawn(rng, prior)
    fit = solve_map(basis, photographed(rng, basis, x, blocks, noise=0.01), blocks=blocks, prior=prior, order=2)
    assert fit.determined.tolist() == [True] * 4 + [False] * 5
    assert np.abs(fit.coefficients[4:]).max() < 1e-6 * np.abs(fit.coefficients).max()
    assert fit.effective_degrees_of_freedom < 4.01
    level = fit.coefficients[0].mean()
    expected = fit.prior_scale * level * prior.deviation[4]
    assert np.allclose(fit.stddev[4:], expected, rtol=0.2)


def test_few_pixels_and_degenerate_photos(rng):
    basis, blocks = view_of_a_sphere(rng, pixels=40, order=9)
    prior = natural_prior(9)
    x = drawn(rng, prior)
    few = solve_map(basis, photographed(rng, basis, x, blocks, noise=0.02), blocks=blocks, prior=prior, order=2)
    assert np.isfinite(few.coefficients).all() and np.isfinite(few.stddev).all()
    assert np.linalg.norm(few.coefficients - x[:9]) < 0.8 * np.linalg.norm(x[:9])
    constant = solve_map(basis, np.full((40, 3), 0.5), blocks=blocks, prior=prior, order=2)
    assert np.isfinite(constant.coefficients).all() and constant.coefficients[0].min() > 0
    single = solve_map(basis[:1], np.ones((1, 3)), blocks=blocks[:1], prior=prior, order=1)
    assert np.isfinite(single.stddev).all() and not single.determined[1:].any()
    for change, words in (
        (dict(radiance=np.zeros((40, 3))), "black"),
        (dict(basis=np.zeros_like(basis)), "reflects nothing"),
        (dict(basis=basis[:0], radiance=np.zeros((0, 3)), blocks=blocks[:0]), "no usable pixels"),
    ):
        given = {"basis": basis, "radiance": np.ones((40, 3)), "blocks": blocks, **change}
        with pytest.raises(InputError, match=words):
            solve_map(given["basis"], given["radiance"], blocks=given["blocks"], prior=prior, order=2)


def test_large_photos_go_through_in_pieces(rng, monkeypatch):
    basis, blocks = view_of_a_sphere(rng, pixels=300, order=3)
    b = photographed(rng, basis, drawn(rng, natural_prior(3)), blocks, noise=0.05)
    whole = solve_map(basis, b, blocks=blocks, prior=natural_prior(3), order=3)
    monkeypatch.setattr(factorised, "CHUNK", 37)
    pieces = solve_map(basis, b, blocks=blocks, prior=natural_prior(3), order=3)
    assert np.allclose(whole.coefficients, pieces.coefficients) and np.allclose(whole.stddev, pieces.stddev)


def test_natural_light_is_learned(rng):
    """What is drawn from a prior teaches that prior; the shipped lights teach no zonal mean above the level."""
    made = replace(natural_prior(9), log_scale_spread=0.5)
    lights = np.stack([drawn(rng, made, level=1, scale=np.exp(0.5 * rng.normal())) for _ in range(300)])
    lights /= lights[:, 0].mean(-1)[:, None, None]
    again = learn(lights)
    ratio = again.deviation[1:] / made.deviation[1:]
    assert 0.8 < ratio.min() and ratio.max() < 1.3
    assert abs(again.log_scale_spread - 0.5) < 0.12
    assert (1 - again.correlation) / (1 - made.correlation) == pytest.approx(2, rel=0.25)  # COLOUR_ALLOWANCE
    shipped = relative_coefficients()
    likelihood = [held_out(shipped, mean_order=k) for k in range(3)]
    assert int(np.argmax(likelihood)) == 0
    covariance = natural_prior(2).covariance()
    assert np.allclose(covariance, covariance.T) and np.linalg.eigvalsh(covariance).min() > 0
