# SPDX-License-Identifier: GPL-3.0-or-later
"""Dust: a surface that has another colour where it faces up than its numbers say, most often a lighter one.

Who takes a colour from a photo takes that of a side, and says nothing of the dust that lies on top. A dusty thing looks
as if more light came from above, and of a colour that makes up for the thing's own: of twelve such plates the light
erred up to 0.76, up to 3.8 times what was stated, with little left over. But such light is unlike natural light, and
the evidence says so: with dust on top a few pixels gain 8 to 140 of its logarithm on eleven of these twelve (the other
is white, as dust is), on 27 things without dust at most 2, on one that is explained badly 7.

Dust covers more the more a place faces up, and what is below it the less: of its share a what is reflected is dust's.
It is asked for of things of one colour, no metal, that have more than a few flat faces; no plate
asked for dark dust. What dust does to a gloss is left out.
"""

from dataclasses import replace

import numpy as np

from btfsep_engine.fit.diagnose import has_few_faces
from btfsep_engine.pipeline.refine.given import asked_of, surface_of
from btfsep_engine.pipeline.refine.reflectance import FEW, fewer, field_alone
from btfsep_engine.pipeline.together import fit_together

DUSTS = ((0.55, 0.5, 0.42), (0.5, 0.5, 0.5))  # base colours
FIRST, OTHERS = 0.35, (0.15, 0.6, 0.9)  # of what faces straight up, how much it covers
STEEP = 1.5  # power of the normal's part upwards
DARKEST = 0.02  # of a base colour, which what lies on it is over
METAL = 0.1
LEFT = 0.04  # of the photo, that the light leaves over: one that is explained better is not asked
HOPEFUL = 8.0  # of the logarithm of the evidence of a few pixels
DUSTY = "dust"  # its name among what is chosen
SAID = (
    "object '{}' has another colour where it faces up, as of dust on it, of which its surface says nothing (by "
    "evidence); the light goes by that"
)


def dusty(model, light):
    """The refinement: dust on objects of one given colour, where that explains the photo clearly better."""
    words = []
    with model.reporter.stage("reflectance"):
        for i in asked_of(model, light):
            found = _with_dust(model, light, i)
            if found is not None:
                model, light = found
                words.append(SAID.format(model.problems[0].scene.job.objects[i].name))
    return model, light, {DUSTY: "; ".join(words)} if words else {}


def lighter(normals, colour, dust, share: float) -> np.ndarray:
    """(p, 3), how much more than its own ``colour`` (3,) a surface of ``normals`` (p, 3) reflects, under dust of the
    colour ``dust`` (3,) that covers a ``share`` of what faces straight up."""
    covered = share * np.maximum(normals[:, 2:], 0) ** STEEP
    return 1 + covered * (np.asarray(dust) / np.maximum(colour, DARKEST) - 1)


def _with_dust(model, light, i: int):
    """Model and light with dust on an object; None where it does not explain the photo clearly better."""
    surface, left = surface_of(model, i), light.share_left(model.problems)
    if surface.image is not None or surface.metallic > METAL or left < LEFT:
        return None
    if all(has_few_faces(p.points[i].normal) for p in model.problems):  # how light its top is says nothing
        return None
    settings = replace(model.modelled, order=light.order)
    dust = _hopeful(model, light, i, surface.base_color, settings)
    if dust is None:
        return None
    trial = model.changed(lambda p: on_dust(p, _factor(p, i, surface.base_color, *dust)))
    trial = replace(trial, dust=model.dust | {i: (surface.base_color, *dust)})
    answer = fit_together(trial.problems, settings, beside=light.fit)
    return (trial, answer) if answer.share_left(trial.problems) < left else None


def _hopeful(model, light, i: int, colour, settings):
    """Colour and share of the dust with which a few of the pixels gain most under a field alone; None: too little."""
    few = fewer(model.problems, FEW, settings.seed)
    start = field_alone(few, light, settings)

    def gain(*dust) -> float:
        made = [on_dust(p, _factor(p, i, colour, *dust)) for p in few]
        return field_alone(made, light, settings, start=start).evidence - start.evidence

    most, best = max((gain(dust, FIRST), dust) for dust in DUSTS)
    if most <= 0:
        return None
    most, share = max((most, FIRST), *((gain(best, share), share) for share in OTHERS))
    return (best, share) if most > HOPEFUL else None


def _factor(problem, i: int, colour, dust, share: float) -> np.ndarray:
    """(p, 3) of `lighter`, of all of a problem's pixels; of other objects than ``i`` 1."""
    parts = [np.ones((len(points), 3)) for points in problem.points]
    parts[i] = lighter(problem.points[i].normal, colour, dust, share)
    return np.concatenate(parts)


def on_dust(problem, factor):
    """The problem of a photo that is brighter by a ``factor`` (p, 3) than its objects' materials make it."""
    parts = problem.by_object(factor.astype(np.float32))
    return replace(
        problem,
        basis=[a * f[:, None] for a, f in zip(problem.basis, parts, strict=True)],
        of_flash=None if problem.of_flash is None else problem.of_flash * factor,
    )
