# SPDX-License-Identifier: GPL-3.0-or-later
"""Products under the noise model: against inverse covariances with every pixel written out."""

import numpy as np
import pytest

from btfsep_engine import sh
from btfsep_engine.errors import InputError
from btfsep_engine.fit.products import Basis, Photograph
from tests.engine.half_sphere import half_sphere, shown, side_light

PIXELS = 90
NOISE = np.array([0.004, 0.006, 0.01])
SIZES = (0.02, 0.08)  # of the discrepancy: as good as exact, and nearly right (docs/results/fit.md)


@pytest.fixture(params=["alike", "weighted", "with slopes", "of three photographs"])
def dense(request, rng):
    """The products, and by hand: A (3, p, terms), b (3, p), W's own weights (3, p), F (3, p, k) by its size."""
    basis, normals, _ = half_sphere(rng, pixels=PIXELS)
    b = shown(basis, side_light(), rng, 0.1)
    weights = rng.uniform(0.1, 1, b.shape) if request.param == "weighted" else None
    slopes = 0.3 * rng.normal(size=(PIXELS, 4, 3)) * b[:, None] if request.param == "with slopes" else None
    number, departing = (np.arange(PIXELS) % 3, rng.uniform(1, 3, PIXELS)) if "three" in request.param else (None, None)
    photo = Photograph(Basis(basis, normals, number), b, weights=weights, slopes=slopes, departing=departing)
    first = 0.9 * side_light().T / photo.level[:, None]
    photo.learn_from(first)
    response = basis[:, 0].mean(0) * np.sqrt(4 * np.pi)
    a = np.moveaxis(basis, -1, 0) / response[:, None, None]
    w = np.ones((3, PIXELS)) if weights is None else weights.T
    level = (w * (b / response).T).sum(1) / w.sum(1)
    np.testing.assert_allclose(photo.level, level)
    measured = (b / response).T / level[:, None]
    y = sh.evaluate(4, normals)[:, 1:] * np.sqrt(4 * np.pi)  # each of mean square 1 over the sphere
    f = 1 / np.sqrt(24) * np.einsum("cpt,ct->cp", a, first)[..., None] * y
    if number is not None:  # each has a misfit of its own
        f = np.concatenate([f * (departing * (number == i))[:, None] for i in range(3)], -1)
    moves = np.zeros((3, PIXELS, 0)) if slopes is None else np.moveaxis(slopes / response / level, 2, 0)
    return photo, a, measured, w, lambda size: np.concatenate([size * f, moves], -1)  # a slope's size is its own


def one(f):
    """I, as large as F has columns."""
    return np.eye(f.shape[-1])


def covariance(photo, w, f, c):
    """N of a channel: (p, p)."""
    return np.diag(photo.coarsening * NOISE[c] / w[c]) + f[c] @ f[c].T


@pytest.mark.parametrize("size", SIZES)
def test_the_rows_are_a_square_root_of_the_dense_inverse_covariance(dense, size, rng):
    photo, a, b, w, f = dense
    f = f(size)
    rows = photo.rows(NOISE, size)
    x = side_light().T / photo.level[:, None] * rng.uniform(0.5, 1.5, (3, 100))
    square = 0.0
    for c in range(3):
        inverse = np.linalg.inv(covariance(photo, w, f, c))
        gram = a[c].T @ inverse @ a[c]
        np.testing.assert_allclose(rows.root[c].T @ rows.root[c], gram, atol=2e-2)  # less is left out
        np.testing.assert_allclose(rows.root[c].T @ rows.target[c], a[c].T @ inverse @ b[c], atol=1e-3 * gram.max())
        left = b[c] - a[c] @ x[c]
        square += left @ inverse @ left
    assert np.square(rows.residual(x)).sum() + rows.rest == pytest.approx(square, rel=0.01)
    scale = [w[c] / (photo.coarsening * NOISE[c]) for c in range(3)]
    stated = [np.linalg.slogdet(one(f) + f[c].T @ (f[c] * scale[c][:, None]))[1] for c in range(3)]
    assert rows.log_determinant == pytest.approx(sum(stated) / 2, rel=1e-6)


@pytest.mark.parametrize("size", SIZES)
def test_the_misfit_and_what_of_it_is_no_discrepancy(dense, size):
    photo, a, b, w, f = dense
    f = f(size)
    x = 1.1 * side_light().T / photo.level[:, None]
    for c in range(3):
        left = b[c] - a[c] @ x[c]
        assert photo.misfit(x)[c] == pytest.approx((w[c] * left**2).sum() / w[c].sum())
        scale = w[c] / (photo.coarsening * NOISE[c])
        best = np.linalg.solve(one(f) + (f[c] * scale[:, None]).T @ f[c], f[c].T @ (scale * left))
        rest = (w[c] * (left - f[c] @ best) ** 2).sum() / w[c].sum()
        assert photo.noise(x, NOISE, size)[c] == pytest.approx(rest)
        assert rest < (0.9 if size == 0.08 else 1) * photo.misfit(x)[c]


@pytest.mark.parametrize("size", SIZES)
def test_scores_of_other_values(dense, size, rng):
    photo, a, _, w, f = dense
    f = f(size)
    values = rng.normal(size=(PIXELS, 3))
    found = photo.scores(values, NOISE, size)
    for c in range(3):
        inside = values[:, c] / (photo.basis.response[c] * photo.level[c])
        stated = a[c].T @ np.linalg.solve(covariance(photo, w, f, c), inside)
        np.testing.assert_allclose(found[c], stated, atol=1e-9 * np.abs(stated).max())


def test_a_pixel_of_no_weight_might_as_well_not_be_there(rng):
    basis, normals, _ = half_sphere(rng, pixels=200)
    b = shown(basis, side_light(), rng, 0.1)
    weights = np.ones_like(b)
    weights[100:] = 0
    b[100:] *= 7
    both = Photograph(Basis(basis, normals), b, weights=weights)
    few = Photograph(Basis(basis[:100], normals[:100]), b[:100])
    shift = (few.basis.response / both.basis.response)[:, None]  # the response is of all pixels
    for c in range(3):
        np.testing.assert_allclose(both.grams[c], few.grams[c] * shift[c] ** 2, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(both.level, few.level * shift[:, 0])
    np.testing.assert_allclose(both.count, few.count)


def test_many_pixels_count_as_so_many_and_channels_that_go_together_as_one(rng):
    """n pixels are worth n 500 / (n + 500), in the mean of the channels a third where all misfit alike."""
    for pixels in (100, 3000):
        basis, normals, _ = half_sphere(rng, pixels=pixels, albedo=(0.5,) * 3)
        x = side_light()
        exact = shown(basis, x)
        for channels, effective in ((1, 1.0), (3, 3.0)):
            photo = Photograph(Basis(basis, normals), exact * (1 + 0.05 * rng.normal(size=(pixels, channels))))
            photo.learn_from(x.T / photo.level[:, None])
            assert photo.effective == pytest.approx(effective, rel=0.1)
            worth = pixels / photo.coarsening * 3 / photo.effective
            assert worth == pytest.approx(pixels * 500 / (pixels + 500))


def test_large_photos_are_taken_in_parts_with_the_same_products(rng, monkeypatch):
    basis, normals, _ = half_sphere(rng, pixels=300)
    b, weights = shown(basis, side_light(), rng, 0.1), rng.uniform(0, 1, (300, 3))
    whole = Photograph(Basis(basis, normals), b, weights=weights)
    monkeypatch.setattr("btfsep_engine.fit.products.CHUNK", 77)
    parts = Photograph(Basis(basis, normals), b, weights=weights)
    np.testing.assert_allclose(parts.grams, whole.grams, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(parts.basis.grams, whole.basis.grams, rtol=1e-9, atol=1e-12)


def test_what_cannot_be_fitted_is_refused_in_words(rng):
    basis, normals, _ = half_sphere(rng, pixels=50)
    with pytest.raises(InputError, match="no usable pixels"):
        Basis(basis[:0], normals[:0])
    with pytest.raises(InputError, match="green channel"):
        Basis(basis * [1, 0, 1], normals)
    with pytest.raises(InputError, match="black"):
        Photograph(Basis(basis, normals), np.zeros((50, 3)))
