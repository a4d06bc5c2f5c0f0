# SPDX-License-Identifier: GPL-3.0-or-later
"""The light by its unknowns, its derivatives, the most probable light, and its evidence, by dense Gaussian algebra."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import lapack
from scipy.optimize import approx_fprime

from btfsep_engine.fit.light_model import LightModel
from btfsep_engine.fit.products import NEARLY_RIGHT, Basis, Photograph
from btfsep_engine.fit.search import ROUNDED, nearby, small_factor, solve
from btfsep_engine.light.log_field import as_vivid, even_field, natural_field
from tests.engine.half_sphere import FILL, SUN, even, half_sphere, lamp, shown, side_light

COST = 5.0  # of a lamp, of the logarithm of the evidence (docs/results/fit.md)
EXACT, EXACT_COST = 0.02, 12.0  # a discrepancy as good as none, and how much less probable it is


@pytest.mark.parametrize(
    "field", [even_field(), natural_field(), as_vivid(even_field())], ids=["even", "natural", "vivid"]
)
def test_the_jacobian_with_lamps_is_that_of_finite_differences(field, rng):
    model = LightModel(field, (SUN, FILL))
    white = 0.7 * rng.normal(size=model.unknowns)
    rows = [rng.normal(size=(n, field.terms)) for n in (4, 3, 5)]

    def images(at):
        return np.concatenate([r @ each for r, each in zip(rows, model.light(at)[0], strict=True)])

    step = 1e-5 * np.eye(model.unknowns)
    numerical = np.stack([(images(white + s) - images(white - s)) / 2e-5 for s in step], 1)
    found = model.jacobian(white, model.light(white)[1], rows)
    np.testing.assert_allclose(found, numerical, atol=2e-3 * np.abs(numerical).max())


@pytest.mark.parametrize("lamps", [(), (SUN, FILL)])
def test_the_gradient_without_the_jacobian_is_the_jacobians(lamps, rng):
    model = LightModel(natural_field(), lamps)
    white = 0.7 * rng.normal(size=model.unknowns)
    rows = [rng.normal(size=(n, model.field.terms)) for n in (4, 0, 5)]
    radiance, by_direction = model.light(white)[1], model.field.by_direction(rows)
    residual = [rng.normal(size=len(r)) for r in rows]
    expected = model.jacobian(white, radiance, rows, by_direction).T @ np.concatenate(residual)
    found = model.gradient(white, radiance, rows, by_direction, residual)
    np.testing.assert_allclose(found, expected, atol=1e-10 * np.abs(expected).max())


def test_many_lights_at_once_are_those_one_by_one(rng):
    model = LightModel(natural_field(), (SUN, FILL))
    whites = 0.7 * rng.normal(size=(5, model.unknowns))
    rows = [rng.normal(size=(n, model.field.terms)) for n in (4, 3, 5)]
    x, radiance = model.light(whites)
    seen = model.seen(whites, rows, model.field.by_direction(rows))
    for i, white in enumerate(whites):
        own, of_field = model.light(white)
        np.testing.assert_allclose(x[i], own, rtol=1e-10, atol=1e-10)
        np.testing.assert_allclose(radiance[i], of_field, rtol=1e-10)
        np.testing.assert_allclose(seen[i], np.concatenate([r @ c for r, c in zip(rows, own, strict=True)]), rtol=1e-8)


def test_what_a_lamp_does_beside_a_light_is_that_of_all_unknowns_written_out(rng):
    basis, normals, _ = half_sphere(rng, pixels=300)
    photo = Photograph(Basis(basis, normals), shown(basis, side_light(), rng, 0.05))
    for field in (even_field(), natural_field()):  # more rows than unknowns, and fewer
        found = solve(photo, LightModel(field))
        seen = rng.normal(size=len(found.jacobian))
        precision = np.eye(found.model.unknowns) + found.jacobian.T @ found.jacobian
        answer = -np.linalg.solve(precision, found.jacobian.T @ seen)
        slope, curvature, by_field = found.beside(seen)
        assert slope == pytest.approx(seen @ found.rows.residual(found.x))
        assert curvature == pytest.approx(seen @ (seen + found.jacobian @ answer), rel=1e-3)
        np.testing.assert_allclose(by_field, answer, atol=1e-3 * np.abs(answer).max())


def test_a_lamp_in_the_middle_of_its_prior_is_as_bright_as_twice_even_light(rng):
    model = LightModel(even_field(), (SUN,))
    direction, irradiance = model.lamp(0, np.zeros(5))
    np.testing.assert_allclose(direction, SUN)
    np.testing.assert_allclose(irradiance, 2 * np.pi)
    aside, _ = model.lamp(0, np.array([1.0, 0, 0, 0, 0]))
    assert np.degrees(np.arccos(aside @ SUN)) == pytest.approx(np.degrees(np.arctan(np.radians(10))))


def dense_evidence(photo, solution, first):
    """Laplace's evidence with every pixel written out and a derivative by finite differences.

    ``first`` : (3, terms), the light that the discrepancy was learned from
    """
    basis, model, h = photo.basis, solution.model, photo.coarsening
    out = -0.5 * solution.white @ solution.white
    step = 1e-4 * np.eye(model.unknowns)
    by_light = np.stack(
        [(model.light(solution.white + s)[0] - model.light(solution.white - s)[0]) / 2e-4 for s in step], -1
    )
    precision = np.eye(model.unknowns)
    for c in range(3):
        a = basis.rows(c)
        f = solution.discrepancy * basis.smooth * (a @ first[c])[:, None]
        n = h * solution.v[c] * np.eye(len(a)) + f @ f.T
        left = photo.b[:, c] - a @ solution.x[c]
        seen = a @ by_light[c]
        precision += seen.T @ np.linalg.solve(n, seen)
        log_n = np.linalg.slogdet(n)[1] - len(a) * np.log(h * solution.v[c])  # of the discrepancy's part alone
        out -= 0.5 * (left @ np.linalg.solve(n, left) + log_n + len(a) * np.log(solution.v[c]) / h)
    out -= EXACT_COST if solution.discrepancy == EXACT else 0
    return out - 0.5 * np.linalg.slogdet(precision)[1] - COST * len(model.lamps)


@pytest.mark.parametrize("discrepancy", [EXACT, NEARLY_RIGHT])
@pytest.mark.parametrize("lamps", [(), (SUN,), (SUN, FILL)])
@pytest.mark.parametrize("field", [even_field(), natural_field()], ids=["even", "natural"])
def test_the_evidence_is_laplaces_of_the_dense_problem(field, lamps, discrepancy, rng):
    basis, normals, _ = half_sphere(rng, pixels=200)
    photo = Photograph(Basis(basis, normals), shown(basis, side_light(), rng, 0.1))
    first = side_light().T / photo.level[:, None]
    photo.learn_from(first)
    solution = solve(photo, LightModel(field, lamps), discrepancy=discrepancy)
    assert solution.evidence == pytest.approx(dense_evidence(photo, solution, first), abs=0.2)


def test_nearly_linear_light_has_the_evidence_and_the_light_of_gauss(rng):
    """Fields that hardly vary make the light linear in the unknowns: all is Gaussian and known in closed form."""
    basis, normals, _ = half_sphere(rng, pixels=150)
    full = natural_field()
    field = replace(full, deviation=0.004 * full.deviation / full.deviation.max(), mean=np.zeros(full.unknowns))
    model = LightModel(field)
    truth = model.light(3 * rng.normal(size=model.unknowns))[0].T
    photo = Photograph(Basis(basis, normals), shown(basis, truth, rng, 0.2))
    photo.b = photo.b * photo.level  # the level has no freedom here: it is that of the truth
    photo.level = np.ones(3)
    photo = _again(photo)
    solution = solve(photo, model)
    nothing = np.zeros(model.unknowns)
    x0, radiance = model.light(nothing)
    j = model.jacobian(nothing, radiance, [photo.basis.rows(c) for c in range(3)])
    v = np.repeat(photo.coarsening * solution.v, 150)
    total = np.diag(v) + j @ j.T
    left = photo.b.T.ravel() - np.concatenate([photo.basis.rows(c) @ x0[c] for c in range(3)])
    gauss = -0.5 * left @ np.linalg.solve(total, left) - 0.5 * np.linalg.slogdet(total)[1]
    gauss += 0.5 * np.log(v).sum() - 0.5 * 150 * np.log(solution.v).sum() / photo.coarsening
    assert solution.evidence == pytest.approx(gauss, abs=0.05)
    np.testing.assert_allclose(solution.white, j.T @ np.linalg.solve(total, left), atol=0.02)


def _again(photo):
    """The photo's products after its values were changed."""
    photo.moments = [photo.basis.rows(c).T @ photo.b[:, c] for c in range(3)]
    photo.energies = (photo.b**2).sum(0)
    photo.mean_square = photo.energies / photo.count
    return photo


def test_the_most_probable_light_is_a_stationary_point_and_nothing_near_it_is_better(rng):
    basis, normals, _ = half_sphere(rng, pixels=300)
    photo = Photograph(Basis(basis, normals), shown(basis, side_light(), rng, 0.05))
    solution = solve(photo, LightModel(natural_field(), (SUN,)))

    def lack(white):
        r = solution.rows.residual(solution.model.light(white)[0])
        return 0.5 * (r @ r + white @ white)

    slope = approx_fprime(solution.white, lack, 1e-6)
    # what a further step of Newton's would gain: less than is worth a step
    assert 0.5 * slope @ np.linalg.solve(solution.factor @ solution.factor.T, slope) < 0.01
    here = lack(solution.white)
    spread = np.linalg.inv(solution.factor).T
    for _ in range(20):
        assert lack(solution.white + 0.3 * spread @ rng.normal(size=len(spread))) > here


def test_no_material_is_better_known_than_a_twentieth(rng):
    basis, normals, _ = half_sphere(rng, pixels=300)
    photo = Photograph(Basis(basis, normals), shown(basis, even()))
    solution = solve(photo, LightModel(even_field()))
    np.testing.assert_allclose(solution.v, 0.05**2 * photo.mean_square, rtol=1e-6)
    noisy = Photograph(Basis(basis, normals), shown(basis, even(), rng, 0.2))
    found = np.sqrt(solve(noisy, LightModel(even_field())).v / noisy.mean_square)
    np.testing.assert_allclose(found, 0.2, rtol=0.12)


def test_a_brighter_lamp_is_found_from_its_first_guess(rng):
    """Ten degrees off, and twenty times as bright as it begins."""
    basis, normals, _ = half_sphere(rng, pixels=300)
    photo = Photograph(Basis(basis, normals), shown(basis, even((0.05,) * 3) + lamp(SUN, [6.0] * 3), rng, 0.02))
    start = SUN + np.array([0.0, 0.12, 0.12])
    found = solve(photo, LightModel(even_field(), (start / np.linalg.norm(start),)))
    direction, _ = found.model.lamp(0, found.model.parts(found.white)[1][0])
    assert np.degrees(np.arccos(direction @ SUN)) < 1


def test_a_matrix_that_spans_more_than_single_precision_has_a_factor():
    random = np.random.default_rng(0)
    jacobian = (random.standard_normal((60, 60)) * np.logspace(4.5, -3, 60)).astype(np.float32)
    gram = jacobian @ jacobian.T
    whole = gram.astype(float) + np.eye(60)
    assert lapack.spotrf(whole.astype(np.float32), lower=1)[1] > 0  # it fails as it is
    factor = np.tril(small_factor(gram, 0.0)).astype(float)
    assert np.isfinite(np.log(np.diag(factor))).all()
    assert np.abs(factor @ factor.T - whole).max() < 1e-5 * whole.max()


def test_of_many_values_that_are_alike_the_largest_says_too_little_of_what_is_lost():
    """As of a photo whose unknowns all say the same: its largest value is 220 times less than what it is rounded by."""
    same, other = np.ones((220, 1)), (-1.0) ** np.arange(220)[:, None]
    gram = (2.6e5 * same @ same.T - 0.1 * other @ other.T).astype(np.float32)
    assert np.linalg.eigvalsh(gram.astype(float))[0] < -10 * ROUNDED * gram.max()
    factor = np.tril(small_factor(gram, 0.0)).astype(float)
    assert np.abs(factor @ factor.T - gram).max() < 1e-3 * gram.max()
    with pytest.raises(np.linalg.LinAlgError, match="no numbers"):
        small_factor(np.full((4, 4), -np.inf, np.float32), 0.0)


def test_the_light_of_a_photograph_that_differs_by_noise_is_found_from_the_others(rng):
    basis, normals, _ = half_sphere(rng, pixels=300)
    slopes, weights = 0.05 * rng.normal(size=(300, 2, 3)), rng.uniform(0.5, 1, (300, 3))
    photo = Photograph(Basis(basis, normals), shown(basis, side_light(), rng, 0.01), weights=weights, slopes=slopes)
    first = solve(photo, LightModel(natural_field(), (SUN,)))
    photo.learn_from(first.x)
    first = solve(photo, first.model, white=first.white, v=first.v)
    there = photo.again(photo.b * photo.level * photo.basis.response)
    for mine, own in ((there.rows(first.v, NEARLY_RIGHT), first.rows), (there, photo)):
        for name in ("target", "root") if mine is not there else ("moments", "energies"):
            for a, b in zip(getattr(mine, name), getattr(own, name), strict=True):
                np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-9)
    other = photo.again(shown(basis, side_light(), rng, 0.01))
    found = nearby(other, first, first.white)
    searched = solve(other, first.model, white=first.white, v=first.v, rounds=1)
    spread = 1 / np.sqrt(np.diag(first.factor @ first.factor.T))
    np.testing.assert_array_less(np.abs(found.white - searched.white), 0.1 * spread)
    assert np.abs(found.white - first.white).max() > 0.1  # which is another light
    np.testing.assert_allclose(found.x, found.model.light(found.white)[0])
