# SPDX-License-Identifier: GPL-3.0-or-later
"""What an estimate is worth against the truth, and what a call costs."""

import time

import numpy as np

from btfsep_engine import sh
from btfsep_engine.fit import compare
from btfsep_engine.fit.stated import expected_error
from btfsep_engine.storage import kept

ERROR_ORDER = 2
TERMS = sh.term_count(ERROR_ORDER)
WITHIN = {"within68": 0.9945, "within95": 1.96}  # standard deviations of a normal distribution


def errors(estimate, truth, orders=(1, 2)) -> dict:
    """What coefficients (terms, 3) are worth.

    Returns
    -------
    orderN : relative L2 error up to each of ``orders``, one free scale; orderN_absolute : none; NaN above the
        estimate's or the truth's own order
    scale : the free scale of the highest of them; direction : degrees between the main directions of the light
    """
    estimate, truth = np.asarray(estimate), np.asarray(truth)
    out = {"direction": compare.direction_error(estimate, truth)}
    for order in orders:
        n = sh.term_count(order)
        known = min(len(estimate), len(truth)) >= n
        found = compare.relative_l2(estimate[:n], truth[:n]) if known else {}
        out[f"order{order}"] = found.get("relative_l2_free_scale", np.nan)
        out[f"order{order}_absolute"] = found.get("relative_l2", np.nan)
        out["scale"] = found.get("scale", out.get("scale"))
    return out


def order2(estimate, truth) -> float:
    """The usual error: relative, up to order 2, with one free scale."""
    return errors(estimate, truth)["order2"]


def covered(x, stddev, truth, *, interval=None) -> dict:
    """Shares of true coefficients (terms, 3) in what is stated of ``x``: within 1 and 1.96 ``stddev``, and, where
    there is an ``interval`` (2, terms, 3), ``inside`` it."""
    off = np.abs(x - truth)
    out = {key: float((off <= width * stddev).mean()) for key, width in WITHIN.items()}
    if interval is not None:
        out["inside"] = float(((interval[0] <= truth) & (truth <= interval[1])).mean())
    return out


def judged(light, samples, truth, *, free_scale: bool = False) -> dict:
    """An estimate and what it states: ``errors``, ``covered`` up to order 2, stated1 and stated2 (expected errors).

    With ``free_scale`` also pattern68 and pattern95: shares of true coefficients in the ranges of the light's pattern.

    Parameters
    ----------
    light : anything with coefficients, stddev, interval and pattern; samples : the fit's
    truth : (terms, 3), order 2 or more
    free_scale : whether ranges are held against a truth of another scale
    """
    x, truth = light.coefficients, np.asarray(truth)
    out = errors(x, truth)
    n, scale = TERMS, errors(x, truth)["scale"] if free_scale else 1.0
    stated = expected_error(x, samples)
    out |= {f"stated{order}": stated[f"order_{order}"]["median"] for order in (1, 2)}
    ends = scale * light.interval[:, :n]
    if free_scale and light.pattern is not None:
        wide, far = scale * light.pattern[1:3, :n], scale * light.pattern[::3, :n]
        for key, (low, high) in (("pattern68", wide), ("pattern95", far)):
            out[key] = float(((low <= truth[:n]) & (truth[:n] <= high)).mean())
    return out | covered(scale * x[:n], scale * light.stddev[:n], truth[:n], interval=ends)


def timed(function, *, afresh: bool = False):
    """Seconds of a call, by the clock and of all processors together: (2,), and its result.

    ``afresh`` : with nothing kept of what the process has traced and looked up before
    """
    if afresh:
        kept.STORE.forget()
    clock, work = time.perf_counter(), time.process_time()
    result = function()
    return np.array([time.perf_counter() - clock, time.process_time() - work]), result


def seconds_of(function, repeats: int, *, of=np.median, afresh: bool = False):
    """Medians (or the least, ``of=np.min``) of what :func:`timed` says of a few calls after one that is not counted,
    and the last result."""
    function()
    seconds, results = zip(*(timed(function, afresh=afresh) for _ in range(repeats)), strict=True)
    return of(seconds, axis=0), results[-1]
