# SPDX-License-Identifier: GPL-3.0-or-later
"""Pixels that show something else than the objects: a hand or a leaf in front, background where a mesh is too large.

Where a few pixels are left over far more than all the others, those that stand apart from what a stiff light explains
(`fit.robust`) are left out on trial; or whole parts that smooth light does not explain (`fit.two_kinds`), which may be
a quarter of all. They stay out where the light explains what is left two or three times as well: so much neither a
texture, nor the edges of shadows, nor highlights make of a photograph of the objects alone, and these are what lamps
are found by. Of an object with gloss, what is brighter than the light explains may be a highlight, and stays. Where
most of them lie along outlines, the camera is off, or the mesh. Light between surfaces that was left out of what the
photo seemed to show is asked for again. Nor are those left out that are shaded as objects are which a lamp lights there
and nowhere else, or only elsewhere (`refine.parted`), nor highlights of gloss that the material has not, or of lamps
sharper than the light is so far; and a thing's shadow stays, where a lamp explains it. What is shaded, coloured and
bounded as the light of all pixels has it, only not just there, shows the objects, whose mesh is of another shape: it
stays, and what is stated holds the light without it, too.
"""

from dataclasses import replace

import numpy as np
from scipy.sparse.csgraph import connected_components

from btfsep_engine.fit.colour import as_of_two_lights
from btfsep_engine.fit.robust import outliers
from btfsep_engine.fit.two_kinds import neighbours
from btfsep_engine.pipeline.real_photo import STIFF, left_out_words, some_of_each
from btfsep_engine.pipeline.refine.highlights import SHARED, TOLD, highlights, mirrored_alike
from btfsep_engine.pipeline.refine.interreflection import light_between_surfaces
from btfsep_engine.pipeline.refine.parted import in_parts, lit_otherwise, shines, with_others
from btfsep_engine.pipeline.refine.pixels import Pixels, objects_apart
from btfsep_engine.pipeline.refine.shaded import SHADOW
from btfsep_engine.pipeline.refine.sharp import sharp_lamps
from btfsep_engine.pipeline.together import all_weights, fit_together, followed, light_solver

TAILS = 1.4  # root mean square of what is left over, over what its median would be of noise: 1 of noise, 1.2 to 1.4
# of textures, 1.6 and more of photographs of which something in front was left out
NORMAL = 1.126  # of three channels of noise: root mean square over median of a pixel's size
POOR = 0.1  # relative misfit of all pixels: one explained better needs no such help
EXPLAINED = 0.4  # of the misfit, that is left without them: of things in front 0.1 to 0.35, of crevices 0.5
HOPEFUL = 0.6  # the same by the light's own model, which is in the way of things in front: where there are none, it is
# within 0.001 of an election's
RIM, WITHIN = 2, 0.5  # rings of `render.outlines`; share of what is left out that lies farther from outlines
MOST = 0.5  # of the pixels
# Of what is left without single pixels: parts, which take the lit edges of objects with them, have to leave less, if
# either is left out. On five plates with things in front they leave 0.1 to 0.55; where a sun lights a rim, as much.
CLEARLY = 0.75
# Of what would be left out, what is brighter: of highlights 0.73 and more. Of the other places that reflect the same
# direction, those that are, too: of leather that was taken for another 0.65 to 0.88, of things in front that have the
# light's colour up to 0.4; and of what is left over, what sharp lamps leave, where it is no more of them: 0.3 and 0.45
BRIGHTER, SURELY, BY_LAMPS = 0.5, 0.6, 0.5
UNLIKE = -25.0  # log odds of a colour's being of two lights: of highlights in clean photographs -15 and more
EITHER = 0.5  # how probable they are highlights, if not for that; or a thing in front, if not of another shape
# Of what would be left out: how much of the way in which it differs from place to place the light of all pixels has;
# how far its colour is from the one that this light gives there, over the same of all else; and by how much this light
# jumps at its border, over what the photo jumps by otherwise. Of 36 plates on which things in front are found (sets
# "covered" and "covered again") four are explained so well, 0.4 to 0.8: of two the colour is 17 and 5 times as far, of
# one the border is not the light's (0.3), and one of metal is taken for another shape. Of five that lost their suns by
# it (four of a mesh as scans have it, one under a flash): 0.4 to 0.8, 1.3 to 2.9 times, and 1.1 to 1.8.
SHADED_ALIKE, COLOURED_ALIKE, JUMPS_ALIKE = 0.35, 3.5, 0.7
SAME_COLOUR, SAME_LEVEL, DARK = 0.01, 0.003, 0.02  # radians; logarithm; of the mean
OTHER_SHAPE = "shape"  # its name among what is chosen
MISPLACED = (
    "light and shade of the objects (a highlight, where a lamp's light ends) lie beside where the mesh has them: its "
    "shape or pose may be wrong; what is known of the light is stated wider for it"
)
HIGHLIGHTS = "what looks like highlights is not left out: of gloss that the material has not, or of sharp lamps"
SHADOWS = 0.02  # of the pixels: shadows of things in front that are worth a search


def without_highlights(model, light, apart) -> np.ndarray:
    """Pixels that stand ``apart`` (p,) bool, but for what may be highlights: where they are brighter than the light
    explains, in parts whose colour is not far from its own, nor from the objects'."""
    problems, left = model.problems, light.left_over(model.problems)
    brighter = apart & ((left / light.solver.basis.response).sum(1) > 0)  # channels count alike
    if brighter.any():
        part, where = connected_components(neighbours(objects_apart(problems)[brighter]))[1], np.flatnonzero(brighter)
        known = light.fit.all_coefficients[0], light.radiance(problems).mean(0)
        for inside in (where[part == k] for k in range(part.max() + 1)):
            more = left[inside].sum(0)
            brighter[inside] = max(as_of_two_lights(more, colour) for colour in known) > UNLIKE
    ends = np.cumsum([len(p.pixels) for p in problems])[:-1]
    parts = np.split(apart, ends), np.split(brighter, ends)
    return np.concatenate([some & ~highlights(p, bright) for p, some, bright in zip(problems, *parts, strict=True)])


def pixels_apart(model, light):
    """(p,) bool, pixels that a stiff light explains far worse than most; None where no few of them are left over."""
    problems, settings = model.problems, model.settings
    weights = all_weights(problems)
    left = light.left_over(problems) / light.solver.basis.response * (1.0 if weights is None else np.sqrt(weights))
    size = np.sqrt(np.square(left).sum(1))
    if np.sqrt(np.square(size).mean()) < TAILS * NORMAL * np.median(size):
        return None
    solving, apart = replace(settings, order=settings.fit_order), []
    for problem in problems:
        stiff = light_solver([problem], solving, coarsening=STIFF)
        apart.append(outliers(stiff, problem.radiance(), weights=problem.weights))
    return without_highlights(model, light, np.concatenate(apart))


def parts_apart(model, light):
    """(p,) bool, pixels that smooth light explains not at all, and those around them neither."""
    apart = Pixels(model, light).apart()
    return without_highlights(model, light, apart) if shines(model) else apart


def as_more_light(model, freed, lost):
    """(p,) bool, which of the pixels that would be left out, ``lost`` (p,) bool, are brighter than the light of all
    others, ``freed``, explains; None where these are few, or are so by another colour than that light has."""
    more = freed.left_over(model.problems)
    bright = lost & ((more / freed.solver.basis.response).sum(1) > 0)
    alike = bright.sum() >= BRIGHTER * lost.sum()
    return bright if alike and as_of_two_lights(more[bright].sum(0), freed.fit.all_coefficients[0]) > 0 else None


def shine(model, light, bright) -> bool:
    """Whether pixels that are ``bright`` (p,) bool show highlights, of gloss that materials have not or of lamps.

    Other places that reflect the same direction are as bright: most of them, or some, where sharp lamps explain them.
    """
    ends = np.cumsum([len(p.pixels) for p in model.problems])[:-1]
    parts = [(p, some) for p, some in zip(model.problems, np.split(bright, ends), strict=True) if some.sum() > 1]
    if not parts:
        return False
    told, shared = np.transpose([mirrored_alike(p, np.flatnonzero(some), some) for p, some in parts])
    size = np.array([some.sum() for _, some in parts])
    told, shared = size @ told / size.sum(), (size * told) @ shared / max(float(size @ told), 1e-300)
    if told <= TOLD or shared <= SHARED:
        return False
    return shared > SURELY or sharp_lamps(model, light)[1].fit.residual < BY_LAMPS * light.fit.residual


def as_the_objects(model, light, lost) -> bool:
    """Whether pixels that would be left out, ``lost`` (p,) bool, are shaded and coloured much as the light of all
    pixels has the objects there, which ends where they do: then it is the mesh that has another shape than these."""
    b, left = light.radiance(model.problems), light.left_over(model.problems)
    shown, spread = b - left, np.square(b[lost] - b[lost].mean(0)).sum()
    if np.square(left[lost]).sum() > (1 - SHADED_ALIKE) * spread:
        return False
    size = np.linalg.norm(b, axis=1) * np.linalg.norm(shown, axis=1)
    angle = np.arccos(np.clip((b * shown).sum(1) / np.maximum(size, 1e-300), -1, 1))
    if np.median(angle[lost]) > COLOURED_ALIKE * max(np.median(angle[~lost]), SAME_COLOUR):
        return False
    one, other = neighbours(objects_apart(model.problems)).nonzero()
    border = lost[one] & ~lost[other]
    if not border.any():  # a whole object, which something else stands for
        return False
    level, model_level = (np.log(np.maximum(each.sum(1), 0) + DARK * b.sum(1).mean()) for each in (b, shown))
    jump, model_jump = (each[one[border]] - each[other[border]] for each in (level, model_level))
    otherwise = np.median(np.abs(jump - model_jump))
    return bool(np.median(np.abs(model_jump)) >= JUMPS_ALIKE * max(otherwise, SAME_LEVEL))


def without(model, lost):
    """The model of all pixels but those ``lost`` (p,) bool; None where these are too many, or lie along outlines."""
    problems = model.problems
    ends = np.cumsum([len(p.pixels) for p in problems])[:-1]
    kept = [some_of_each(p, ~some) for p, some in zip(problems, np.split(lost, ends), strict=True)]
    lost, rings = ~np.concatenate(kept), np.concatenate([p.rings for p in problems])
    if not 0 < lost.mean() < MOST or (rings[lost] > RIM).mean() < WITHIN:
        return None
    return model.changed(lambda p, some: replace(p, left_out=int((~some).sum())).subset(some), kept)


def with_shadows_kept(model, light, lost, freed):
    """What is left without things in front, but with their shadows on the objects, where it is found what casts them.

    ``lost`` : (p,) bool, both; ``freed`` : (Model, SolvedLight, words) without both, returned where it is not found
    """
    shown = np.concatenate([problem.predicted(freed[1].fit.shown) for problem in model.problems])
    shadow = lost & Pixels(model, light).darker(shown)
    again = without(model, lost & ~shadow) if shadow.mean() > SHADOWS else None
    if again is None:
        return freed
    found = in_parts(again, fit_together(again.problems, replace(model.settings, order=light.order)))
    return found if SHADOW in found[2] else freed


def without_things_in_front(model, light):
    """The refinement: pixels that the light does not explain are left out, where all else is then explained."""
    settled = any(problem.left_out is not None for problem in model.problems)
    if light.solver is None or settled or light.fit.residual < POOR or model.all_mirror:
        return model, light, {}
    with model.reporter.stage("fit"):
        ordered, tried = replace(model.settings, order=light.order), []
        for lost in (pixels_apart(model, light), parts_apart(model, light)):
            freed = None if lost is None else without(model, lost)
            if freed is not None:
                tried.append((followed(freed.problems, light, ordered).residual, lost, freed))
        if len(tried) == 2 and tried[1][0] < CLEARLY * tried[0][0]:
            tried.reverse()
        for left, lost, freed in tried:
            if left > HOPEFUL * light.fit.residual:
                continue
            answer = fit_together(freed.problems, ordered)
            if answer.fit.residual >= EXPLAINED * light.fit.residual:
                continue
            bright = as_more_light(model, answer, lost)
            if bright is not None and shine(model, light, bright):
                return replace(model, highlights=True), light, {"highlights": HIGHLIGHTS}
            lit = lit_otherwise(model, light, lost)
            if lit is not None:
                model = lit
                continue
            if as_the_objects(model, light, lost):
                return with_others(model, [((freed, answer), EITHER)]), light, {OTHER_SHAPE: MISPLACED}
            break
        else:
            return model, light, {}
    freed, answer, words = with_shadows_kept(model, light, lost, (freed, answer, {}))
    words = {"robust": left_out_words(freed.problems)} | words
    if bright is not None:
        freed = with_others(freed, [((model, light), EITHER)])
    freed, answer, more = light_between_surfaces(freed, answer)
    return freed, answer, words | more
