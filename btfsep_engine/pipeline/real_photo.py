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
from btfsep_engine.pipeline.doubts import THRESHOLDS
from btfsep_engine.pipeline.problem import Problem
from btfsep_engine.pipeline.settings import FitSettings
from btfsep_engine.pipeline.together import light_solver

STIFF = 4.0  # times the coarsening of an estimate, where pixels are looked for that stand apart
PHOTOS_OWN = "the light's scale is the photo's own: its exposure and white balance cannot be told from the light's"


def clipped_channels(scene, points) -> np.ndarray:
    """Which channels of the points' pixels are lower bounds: (p, 3) bool."""
    clipped = scene.job.photo.clipped
    if clipped is None:
        return np.zeros((len(points), 3), bool)
    return clipped[points.pixels[:, 0], points.pixels[:, 1]]


def warn_of_clipping(scene, index: int, settings: FitSettings) -> None:
    """Says where much of an object is saturated or transparent, and what becomes of it."""
    region = scene.regions[index]
    unusable = region & ~scene.job.photo.usable
    share = unusable.sum() / max(region.sum(), 1)
    if share <= THRESHOLDS.clipped:
        return
    clipped = scene.job.photo.clipped
    bounds = settings.estimator == "map" and clipped is not None and (unusable & clipped.any(-1)).any()
    enter = (
        "the saturated ones count as at least as bright as they are"
        if bounds
        else "were left out: what they saw of the light is not in the estimate"
    )
    scene.reporter.warn(
        f"{100 * share:.0f} % of the pixels of object '{scene.job.objects[index].name}' are saturated or transparent"
        f"{'; ' if bounds else ' and '}{enter}"
    )


def as_real_photos(problems, rich, materials, settings: FitSettings):
    """The problems with clipped channels and free scales settled.

    Parameters
    ----------
    problems : list of Problem, one for each photograph; rich : the same points with textures, or None
    materials : for each photograph the estimation.ObjectMaterial of each object
    settings : with a prior

    Returns
    -------
    problems, rich
    """
    out = []
    for i, (problem, found) in enumerate(zip(problems, materials, strict=True)):
        clipped = np.concatenate([clipped_channels(problem.scene, p) for p in problem.points])
        used, measured, weights = np.ones(len(clipped), bool), None, None
        solving = replace(settings, order=settings.fit_order)
        if clipped.any():
            measured, weights = working_values(light_solver([problem], solving), problem.radiance(), clipped)
            used = weights.any(1)
            for part in problem.by_object(used):  # views into it: no object may vanish from the fit
                if not part.any():
                    part[:] = True
        problem = replace(problem, measured=measured, weights=weights, clipped=float(clipped.mean()))
        one = problem.kept(used)
        if settings.robust:
            stiff = light_solver([one], solving, coarsening=STIFF)
            out_of_line = outliers(stiff, one.radiance(), weights=one.weights)
            for part in one.by_object(out_of_line):  # views into it: no object may vanish from the fit
                part &= not part.all()
            used[used] = ~out_of_line
            one = replace(problem, left_out=int(out_of_line.sum())).kept(used)
        scales = scales_of(one, [not m.given for m in found])
        both = [one]
        if rich is not None:
            same = replace(rich[i], measured=measured, weights=weights, clipped=problem.clipped, left_out=one.left_out)
            both.append(same.kept(used))
        out.append([_divided(p, scales) for p in both])
    return [each[0] for each in out], None if rich is None else [each[1] for each in out]


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


def _divided(problem: Problem, scales) -> Problem:
    if scales is None:
        return problem
    parts = [b / s for b, s in zip(problem.by_object(problem.radiance()), scales, strict=True)]
    return replace(problem, measured=np.concatenate(parts), scales=scales)


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
