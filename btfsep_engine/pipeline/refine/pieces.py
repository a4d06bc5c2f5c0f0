# SPDX-License-Identifier: GPL-3.0-or-later
"""Paint of two colours in pieces with edges: which pixels are of which, and how much more the one reflects.

Pixels of two paints are told apart beside smooth light (`fit.two_kinds`); the light, what each paint reflects, and
which pixels are of it, are then found by turns. What a dielectric reflects at its surface, no paint changes; and bare
metal has none. The objects' mean reflectance stays what the job says. At edges pixels count for less.
"""

from dataclasses import dataclass, replace

import numpy as np

from btfsep_engine.fit.two_kinds import DARKEST, HOPEFUL, TwoKinds, edges_of, share_of
from btfsep_engine.pipeline.refine.sharp import NOISE, UNSURE
from btfsep_engine.pipeline.together import fit_together
from btfsep_engine.render.homogeneous import homogeneous

ROUNDS, WORTH = 8, 0.99  # of light, reflectance and pixels; of what is left over: another round leaves less
LEAST = 0.02  # of an even light's image: objects of which less is below the surface have no paint
MOST = 1.1  # of the light, that a paint reflects: more is none; a material's reflectance is known to about a tenth
KNOWN = 0.1  # deviation of how much more a paint reflects, once it is found
FOUND = "the objects are painted in two colours, in pieces, which the job does not say: {} % is of the {} one"


@dataclass(frozen=True)
class Painted:
    """How objects are painted.

    Attributes
    ----------
    other : (p,) in [0, 1], how much of each pixel is of the other paint; more : (3,), that reflects so many times more
    factor : (p, 3), by which the photo is another one than of objects without paint
    weights : (p, 3), how much the pixels count
    seen : (p, 3), what the light makes of such; left : (p, 3), what it leaves over of the photo
    """

    other: np.ndarray
    more: np.ndarray
    factor: np.ndarray
    weights: np.ndarray
    seen: np.ndarray
    left: np.ndarray


def on_the_surface(material):
    """What a material reflects whatever it is painted with; itself where it has no paint; None: nothing of it."""
    surface = getattr(material, "surface", None)
    if surface is None or surface.image is not None or surface.finish is not None:
        return None
    if surface.metallic > 0.5:
        return material
    return homogeneous(replace(surface, base_color=(0.0, 0.0, 0.0), metallic=0.0), material.name)


class Pieces:
    """The search for paints; ``pixels`` : `pixels.Pixels`; ``settings`` : with which basis images are made."""

    def __init__(self, pixels, settings):
        self.pixels, self.solver = pixels, pixels.light.solver
        self._above = [self._on_the_surface(p, settings) for p in pixels.problems]
        objects = [one for p in pixels.problems for one in zip(p.materials, p.points, strict=True)]
        self._albedo = np.concatenate([np.tile(m.diffuse_albedo(), (len(points), 1)) for m, points in objects])

    @staticmethod
    def _on_the_surface(problem, settings) -> list:
        """Basis images of each object that paint does not change."""
        above = [on_the_surface(m) for m in problem.materials]
        stand = [m if a is None else a for m, a in zip(problem.materials, above, strict=True)]
        same = all(a is None or a is m for m, a in zip(problem.materials, above, strict=True))
        basis = problem.basis if same else problem.of_materials(stand, settings).basis
        return [b * np.float32(a is not None) for a, b in zip(above, basis, strict=True)]

    def _reflected(self, x) -> np.ndarray:
        """(p, 3), what of light x (terms, 3) is reflected whatever objects are painted with."""
        each = [replace(p, basis=b).predicted(x) for p, b in zip(self.pixels.problems, self._above, strict=True)]
        return np.concatenate(each)

    def found(self, likely=()) -> Painted | None:
        """Two paints; None where there is no paint.

        ``likely`` : (p,) in [0, 1] each, what else may be of the other paint
        """
        p, fit = self.pixels, self.pixels.light.fit
        below = p.basis - np.concatenate([b for each in self._above for b in each])
        if below[:, 0].mean() < LEAST * p.basis[:, 0].mean():
            return None
        rest = p.b - self._reflected(fit.shown)
        kinds = TwoKinds(below[p.some], rest[p.some], p.known[p.some], p.around_some)
        starts = [kinds.brighter, *(each[p.some] > 0.5 for each in likely)]
        tried = []
        for other, left in map(kinds.painted, starts):
            one = self._settled(p.of_all(other)) if left < HOPEFUL * kinds.left else None
            tried += [] if one is None or self._too_light(one) else [one]
        return min(tried, key=lambda found: p.share(found.left, p.known), default=None)

    def _too_light(self, painted: Painted) -> bool:
        """Whether a paint would have to reflect more than all light."""
        paint = self.pixels.of_mean(1 + (painted.more - 1) * painted.other[:, None])
        return bool((self._albedo * paint).max() > MOST)

    def _settled(self, other) -> Painted | None:
        """Which pixels are of the other paint, and the light, found by turns."""
        p, fit, best = self.pixels, self.pixels.light.fit, None
        for _ in range(ROUNDS):
            if not 0 < other.mean() < 1:
                break
            now, fit = self._with(other, fit)
            if best is not None and p.share(now.left, now.weights) > WORTH * p.share(best.left, now.weights):
                break
            best = now
            light, above = self.solver.basis.predicted(fit.shown), self._reflected(fit.shown)
            one, two = self._reflectances(other, light - above, p.b - above)
            scale = p.known / self.solver.basis.response**2
            other = share_of(p.b - above - one * (light - above), (two - one) * (light - above), scale, p.around)
        return best

    def _reflectances(self, other, light, b):
        """(3,) and (3,), how much more than the mean the two paints reflect; ``light``, ``b`` : of what is below."""
        out = []
        for part in (1 - other, other):
            weight = self.pixels.known * part[:, None] * light
            out.append(np.maximum((weight * b).sum(0) / np.maximum((weight * light).sum(0), 1e-300), DARKEST))
        return out

    def _with(self, other, fit):
        """Painted in ``other`` (p,), from the light of a fit on; and the fit then."""
        p = self.pixels
        light, above = self.solver.basis.predicted(fit.shown), self._reflected(fit.shown)
        one, two = self._reflectances(other, light - above, p.b - above)
        paint = p.of_mean(one + (two - one) * other[:, None])
        factor = np.maximum(above + paint * (light - above), 0) / np.maximum(light, 1e-9 * p.rms)
        factor = np.clip(factor, DARKEST, 1 / DARKEST)
        unsure = (two / one - 1) * light * edges_of(other, p.around)[:, None]
        weights = p.known / (1 + np.square(unsure * UNSURE / (NOISE * p.rms)))
        fit = self.solver.solve(p.b / factor, weights=weights, start=fit, beside=p.light.fit)
        seen = self.solver.basis.predicted(fit.shown)
        return Painted(other, two / one, factor, weights, seen, p.b - factor * seen), fit

    def lights(self, model, painted: Painted):
        """The model of objects that are painted so, and its light."""
        p = self.pixels
        unsure = KNOWN * (np.log(painted.factor) * painted.seen)[:, None]
        parts = [p.split(each) for each in (painted.factor, painted.weights, unsure)]
        free = model.changed(lambda q, f, w, u: replace(q.beside(u), paint=f, weights=w), *parts)
        settings = replace(model.settings, order=p.light.order)
        return free, fit_together(free.problems, settings, beside=p.light.fit)


def paint_words(painted: Painted) -> str:
    """How much there is of the other paint."""
    return FOUND.format(round(100 * float(painted.other.mean())), "lighter" if painted.more.mean() > 1 else "darker")
