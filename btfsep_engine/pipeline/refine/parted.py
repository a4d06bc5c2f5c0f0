# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether parts of the objects, with edges, are brighter than others because a shadow falls on them, or by their paint.

Asked where whole parts of objects are not explained, be it with things in front left out. A shadow of what no job knows
(`refine.shaded`) and, on what has no highlights, paints of several colours (`refine.pieces`) may be anywhere in the
picture, so that either explains much; but a lamp lights what faces it in a light's colour, and a paint reflects
whatever falls on it, and not more. Both are tried, and what leaves least over is kept, where that is far less than
without (beside highlights, which stay, over whole parts of the objects), and less than with lamps that are sharper than
the harmonics (`refine.sharp`) or nearby (`refine.near`). Pixels that stand apart may show a thing in front, or be those
that a lamp lights: then they are shaded as the objects are.
"""

from dataclasses import replace

import numpy as np

from btfsep_engine.fit.colour import as_of_two_lights
from btfsep_engine.pipeline.refine.highlights import shining
from btfsep_engine.pipeline.refine.misshapen import patch_misfit
from btfsep_engine.pipeline.refine.near import near_lamps
from btfsep_engine.pipeline.refine.pieces import Pieces, paint_words
from btfsep_engine.pipeline.refine.pixels import Pixels
from btfsep_engine.pipeline.refine.shaded import SHADOW, Shadows, shadow_words
from btfsep_engine.pipeline.refine.sharp import sharp_lamps
from btfsep_engine.pipeline.refine.uneven import HIGHLIGHTS
from btfsep_engine.pipeline.together import all_weights

MUCH, POOR = 0.05, 0.08  # misfit of patches, and of all that is left over, with which it is asked
# Of what is left over without: of stained plaster paint leaves 0.6, of balls whose shape comes from shading 0.4 to 0.7,
# of 32 painted plates 0.2 to 0.7.
SHADOW_LEAVES, PAINT_LEAVES = 0.5, 0.4
# The same beside highlights, which leave much over of any light, and of what is left over whole patches: of five
# shadows on gloss and metal that have the lamp within 6 degrees 0.53 to 0.72 and 0.34 to 0.95; of seven such plates
# without a shadow, on which some lamp was found, 0.56 to 1.3 and 0.54 to 1.8: the one that passes errs less for it. And
# of what sharper or nearby lamps leave, which imitate shadows: true ones up to 0.76, two under softboxes 1.3 and 4
BESIDE_GLOSS, OF_PATCHES, OF_LAMPS = 0.75, 0.6, 0.8
DECIDES = 8.0  # power of what is left over, inverse, by which other lamps are as probable
# Of what paint leaves over: where a shadow leaves so much, either is as probable; and the power of it by which one is
# more so. Of 19 plates with a shadow, where both are found, 13 leave less than that; of 31 painted ones one.
UNLIKE_PAINT, JUDGES = 0.6, 4.0
WITHIN = 0.999  # share of what is around a pixel that has to stand apart for it to count: at edges both show


def asked(model, light) -> bool:
    """Whether parts of the objects are looked for: whole ones are not explained, lamps are not given, none is found."""
    if light.solver is None or light.solver.given or light.fit.residual < POOR or model.all_mirror:
        return False
    if any(p.correction is not None or p.paint is not None for p in model.problems):
        return False
    return patch_misfit(model.problems, light) >= MUCH


def shines(model) -> bool:
    """Whether any object has highlights."""
    return any(shining(p, beyond=HIGHLIGHTS)[0].any() for p in model.problems)


def with_shadows_sought(model, light):
    """The model with the lamps that some pixels do not see under a light: the search takes long, and is made once."""
    if model.shaded is not None and model.shaded[0] is light:
        return model
    return replace(model, shaded=(light, Shadows(Pixels(model, light)).found()))


def lit_otherwise(model, light, apart):
    """Whether pixels that stand ``apart`` (p,) bool are lit as the others are not, and show the objects all the same.

    A thing in front is not shaded as the objects would be: a lamp explains it no better than one colour does. Returns
    the model `with_shadows_sought`; None: they are not.
    """
    if not asked(model, light):
        return None
    pixels = Pixels(model, light)
    inner = apart & (pixels.around @ apart.astype(np.float64) > WITHIN)
    if not inner.any():
        return None
    model = with_shadows_sought(model, light)
    found = model.shaded[1]
    lit = bool(found) and coloured_as_light(found[0]) > 0 and found[0].left < SHADOW_LEAVES * light.fit.residual
    return model if lit and not pixels.unlike_the_rest(inner, found[0].rest[inner]) else None


def leaves_less(left, tried) -> bool:
    """Whether a shadow explains far more than is explained without it; beside highlights, of whole parts.

    ``left`` : (2,), what is left over without and with it; ``tried`` : (Model, SolvedLight) of either
    """
    without, shadow = left
    if shadow < SHADOW_LEAVES * without:
        return True
    if shadow >= BESIDE_GLOSS * without or not shines(tried[0][0]):
        return False
    patches = [patch_misfit(model.problems, light) for model, light in tried]
    return patches[1] < OF_PATCHES * patches[0]


def in_parts(model, light):
    """The refinement: a shadow that falls on a part of the objects, or paint that the job does not say."""
    if not asked(model, light):
        return model, light, {}
    with model.reporter.stage("fit"):
        pixels = Pixels(model, light)
        shadows, pieces = Shadows(pixels), Pieces(pixels, model.modelled)
        shaded = with_shadows_sought(model, light).shaded[1]
        if model.shaded is not None:  # it is large, and asked for no more
            model = replace(model, shaded=None)
        painted = None if shines(model) else pieces.found(one.seen for one in shaded[:1])
        of_shadows = [shadows.lights(model, one) for one in shaded]
        of_paint = [] if painted is None else [pieces.lights(model, painted)]
        tried = [(model, light), *of_shadows[:1], *of_paint]
        lefts = left_over(pixels, tried)
        in_shade = bool(shaded) and leaves_less(lefts[:2], tried[:2])
        if not in_shade and min(lefts[1:], default=np.inf) >= SHADOW_LEAVES * lefts[0]:
            return model, light, {}
        lamps = [refined(model, light)[:2] for refined in (sharp_lamps, near_lamps)]
        lefts = left_over(pixels, [*tried, *lamps])
        without, lefts = min(lefts[:1] + lefts[len(tried) :]), lefts[1 : len(tried)]
    paint = lefts[-1] if of_paint else np.inf
    shadow = lefts[0] if shaded else np.inf
    odds = 0.0  # of a shadow over paint
    if shaded:
        odds = (min(paint, without) * UNLIKE_PAINT / shadow) ** JUDGES * np.exp(coloured_as_light(shaded[0]))
    is_paint = 1 / (1 + odds)
    if is_paint < 0.5 and in_shade and shadow < OF_LAMPS * without:
        shares = (1 - is_paint) * likely(shaded)
        others = [*zip(of_shadows[1:], shares[1:], strict=True), *((each, is_paint) for each in of_paint)]
        model, light = of_shadows[0]
        return with_others(model, others), light, {SHADOW: shadow_words(shaded[0])}
    if paint >= PAINT_LEAVES * without:
        return model, light, {}
    others = zip(of_shadows, (1 - is_paint) * likely(shaded), strict=True)
    model, light = of_paint[0]
    return with_others(model, others), light, {"paint": paint_words(painted)}


def coloured_as_light(shaded) -> float:
    """How much a Shaded's colour speaks for a lamp and against a paint that reflects what others do not: log odds."""
    return as_of_two_lights(shaded.light.irradiances[0], shaded.light.x[0])


def likely(shaded) -> np.ndarray:
    """How probable each of some Shaded is beside the others."""
    shares = np.array([one.left for one in shaded]) ** -DECIDES
    return shares / max(float(shares.sum()), 1e-300)


def with_others(model, others):
    """The model whose photo may show the lights of ``others`` as well: ((Model, SolvedLight), probability) of each;
    what it may show already is as much less probable."""
    others = tuple((light.fit, float(share)) for (_, light), share in others)
    left = 1 - sum(share for _, share in others)
    return replace(model, otherwise=(*((fit, left * share) for fit, share in model.otherwise), *others))


def left_over(pixels: Pixels, tried) -> list[float]:
    """What each of some (Model, SolvedLight) leaves over of the photo, relative; pixels count as in all of them."""
    counted = [weights for model, _ in tried if (weights := all_weights(model.problems)) is not None]
    counted = np.min(counted, axis=0) if counted else np.ones_like(pixels.b)
    out = []
    for model, light in tried:
        painted = [np.ones((len(p.pixels), 3)) if p.paint is None else p.paint for p in model.problems]
        out.append(pixels.share(np.concatenate(painted) * light.left_over(model.problems), counted))
    return out
