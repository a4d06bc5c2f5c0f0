# SPDX-License-Identifier: GPL-3.0-or-later
"""The error that an estimate has to expect, by its own posterior: what was knowable, beside what was found.

An error of a light x^ is |s x^ - x| / |x| with the best factor s (one free scale), over the coefficients up to an
order. The truth x is drawn from the posterior N(x^, covariance), so the error has a distribution; its median and the
range that holds 68 % of it are stated.
"""

import numpy as np

from btfsep_engine import sh

DRAWS = 400
RANGE = (16, 50, 84)  # percentiles


def expected_error(coefficients, covariance, *, orders=(1, 2), draws: int = DRAWS, seed: int = 0) -> dict:
    """The expected relative error up to each order, with one free scale.

    Parameters
    ----------
    coefficients : (terms, 3), the estimate
    covariance : (3 n, 3 n) of its first n rows, row by row and in it channel by channel
    orders : those of them that n and the terms reach are answered

    Returns
    -------
    {"order_1": {"median", "low", "high"}, …}, relative errors with one free scale
    """
    known = min(len(covariance) // 3, len(coefficients))
    covariance = np.asarray(covariance)[: 3 * known, : 3 * known]
    x = np.asarray(coefficients, np.float64)[:known].ravel()
    values, vectors = np.linalg.eigh((covariance + covariance.T) / 2)
    root = vectors * np.sqrt(np.maximum(values, 0))
    truth = x + np.random.default_rng(seed).standard_normal((draws, len(values))) @ root.T
    out = {}
    for order in orders:
        n = 3 * sh.term_count(order)
        if n > len(x):
            continue
        a, b = x[:n], truth[:, :n]
        scale = np.maximum(b @ a / max(a @ a, 1e-300), 0)
        error = np.linalg.norm(scale[:, None] * a - b, axis=1) / np.maximum(np.linalg.norm(b, axis=1), 1e-300)
        low, median, high = np.percentile(error, RANGE)
        out[f"order_{order}"] = {"median": float(median), "low": float(low), "high": float(high)}
    return out
