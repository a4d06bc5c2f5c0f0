# SPDX-License-Identifier: GPL-3.0-or-later
"""The light by its unknowns, its derivatives, the most probable light, and its evidence, by dense Gaussian algebra."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import approx_fprime

from btfsep_engine.fit.light_model import LightModel
from btfsep_engine.fit.products import NEARLY_RIGHT, Basis, Photograph
from btfsep_engine.fit.search import solve
from btfsep_engine.light.log_field import even_field, natural_field
from tests.engine.half_sphere import FILL, SUN, even, half_sphere, lamp, shown, side_light

COST = 5.0  # of a lamp, of the logarithm of the evidence (docs/results/fit.md)
EXACT, EXACT_COST = 0.02, 12.0  # a discrepancy as good as none, and how much less probable it is


@pytest.mark.parametrize("field", [even_field(), natural_field()], ids=["even", "natural"])
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
