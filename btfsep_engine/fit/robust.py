# SPDX-License-Identifier: GPL-3.0-or-later
"""Pixels that the light does not explain count less: iteratively re-weighted fits (Huber 1964; Beaton and Tukey 1974).

The residual of a pixel (or the root mean square of a block's) over its robust spread decides its weight. The spread is
the median absolute deviation, scaled to a normal distribution's; it is found anew in each round. A weight w enters as
sqrt(w) on the pixel's rows of A and b, which is a noise variance of 1 / w. Basis images must have shadows: without
them, what is in shade looks like an outlier.

The weighted fit itself pays for its safety: it takes the texture that the mean ABRDF does not have for outliers, too.
So an estimate (`--robust`) uses it to find out which pixels stand apart (`outliers`), leaves these out, and fits the
others as ever.
"""

from dataclasses import dataclass

import numpy as np

from btfsep_engine.fit.least_squares import Fit
from btfsep_engine.fit.map_estimate import LightSolver, coarsening_of

ROUNDS = 5
STIFF = 4.0  # times the coarsening of an estimate: a light as sharp as can be explains what stands apart, too
NORMAL = 1.4826  # standard deviation over the median absolute deviation
TUNING = {"huber": 1.345, "tukey": 4.685}  # 95 % efficiency for normal residuals
SETTLED = 0.01  # largest change of a weight
OUTLIER = 0.1  # a Tukey weight below which a pixel is left out: 3.9 times the spread


@dataclass(frozen=True)
class RobustFit:
    """``fit`` : Fit; ``solver`` : the LightSolver of the weighted rows; ``weights`` : (p,) in [0, 1]."""

    fit: Fit
    solver: LightSolver
    weights: np.ndarray


def weights_of(residual, *, kind: str) -> np.ndarray:
    """Weights (n,) in [0, 1] of residuals' sizes (n,) >= 0, whose spread is found by their median."""
    size = np.asarray(residual, np.float64)
    spread = NORMAL * np.median(size)
    if not spread > 0:
        return np.ones_like(size)
    u = size / (TUNING[kind] * spread)
    if kind == "huber":
        return 1 / np.maximum(u, 1)
    return np.where(u < 1, (1 - np.minimum(u, 1) ** 2) ** 2, 0.0)


def outliers(basis, radiance, *, blocks, prior, order: int) -> np.ndarray:
    """The pixels that stand apart from what light can explain: (p,) bool. Parameters and errors of `solve_robust`."""
    return solve_robust(basis, radiance, blocks=blocks, prior=prior, order=order, kind="tukey").weights < OUTLIER


def solve_robust(basis, radiance, *, blocks, prior, order: int, kind: str, by: str = "pixel") -> RobustFit:
    """The most probable light, with weights by what each pixel or block leaves over.

    Parameters
    ----------
    basis : (p, terms, 3) float, A; radiance : (p, 3) float, b
    blocks, prior, order : of `LightSolver`
    kind : "huber" or "tukey"; by : "pixel" or "block"

    Returns
    -------
    RobustFit; its fit's residual is the weighted one

    Raises
    ------
    InputError
        As `LightSolver`.
    """
    basis, b = np.asarray(basis), np.asarray(radiance, np.float64)
    _, labels, counts = np.unique(blocks, return_inverse=True, return_counts=True)
    labels = labels.reshape(-1)
    weights = np.ones(len(b))
    response = np.sqrt(np.mean(np.square(basis[:, 0], dtype=np.float64), 0))
    for _ in range(ROUNDS):
        kept = weights > 1e-4
        root = np.sqrt(weights[kept])
        rows = basis[kept] * root[:, None, None].astype(basis.dtype)
        stiff = STIFF * coarsening_of(len(rows))
        solver = LightSolver(rows, blocks=blocks[kept], prior=prior, order=order, coarsening=stiff)
        fit = solver.solve(b[kept] * root[:, None])
        x = fit.all_coefficients
        predicted = np.stack([basis[:, :, c] @ x[:, c].astype(basis.dtype) for c in range(3)], 1)
        size = np.sqrt(np.square((b - predicted) / response).sum(1))
        if by == "block":
            size = np.sqrt(np.bincount(labels, size**2) / counts)
        found = weights_of(size, kind=kind)
        found = found[labels] if by == "block" else found
        change, weights = np.abs(found - weights).max(), found
        if change < SETTLED:
            break
    return RobustFit(fit, solver, weights)
