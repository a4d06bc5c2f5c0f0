# SPDX-License-Identifier: GPL-3.0-or-later
"""One light for several photographs: the same unknowns, each photo with its own exposure.

Photo k shows e_k A_k x. The exposure of the first is 1, so that the light is in its scale; the others are found by
turns: with the light known, e_k is a projection; with the exposures known, the light is one fit of b_k / e_k. Basis
images do not change, so that they are factorised once and a turn takes milliseconds.
"""

import numpy as np

from btfsep_engine.fit.least_squares import Fit, solve
from btfsep_engine.fit.map_estimate import LightSolver
from btfsep_engine.light.natural import natural_prior
from btfsep_engine.pipeline.problem import Problem

TURNS = 30
SETTLED = 1e-4  # relative change of an exposure
APART = 1 << 30  # blocks' numbers of one photo


def light_solver(problems: list[Problem], settings) -> LightSolver:
    """The factorised basis images of all photos together, for the estimator with a prior."""
    basis, blocks = stacked(problems)
    return LightSolver(
        basis,
        blocks=blocks,
        prior=natural_prior(settings.fit_order),
        order=min(settings.order, settings.fit_order),
        positive=settings.positive,
    )


def stacked(problems: list[Problem]):
    """Basis images (p, terms, 3) and blocks (p,) of all photos; one photo's are not copied."""
    if len(problems) == 1:
        return problems[0].all_basis, problems[0].blocks
    blocks = np.concatenate([p.blocks + i * APART for i, p in enumerate(problems)])
    return np.concatenate([p.all_basis for p in problems]), blocks


def fit_together(problems: list[Problem], settings) -> tuple[Fit, LightSolver | None, list[float]]:
    """The light of all photographs.

    Parameters
    ----------
    problems : of each photograph; settings : Settings with a number as ``order``

    Returns
    -------
    fit, the solver (None for least squares), and the exposure of each photograph over the first's
    """
    solver = light_solver(problems, settings) if settings.estimator == "map" else None
    basis, blocks = (None, None) if solver else stacked(problems)
    measured = [p.radiance().astype(np.float64) for p in problems]
    exposures = [1.0] * len(problems)
    for _ in range(TURNS if len(problems) > 1 else 1):
        b = np.concatenate([m / e for m, e in zip(measured, exposures, strict=True)])
        fit = solver.solve(b) if solver else solve(basis, b, blocks=blocks)
        before, exposures = (
            exposures,
            [1.0] + [exposure_of(p, m, fit) for p, m in zip(problems[1:], measured[1:], strict=True)],
        )
        if max(abs(a / e - 1) for a, e in zip(before, exposures, strict=True)) < SETTLED:
            break
    return fit, solver, exposures


def exposure_of(problem: Problem, measured, fit: Fit) -> float:
    """The factor on the light that explains a photo best, least squares, > 0."""
    predicted = problem.predicted(fit.coefficients if fit.all_coefficients is None else fit.all_coefficients)
    factor = float((predicted * measured).sum() / max(float(np.square(predicted).sum()), 1e-300))
    return max(factor, 1e-6)
