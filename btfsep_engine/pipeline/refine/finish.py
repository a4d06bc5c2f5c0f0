# SPDX-License-Identifier: GPL-3.0-or-later
"""A surface that nobody measured: how rough it is, and its colour where that is not known, by evidence.

The homogeneous family (`btf.surfaces`) stands for what no library holds, as one plastic, one matte and one metallic
surface. A real thing is rougher or glossier, darker or brighter than these, and light imitates the difference. What is
coloured of a dielectric is its base: its gloss is white. A grey surface under coloured light is as a coloured one under
grey light only as long as it has no gloss; of a red thing, in green and blue, that is nearly all one sees. So where the
object's colour is not known (`fit.colour`) the base gets the one that the light leaves to the object, and both are
found by turns.

A material that was recognised stands beside them: recognition knows what looks most like the photo, and of a thing
that is not in the library that may be anything. Where a plain surface explains the photo far better, it takes over.

Surfaces are tried on a few of the pixels, under a field alone; the best of them on all, and one beside it that a walk
in small steps comes to, on the few pixels again. Of one object alone: a tint is that of all light.
"""

from dataclasses import dataclass, replace

import numpy as np

from btfsep_engine.btf.surfaces import SURFACES, Surface
from btfsep_engine.fit.colour import base_colour, tint_of
from btfsep_engine.fit.search import Solution
from btfsep_engine.pipeline.light_account import UNKNOWN_COLOUR
from btfsep_engine.pipeline.refine.reflectance import FEW, HOPEFUL, fewer, field_alone, with_material
from btfsep_engine.pipeline.together import SolvedLight, fit_together, followed
from btfsep_engine.render.homogeneous import homogeneous

ROUGHNESSES = (0.2, 0.4, 0.6, 0.9)
# Of the base colour's channels. Nothing darker: of a real grey ball the evidence prefers 0.1 with a roughness of 0.6:
# by that the light of seven of 18 photographs errs 0.15 to 0.36, and 0.09 to 0.16 without; six err a little less.
BRIGHTEST = (0.6, 0.25)
OF_METAL = (0.45, 0.6)  # roughnesses beside its own: of smoother ones the light's order shows too little
ON_ALL = 2  # surfaces that are tried on all pixels, beside the walk's end; but none
NEARLY_AS_GOOD = 15.0  # ... that explains so much less of a few than the best, of the logarithm of the evidence
# Steps of that walk, and how far it may go. Of 32 plates, as any plastic, the error is 0.88 times what it is without, 7
# less by a tenth, none more; of 29 others with flaws in lens and surface 1.00, of 18 photographs of a real ball 0.99.
FINER, SMOOTHEST, ROUGHEST = 0.1, 0.2, 1.0  # of a roughness
LIGHTER, DARKEST, LIGHTEST = 1.4, 0.17, 0.85  # of the brightest of the base colour's channels; the first a factor
# Of what is needed on all pixels, that the walk's end has to gain on a few: where a plain surface took over, on 82 of
# 107 photographs, it gains 0.41 times as much and more; where none did, two of three gain less.
PROMISES = 0.4
# Over the likeliest candidate: less, and no plain surface is asked. Of 64 plain and painted objects the likeliest plain
# one has at least 0.06 of that; of 18 photographs of a library's textures, rightly recognised, 4e-5 and less but once.
# Two of these were taken for plain, by an evidence of 15 and 21: their light erred 0.25 in place of 0.12 and 0.17.
RULED_OUT = 1e-3
TURNS = 3
SETTLED = 0.05  # of a tint
GREY = 0.05  # as such
# By how much a plain surface has to explain the photo better, of the logarithm of the evidence. Of 27 photographs of a
# library's own materials, rightly recognised, none gains more than 1.2; of plates of others, taken for one of a
# library or for a surface as it stands there, most gain 11 to 150. Painted objects of which a job says that they are
# white references gain up to 8.5, and plain ones as a rule 50 to 200.
# And by how much on a few of the pixels, before all are asked: of references those gain up to 11, these 30 and more.
# One of the family itself says of a thing that it is a plastic, and nothing of how rough or dark: there a little is
# enough. Of 18 photographs of a real ball nine gain 3 to 12, and err 0.14 in place of 0.33; of 95 plates three, and err
# 0.94 to 1.13 times as much.
FAR, OF_FAMILY, FROM_REFERENCE = 12.0, 3.0, (30.0, 15.0)
PLASTIC, MATTE = "surface/plastic", "surface/matte"


@dataclass(frozen=True)
class Finished:
    """A surface that was tried, with its light; ``problems`` : with it; ``by_turns`` : whether the light's model was
    elected for another colour."""

    surface: Surface
    problems: list
    light: SolvedLight
    by_turns: bool = False


def finished(model, light):
    """The refinement: the only object's surface as rough, as bright and of the colour that explains the photo best."""
    if light.fit.tint is None or model.appearance != "mean" or model.settings.departures == "never":
        return model, light, {}
    if any(len(p.materials) > 1 for p in model.problems):
        return model, light, {}
    made_of, unknown = model.problems[0].materials[0], light.fit.tint.unknown > UNKNOWN_COLOUR
    taken = next((m[0] for m in model.materials), None)
    recognised = taken is not None and not taken.is_given and taken.mirror is None
    of_family = SURFACES.get(made_of.name)
    metal = of_family is not None and of_family.metallic == 1
    ideal = unknown and made_of.matte_albedo is not None  # a reference has no colour
    if not (of_family or ideal or recognised) or made_of.mirror_reflectance is not None:
        return model, light, {}
    if recognised and _has_texture(taken):
        return model, light, {"finish": "as it is in the library: recognition rules out a surface alike all over"}
    tint = tint_of(made_of.diffuse_albedo())
    with model.reporter.stage("reflectance"):
        seen = tint + light.fit.tint.object_tint if unknown or np.abs(tint).max() > GREY else None
        if metal:
            seen, every = None, [replace(of_family, roughness=roughness) for roughness in OF_METAL]
        else:
            every = _dielectrics(seen)
        of_library = recognised and not of_family
        needed, hopeful = (FAR, HOPEFUL) if of_library else (OF_FAMILY, HOPEFUL) if of_family else FROM_REFERENCE
        settings = replace(model.modelled, order=light.order)
        best = _best(model.problems, light, seen, every, settings, hopeful=hopeful, needed=needed)
    if best is None or best.light.fit.evidence < light.fit.evidence + needed:
        return model, light, {"finish": "as it is in the library: no plain surface explains the photo better"}
    answer = fit_together(best.problems, settings, beside=light.fit) if best.by_turns else best.light
    words = f"a roughness of {best.surface.roughness:g}"
    if seen is not None:
        words += f" and the base colour {', '.join(f'{c:.2f}' for c in best.surface.base_color)}"
    (material,) = best.problems[0].materials
    changed = replace(model, looks={model.appearance: best.problems}, departed={0: material})
    materials = _none_of_the_library(model, best) if of_library else model.materials
    materials = tuple([replace(one, surface=best.surface) for one in each] for each in materials)
    words = f"the surface was taken to have {words} (by evidence)"
    return replace(changed, materials=materials), answer, {"finish": words}


def _has_texture(recognised) -> bool:
    """Whether recognition, which has seen the texture, is sure of it: a thing alike all over is ruled out."""
    if recognised.looks_alike:
        return False
    plain = [score for name, score in recognised.candidates if name in SURFACES]
    return bool(plain) and max(plain) < RULED_OUT * max(score for _, score in recognised.candidates)


def _none_of_the_library(model, best: Finished) -> tuple:
    """The materials of the photographs' objects, the recognised one's place taken by a plain surface; says so."""
    name = MATTE if best.surface.roughness == max(ROUGHNESSES) else PLASTIC
    (material,) = best.problems[0].materials
    instead = {"name": name, "material": replace(material, name=name), "unknown": True, "likely": ()}
    model.reporter.warn(
        f"object '{model.problems[0].scene.job.objects[0].name}' looks like none of the library's materials after all: "
        f"a surface of one kind all over explains the photo far better than the nearest, {model.materials[0][0].name}; "
        "give its material, or its 'surface', if you know it"
    )
    return tuple([replace(one, **instead) for one in each] for each in model.materials)


def _dielectrics(tint) -> list[Surface]:
    """Those that are tried of a colour."""
    colour = base_colour(np.zeros(2) if tint is None else tint)
    return [Surface(tuple(b * colour), roughness) for roughness in ROUGHNESSES for b in BRIGHTEST]


def _best(problems, light, tint, every: list[Surface], settings, *, hopeful: float, needed: float) -> Finished | None:
    """The surface of the largest evidence; None where none promises on a few of the pixels to gain what is ``needed``.

    Parameters
    ----------
    tint : (2,) of the object's colour, as far as it is seen; None: it is grey, or all of it is the light's
    hopeful : what the best of ``every`` has to gain on a few pixels before any more are tried
    """
    few, name = fewer(problems, FEW, settings.seed), problems[0].materials[0].name
    made = [with_material(few, 0, homogeneous(surface, name), settings) for surface in every]
    own = field_alone(few, light, settings)
    evidence = np.array([field_alone(trial, light, settings, start=own).evidence for trial in made])
    if evidence.max() < own.evidence + hopeful:
        return None
    tried = [every[i] for i in np.argsort(evidence)[-ON_ALL:] if evidence[i] > evidence.max() - NEARLY_AS_GOOD]
    if settings.refine == "all" and not tried[-1].metallic:
        end, most = _walked_to(few, own, tried[-1], evidence.max(), light, settings)
        if most < own.evidence + PROMISES * needed:
            return None
        tried.append(end)
    each = [_by_turns(problems, light, surface, tint, settings) for surface in dict.fromkeys(tried)]
    return max(each, key=lambda one: one.light.fit.evidence)


def _walked_to(few, start: Solution, surface: Surface, evidence: float, light, settings) -> tuple[Surface, float]:
    """The surface that a walk from ``surface`` ends at, and its evidence: to the next rougher, smoother, lighter or
    darker one that explains a few of the pixels best, as long as that does better. ``evidence`` : of ``surface``"""
    name, known = few[0].materials[0].name, {surface: evidence}
    while True:
        for near in _beside(surface):
            if near not in known:
                trial = with_material(few, 0, homogeneous(near, name), settings)
                known[near] = field_alone(trial, light, settings, start=start).evidence
        best = max(known, key=known.get)
        if best == surface:
            return surface, known[surface]
        surface = best


def _beside(surface: Surface) -> list[Surface]:
    """Those a step away, of the same colour."""
    colour = np.array(surface.base_color)
    brightest = float(colour.max())
    roughnesses = [round(float(np.clip(surface.roughness + d, SMOOTHEST, ROUGHEST)), 2) for d in (FINER, -FINER)]
    by_brightness = [np.clip(brightest * f, DARKEST, LIGHTEST) / brightest for f in (LIGHTER, 1 / LIGHTER)]
    colours = [tuple(float(round(c, 4)) for c in colour * f) for f in by_brightness]
    return [replace(surface, roughness=r) for r in roughnesses] + [replace(surface, base_color=c) for c in colours]


def _by_turns(problems, light, surface: Surface, tint, settings) -> Finished:
    """A surface, where its colour is unknown in that which the light leaves to the object, and the light."""
    name, brightest = problems[0].materials[0].name, max(surface.base_color)
    for turn in range(TURNS):
        material = replace(homogeneous(surface, name), dye=None if tint is None else tuple(tint))
        trial = with_material(problems, 0, material, settings)
        if not turn:
            answer = fit_together(trial, settings, beside=light.fit)
        else:  # of nearly the same surface: by the model that was elected of the first
            answer = replace(answer, fit=followed(trial, answer, settings))
        if tint is None or np.abs(answer.fit.tint.object_tint - tint).max() < SETTLED:
            break
        tint = answer.fit.tint.object_tint
        surface = replace(surface, base_color=tuple(brightest * base_colour(tint)))
    return Finished(surface, trial, answer, by_turns=turn > 0)
