# SPDX-License-Identifier: GPL-3.0-or-later
"""Up to which order the light is reported, where that was left open: no more than the photo speaks of."""

from dataclasses import replace

import numpy as np

from btfsep_engine.linear_algebra import product

FOLDS = 5


def reported_order(model, light):
    """The refinement: under the prior, the highest order of which the photo determines something."""
    if model.settings.order != "auto" or model.settings.estimator != "map":
        return model, light, {}
    order = determined_order(light.fit.determined)
    why = f"the highest order of which the photo determines something is {order}"
    return model, replace(light, fit=light.solver.reported_up_to(light.fit, order)), {"order": why}


def determined_order(determined) -> int:
    """The highest order of which something is determined: (terms,) bool -> L, at least 1 where there is one."""
    known = np.flatnonzero(determined)
    highest = int(np.sqrt(known.max())) if len(known) else 0
    return max(highest, min(1, int(np.sqrt(len(determined))) - 1))


def cross_validated_order(basis, radiance, blocks, largest: int, *, seed: int = 0) -> tuple[int, str]:
    """The order of a least-squares fit: by block cross-validation, the lowest within one standard error of the best.

    Parameters
    ----------
    basis : (p, terms, 3) at the order ``largest``; radiance : (p, 3); blocks : (p,) int

    Returns
    -------
    order, and the reason in words
    """
    names, labels = np.unique(blocks, return_inverse=True)
    fold_of_block = np.random.default_rng(seed).permutation(len(names)) % FOLDS
    fold = fold_of_block[labels.reshape(-1)]
    response = np.sqrt(np.mean(np.square(basis[:, 0], dtype=np.float64), 0))
    b = radiance / response
    terms = basis.shape[1]
    grams, moments = np.zeros((FOLDS, 3, terms, terms)), np.zeros((FOLDS, 3, terms))
    for k in range(FOLDS):
        mine = fold == k
        for c in range(3):
            a = basis[mine, :, c] / response[c]
            grams[k, c], moments[k, c] = product(a.T, a), product(a.T, b[mine, c])
    energies = np.array([np.square(b[fold == k]).sum(0) for k in range(FOLDS)])
    errors = np.full((largest + 1, FOLDS), np.inf)
    for order in range(largest + 1):
        n = (order + 1) ** 2
        for k in range(FOLDS):
            left = 0.0
            for c in range(3):
                gram = grams[:, c, :n, :n].sum(0) - grams[k, c, :n, :n]
                ridge = 1e-12 * np.trace(gram) / n * np.eye(n)
                moment = moments[:, c, :n].sum(0) - moments[k, c, :n]
                x = np.linalg.lstsq(gram + ridge, moment, rcond=None)[0]  # of few blocks a fold may have all
                left += energies[k, c] - 2 * x @ moments[k, c, :n] + x @ grams[k, c, :n, :n] @ x
            errors[order, k] = left / max(energies[k].sum(), 1e-300)
    mean = errors.mean(1)
    best = int(mean.argmin())
    error = errors[best].std(ddof=1) / np.sqrt(FOLDS)
    order = int(np.flatnonzero(mean <= mean[best] + error)[0])
    words = (
        f"the lowest order whose cross-validated misfit ({np.sqrt(max(mean[order], 0)):.3f}) is within one standard "
    )
    return order, words + f"error of the best, that of order {best} ({np.sqrt(max(mean[best], 0)):.3f})"
