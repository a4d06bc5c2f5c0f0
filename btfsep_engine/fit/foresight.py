# SPDX-License-Identifier: GPL-3.0-or-later
"""What a geometry, a view and a material could determine, before any photograph is looked at.

The posterior's covariance holds no pixel's value: with an assumed noise it is known beforehand,

    cov x = v F (F^T A^T N^-1 A F + 1 / q)^-1 F^T,    q = s^2 / v,

for light of level 1 that varies as natural light does on average (s = 1) and misfit of the relative size `noise`.
"""

from dataclasses import dataclass

import numpy as np

from btfsep_engine import sh
from btfsep_engine.fit.expected_error import expected_error
from btfsep_engine.fit.factorised import Factorised
from btfsep_engine.fit.map_estimate import DETERMINED, FIRST_CORRELATION, REFLECTANCE_SPREAD, cholesky, coarsening_of

CHANNELS_TOGETHER = 0.8  # correlation of misfit between channels, as texture and shape make it
LIGHTS = 40  # drawn from the prior, for the expected error
DRAWS = 10  # truths for each of them


@dataclass(frozen=True)
class Foresight:
    """What could be known, of light of level 1.

    Attributes
    ----------
    stddev : (terms, 3), expected standard deviation of each reported coefficient
    share : (terms,) posterior over prior variance, 0 (the photo decides) to 1 (it says nothing)
    determined, all_determined : (terms,), (all terms,) bool
    covariance : (3 terms, 3 terms) of the reported ones, row by row and in it channel by channel, without the model's
        part; prior : the same before the photo, without the level's own spread
    effective_degrees_of_freedom : of a channel's unknowns
    condition : of the reported orders
    expected : as `expected_error.expected_error`
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


def foresee(basis, *, blocks, prior, order: int, noise: float, seed: int = 0) -> Foresight:
    """What a photo of these pixels could determine.

    Parameters
    ----------
    basis : (p, terms, 3) float, A, at the prior's order
    blocks : (p,) int
    prior : light.natural.NaturalPrior
    order : the order that would be reported
    noise : misfit of a pixel over the photo's root mean square

    Raises
    ------
    InputError
        Without pixels, or where the material reflects nothing.
    """
    f, terms = Factorised(basis, blocks, prior), sh.term_count(order)
    # under even light of level 1 every channel's root mean square is 1: the responses are brought to that
    v = noise**2
    q = 1 / (v * coarsening_of(f.pixels))
    channels = np.full((3, 3), CHANNELS_TOGETHER) + (1 - CHANNELS_TOGETHER) * np.eye(3)
    matrix = q * f.whitened_gram(FIRST_CORRELATION, np.linalg.inv(channels))
    matrix[np.diag_indices_from(matrix)] += 1
    root, unknown = f.whitening.root(cholesky(matrix))
    freedom = f.terms - unknown / 3
    natural = prior.deviation**2 + prior.mean**2  # the mean square of a coefficient
    shared = noise**2 * FIRST_CORRELATION / (1 + FIRST_CORRELATION)  # of a pixel's misfit, its block's
    model = shared * natural[:, None]
    variance = f.variances(root)
    stddev = np.sqrt(variance + model + REFLECTANCE_SPREAD**2 * natural[:, None])
    varies = prior.deviation**2
    varies = np.where(np.arange(len(varies)) == 0, 1.0, varies)
    share = (variance + model).mean(1) / varies
    before = np.full((3, 3), prior.correlation) + (1 - prior.correlation) * np.eye(3)
    before = np.einsum("tu,cd->tcud", np.diag(varies[:terms]), before)
    singular = f.singular_values(terms)
    return Foresight(
        stddev[:terms],
        np.clip(share, 0, 1)[:terms],
        (share < DETERMINED)[:terms],
        share < DETERMINED,
        f.covariance(root, terms),
        before.reshape(3 * terms, 3 * terms),
        freedom,
        float(singular[0] / max(singular[-1], singular[0] * 1e-15)),
        _expected(f, root, prior, model, seed),
    )


def _expected(f: Factorised, root, prior, model, seed: int) -> dict:
    """Means over lights of the prior of their expected errors."""
    few = min(f.terms, 9)
    posterior = f.covariance(root, few) + np.diag(np.repeat(model[:few, 0], 3))
    together = np.full((3, 3), prior.correlation) + (1 - prior.correlation) * np.eye(3)
    natural = np.kron(np.diag(prior.deviation[:few] ** 2), together)
    values, vectors = np.linalg.eigh(natural)
    spread = vectors * np.sqrt(np.maximum(values, 0))
    random = np.random.default_rng(seed)
    lights = prior.mean[:few].repeat(3) + random.standard_normal((LIGHTS, 3 * few)) @ spread.T
    each = [expected_error(x.reshape(few, 3), posterior, draws=DRAWS, seed=seed + i) for i, x in enumerate(lights)]
    return {
        key: {part: float(np.median([e[key][part] for e in each])) for part in ("median", "low", "high")}
        for key in each[0]
    }


def over_directions(covariance, directions) -> np.ndarray:
    """Standard deviation of the radiance, mean of the channels, in ``directions : (…, 3)``, unit: (…).

    ``covariance`` is (3 terms, 3 terms), row by row and in it channel by channel.
    """
    terms = len(covariance) // 3
    grey = np.asarray(covariance).reshape(terms, 3, terms, 3).mean((1, 3))
    y = sh.evaluate(sh.order_of(terms), np.asarray(directions).reshape(-1, 3))
    variance = np.einsum("nt,tu,nu->n", y, grey, y, optimize=True)
    return np.sqrt(np.maximum(variance, 0)).reshape(np.shape(directions)[:-1])
