# SPDX-License-Identifier: GPL-3.0-or-later
"""The error that an estimate has to expect, by its own posterior: what was knowable, beside what was found.

An error of a light x^ is |s x^ - x| / |x| with the best factor s >= 0 (one free scale), over the coefficients up to an
order. The truth x is any of the posterior's samples, so the error has a distribution; its median and the range that
holds 68 % of it are stated.
"""

import numpy as np

from btfsep_engine import sh

RANGE = (16, 50, 84)  # percentiles


def expected_error(coefficients, samples, *, orders=(1, 2)) -> dict:
    """The expected relative error up to each order, with one free scale.

    Parameters
    ----------
    coefficients : (terms, 3), the estimate
    samples : (n, at least so many terms, 3), lights as probable as the posterior has them
    orders : those of them that the terms reach are answered

    Returns
    -------
    {"order_1": {"median", "low", "high"}, …}, relative errors with one free scale
    """
    x, out = np.asarray(coefficients, np.float64), {}
    for order in orders:
        n = sh.term_count(order)
        if n > len(x):
            continue
        a, b = x[:n].ravel(), np.asarray(samples)[:, :n].reshape(len(samples), -1)
        scale = np.maximum(b @ a / max(a @ a, 1e-300), 0)
        error = np.linalg.norm(scale[:, None] * a - b, axis=1) / np.maximum(np.linalg.norm(b, axis=1), 1e-300)
        low, median, high = np.percentile(error, RANGE)
        out[f"order_{order}"] = {"median": float(median), "low": float(low), "high": float(high)}
    return out
