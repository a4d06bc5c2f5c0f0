# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether the misfit is a part of what is seen: of a surface that is lighter here and darker there than it was told.

A texture of which only the mean is known, and an albedo that varies and nobody told, change what is bright by more than
what is dark. Where what is left over goes with the brightness (`fit.noise_law`), once lamps, shapes and materials have
been looked at, pixels count as that says, if the photo is clearly more probable then, and the light is not another one:
what moves it by more than it is expected to be wrong is some other misfit, of a wrong material or of a lamp nearby. The
light's model stays: pieces of a surface are larger than pixels, and another election would take them for lamps. Of what
has gloss, the brightest is what lamps are known by, and counts as before; so does all of a surface that the job gives
by numbers or images: who knows these, knows where it is light and dark, and on plates of such surfaces, alike all over,
the misfit is of other kinds. What was found to be painted in pieces (`refine.painted`) is known better by these.
"""

from dataclasses import replace

import numpy as np

from btfsep_engine.btf.surfaces import GIVEN
from btfsep_engine.fit.noise_law import precision
from btfsep_engine.fit.search import FLOOR
from btfsep_engine.fit.stated import ERROR_ORDERS, Fit, expected_error
from btfsep_engine.pipeline.doubts import THRESHOLDS
from btfsep_engine.pipeline.refine.highlights import shining
from btfsep_engine.pipeline.together import all_weights, followed

HIGHLIGHTS = 0.055  # as `highlights.GLOSSY`: roughness 0.3
CLEARLY = 5.0  # of the logarithm of the evidence
UNEVEN = (
    "what is left over goes with the brightness, as of a texture, or of an albedo that varies: what is dark counts for "
    "more (by evidence)"
)


def uneven_surfaces(model, light):
    """The refinement: pixels of surfaces without gloss count by how bright they are, where the misfit does."""
    if any(problem.painted for problem in model.problems):
        return model, light, {}
    uneven = [_may_be_uneven(problem) for problem in model.problems]
    explained = light.solver is not None and light.fit.residual < THRESHOLDS.residual  # no texture is as much as that
    if not explained or not np.any(np.concatenate(uneven)):
        return model, light, {}
    with model.reporter.stage("fit"):
        election, given = light.fit.election, all_weights(model.problems)
        photo, solution = election.photo, election.solution
        given = np.ones_like(photo.b) if given is None else given
        left = photo.left_over(solution.x, solution.v, solution.discrepancy)
        how = {"of": np.concatenate(uneven), "given": given, "floor": FLOOR**2 * photo.mean_square}
        own = precision(photo.b - left, left, **how)
        if np.allclose(own, 1):
            return model, light, {}
        ends = np.cumsum([len(p.pixels) for p in model.problems])[:-1]
        weighted = model.changed(lambda p, w: replace(p, weights=w), np.split(given * own, ends))
        fit = followed(weighted.problems, light, replace(model.settings, order=light.order))
    evidence = fit.election.evidence_of_photo + 0.5 * float((given * np.log(own)).sum()) / photo.coarsening
    if evidence < election.evidence_of_photo + CLEARLY or _overthrown(light.fit, fit):
        return model, light, {}
    return weighted, replace(light, fit=fit), {"uneven": UNEVEN}


def _may_be_uneven(problem) -> np.ndarray:
    """(p,) bool, the pixels of objects that may be lighter here and darker there, and have no highlights."""
    of_objects = zip(problem.materials, problem.points, strict=True)
    told = np.concatenate([np.full(len(points), material.name == GIVEN) for material, points in of_objects])
    return ~told & ~shining(problem, beyond=HIGHLIGHTS)[0]


def _overthrown(before: Fit, now: Fit) -> bool:
    """Whether a light is farther from the one before than that is expected to be wrong."""
    of, order = before.all_coefficients, max(ERROR_ORDERS)
    apart = expected_error(of, now.all_coefficients[None])[f"order_{order}"]["median"]
    return apart > expected_error(of, before.samples)[f"order_{order}"]["median"]
