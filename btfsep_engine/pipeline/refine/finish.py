# SPDX-License-Identifier: GPL-3.0-or-later
"""A surface that nobody measured: how rough it is, and its colour where that is not known, by evidence.

The homogeneous family (`btf.surfaces`) stands for what no library holds, as one plastic and one matte surface. A real
thing is rougher or glossier, darker or brighter than either, and light imitates the difference. What is coloured is
its base: its gloss is white. A grey surface under coloured light is as a coloured one under grey light only as long as
it has no gloss; of a red thing, in green and blue, that is nearly all one sees. So where the object's colour is not
known (`fit.colour`) the base gets the one that the light leaves to the object, and both are found by turns.

Surfaces are tried on a few of the pixels, under a field alone; the best of them on all. Of one object alone: a tint is
that of all light.
"""

from dataclasses import dataclass, replace

import numpy as np

from btfsep_engine.btf.surfaces import SURFACES, Surface
from btfsep_engine.fit.colour import base_colour
from btfsep_engine.pipeline.light_account import UNKNOWN_COLOUR
from btfsep_engine.pipeline.refine.reflectance import CLEARLY, FEW, fewer, field_alone, with_material
from btfsep_engine.pipeline.together import SolvedLight, fit_together
from btfsep_engine.render.homogeneous import homogeneous

ROUGHNESSES = (0.2, 0.4, 0.6, 0.9)
BRIGHTEST = (0.6, 0.25)  # of the base colour's channels
ON_ALL = 2  # surfaces that are tried on all pixels
TURNS = 3
SETTLED = 0.05  # of a tint


@dataclass(frozen=True)
class Finished:
    """A surface that was tried, with its light; ``problems`` : with it."""

    surface: Surface
    problems: list
    light: SolvedLight


def finished(model, light):
    """The refinement: the only object's surface as rough, as bright and of the colour that explains the photo best."""
    problems, fit = model.problems, light.fit
    if fit.tint is None or model.appearance != "mean" or model.settings.departures == "never":
        return model, light, {}
    of_family, unknown = SURFACES.get(problems[0].materials[0].name), fit.tint.unknown > UNKNOWN_COLOUR
    dielectric = of_family is not None and not of_family.metallic
    ideal = unknown and problems[0].materials[0].matte_albedo is not None  # a reference has no colour
    if not (dielectric or ideal) or any(len(p.materials) > 1 for p in problems):
        return model, light, {}
    with model.reporter.stage("reflectance"):
        best = _best(problems, light, unknown, replace(model.modelled, order=light.order))
    if best.light.fit.evidence < fit.evidence + CLEARLY:
        return model, light, {"finish": "as it is in the library: no other explains the photo better"}
    words = f"a roughness of {best.surface.roughness:g}"
    if unknown:
        words += f" and the base colour {', '.join(f'{c:.2f}' for c in best.surface.base_color)}"
    changed = replace(model, looks={model.appearance: best.problems}, departed={0: best.problems[0].materials[0]})
    return changed, best.light, {"finish": f"the surface was taken to have {words} (by evidence)"}


def _best(problems, light, unknown: bool, settings) -> Finished:
    """The surface of the largest evidence."""
    tint = light.fit.tint.object_tint if unknown else np.zeros(2)
    few, name = fewer(problems, FEW, settings.seed), problems[0].materials[0].name
    every = [
        Surface(tuple(brightest * base_colour(tint)), roughness) for roughness in ROUGHNESSES for brightest in BRIGHTEST
    ]
    made = [with_material(few, 0, homogeneous(surface, name), settings) for surface in every]
    evidence = [field_alone(trial, light, settings).evidence for trial in made]
    tried = [every[i] for i in np.argsort(evidence)[-ON_ALL:]]
    each = [_by_turns(problems, light, surface, unknown, settings) for surface in tried]
    return max(each, key=lambda one: one.light.fit.evidence)


def _by_turns(problems, light, surface: Surface, unknown: bool, settings) -> Finished:
    """A surface, where its colour is unknown in that which the light leaves to the object, and the light."""
    name, brightest, before, answer = problems[0].materials[0].name, max(surface.base_color), None, light
    for _ in range(TURNS if unknown else 1):
        tint = answer.fit.tint.object_tint if unknown else None
        if before is not None and np.abs(tint - before).max() < SETTLED:
            break
        if unknown:
            surface, before = replace(surface, base_color=tuple(brightest * base_colour(tint))), tint
        material = replace(homogeneous(surface, name), dye=tuple(tint) if unknown else None)
        trial = with_material(problems, 0, material, settings)
        answer = fit_together(trial, settings, beside=light.fit)
    return Finished(surface, trial, answer)
