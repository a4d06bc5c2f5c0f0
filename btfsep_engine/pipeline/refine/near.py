# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether a lamp stands near: where what is left over looks like what nearness would make of the brightest lamp.

A place of the lamp is judged by the photograph less what its nearness makes of it (`fit.near_lamp`), fitted as one of
light from afar, from the last place's light on: how bright the lamp is, that fit says. From the best of a few distances
the place goes where the misfit asks for it (Gauss and Newton, the light projected out), as long as the evidence rises.
A place is believed where it explains the photo clearly better than the lamp far away; so is, after it, a further
lamp's. What is stated of the light, of lamps above all, is then of the objects' middle. A lamp whose direction is given
is taken to be far away.
"""

from dataclasses import dataclass, replace

import numpy as np

from btfsep_engine.conventions import across
from btfsep_engine.fit.diagnose import effect
from btfsep_engine.fit.near_lamp import nearness
from btfsep_engine.fit.stated import Fit
from btfsep_engine.light.sun import Near
from btfsep_engine.linear_algebra import product
from btfsep_engine.pipeline.refine.curves import curve_doubts
from btfsep_engine.pipeline.refine.sharp import has_own_images
from btfsep_engine.pipeline.scene import unseen_meshes
from btfsep_engine.pipeline.together import all_weights, stacked

SPEAKS = 12.0  # chi^2 of one degree of freedom, of what is left over looking like a lamp's nearness
# On 12 real photographs of a ball under lamps far away and 128 by Cycles under natural light no place was believed with
# this; a lamp at 3.5 radii that gives half of the light gains 18 to 150, where the material is right. Of depths, whose
# slopes are less sure, those of a painted owl gain 16 to 36.
CLEARLY, OF_A_DEPTH = 20.0, 40.0  # of the logarithm of the evidence
RADII = (8.0, 4.0, 2.0)  # of the objects: the distances that are tried first
TURNS = 2  # of how bright the lamp is, at one place
MOVES, WORTH = 8, 0.5  # of the place; of the logarithm of the evidence: less is no move worth taking
FARTHEST_TURN, FARTHEST_ZOOM = np.radians(10), np.log(1.5)  # of one move
SAME_LAMP = 15.0  # degrees between a lamp and the same in another fit
NEAREST, FARTHEST = 1.1, 40.0  # radii
MORE, MORE_STDDEV, MOST_MORE = 0.15, 0.15, 0.7  # `Place.more`: what it is as a rule, its spread, its largest
SMALL = 0.01  # radians, and of a distance: of a numerical derivative
BLUR = 0.08  # of a distance: lamps are as wide as the basis lights are, which no evidence knows


@dataclass(frozen=True)
class Place:
    """A lamp at a place.

    Attributes
    ----------
    lamp : its number in the fit's model; away : (3,), from the objects' middle, radii
    more : logarithm of how much brighter the lamp is than in the fit, whose free sky has taken a part of it for its own
    fit : of the photo as from afar; correction : (p, 3), the nearness of all lamps, which was taken off
    impossible : nothing would be left of the photo, and ``fit`` is that of the place before
    """

    lamp: int
    away: np.ndarray
    more: float
    fit: Fit
    correction: np.ndarray
    impossible: bool = False

    @property
    def radii(self) -> float:
        """Its distance."""
        return float(np.linalg.norm(self.away))

    @property
    def evidence(self) -> float:
        """That can be compared with other places'."""
        if self.impossible:
            return -np.inf
        return self.fit.election.evidence_of_photo - 0.5 * ((self.more - MORE) / MORE_STDDEV) ** 2


class Photographed:
    """What all places have in common."""

    def __init__(self, model, light):
        self.light, self.problems = light, model.problems
        points = [p for problem in self.problems for p in problem.points]
        self.position = np.concatenate([p.position for p in points])
        self.basis, self.blocks = stacked(self.problems)
        self.photo, self.weights = light.radiance(self.problems), all_weights(self.problems)
        corners = np.concatenate([o.mesh.vertices for o in self.problems[0].scene.job.objects])
        self.clearly = OF_A_DEPTH if any(unseen_meshes(p.scene.job) for p in self.problems) else CLEARLY
        low, high = corners.min(0), corners.max(0)
        self.centre, self.radius = (low + high) / 2, float(np.linalg.norm(high - low)) / 2

    def nearness(self, away) -> np.ndarray:
        """`fit.near_lamp.nearness` (p, 3) of a lamp so far away, in radii, (3,)."""
        return nearness(self.basis, self.position, self.centre + self.radius * away, self.centre)

    def solve(self, correction, start: Fit | None) -> Fit:
        """The light of the photograph less ``correction`` (p, 3), of the model of ``start``; None: elected anew."""
        solver = self.light.solver
        return solver.solve(self.photo - correction, weights=self.weights, start=start, beside=self.light.fit)

    def place(self, lamp: int, away, more: float, start: Fit, others, *, turns: int = TURNS) -> Place:
        """A lamp at a place; ``others`` (p, 3): the nearness of those that were found before."""
        fit, of_one = start, self.nearness(away)
        for _ in range(turns):
            correction = others + np.exp(more) * fit.election.lamps[lamp][1] * of_one
            rest = self.photo - correction if self.weights is None else self.weights * (self.photo - correction)
            if rest.sum(0).max() <= 0:
                return Place(lamp, away, more, fit, correction, impossible=True)
            fit = self.solve(correction, fit)
        return Place(lamp, away, more, fit, correction)

    def residual(self, fit: Fit, correction) -> np.ndarray:
        """(p, 3), what a fit of the photograph less ``correction`` leaves over, each channel in its material's unit."""
        solver = self.light.solver
        return (self.photo - correction - solver.basis.predicted(fit.shown)) / solver.basis.response

    def next_step(self, at: Place) -> tuple[np.ndarray, np.ndarray]:
        """By how much a lamp's misfit asks it to move (2 angles across, logarithms of distance and brightness: (4,));
        and how well that is known: its covariance (4, 4)."""
        solver, photo = self.light.solver, at.fit.election.photo
        brightness, of_one = np.exp(at.more) * at.fit.election.lamps[at.lamp][1], self.nearness(at.away)
        project, weight = solver.smoother(at.fit), 1 / solver.basis.response
        changes = [(self.nearness(moved(at.away, turn)) - of_one) / SMALL for turn in SMALL * np.eye(3)]
        columns = np.stack([(project(brightness * c) * weight).ravel() for c in (*changes, of_one)], 1)
        left = self.residual(at.fit, at.correction).ravel()
        # a number counts as one of so many that are independent (`Photograph.coarsening`)
        precision = product(columns.T, columns) / max(float(np.square(left).mean()) * photo.coarsening, 1e-300)
        wanted = precision @ np.linalg.lstsq(columns, left, rcond=None)[0]
        precision[3, 3] += 1 / MORE_STDDEV**2
        wanted[3] += (MORE - at.more) / MORE_STDDEV**2
        precision += 1e-9 * np.trace(precision) * np.eye(4)
        covariance = np.linalg.inv(precision)
        return covariance @ wanted, covariance


def moved(away, step) -> np.ndarray:
    """A place (3,) turned by two angles, and moved by the logarithm of a factor: the first of ``step``."""
    distance = np.linalg.norm(away)
    direction = away / distance
    turned = direction + step[:2] @ across(direction)
    return turned * (np.clip(distance * np.exp(step[2]), NEAREST, FARTHEST) / np.linalg.norm(turned))


def speaks_for_nearness(scene: Photographed, fit: Fit, correction, direction) -> float:
    """chi^2 of how much a misfit looks like what nearness would make of a lamp; 0: of the opposite."""
    column = scene.light.solver.smoother(fit)(scene.nearness(RADII[0] * direction)) / scene.light.solver.basis.response
    found = effect(scene.residual(fit, correction), column[None], scene.blocks)
    return found.chi2 if found.size[0] > 0 else 0.0


def near_lamps(model, light):
    """The refinement: how near the lamps of a light are, the brightest first."""
    if model.settings.estimator != "map":
        return model, light, {}
    if any(problem.scene.mirrors for problem in model.problems):
        return model, light, {"near": "light is taken to come from far away: what mirrors show was put together so"}
    if has_own_images(model):
        return model, light, {"near": "light is taken to come from far away: a shadow falls on the objects"}
    with model.reporter.stage("fit"):
        scene = Photographed(model, light)
        direction = light.solver.brightest_direction(light.fit)
        if speaks_for_nearness(scene, light.fit, 0.0, direction) < SPEAKS:
            why = "light comes from far away: nothing in the photo looks like a lamp nearby"
            return model, light, {"near": why}
        if curve_doubts(model.problems, light):
            why = "light is taken to come from far away: what looks like a lamp nearby may be the photo's tone curve"
            return model, light, {"near": why}
        places = found_places(scene)
    if not places:
        why = "light is taken to come from far away: no lamp nearby explains the photo clearly better"
        return model, light, {"near": why}
    return nearer(scene, model, light, places)


def found_places(scene: Photographed) -> list[Place]:
    """Of each lamp that stands near, the brightest first; the last one's fit and what was taken off are of all."""
    start, others, found = scene.light.fit, np.zeros_like(scene.photo), []
    if not start.election.found:
        start = scene.light.solver.with_lamp(start)
    while len(found) < len(start.election.found):
        lamp = brightest_left(start, found)
        if found and speaks_for_nearness(scene, start, others, start.election.lamps[lamp][0]) < SPEAKS:
            break
        best = search(scene, lamp, start, others)
        if best.evidence < start.election.evidence_of_photo + scene.clearly:
            break
        # lamps that stood in for nearness are gone from a light that is elected anew
        anew = scene.solve(best.correction, None)
        numbers = [lamp_towards(anew, p.away) for p in (*found, best)]
        if None not in numbers:
            *rest, lamp = numbers
            found = [replace(p, lamp=i) for p, i in zip(found, rest, strict=True)]
            best = followed(scene, scene.place(lamp, best.away, best.more, anew, others), others)
        start, others = best.fit, best.correction
        found.append(best)
    return found


def brightest_left(fit: Fit, places) -> int:
    """The brightest of a fit's lamps that is at none of the ``places`` yet, by its number."""
    lamps, done = fit.election.lamps, [place.lamp for place in places]
    return max((i for i in fit.election.found if i not in done), key=lambda i: lamps[i][1].mean())


def lamp_towards(fit: Fit, away) -> int | None:
    """The number of a fit's lamp in the direction of a place, or None."""
    lamps, toward = fit.election.lamps, away / np.linalg.norm(away)
    nearest = max(fit.election.found, key=lambda i: toward @ lamps[i][0], default=None)
    return nearest if nearest is not None and toward @ lamps[nearest][0] > np.cos(np.radians(SAME_LAMP)) else None


def search(scene: Photographed, lamp: int, start: Fit, others) -> Place:
    """The most probable place of a lamp, from the best of a few distances on, if one is better than afar."""
    tried, fit = [], start
    for radii in RADII:
        tried.append(scene.place(lamp, radii * fit.election.lamps[lamp][0], MORE, fit, others, turns=1))
        fit = tried[-1].fit
        if len(tried) > 1 and tried[-1].evidence < tried[-2].evidence:
            break
    best = max(tried, key=lambda p: p.evidence)
    # where a lamp is believed, the best of these explains the photo clearly better already
    if best.evidence < start.election.evidence_of_photo:
        return best
    return followed(scene, scene.place(lamp, best.away, MORE, best.fit, others), others)


def followed(scene: Photographed, at: Place, others) -> Place:
    """A place moved where its misfit asks for it, as long as the evidence rises."""
    for _ in range(MOVES):
        step, _ = scene.next_step(at)
        step *= min(1.0, FARTHEST_TURN / max(np.linalg.norm(step[:2]), 1e-9), FARTHEST_ZOOM / max(abs(step[2]), 1e-9))
        for part in (step, step / 3):
            more = float(np.clip(at.more + part[3], 0, MOST_MORE))
            trial = scene.place(at.lamp, moved(at.away, part), more, at.fit, others)
            if trial.evidence > at.evidence + WORTH:
                break
        else:
            break
        at = trial
    return at


def nearer(scene: Photographed, model, light, places):
    """The model whose photos are less what lamps at ``places`` make of them, its light, and what is said of it."""
    last, lamps = places[-1], []
    for place in places:
        _, covariance = scene.next_step(replace(place, fit=last.fit, correction=last.correction))
        sigma, radii = np.hypot(np.sqrt(covariance[2, 2]), BLUR), place.radii
        between = np.clip(radii * np.exp(1.96 * sigma * np.array([-1, 1])), NEAREST, FARTHEST)
        distance, (low, high) = scene.radius * radii, scene.radius * between
        lamps.append((place.away / radii, Near(scene.centre, distance, float(low), float(high))))
    fit = max(scene.solve(last.correction, None), last.fit, key=lambda f: f.evidence)
    parts = np.split(last.correction, np.cumsum([len(p.pixels) for p in model.problems])[:-1])
    parts = [part * e for part, e in zip(parts, light.exposures, strict=True)]
    model = model.changed(lambda p, part: replace(p, correction=part), parts)
    metres = model.problems[0].scene.job.metres_per_unit
    each = [f"{metres * n.distance:.2g} m ({metres * n.low:.2g} to {metres * n.high:.2g} m)" for _, n in lamps]
    what = f"{'a lamp stands' if len(each) == 1 else f'{len(each)} lamps stand'} {' and '.join(each)}"
    why = f"{what} from the objects' middle, for which the light is stated (by evidence)"
    return model, replace(light, fit=fit, near=tuple(lamps)), {"near": why}
