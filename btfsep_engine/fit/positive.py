# SPDX-License-Identifier: GPL-3.0-or-later
"""The most probable light among those that are nowhere too dark: the posterior's maximum under linear inequalities.

With the Gaussian posterior N(m, R R^T), x = m + R z, and B the blurred light of `light.positivity`,

    min |z|^2   subject to   B (m + R z) >= floor     in every direction and channel,

is least-distance programming; by Lawson and Hanson (1974, ch. 23) it is one non-negative least-squares problem. Few of
the 1,200 inequalities bind, so the problem is solved with those that are broken most, and again with those of them that
bind and those that its solution breaks most, until there are none: the same light, as the solution is the only one, and
no round goes in a circle, as |z| grows with each.
"""

import numpy as np
from scipy.linalg import block_diag
from scipy.optimize import nnls

from btfsep_engine import sh
from btfsep_engine.light.positivity import blurred_basis, darkest_share

ITERATIONS = 100  # for each unknown of the non-negative problem; a few for each active direction are enough
MOST = 0.4  # of the largest shortfall: what is broken by more enters together
ROUNDS = 100  # a few are enough
EXACT = 1e-9  # of the largest shortfall: an inequality broken by less is kept


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
    basis, beams = blurred, terms - sh.term_count(order)
    if beams:
        basis = block_diag(blurred, np.eye(beams))
    least = np.zeros((len(basis), 1))
    least[: len(blurred)] = floor * sh.evaluate(0, np.array([[0.0, 0.0, 1.0]]))[0, 0] * mean[0].mean()
    short = least - basis @ mean
    scale = short.max()
    if scale <= 0:
        return mean
    by_channel = factor.reshape(3, terms, -1)
    target = np.zeros(factor.shape[1] + 1)
    target[-1] = 1
    columns, bound = np.empty((len(target), 0)), np.empty((2, 0), int)  # channel and direction of each column
    now, x = short, mean
    for _ in range(ROUNDS):
        broken = now.T.copy()
        broken[*bound] = 0
        if broken.max() <= EXACT * scale:
            break
        new = broken > max(MOST * broken.max(), EXACT * scale)
        # a column for each inequality: what z does to it, and what is missing
        added = [(basis[which] @ by_channel[c]).T for c, which in enumerate(new)]
        columns = np.hstack([columns, np.vstack([np.hstack(added), short.T[new] / scale])])
        bound = np.hstack([bound, np.nonzero(new)])
        try:
            dual, _ = nnls(columns, target, maxiter=ITERATIONS * len(columns))
        except RuntimeError:  # no convergence
            return mean
        residual = columns @ dual - target
        if residual[-1] > -1e-12:  # no light keeps the floor
            return mean
        x = mean + (factor @ (-residual[:-1] / residual[-1] * scale)).reshape(3, terms).T
        now = least - basis @ x
        columns, bound = columns[:, dual > 0], bound[:, dual > 0]
    return x
