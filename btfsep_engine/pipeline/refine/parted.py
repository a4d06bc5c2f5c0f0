# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether parts of the objects, with edges, are brighter than others because a shadow falls on them, or by their paint.

Asked where whole parts of objects without highlights are not explained, be it with things in front left out. A shadow
of what no job knows (`refine.shaded`) and paints of several colours (`refine.pieces`) may be anywhere in the picture,
so that either explains much; but a lamp lights what faces it, and a paint reflects whatever falls on it. Both are
tried, and what leaves least over is kept, where that is far less than without, and than with lamps that are sharper
than the harmonics (`refine.sharp`).
"""

from dataclasses import replace
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from btfsep_engine.fit.two_kinds import FINE, FINEST, TwoKinds, neighbours
from btfsep_engine.pipeline.refine.highlights import shining
from btfsep_engine.pipeline.refine.misshapen import patch_misfit
from btfsep_engine.pipeline.refine.pieces import Pieces, paint_words
from btfsep_engine.pipeline.refine.shaded import SHADOW, Shadows, shadow_words
from btfsep_engine.pipeline.refine.sharp import sharp_lamps
from btfsep_engine.pipeline.refine.uneven import HIGHLIGHTS
from btfsep_engine.pipeline.together import APART, all_weights

MUCH, POOR = 0.05, 0.08  # misfit of patches, and of all that is left over, with which it is asked
SOME = 700  # pixels, of which what they are is asked first
# Of what is left over without: of stained plaster paint leaves 0.6, of balls whose shape comes from shading 0.4 to 0.7,
# of 32 painted plates 0.2 to 0.7.
SHADOW_LEAVES, PAINT_LEAVES = 0.5, 0.4
DECIDES = 8.0  # power of what is left over, inverse, by which other lamps are as probable
# Of what paint leaves over: where a shadow leaves so much, either is as probable; and the power of it by which one is
# more so. Of 19 plates with a shadow, where both are found, 13 leave less than that; of 31 painted ones one.
UNLIKE_PAINT, JUDGES = 0.6, 4.0


class Pixels:
    """All photographs' pixels as the search for their parts needs them.

    Attributes
    ----------
    b : (p, 3), what is fitted; known : (p, 3), how much it counts; rms : (3,), of b
    at : (p, 2), where they are, objects apart; around : `neighbours` of them
    some : (p,) bool, those that are asked first; around_some : `neighbours` of these
    """

    def __init__(self, model, light):
        self.problems, self.light = model.problems, light
        self.b, own = light.radiance(self.problems), all_weights(self.problems)
        clipped = np.concatenate([p.clipped for p in self.problems])
        self.known = np.where(clipped, 0.0, 1.0 if own is None else own)
        self.rms = np.sqrt((self.known * self.b**2).sum(0) / np.maximum(self.known.sum(0), 1.0))
        each = [points.pixels for p in self.problems for points in p.points]  # objects apart
        self.at = np.concatenate([pixels + np.array([i * APART, 0]) for i, pixels in enumerate(each)])
        self.some = np.arange(len(self.b)) % -(-len(self.b) // SOME) == 0
        self.around = neighbours(self.at, deviation=FINE, farthest=FINEST)
        self.around_some = neighbours(self.at[self.some])

    @cached_property
    def basis(self) -> np.ndarray:
        """(p, terms, 3)."""
        return np.concatenate([p.all_basis for p in self.problems])

    @cached_property
    def kinds(self) -> TwoKinds:
        """Of some."""
        some = self.some
        return TwoKinds(self.basis[some], self.b[some], self.known[some], self.around_some)

    @cached_property
    def _nearest(self) -> np.ndarray:
        return cKDTree(self.at[self.some]).query(self.at)[1]

    def of_all(self, values) -> np.ndarray:
        """(p,) float, those of some (some,), each pixel's as the nearest one's."""
        return values[self._nearest].astype(np.float64)

    def of_mean(self, factor) -> np.ndarray:
        """A factor (p, 3) on objects' reflectance, over its mean of each object."""
        return np.concatenate([f / np.average(f, axis=0) for p in self.split(factor, True) for f in p if len(f)])

    def split(self, values, by_object=False) -> list:
        """Rows of all pixels cut by photograph, maybe those by object."""
        each = np.split(values, np.cumsum([len(p.pixels) for p in self.problems])[:-1])
        return [p.by_object(v) for p, v in zip(self.problems, each, strict=True)] if by_object else each

    def share(self, left, weights) -> float:
        """What is left over of pixels that count by ``weights``, relative."""
        return float(np.sqrt((weights * left**2).sum() / max(float((weights * self.b**2).sum()), 1e-300)))


def in_parts(model, light):
    """The refinement: a shadow that falls on a part of the objects, or paint that the job does not say."""
    if light.solver is None or light.solver.given or light.fit.residual < POOR:
        return model, light, {}
    shines = any(shining(p, beyond=HIGHLIGHTS)[0].any() for p in model.problems)
    if shines or patch_misfit(model.problems, light) < MUCH:
        return model, light, {}
    with model.reporter.stage("fit"):
        pixels = Pixels(model, light)
        shadows, pieces = Shadows(pixels), Pieces(pixels, model.modelled)
        shaded = shadows.found()
        painted = pieces.found(one.seen for one in shaded[:1])
        plain = [(model, light), sharp_lamps(model, light)[:2]]
        of_shadows = [shadows.lights(model, one) for one in shaded]
        of_paint = [] if painted is None else [pieces.lights(model, painted)]
        left = left_over(pixels, [*plain, *of_shadows[:1], *of_paint])
    without = min(left[: len(plain)])
    paint = left[-1] if of_paint else np.inf
    shadow = left[len(plain)] if shaded else np.inf
    if min(shadow, paint) >= SHADOW_LEAVES * without:
        return model, light, {}
    is_paint = 1 / (1 + (paint * UNLIKE_PAINT / shadow) ** JUDGES)
    if is_paint < 0.5 and shadow < SHADOW_LEAVES * without:
        shares = (1 - is_paint) * likely(shaded)
        others = [*zip(of_shadows[1:], shares[1:], strict=True), *((each, is_paint) for each in of_paint)]
        model, light = of_shadows[0]
        return with_others(model, others), light, {SHADOW: shadow_words(shaded[0])}
    if paint >= PAINT_LEAVES * without:
        return model, light, {}
    others = zip(of_shadows, (1 - is_paint) * likely(shaded), strict=True)
    model, light = of_paint[0]
    return with_others(model, others), light, {"paint": paint_words(painted)}


def likely(shaded) -> np.ndarray:
    """How probable each of some Shaded is beside the others."""
    shares = np.array([one.left for one in shaded]) ** -DECIDES
    return shares / max(float(shares.sum()), 1e-300)


def with_others(model, others):
    """The model whose photo may show the lights of ``others`` as well: ((Model, SolvedLight), probability) of each."""
    return replace(model, otherwise=tuple((light.fit, float(share)) for (_, light), share in others))


def left_over(pixels: Pixels, tried) -> list[float]:
    """What each of some (Model, SolvedLight) leaves over of the photo, relative; pixels count as in all of them."""
    counted = [weights for model, _ in tried if (weights := all_weights(model.problems)) is not None]
    counted = np.min(counted, axis=0) if counted else np.ones_like(pixels.b)
    out = []
    for model, light in tried:
        painted = [np.ones((len(p.pixels), 3)) if p.paint is None else p.paint for p in model.problems]
        out.append(pixels.share(np.concatenate(painted) * light.left_over(model.problems), counted))
    return out
