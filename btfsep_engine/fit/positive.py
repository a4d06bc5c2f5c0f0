# SPDX-License-Identifier: GPL-3.0-or-later
"""The most probable light among those that are nowhere too dark: the posterior's maximum under linear inequalities.

With the Gaussian posterior N(m, R R^T), x = m + R z, and B the blurred light of `light.positivity`,

    min |z|^2   subject to   B (m + R z) >= floor     in every direction and channel,

is least-distance programming; by Lawson and Hanson (1974, ch. 23) it is one non-negative least-squares problem.
"""

import numpy as np
from scipy.linalg import block_diag
from scipy.optimize import nnls

from btfsep_engine import sh
from btfsep_engine.light.positivity import blurred_basis, darkest_share

ITERATIONS = 100  # for each unknown of the non-negative problem; a few for each active direction are enough


def positive_light(mean, factor, *, floor: float | None = None) -> np.ndarray:
    """The light of highest posterior probability whose blurred radiance is nowhere under the floor.

    Parameters
    ----------
    mean : (terms, 3) float, the posterior's mean; rows beyond the last full order (a beam's irradiance) are kept from
        being negative as they are
    factor : (3 terms, r) float, R, channel by channel: the posterior's covariance is R R^T
    floor : least blurred radiance over the light's mean radiance; None: the darkest of the training lights

    Returns
    -------
    (terms, 3) float64; ``mean`` itself where it keeps the floor already, or where no light does
    """
    mean, factor = np.asarray(mean, np.float64), np.asarray(factor, np.float64)
    terms = len(mean)
    order = int(np.sqrt(terms)) - 1
    blurred = blurred_basis(order)
    floor = darkest_share(order) if floor is None else floor
    basis = block_diag(blurred, np.eye(terms - sh.term_count(order)))
    least = np.zeros((len(basis), 1))
    least[: len(blurred)] = floor * sh.evaluate(0, np.array([[0.0, 0.0, 1.0]]))[0, 0] * mean[0].mean()
    missing = (least - basis @ mean).T.ravel()
    if missing.max() <= 0:
        return mean
    reach = np.concatenate([basis @ factor[c * terms : (c + 1) * terms] for c in range(3)])
    scale = missing.max()
    system = np.concatenate([reach.T, missing[None] / scale])
    target = np.zeros(len(system))
    target[-1] = 1
    try:
        dual, _ = nnls(system, target, maxiter=ITERATIONS * system.shape[1])
    except RuntimeError:  # no convergence
        return mean
    residual = system @ dual - target
    if residual[-1] > -1e-12:  # no light keeps the floor
        return mean
    moved = factor @ (-residual[:-1] / residual[-1] * scale)
    return mean + moved.reshape(3, terms).T
