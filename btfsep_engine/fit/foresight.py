# SPDX-License-Identifier: GPL-3.0-or-later
"""What a geometry, a view and a material could determine, before any photograph is looked at.

About a light theta the posterior's covariance holds no pixel's value: with an assumed noise it is known beforehand,

    cov x = J_x (I + J^T J)^-1 J_x^T,

J_x the derivative of the light by the white unknowns of `light.log_field`, J that of the rows R x of `fit.products`.
What is stated of single coefficients is about even light; the expected error is over lights drawn from the prior.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular

from btfsep_engine import sh
from btfsep_engine.fit.light_model import LightModel
from btfsep_engine.fit.products import NEARLY_RIGHT, Basis, Photograph
from btfsep_engine.fit.stated import DETERMINED, REFLECTANCE, decided_unknowns, expected_error
from btfsep_engine.light.log_field import natural_field
from btfsep_engine.linear_algebra import cholesky, product
from btfsep_engine.threads import one_thread

LIGHTS = 24  # drawn from the prior, for the expected error
DRAWS = 60  # truths for each of them
CALM = 0.6  # of the prior's deviations: lights that are drawn have no peak that a fit would take for a lamp


@dataclass(frozen=True)
class Foresight:
    """What could be known, of light of radiance 1.

    Attributes
    ----------
    stddev : (terms, 3), expected standard deviation of each reported coefficient
    share : (terms,) posterior over prior variance, 0 (the photo decides) to 1 (it says nothing)
    determined, all_determined : (terms,), (all terms,) bool
    covariance : (3 terms, 3 terms) of the reported ones, row by row and in it channel by channel; prior : the same
        before the photo, without the level's own spread
    effective_degrees_of_freedom : of a channel's unknowns
    condition : of the reported orders
    expected : as `stated.expected_error`
    """

    stddev: np.ndarray
    share: np.ndarray
    determined: np.ndarray
    all_determined: np.ndarray
    covariance: np.ndarray
    prior: np.ndarray
    effective_degrees_of_freedom: float
    condition: float
    expected: dict


def foresee(basis, *, normals, order: int, noise: float, seed: int = 0) -> Foresight:
    """What a photo of these pixels could determine.

    Parameters
    ----------
    basis : (p, terms, 3) float, A, of order 9; normals : (p, 3), unit, world
    order : the order that would be reported
    noise : misfit of a pixel over the photo's root mean square

    Raises
    ------
    InputError
        Without pixels, or where the material reflects nothing.
    """
    ready, model = Basis(basis, normals), LightModel(natural_field())
    terms, all_terms = sh.term_count(order), ready.terms
    random = np.random.default_rng(seed)
    with one_thread():
        even = np.zeros(model.unknowns)
        even[: len(model.field.mean)] = -model.field.mean / model.field.deviation  # of radiance 1 everywhere
        factor, by_coefficient = _about(ready, model, even, noise)
        root = solve_triangular(factor, by_coefficient.T, lower=True).T  # (all terms * 3, unknowns)
        variance = np.square(root).sum(1).reshape(all_terms, 3)
        natural = np.square(by_coefficient).sum(1).reshape(all_terms, 3)
        unknowns = decided_unknowns(factor)
        prior = product(by_coefficient[: 3 * terms], by_coefficient[: 3 * terms].T)
        expected = [_expected(ready, model, even, noise, random) for _ in range(LIGHTS)]
    varies = natural.mean(1)
    varies[0] = 4 * np.pi  # of the level squared
    share = variance.mean(1) / varies
    stddev = np.sqrt(variance + REFLECTANCE**2 * natural)
    prior[:3, :3] = 4 * np.pi * np.eye(3)
    return Foresight(
        stddev[:terms],
        np.clip(share, 0, 1)[:terms],
        (share < DETERMINED**2)[:terms],
        share < DETERMINED**2,
        product(root[: 3 * terms], root[: 3 * terms].T),
        prior,
        unknowns,
        ready.condition(order),
        {
            key: {part: float(np.median([e[key][part] for e in expected])) for part in ("median", "low", "high")}
            for key in expected[0]
        },
    )


def _about(ready: Basis, model: LightModel, white, noise: float):
    """The posterior's factor about a light, and J_x, (3 terms, unknowns), row by row and in it channel by channel."""
    x, radiance = model.light(white)
    photo = Photograph(ready, np.maximum(ready.predicted(x.T), 0))
    inside = x / photo.level[:, None]
    photo.learn_from(inside)
    photo.effective = 1.5  # channels' misfits go together, as texture and shape make them
    rows = photo.rows(noise**2 * photo.mean_square, NEARLY_RIGHT)
    j = model.jacobian(white, radiance / photo.level[:, None], rows.root)
    j_x = model.jacobian(white, radiance, [np.eye(ready.terms)] * 3)
    j_x = j_x.reshape(3, ready.terms, -1).transpose(1, 0, 2).reshape(3 * ready.terms, -1)
    return cholesky(np.eye(model.unknowns) + product(j.T, j)), j_x


def _expected(ready: Basis, model: LightModel, even, noise: float, random) -> dict:
    """The expected error of one light of the prior."""
    white = even + CALM * random.standard_normal(model.unknowns)
    white[0] = even[0]
    factor, _ = _about(ready, model, white, noise)
    steps = solve_triangular(factor.T, random.standard_normal((model.unknowns, DRAWS)), lower=False).T
    samples = np.stack([model.light(white + step)[0].T for step in steps])
    return expected_error(model.light(white)[0].T, samples)


def over_directions(covariance, directions) -> np.ndarray:
    """Standard deviation of the radiance, mean of the channels, in ``directions : (…, 3)``, unit: (…).

    ``covariance`` is (3 terms, 3 terms), row by row and in it channel by channel.
    """
    terms = len(covariance) // 3
    grey = np.asarray(covariance).reshape(terms, 3, terms, 3).mean((1, 3))
    y = sh.evaluate(sh.order_of(terms), np.asarray(directions).reshape(-1, 3))
    variance = np.einsum("nt,tu,nu->n", y, grey, y, optimize=True)
    return np.sqrt(np.maximum(variance, 0)).reshape(np.shape(directions)[:-1])
