# SPDX-License-Identifier: GPL-3.0-or-later
"""Pixels that the light does not explain: iteratively re-weighted fits with Tukey's weights (Beaton and Tukey 1974).

The residual of a pixel over its robust spread decides its weight, which is 1 over a variance in the next fit. The
spread is the median absolute deviation, scaled to a normal distribution's; it is found anew in each round. Basis images
must have shadows: without them, what is in shade looks like an outlier.

The weighted fit itself pays for its safety: it takes the texture that the mean ABRDF does not have for outliers, too.
So an estimate (`--robust`) uses it to find out which pixels stand apart, leaves these out, and fits the others.
"""

import numpy as np

from btfsep_engine.fit.log_normal import LightSolver

ROUNDS = 5
NORMAL = 1.4826  # standard deviation over the median absolute deviation
TUNING = 4.685  # 95 % efficiency for normal residuals
SETTLED = 0.01  # largest change of a weight
OUTLIER = 0.1  # a weight below which a pixel is left out: 3.9 times the spread
LEAST = 1e-4  # a weight: a pixel counts for that at least, so that it stays in the fit's arithmetic


def tukey_weights(residual) -> np.ndarray:
    """Weights (n,) in [0, 1] of residuals' sizes (n,) >= 0, whose spread is found by their median."""
    size = np.asarray(residual, np.float64)
    spread = NORMAL * np.median(size)
    if not spread > 0:
        return np.ones_like(size)
    return (1 - np.minimum(size / (TUNING * spread), 1) ** 2) ** 2


def outliers(solver: LightSolver, radiance, *, weights=None) -> np.ndarray:
    """The pixels that stand apart from what light can explain: (p,) bool.

    Parameters
    ----------
    solver : log_normal.LightSolver of the p pixels, a stiff one (`coarsening`): a light as sharp as can be explains
        what stands apart, too
    radiance, weights : of `LightSolver.solve`
    """
    b = np.asarray(radiance, np.float64)
    own = np.ones_like(b) if weights is None else weights
    tukey, fit = np.ones(len(b)), None
    for _ in range(ROUNDS):
        fit = solver.solve(b, weights=own * np.maximum(tukey, LEAST)[:, None], start=fit)
        left = (b - solver.basis.predicted(fit.shown)) / solver.basis.response
        before, tukey = tukey, tukey_weights(np.sqrt((own * np.square(left)).sum(1)))
        if np.abs(tukey - before).max() < SETTLED:
            break
    return tukey < OUTLIER
