# SPDX-License-Identifier: GPL-3.0-or-later
"""What a real photograph needs before its light is fitted: clipped channels, things in front, unknown reflectances.

Both are settled once, with a fit of their own (`fit.censored`, `fit.white_balance`), and leave ordinary problems: the
points that are used, and for each the values to be fitted. What follows knows nothing of them. So are, where they are
asked for, pixels that the light does not explain (`fit.robust`).
"""

from dataclasses import replace

import numpy as np

from btfsep_engine.fit.censored import working_values
from btfsep_engine.fit.robust import outliers
from btfsep_engine.fit.white_balance import free_scales
from btfsep_engine.pipeline.problem import Problem
from btfsep_engine.pipeline.settings import FitSettings
from btfsep_engine.pipeline.together import light_solver

STIFF = 4.0  # times the coarsening of an estimate, where pixels are looked for that stand apart
PHOTOS_OWN = "the light's scale is the photo's own: its exposure and white balance cannot be told from the light's"


def as_real_photo(problem: Problem, settings: FitSettings, *, recognised) -> Problem:
    """The problem with clipped channels and free scales settled.

    Parameters
    ----------
    settings : with a prior
    recognised : of each object, whether its material is
    """
    clipped, solving = problem.clipped, replace(settings, order=settings.fit_order)
    if clipped.any():
        known = 1.0 if problem.weights is None else problem.weights
        measured, weights = working_values(light_solver([problem], solving), problem.radiance(), clipped, known)
        problem = replace(problem, measured=measured, weights=weights)
        problem = problem.subset(some_of_each(problem, weights.any(1)))
    if settings.robust:
        stiff = light_solver([problem], solving, coarsening=STIFF)
        kept = some_of_each(problem, ~outliers(stiff, problem.radiance(), weights=problem.weights))
        problem = replace(problem, left_out=int((~kept).sum())).subset(kept)
    scales = scales_of(problem, recognised)
    if scales is None:
        return problem
    problem = replace(problem, scales=scales)
    return replace(problem, measured=problem.as_measured(problem.radiance()))


def some_of_each(problem: Problem, kept) -> np.ndarray:
    """``kept`` (p,) bool, and all of an object of which it is nothing: none may vanish from the fit."""
    parts = problem.by_object(kept)
    return np.concatenate([part if part.any() else np.ones_like(part) for part in parts])


def scales_of(problem: Problem, recognised) -> np.ndarray | None:
    """(objects, 3) of a problem, or None where no object's material is better known than another's."""
    if all(recognised) or not any(recognised):
        return None
    return free_scales(
        problem.basis,
        problem.by_object(problem.radiance()),
        normals=problem.by_object(problem.normals),
        blocks=problem.by_object(problem.blocks),
        free=recognised,
    )


def scale_words(problems) -> str:
    """Whose scale the light is in, for ``result.json``."""
    said = []
    for problem in problems:
        if problem.scales is None:
            continue
        names = [o.name for o in problem.scene.job.objects]
        free = [i for i, s in enumerate(problem.scales) if (s != 1).any()]
        held = " and ".join(f"'{n}'" for i, n in enumerate(names) if i not in free)
        each = [f"'{names[i]}' reflects {', '.join(f'{v:.2f}' for v in problem.scales[i])}" for i in free]
        said.append(
            f"the light's scale is held by {held}, whose material is given; "
            f"{'; '.join(each)} times (red, green, blue) its material"
        )
    return " | ".join(said) or PHOTOS_OWN


def left_out_words(problems) -> str:
    """How many pixels were not explained by the light, and left out."""
    lost = sum(p.left_out or 0 for p in problems)
    share = 100 * lost / max(lost + sum(len(points) for p in problems for points in p.points), 1)
    return f"{lost} pixels ({share:.1f} %) that the light does not explain were left out"
