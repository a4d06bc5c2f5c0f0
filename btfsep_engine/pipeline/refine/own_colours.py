# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether what was taken for light in a texture (`pipeline.delighting`) is the object's own colour after all.

Dirt in hollows, and a colour that goes from light to dark over something round, go by the shape as light does. Then the
photo is explained better by the texture as it was told, and a few pixels show that. But so may a scan be that was taken
under the photo's own light: its texture has all of the shading, and even light on it makes the photo. So what explains
the photo better by making its light more even is not believed.
"""

from dataclasses import replace

import numpy as np

from btfsep_engine.btf.surfaces import GIVEN
from btfsep_engine.fit.search import Solution
from btfsep_engine.pipeline.delighting import DE_LIT, light_in_texture, words_of
from btfsep_engine.pipeline.materials import of_surface
from btfsep_engine.pipeline.model import stand_ins
from btfsep_engine.pipeline.refine.reflectance import FEW, fewer, field_alone, with_material
from btfsep_engine.pipeline.refine.sharp import sharp_lamps
from btfsep_engine.pipeline.together import fit_together

# Of the logarithm of the evidence, of a few pixels. Of 12 photographs of textures that are dirty in hollows, dusty on
# top or go from light to dark, three of which pass for light, told colours gain 22 to 41; of 26 by the transport
# itself 16 and more. Of 42 of scans with light in them most gain nothing, five 7 to 118
CLEARLY = 20.0
# Times what order 1 has over order 0: 0.67 to 1.1 of all of the former, whose light is too uneven where own colours are
# taken for light; 0.35 to 0.59 of three of the five scans
AS_UNEVEN = 0.63
# Times what is left over then, sharp lamps and all: 0.86 and 0.93 of two of the former; 0.98 of a scan in the sun, of
# which a field alone says that told colours are 118 more probable, and whose light errs 0.03, and 0.31 by these
CLOSER = 0.95
ITS_OWN = "what goes by the shape in the texture is the objects' own colour: the photo is explained better by it"


def its_own_colours(model, light):
    """The refinement: textures as they were told, where the photo speaks for them; and which were not taken so."""
    scene, each = model.problems[0].scene, model.materials[0]
    pictured = [i for i, (o, m) in enumerate(zip(scene.job.objects, each, strict=True)) if _has_light(o, m, model)]
    if not pictured:
        return model, light, {}
    words = {DE_LIT: words_of([scene.job.objects[i] for i in pictured], model.settings)}
    if light.solver is None:
        return model, light, words
    with model.reporter.stage("reflectance"):
        told = replace(model.settings, delight="never")
        made = {i: of_surface(scene.job.objects[i], scene.job, told) for i in pictured}
        settings = replace(model.modelled, order=light.order)
        few = fewer(model.problems, FEW, settings.seed)
        start = field_alone(few, light, settings)
        seen = field_alone(_of(few, made, model.appearance, settings), light, settings, start=start)
        if seen.evidence < start.evidence + CLEARLY or _unevenness(seen) < AS_UNEVEN * _unevenness(start):
            return model, light, words
        problems = _of(model.problems, made, model.appearance, settings)
        answer = fit_together(problems, settings, beside=light.fit)
    materials = tuple([replace(m, material=made.get(i, m.material)) for i, m in enumerate(e)] for e in model.materials)
    departed = model.departed | {i: problems[0].materials[i] for i in pictured}
    looks = {model.appearance: problems}
    changed = replace(model, settings=told, looks=looks, materials=materials, departed=departed)
    if _left(changed, answer) > CLOSER * _left(model, light):
        return model, light, words
    return changed, answer, {DE_LIT: ITS_OWN}


def _left(model, light) -> float:
    """What is left over of the photographs, lamps sharper than the harmonics taken into account."""
    model, light, _ = sharp_lamps(model, light)
    return float(np.linalg.norm(light.left_over(model.problems)))


def _has_light(thing, made_of, model) -> bool:
    return made_of.name == GIVEN and made_of.mirror is None and light_in_texture(thing, model.settings) is not None


def _of(problems, made: dict, appearance: str, settings) -> list:
    """The problems with other materials, {number of the object: what the job makes of it}."""
    for i, material in made.items():
        problems = with_material(problems, i, stand_ins([material], appearance)[0], settings)
    return problems


def _unevenness(seen: Solution) -> float:
    """Of a light's brightness: its coefficients of order 1 over that of order 0."""
    return float(np.linalg.norm(seen.x[:, 1:4]) / max(float(np.linalg.norm(seen.x[:, 0])), 1e-300))
