# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether the light has suns: lamps that are sharper than the fit's harmonics, 20 degrees wide, can be.

On gloss a sun leaves a highlight a few degrees wide, on anything the edges of shadows. Basis images of order 9 have
neither: what they make of a sun is bright where the photo is dark, and a fit of them takes the sun to be weaker and
wider than it is, the more so where the highlight itself is clipped. Here lamps have images of their own
(`fit.sharp_lamp`): the brightest one where what the light leaves over looks like it, and those that `lamp_search` finds
in what is left over then, as bare lamps of a studio are. Where such an image is steep, at the highlight's edge, it is
only as good as the geometry's normals are, and counts for less there; a clipped highlight says nothing. Whether a lamp
is sharp, the evidence decides, of the same pixels with the same weights. What its own image has beside the basis images
is then taken off the photo, and what is left is one of light of order 9.
"""

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from btfsep_engine.conventions import across
from btfsep_engine.fit.diagnose import effect
from btfsep_engine.pipeline.own_image import OwnImage, image_from_afar
from btfsep_engine.pipeline.refine.highlights import shining
from btfsep_engine.pipeline.refine.lamp_search import LampSearch
from btfsep_engine.pipeline.together import all_weights, fit_together, stacked

CAP, LEAST = np.radians(25), 0.2  # about the brightest direction, and how much of the light has to come from there
# Sought there alone, a lamp is found on none of 30 real photographs under lamps, on 8 of 128 by Cycles: the light of 5
# errs less than without, of 2 as much, of one more. On one of lacquered wood that gains 20 it errs twice as much.
LOOKS, PART = 12.0, 0.3  # chi^2 of one degree of freedom, and how much of it: of what is left over looking like that
# image. On 12 photographs by Cycles under training lights they are 3 to 430 and 0.27 to 0.91; of the five whose first
# place gains more than 5, at least 32 and 0.54.
MOST, PATIENCE = 4, 2  # lamps; where much is left over, so many may be found before any speaks
MISSED = 0.005  # of a channel's mean square: where gloss leaves more over, lamps are sought in it,
STRIKING = 0.1  # where the light has none so far, such as explain more than that of it
SPEAKS, CLEARLY, SOUGHT = 5.0, 25.0, 32.0  # of the logarithm of the evidence: of one of several; of all of them, where
# the first is the light's brightest direction, and where it was sought all around
SETTLED = 1.0  # of it: a place that gains less than that over the last one is the last
SAME, CHEAP = np.radians(15), 10.0  # between a lamp and another fit's; of the logarithm of the evidence
FAINTEST = 0.02  # of the light: a fainter lamp gains by chance
UNSURE = 3.0  # times what the image changes by from one to the next: as if normals were known to some 4 degrees
NOISE = 0.1  # of the photo's root mean square: what that is laid against
BRIGHTER, ASIDE = 0.2, np.radians(1)  # standard deviations of how bright it is and where it stands, once it is found
FARTHEST = np.radians(6)  # of one move of the lamp
TRIALS = 3  # of places, and of how bright the lamp is and what counts for less then
FOUND = "the brightest lamp is sharper than the harmonics are: it has an image of its own (by evidence)"
SEVERAL = "{} lamps are sharper than the harmonics are: each has an image of its own (by evidence)"


@dataclass(frozen=True)
class OwnImages:
    """Lamps' own images, their irradiances (k, 3), and how much the pixels count beside them: (p, 3)."""

    lamps: tuple[OwnImage, ...] = ()
    irradiances: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    weights: np.ndarray | None = None

    @property
    def directions(self) -> np.ndarray:
        """(k, 3)."""
        return np.array([lamp.direction for lamp in self.lamps]).reshape(-1, 3)

    def at(self, irradiances, rms, known) -> "OwnImages":
        """With irradiances (k, 3), of pixels that were ``known`` (p, 3) and have the root mean squares ``rms`` (3,)."""
        unsure = sum(np.square(e * each.spread) for each, e in zip(self.lamps, irradiances, strict=True))
        laid_against = np.divide(UNSURE, NOISE * rms, out=np.zeros(3), where=rms > 0)  # a channel may be all black
        return OwnImages(self.lamps, irradiances, known / (1 + unsure * np.square(laid_against)))

    @property
    def excess(self) -> np.ndarray:
        """(p, 3), all that they show beside what the basis images have of them."""
        return sum(e * lamp.excess for lamp, e in zip(self.lamps, self.irradiances, strict=True))

    @property
    def departures(self) -> np.ndarray:
        """(p, 3 k, 3), what that may be off by: each lamp brighter, and aside to both sides."""
        each = [
            e * np.stack([BRIGHTER * lamp.excess, *(ASIDE * lamp.slopes)], 1)
            for lamp, e in zip(self.lamps, self.irradiances, strict=True)
        ]
        return np.concatenate(each, 1)


def sharp_lamps(model, light):
    """The refinement: lamps with images of their own; where lamps are given or near, or shaded, none is sought."""
    if light.solver is None or light.solver.given or light.near or has_own_images(model):
        return model, light, {}
    with model.reporter.stage("fit"):
        found = Pursuit(model, light).lamps()
        if not found.lamps:
            return model, light, {}
        free = model_beside(model, light, found)
        answer = fit_together(free.problems, replace(model.settings, order=light.order), beside=light.fit)
        for lamp in found.lamps:
            answer = with_its_lamp(answer, lamp.direction)
    return free, answer, {"sharp": FOUND if len(found.lamps) == 1 else SEVERAL.format(len(found.lamps))}


def has_own_images(model) -> bool:
    """Whether lamps have been taken off the photos already, by images of their own."""
    return any(problem.correction is not None for problem in model.problems)


def with_its_lamp(light, direction):
    """The light with a lamp towards a direction, in place of a free sky that is as bright there, if it costs little."""
    if any(lamp.direction @ direction > np.cos(SAME) for lamp in light.fit.lamps):
        return light
    fit = light.solver.with_lamp(light.fit)
    stands = any(lamp.direction @ direction > np.cos(SAME) for lamp in fit.lamps)
    return replace(light, fit=fit) if stands and fit.evidence > light.fit.evidence - CHEAP else light


def model_beside(model, light, found):
    """The model whose photos are less what sharp lamps make of them, as well as that is known."""
    ends = np.cumsum([len(problem.pixels) for problem in model.problems])[:-1]
    parts = [np.split(values, ends) for values in (found.excess, found.weights, found.departures)]

    def without(problem, exposure, excess, weights, departures):
        return replace(problem.beside(departures), correction=exposure * excess, weights=weights)

    return model.changed(without, light.exposures, *parts)


def irradiance_around(fit, direction) -> np.ndarray:
    """(3,), of all of a fit's light within `CAP` of a direction, in the colour that the object gives it."""
    election, sky = fit.election, fit.election.solution.model.field
    inside = sky.directions @ direction > np.cos(CAP)
    share = 4 * np.pi / len(sky.directions) if len(sky.directions) > 1 else 2 * np.pi * (1 - np.cos(CAP))
    of_field = election.solution.radiance[:, inside if inside.size > 1 else slice(None)].sum(1) * share
    lamps = [e for d, e in election.lamps if d @ direction > np.cos(CAP)]
    return of_field * election.photo.level + sum(lamps, np.zeros(3))


class Pursuit:
    """The search for sharp lamps, one after the other: which of them are, is decided of all together.

    As long as one of several is missing, the others explain little: what it shows is noise to them.
    """

    def __init__(self, model, light):
        self.problems, self.light, self.solver = model.problems, light, light.solver
        self.b = light.radiance(self.problems)
        own, clipped = all_weights(self.problems), np.concatenate([p.clipped for p in self.problems])
        self.known = np.where(clipped, 0.0, 1.0 if own is None else own)
        self.rms = np.sqrt((self.known * self.b**2).sum(0) / np.maximum(self.known.sum(0), 1.0))
        self.search = LampSearch(self.problems, known=self.known / self.solver.basis.response**2)
        self.clearly = CLEARLY
        self._images = {}  # by directions
        self._solutions = {}  # by weights, of which each set of lamps has its own, and the lamps with own images

    def lamps(self) -> OwnImages:
        """All that are sharp, the one that was found first coming first; maybe none."""
        found, left = OwnImages(), self.light.left_over(self.problems)
        while len(found.lamps) < MOST:
            place = self.place(found, left)
            more = None if place is None else self.with_one(found, *place)
            if more is None:
                break
            found, left = more
            patience, least = (PATIENCE, SPEAKS) if self.seeks else (1, self.clearly)
            if len(found.lamps) == patience and self.gain(found) < least:
                return OwnImages()
        return self.kept(found)

    @cached_property
    def seeks(self) -> bool:
        """Whether the light leaves over more than what any does, of objects with gloss, which show lamps all around."""
        election = self.light.fit.election
        missed = (election.solution.v[:3] / election.photo.noise_unit).max() > MISSED
        return bool(missed and any(shining(problem)[0].any() for problem in self.problems))

    def place(self, found, left):
        """The direction (3,) and irradiance (3,) of the lamp that may be next; None: none looks like one."""
        if not found.lamps:
            brightest = self.brightest()
            self.clearly = SOUGHT if brightest is None else CLEARLY
            if brightest is not None or not self.seeks:
                return brightest
        likely = self.search.likeliest(left, beside=found.directions)
        if likely is None or not (found.lamps or self.light.fit.lamps or likely.part > STRIKING):
            return None
        return likely.direction, likely.irradiance

    def brightest(self):
        """The light's brightest direction, if there is much light and what is left over looks like a lamp there."""
        direction = self.solver.brightest_direction(self.light.fit)
        irradiance = irradiance_around(self.light.fit, direction)
        if irradiance.sum() < LEAST * np.sqrt(4 * np.pi) * self.light.fit.all_coefficients[0].sum():
            return None
        one = OwnImages((self.image(direction),)).at(irradiance[None], self.rms, self.known)
        return (direction, irradiance) if looks_sharp(self.light, self.problems, one.excess, one.weights) else None

    def image(self, direction) -> OwnImage:
        """Of a lamp towards a direction (3,), made once."""
        key = direction.tobytes()
        if key not in self._images:
            self._images[key] = image_from_afar(self.problems, direction)
        return self._images[key]

    def solved(self, found, sharp=None, *, start=None):
        """`LightSolver.sharp_lamps` of lamps, in their order.

        ``sharp`` : the numbers of those with own images; None: of all. ``start`` : that of lamps nearby; None: where
        all have own images, it is the one of these
        """
        each = range(len(found.lamps))
        every = list(each) if sharp is None else list(sharp)
        key = id(found.weights), *every
        if key not in self._solutions:
            order = every + [i for i in each if i not in every]
            if sharp is not None and start is None:
                start = self.solved(found)
            excess = np.stack([found.lamps[i].excess for i in every], 1) if every else np.zeros((len(self.b), 0, 3))
            how = {"weights": found.weights, "start": start and start.reordered(order)}
            solved = self.solver.sharp_lamps(self.b, self.light.fit, found.directions[order], excess, **how)
            self._solutions[key] = solved.reordered(np.argsort(order)), found.weights
        return self._solutions[key][0]

    def with_one(self, found, direction, irradiance):
        """The lamps and one more from about a direction (3,), and what is left over then (p, 3); None: none counts."""
        best, most, last = None, -np.inf, None
        for _ in range(TRIALS):
            more = OwnImages((*found.lamps, self.image(direction)))
            more = more.at(np.concatenate([found.irradiances, irradiance[None]]), self.rms, self.known)
            if not more.weights.sum(0).all():
                break
            last = self.solved(more, start=last)
            irradiance = last.irradiances[-1]
            if last.evidence < most:
                break
            grew, most = last.evidence - most, last.evidence
            more = replace(more, irradiances=last.irradiances)
            left = self.b - more.excess - self.solver.basis.predicted(last.x)
            best = more, left
            if grew < SETTLED:
                break
            move = asked_move(left, irradiance * more.lamps[-1].slopes, more.weights / self.solver.basis.response**2)
            direction = more.lamps[-1].direction + move @ across(more.lamps[-1].direction)
        return best

    def kept(self, found) -> OwnImages:
        """The lamps that are sharp, by the evidence of pixels that count as much as they do beside all of them."""
        if not found.lamps or self.gain(found) < self.clearly:
            return OwnImages()
        each, light = range(len(found.lamps)), self.solved(found)
        bright = light.irradiances.sum(1) > FAINTEST * np.sqrt(4 * np.pi) * light.x[0].sum()
        others = [[j for j in each if j != i] for i in each]
        sharp = [i for i in each if bright[i] and (len(each) == 1 or self.gain(found, others[i]) > SPEAKS)]
        if len(sharp) == len(each):
            return found
        few = OwnImages(tuple(found.lamps[i] for i in sharp)).at(found.irradiances[sharp], self.rms, self.known)
        return self.kept(replace(few, irradiances=self.solved(few).irradiances)) if sharp else OwnImages()

    def gain(self, found, sharp=()) -> float:
        """By how much the logarithm of the evidence is larger than where the ``sharp`` ones alone have own images."""
        return self.solved(found).evidence - self.solved(found, sharp).evidence


def looks_sharp(light, problems, excess, weights) -> bool:
    """Whether what a light leaves over looks like what a lamp's own image has beside the basis images, (p, 3)."""
    found = likeness(light, problems, excess, weights)
    return found.chi2 > LOOKS and found.size[0] > PART


def likeness(light, problems, excess, weights):
    """How much what a light leaves over looks like that: `fit.diagnose.Effect`."""
    unit = np.sqrt(weights) / light.solver.basis.response
    column = light.solver.smoother(light.fit)(excess) * unit
    return effect(light.left_over(problems) * unit, column[None], stacked(problems)[1])


def asked_move(left, slopes, weights) -> np.ndarray:
    """The angles (2,) by which a lamp's misfit (p, 3) asks it to move, no more than `FARTHEST`."""
    gram = np.einsum("apc,bpc,pc->ab", slopes, slopes, weights)
    if not np.trace(gram) > 0:
        return np.zeros(2)
    step = np.linalg.solve(gram + 1e-9 * np.trace(gram) * np.eye(2), np.einsum("apc,pc,pc->a", slopes, left, weights))
    return step * min(1.0, FARTHEST / max(float(np.linalg.norm(step)), 1e-12))
