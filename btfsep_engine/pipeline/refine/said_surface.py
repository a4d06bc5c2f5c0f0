# SPDX-License-Identifier: GPL-3.0-or-later
"""What stands around in another colour than the job says, as where a stand-in has not the material of the real table.

A matte surface shows its albedo times what a white one in its place would show under the light that is found
(`refine.seen_colour`): of tables that are as the job says, that is right to a tenth. One that is far from it is taken
as the photo shows it, where the objects are explained clearly better so; where they are not, that the photo shows
another colour is a doubt (`pipeline.checks`): of the light, or of the surface.
"""

from dataclasses import replace

import numpy as np

from btfsep_engine.pipeline.doubts import albedo_differs, albedo_words
from btfsep_engine.pipeline.refine.interreflection import light_between_surfaces, with_reflections
from btfsep_engine.pipeline.refine.seen_colour import by_own_pixels, seen_colours, seen_places
from btfsep_engine.pipeline.refine.surroundings import by_photo

CLEARLY = 5.0  # of the logarithm of the evidence
OTHERWISE = "said_surface"  # its name among what is chosen


def surfaces_otherwise(problem, x, settings) -> dict:
    """{number of an occluder: (what its surface says (3,), what the photo shows (3,))} where these differ.

    ``x`` : (terms, 3), the light in the photo's own exposure
    """
    places = seen_places(problem.scene, said=True)
    said = {k: np.asarray(problem.scene.occluder_albedos[k]).reshape(-1, 3).mean(0) for k in places}
    shown = seen_colours(problem, places, x, settings)
    return {k: (said[k], c) for k, (c, left) in shown.items() if albedo_differs(said[k], c, left)}


def as_the_photo_shows(model, light):
    """The refinement: surfaces around the objects that are far from what the job says, in the photo's own colours."""
    of_default = model.settings.bounces == "auto" and model.settings.transport == "kernel" and model.bounces == 1
    if light.solver is None or not of_default:
        return model, light, {}
    each = [
        surfaces_otherwise(problem, exposure * light.fit.all_coefficients, model.settings)
        for problem, exposure in zip(model.problems, light.exposures, strict=True)
    ]
    if not any(each):
        return model, light, {}
    with model.reporter.stage("transport"):
        read = by_own_pixels(model, model, light, with_reflections, of=each)
        shown, brighter = by_photo(read.direct, read.model, read.light, with_reflections)
    as_said = light_between_surfaces(model, light)[1]
    if brighter.fit.evidence < as_said.fit.evidence + CLEARLY:
        return model, light, {}
    words = [
        f"{albedo_words(k, said, problem.scene.colours[k])}, which it was taken to reflect (by evidence)"
        for problem, own in zip(shown.problems, each, strict=True)
        for k, (said, _) in own.items()
    ]
    return shown, replace(brighter, suns=light.suns), {OTHERWISE: "; ".join(dict.fromkeys(words))}
