# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether a veil lies over the photo: light that never met the objects, of haze, of a window pane, of a stray light.

It adds the same to every pixel, in a colour of its own. Light from all sides does much the same to a convex object, so
that one of those alone cannot tell; but hollows and shadows would be darker than they are. Where what is left over
looks like that, the light is fitted with such a difference free (`fit.products`, ``slopes``), and where that explains
the photo clearly better and less is left over without it, it is taken off; how much of it there is stays free. A photo
that is too dark everywhere has none: that speaks of its tone curve. What a JPEG's or a film's colours make of strong
ones, and light of things nearby which nobody modelled, looks much the same, and is better taken off, too.
"""

from dataclasses import replace

import numpy as np

from btfsep_engine.fit.diagnose import effect
from btfsep_engine.pipeline.refine.interreflection import light_between_surfaces
from btfsep_engine.pipeline.together import all_weights, fit_together, stacked

USUAL = 0.2  # of the photo's mean: a deviation
SPEAKS = 20.0  # chi^2 of one degree of freedom: 0 to 11 without a veil, 90 to 1,100 with one of two fifths
CLEARLY = 5.0  # of the logarithm of the evidence: -7 to -3 without a veil
LEAST = 0.03  # of the photo's mean
FALLS = 0.9  # of what was left over, without it


def veiled(model, light):
    """The refinement: light that lies over the photo."""
    if light.solver is None or any(problem.veil is not None for problem in model.problems):
        return model, light, {}
    with model.reporter.stage("fit"):
        means = [p.radiance().mean(0) / e for p, e in zip(model.problems, light.exposures, strict=True)]
        even = [np.broadcast_to(m, (len(p.pixels), 3)) for p, m in zip(model.problems, means, strict=True)]
        if _speaks(model.problems, light, np.concatenate(even)) < SPEAKS:
            return model, light, {}
        free = model.changed(lambda p, m: p.beside(USUAL * m[:, None]), even)
        settings = replace(model.settings, order=light.order)
        answer = fit_together(free.problems, settings, beside=light.fit)
        if answer.fit.evidence < light.fit.evidence + CLEARLY:
            return model, light, {}
        veils = _veils(free.problems, answer)
        if min(v.mean() / p.radiance().mean() for p, v in zip(free.problems, veils, strict=True)) < LEAST:
            return model, light, {}
        bare = free.changed(lambda p, v: replace(p, veil=v), veils)
        answer = fit_together(bare.problems, settings, beside=light.fit)
        if _left(bare.problems, answer) > FALLS * _left(model.problems, light):
            return model, light, {}
    words = {"veil": veil_words(bare.problems)}
    bare, answer, more = light_between_surfaces(bare, answer)
    return bare, answer, words | more


def _left(problems, light) -> float:
    """Root mean square of what a light leaves over."""
    return float(np.sqrt(np.square(light.left_over(problems)).mean()))


def _speaks(problems, light, even) -> float:
    """How much what is left over looks like the same light on every pixel (p, 3), of more than none: chi^2."""
    weights = all_weights(problems)
    unit = (1.0 if weights is None else np.sqrt(weights)) / light.solver.basis.response
    column = light.solver.smoother(light.fit)(even) * unit
    found = effect(light.left_over(problems) * unit, column[None], stacked(problems)[1])
    return found.chi2 if found.size[0] > 0 else 0.0


def _veils(problems, light) -> list:
    """Of each photo (3,), in its own unit: what its light leaves over on all pixels, and no more than any shows."""
    ends = np.cumsum([len(p.pixels) for p in problems])[:-1]
    left = np.split(light.left_over(problems), ends)
    return [
        np.clip(np.average(each, 0, p.weights) * e, 0, np.maximum(p.radiance().min(0), 0))
        for p, each, e in zip(problems, left, light.exposures, strict=True)
    ]


def veil_words(problems) -> str:
    """How much lies over each photo."""
    each = [100 * p.veil / np.maximum((p.radiance() + p.as_measured(p.veil_of_all)).mean(0), 1e-300) for p in problems]
    said = " | ".join("{:.0f}, {:.0f}, {:.0f} %".format(*percent) for percent in each)
    return f"{said} (red, green, blue) of what the photo shows of the objects is a veil, by evidence"
