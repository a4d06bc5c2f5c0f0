# SPDX-License-Identifier: GPL-3.0-or-later
"""Clipped pixels as inequalities: a channel that stands at the largest code was at least as bright as that.

Tobin's model (1958): a clipped channel whose limit lies z = (limit - p) / s above what the light predicts, p, with
misfit s, contributes log Phi(-z) in place of a square. Its slope and curvature by p are

    h(z) / s  and  -h (h - z) / s^2,    h(z) = phi(z) / (1 - Phi(z)),

so that a Gauss-Newton step sees it as a measurement of p + s / (h - z) with the weight h (h - z), between 0 (the light
explains more than the limit: it says nothing) and 1 (far less: it speaks like a measurement above the limit). So what
is clipped counts for as much evidence as it is, and no more. With nothing clipped this is the plain fit.
"""

import numpy as np
from scipy.special import log_ndtr

from btfsep_engine.errors import InputError
from btfsep_engine.fit.log_normal import LightSolver

ROUNDS = 6
SETTLED = 5e-3  # relative change of the coefficients
FARTHEST = 6.0  # misfits below the limit: a pixel that is farther below is wrong in another way
LIGHTEST = 1e-3  # a weight: less says nothing


def working_values(solver: LightSolver, radiance, clipped, known=1.0) -> tuple[np.ndarray, np.ndarray]:
    """What stands for clipped channels in a fit by squares.

    Parameters
    ----------
    solver : log_normal.LightSolver of the p pixels
    radiance : (p, 3) float, at the limit where clipped, linear
    clipped : (p, 3) bool
    known : (p, 3) in [0, 1], how much the channels count that are not clipped

    Returns
    -------
    values (p, 3) and weights (p, 3) in [0, 1] for `LightSolver.solve`

    Raises
    ------
    InputError
        Where every channel of every pixel is clipped.
    """
    b, clipped = np.array(radiance, np.float64), np.asarray(clipped, bool)
    if clipped.all():
        raise InputError("the fit", "every pixel is clipped", "give a photo with a shorter exposure")
    weights = np.where(clipped, 0.0, known)
    if not clipped.any():
        return b, weights
    fit, values = solver.solve(b, weights=weights), b
    for _ in range(ROUNDS):
        predicted = solver.basis.predicted(fit.shown)
        counts = np.where(clipped, 0.0, known)
        s = np.sqrt((counts * np.square(b - predicted)).sum(0) / np.maximum(counts.sum(0), 1e-300))
        s = np.maximum(s, 1e-3 * np.abs(predicted).mean(0) + 1e-300)
        z = np.clip((b - predicted) / s, -FARTHEST, FARTHEST)
        hazard = np.exp(-0.5 * z**2 - 0.5 * np.log(2 * np.pi) - log_ndtr(-z))
        weight = hazard * (hazard - z)
        weights = np.where(clipped, np.where(weight > LIGHTEST, np.minimum(weight, 1.0), 0.0), known)
        values = np.where(clipped, b - s * z + s / np.maximum(hazard - z, 1e-9), b)
        before, fit = fit.all_coefficients, solver.solve(values, weights=weights, start=fit)
        if np.linalg.norm(fit.all_coefficients - before) <= SETTLED * np.linalg.norm(before):
            break
    return values, weights
