# SPDX-License-Identifier: GPL-3.0-or-later
"""One light for several photographs: the same unknowns, each photo with its own exposure.

Photo k shows e_k A_k x. The exposure of the first is 1, so that the light is in its scale; the others are found by
turns: with the light known, e_k is a projection; with the exposures known, the light is one fit of b_k / e_k. Basis
images do not change, so that they are factorised once and a turn takes milliseconds.
"""

import numpy as np

from btfsep_engine.fit.least_squares import solve
from btfsep_engine.fit.log_normal import LightSolver
from btfsep_engine.fit.stated import Fit
from btfsep_engine.pipeline.problem import Problem
from btfsep_engine.pipeline.settings import FitSettings

TURNS = 30
SETTLED = 1e-4  # relative change of an exposure
APART = 1 << 30  # blocks' numbers of one photo


def light_solver(problems: list[Problem], settings: FitSettings, *, coarsening: float = 1.0) -> LightSolver:
    """The basis images of all photos together made ready, for the estimator with a prior."""
    return LightSolver(
        stacked(problems)[0],
        normals=np.concatenate([p.normals for p in problems]),
        order=min(settings.order, settings.fit_order),
        seed=settings.seed,
        coarsening=coarsening,
    )


def all_weights(problems: list[Problem]):
    """(p, 3) of all photos, None where none has any."""
    if all(p.weights is None for p in problems):
        return None
    return np.concatenate([np.ones((len(p.blocks), 3)) if p.weights is None else p.weights for p in problems])


def stacked(problems: list[Problem]):
    """Basis images (p, terms, 3) and blocks (p,) of all photos; one photo's are not copied."""
    if len(problems) == 1:
        return problems[0].all_basis, problems[0].blocks
    blocks = np.concatenate([p.blocks + i * APART for i, p in enumerate(problems)])
    return np.concatenate([p.all_basis for p in problems]), blocks


def fit_together(problems: list[Problem], settings: FitSettings) -> tuple[Fit, LightSolver | None, list[float]]:
    """The light of all photographs.

    Parameters
    ----------
    problems : of each photograph; settings : with a number as ``order``

    Returns
    -------
    fit, the solver (None for least squares), and the exposure of each photograph over the first's
    """
    solver = light_solver(problems, settings) if settings.estimator == "map" else None
    basis, blocks = (None, None) if solver else stacked(problems)
    measured = [p.radiance().astype(np.float64) for p in problems]
    exposures, fit, weights = [1.0] * len(problems), None, all_weights(problems)
    for _ in range(TURNS if len(problems) > 1 else 1):
        b = np.concatenate([m / e for m, e in zip(measured, exposures, strict=True)])
        fit = solver.solve(b, weights=weights, start=fit) if solver else solve(basis, b, blocks=blocks)
        before, found = exposures, [exposure_of(p, m, fit) for p, m in zip(problems, measured, strict=True)]
        exposures = [e / found[0] for e in found]  # what all photos miss alike is no exposure
        if max(abs(a / e - 1) for a, e in zip(before, exposures, strict=True)) < SETTLED:
            break
    return fit, solver, exposures


def exposure_of(problem: Problem, measured, fit: Fit) -> float:
    """The factor on the light that explains a photo best, least squares, > 0."""
    predicted = problem.predicted(fit.shown)
    factor = float((predicted * measured).sum() / max(float(np.square(predicted).sum()), 1e-300))
    return max(factor, 1e-6)
