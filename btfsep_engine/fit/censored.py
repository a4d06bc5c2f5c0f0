# SPDX-License-Identifier: GPL-3.0-or-later
"""Clipped pixels as inequalities: a channel that stands at the largest code was at least as bright as that.

A clipped value b >= limit says little where the light already explains more than the limit, and where it explains less
it speaks like a measurement above the limit. That is Tobin's model (1958, "Estimation of relationships for limited
dependent variables"), fitted by turns (EM): with the light found so far, predicted value p and misfit s, a clipped
channel enters as what is to be expected of it,

    E[b | b >= limit] = p + s h((limit - p) / s),    h(z) = phi(z) / (1 - Phi(z)).

Far above the limit this is p, which leaves the channel free. Pixels of which every channel is explained are left out,
so that they do not count as evidence; pixels with a channel that is not clipped are used from the start.

With nothing clipped this is the plain fit.

What is clipped is what the brightest light falls on. The pixels that are left look as if the light were more even than
it is, and a prior whose scale they choose states too little: of photographs by Cycles with 30 and 60 % of the pixels
clipped, 95 % intervals held 86 and 73 % of the coefficients (under three lights that nothing was chosen on: 72 and 58).
`with_hidden_light` adds what clipping hides, a part of natural light's variance that grows with the clipped share: then
they hold 94 and 90 % (85 and 81).
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import log_ndtr

from btfsep_engine.errors import InputError
from btfsep_engine.fit.least_squares import Fit
from btfsep_engine.fit.map_estimate import DETERMINED, LightSolver

ROUNDS = 8
SETTLED = 2e-3  # relative change of the coefficients
HIDDEN = 0.65  # of natural light's deviation: what stays unknown where every channel is clipped
FARTHEST = 6.0  # misfits below the limit: a pixel that is farther below is wrong in another way


@dataclass(frozen=True)
class CensoredFit:
    """A fit with inequalities.

    Attributes
    ----------
    fit : Fit, of the pixels that were used; ``solver`` : the LightSolver that made it
    used : (p,) bool
    radiance : (p, 3), the photograph with the clipped channels as they entered
    active : (p, 3) bool, clipped channels of which the light explains less than the limit
    rounds : fits that were made
    """

    fit: Fit
    solver: LightSolver
    used: np.ndarray
    radiance: np.ndarray
    active: np.ndarray
    rounds: int


def solve_censored(
    basis, radiance, clipped, *, blocks, prior, order: int, partly: bool = True, rounds: int = ROUNDS
) -> CensoredFit:
    """The most probable light where some channels of some pixels are lower bounds.

    Parameters
    ----------
    basis : (p, terms, 3) float, A; radiance : (p, 3) float, b, at the limit where clipped, linear
    clipped : (p, 3) bool
    blocks, prior, order : of `LightSolver`
    partly : whether a pixel's own channels that are not clipped are used from the start
    rounds : the largest number of fits after the first

    Returns
    -------
    CensoredFit

    Raises
    ------
    InputError
        Where every pixel is clipped.
    """
    basis, clipped = np.asarray(basis), np.asarray(clipped, bool)
    measured = np.array(radiance, np.float64)
    whole, some = ~clipped.any(1), ~clipped.all(1)
    if not whole.any():
        raise InputError("the fit", "every pixel is clipped", "give a photo with a shorter exposure")
    active = np.zeros_like(clipped)
    used, b = whole, measured
    solver, fit = _solved(basis, b, used, blocks, prior, order)
    count = 1
    if whole.all():
        return CensoredFit(fit, solver, used, b, active, count)
    x = fit.all_coefficients
    for _ in range(rounds):
        predicted = _predicted(basis, x)
        now = clipped & (predicted < measured)
        spread = np.sqrt(np.square(measured - predicted)[whole].mean(0))
        z = np.minimum((measured - predicted) / np.maximum(spread, 1e-300), FARTHEST)
        b = np.where(clipped, predicted + spread * _hazard(z), measured)
        wanted = whole | now.any(1) | (some if partly else False)
        if not np.array_equal(wanted, used):
            used = wanted
            solver, fit = _solved(basis, b, used, blocks, prior, order)
        else:
            fit = solver.solve(b[used])
        count += 1
        before, x = x, fit.all_coefficients
        settled = np.linalg.norm(x - before) <= SETTLED * np.linalg.norm(x)
        if settled and np.array_equal(now, active):
            break
        active = now
    return CensoredFit(fit, solver, used, b, active, count)


def with_hidden_light(fit: Fit, share: float, prior) -> Fit:
    """The fit with the uncertainty that clipping leaves.

    Parameters
    ----------
    fit : Fit of a light with a prior; share : of the channels of the object's pixels that are clipped, 0 to 1
    prior : light.natural.NaturalPrior of the fit

    Returns
    -------
    Fit with wider ``stddev``, ``covariance``, and fewer of its coefficients ``determined``
    """
    if share <= 0:
        return fit
    relative = HIDDEN * np.sqrt(share)  # to natural light of the fit's level
    added = relative * fit.coefficients[0].mean() * prior.deviation[:, None]
    terms, few = len(fit.coefficients), len(fit.covariance) // 3
    known = fit.all_determined & (np.square(relative / fit.prior_scale) < DETERMINED)
    return replace(
        fit,
        stddev=np.hypot(fit.stddev, added[:terms]),
        covariance=fit.covariance + np.diag(np.broadcast_to(added[:few] ** 2, (few, 3)).ravel()),
        determined=known[:terms],
        all_determined=known,
    )


def _hazard(z) -> np.ndarray:
    """phi(z) / (1 - Phi(z)) of the normal distribution, in logarithms: both run out far above the mean.

    ``scipy.stats`` has both, and takes longer to import than a fit.
    """
    return np.exp(-0.5 * np.square(z) - 0.5 * np.log(2 * np.pi) - log_ndtr(-z))


def _solved(basis, b, used, blocks, prior, order: int):
    solver = LightSolver(basis[used], blocks=blocks[used], prior=prior, order=order)
    return solver, solver.solve(b[used])


def _predicted(basis, x) -> np.ndarray:
    """A x: (p, 3)."""
    return np.stack([basis[:, :, c] @ x[:, c].astype(basis.dtype) for c in range(3)], 1).astype(np.float64)
