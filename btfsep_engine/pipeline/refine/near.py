# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether lamps stand near: where what is left over looks like what nearness would make of bright parts of the light.

Places of lamps are judged by the photograph less what their nearness makes of it (`fit.near_lamp`), fitted as one of
light from afar, from the last places' light on: how bright the lamps are, and how wide, that fit says. From the best of
a few distances the places go where the misfit asks for it, all together (Gauss and Newton, the light projected out), as
long as the evidence rises. They are believed where they explain the photo clearly better than lamps far away. What is
stated of the light, of lamps above all, is then of the objects' middle. A lamp whose direction is given is taken to be
far away.
"""

from dataclasses import dataclass, replace

import numpy as np

from btfsep_engine import sh
from btfsep_engine.conventions import across, fibonacci_sphere
from btfsep_engine.fit.diagnose import effect
from btfsep_engine.fit.near_lamp import MOUND, mounds, nearness
from btfsep_engine.fit.stated import Fit
from btfsep_engine.light.sun import Near
from btfsep_engine.linear_algebra import product
from btfsep_engine.pipeline.refine.curves import curve_doubts
from btfsep_engine.pipeline.refine.sharp import has_own_images
from btfsep_engine.pipeline.scene import unseen_meshes
from btfsep_engine.pipeline.together import all_weights, stacked

# Of the logarithm of the evidence, all that may be lamps at the first of `RADII`: where softboxes stand near, 6 to 140
SPEAKS = 5.0
# On 12 real photographs of a ball under lamps far away and 128 by Cycles under natural light no place was believed with
# this; a lamp at 3.5 radii that gives half of the light gains 18 to 150, where the material is right. Of depths, whose
# slopes are less sure, those of a painted owl gain 16 to 36.
CLEARLY, OF_A_DEPTH = 20.0, 40.0  # of the logarithm of the evidence
# Of what is left over, at most: places that only make the light plainer are none. Where light from far away gained 20
# to 90, 0.95 and more was left; where softboxes stand near, 0.1 to 0.9. Of gloss, whose highlights are left over either
# way, it may be all (0.96 to 1.01 where a ball stands near), where that looks like the nearness of the brightest lamp:
# chi^2 of one degree of freedom
LEAVES, LEAVES_WHERE_IT_SPEAKS, LOOKS_NEAR = 0.9, 1.02, 12.0
RADII = (8.0, 4.0, 2.0)  # of the objects: the distances that are tried first
TURNS = 2  # of how bright the lamp is, at one place
MOVES, WORTH = 8, 1.0  # of the place; of the logarithm of the evidence: less is no move worth taking
FARTHEST_TURN, FARTHEST_ZOOM = np.radians(10), np.log(1.5)  # of one move
MOST = 3  # lamps
# Where one lamp stands near, others hardly stand far away: of the logarithm of the evidence that they ask; of the first
# one's irradiance
FURTHER, LEAST, TRIES = 3.0, 0.1, 2
AROUND = fibonacci_sphere(2000)
NEAREST, FARTHEST = 1.1, 40.0  # radii
METAL = 0.5  # metallic
# Of what a lamp is likely to be: between its place and where the fit, of the light at the middle, has it, twice (4
# degrees); of the logarithm of its distance over the first lamp's
SPREADS = np.array([np.radians(4), np.radians(4), 0.7])
SMALL = 0.01  # radians, and of a distance: of a numerical derivative
BLUR = 0.08  # of a distance: lamps are as wide as the basis lights are, which no evidence knows


@dataclass(frozen=True)
class Lamp:
    """A lamp at a place.

    ``away`` : (3,), from the objects' middle, radii
    """

    away: np.ndarray

    @property
    def radii(self) -> float:
        """Its distance."""
        return float(np.linalg.norm(self.away))

    @property
    def direction(self) -> np.ndarray:
        """(3,), unit."""
        return self.away / self.radii


@dataclass(frozen=True)
class Placed:
    """Lamps at places.

    Attributes
    ----------
    lamps : of Lamp
    fit : of the photo as from afar
    correction : (p, 3), the nearness of all lamps, which was taken off
    mounds : what the fit has about each lamp
    impossible : nothing would be left of the photo, and ``fit`` is that of the places before
    """

    lamps: tuple
    fit: Fit
    correction: np.ndarray
    mounds: tuple
    impossible: bool = False

    @property
    def off(self) -> np.ndarray:
        """(k, 2), radians across (`conventions.across`): how far to a side of each place the fit has its lamp."""
        return np.stack([across(lamp.direction) @ m.middle for lamp, m in zip(self.lamps, self.mounds, strict=True)])

    @property
    def evidence(self) -> float:
        """That can be compared with other places'."""
        if self.impossible:
            return -np.inf
        unlikely = np.square(self.unlikely).sum()
        return self.fit.election.evidence_of_photo - 0.5 * unlikely

    @property
    def unlikely(self) -> np.ndarray:
        """(k, 3): by how many standard deviations of what is likely a priori a lamp ought to move, as of a step.

        To where the fit has it; further ones to about as far away as the first.
        """
        away = np.log([lamp.radii for lamp in self.lamps])
        return np.column_stack([self.off, away[0] - away]) / SPREADS


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

    def nearness(self, away, profile=None) -> np.ndarray:
        """`fit.near_lamp.nearness` (p, 3) of a lamp so far away, in radii, (3,)."""
        return nearness(self.basis, self.position, self.centre + self.radius * away, self.centre, profile)

    def mounds(self, fit: Fit, lamps) -> tuple:
        """What a fit has about each of some lamps: `fit.near_lamp.mounds`."""
        return mounds(fit.election, [lamp.direction for lamp in lamps], sh.order_of(self.basis.shape[1]))

    def solve(self, correction, start: Fit | None) -> Fit:
        """The light of the photograph less ``correction`` (p, 3), of the model of ``start``; None: elected anew."""
        solver = self.light.solver
        return solver.solve(self.photo - correction, weights=self.weights, start=start, beside=self.light.fit)

    def placed(self, lamps, start: Fit, *, turns: int = TURNS) -> Placed:
        """``lamps`` at their places."""
        fit, found = start, self.mounds(start, lamps)
        for _ in range(turns):
            correction = np.zeros_like(self.photo)
            for lamp, own in zip(lamps, found, strict=True):
                correction += own.irradiance * self.nearness(lamp.away, own.profile)
            rest = self.photo - correction if self.weights is None else self.weights * (self.photo - correction)
            if rest.sum(0).max() <= 0:
                return Placed(lamps, fit, correction, found, impossible=True)
            fit = self.solve(correction, fit)
            found = self.mounds(fit, lamps)
        return Placed(lamps, fit, correction, found)

    def residual(self, fit: Fit, correction) -> np.ndarray:
        """(p, 3), what a fit of the photograph less ``correction`` leaves over, each channel in its material's unit."""
        solver = self.light.solver
        return (self.photo - correction - solver.basis.predicted(fit.shown)) / solver.basis.response

    def next_step(self, at: Placed) -> tuple[np.ndarray, np.ndarray]:
        """By how much the misfit asks k lamps to move (of each 2 angles across, and the logarithm of its distance:
        (3 k,)); and how well that is known: its covariance (3 k, 3 k)."""
        solver, photo = self.light.solver, at.fit.election.photo
        project, weight, columns = solver.smoother(at.fit), 1 / solver.basis.response, []
        for lamp, own in zip(at.lamps, at.mounds, strict=True):
            here = self.nearness(lamp.away, own.profile)
            changes = [(self.nearness(moved(lamp.away, t), own.profile) - here) / SMALL for t in SMALL * np.eye(3)]
            columns += [(project(own.irradiance * change) * weight).ravel() for change in changes]
        columns, left = np.stack(columns, 1), self.residual(at.fit, at.correction).ravel()
        # a number counts as one of so many that are independent (`Photograph.coarsening`)
        precision = product(columns.T, columns) / max(float(np.square(left).mean()) * photo.coarsening, 1e-300)
        wanted = precision @ np.linalg.lstsq(columns, left, rcond=None)[0]
        spreads = np.tile(SPREADS, (len(at.lamps), 1))
        spreads[0, 2] = np.inf
        # a lamp that the fit has no light of goes nowhere
        precision += np.diag(1 / np.square(spreads).ravel() + 1e-9 * (1 + np.trace(precision)))
        wanted += (at.unlikely / spreads).ravel()
        covariance = np.linalg.inv(precision)
        return covariance @ wanted, covariance


def moved(away, step) -> np.ndarray:
    """A place (3,) turned by two angles, and moved by the logarithm of a factor: the first of ``step``."""
    distance = np.linalg.norm(away)
    direction = away / distance
    turned = direction + step[:2] @ across(direction)
    return turned * (np.clip(distance * np.exp(step[2]), NEAREST, FARTHEST) / np.linalg.norm(turned))


def near_lamps(model, light):
    """The refinement: how near the lamps of a light are, the brightest first."""
    if model.settings.estimator != "map":
        return model, light, {}
    if any(problem.scene.mirrors for problem in model.problems):
        return model, light, {"near": "light is taken to come from far away: what mirrors show was put together so"}
    if has_own_images(model):
        return model, light, {"near": "light is taken to come from far away: a shadow falls on the objects"}
    things = model.problems[0].scene.job.objects
    if any(is_metal(made_of, thing.surface) for made_of, thing in zip(model.materials[0], things, strict=True)):
        why = "light is taken to come from far away: a metal shows lamps sharper than the fit has them, near or far"
        return model, light, {"near": why}
    with model.reporter.stage("fit"):
        scene = Photographed(model, light)
        lamps = bright_lamps(scene)
        if not speak_for_nearness(scene, lamps):
            why = "light comes from far away: nothing in the photo looks like a lamp nearby"
            return model, light, {"near": why}
        if curve_doubts(model.problems, light):
            why = "light is taken to come from far away: what looks like a lamp nearby may be the photo's tone curve"
            return model, light, {"near": why}
        found = placed_lamps(scene, lamps)
    if found is None:
        why = "light is taken to come from far away: no lamp nearby explains the photo clearly better"
        return model, light, {"near": why}
    return nearer(scene, model, light, found)


def is_metal(made_of, surface) -> bool:
    """Whether an object is, by its `ObjectMaterial`, or by the Surface that its job says, if it does."""
    said = made_of.surface or surface
    return said.metallic >= METAL if said is not None else made_of.material.material_class == "metal"


def bright_lamps(scene: Photographed) -> tuple[Lamp, ...]:
    """What may be lamps nearby: the brightest that is in the light as from afar, and others that are not too dark."""
    fit, lamps = scene.light.fit, ()
    while len(lamps) < MOST:
        towards = brightest_left(fit, lamps) if lamps else scene.light.solver.brightest_direction(fit)
        more = (*lamps, Lamp(RADII[0] * towards))
        if lamps and too_dark(scene, fit, more):
            break
        lamps = more
    return lamps


def too_dark(scene: Photographed, fit: Fit, lamps) -> bool:
    """Whether the last of some lamps has too little of a light, beside the others."""
    *others, own = scene.mounds(fit, lamps)
    return bool(own.irradiance.mean() < LEAST * max(m.irradiance.mean() for m in others))


def brightest_left(fit: Fit, lamps) -> np.ndarray:
    """Where a light is brightest (3,), but for what is at one of some lamps' places."""
    light = fit.all_coefficients.mean(1)
    radiance = sh.evaluate(sh.order_of(len(light)), AROUND) @ light
    for lamp in lamps:
        radiance[AROUND @ lamp.direction > np.cos(np.radians(MOUND))] = -np.inf
    return AROUND[radiance.argmax()]


def speak_for_nearness(scene: Photographed, lamps) -> bool:
    """Whether all that may be lamps explain the photo better nearby, or its misfit looks like the brightest nearby."""
    fit = scene.light.fit
    gained = scene.placed(lamps, fit, turns=1).evidence - fit.election.evidence_of_photo
    return gained > SPEAKS or looks_near(scene, lamps[0]) > LOOKS_NEAR


def placed_lamps(scene: Photographed, lamps) -> Placed | None:
    """The lamps that stand near, of those that may, as `bright_lamps` has them, or None: from all of them on, or from
    the brightest, about which the light as from afar may have the others where none is."""
    afar = scene.light.fit
    most = afar.residual * (LEAVES_WHERE_IT_SPEAKS if looks_near(scene, lamps[0]) > LOOKS_NEAR else LEAVES)
    starts = [lamps, lamps[:1]] if len(lamps) > 1 else [lamps]
    found = search(scene, starts, afar)
    if found.evidence < afar.election.evidence_of_photo + scene.clearly or found.fit.residual >= most:
        return None
    # lamps that stood in for nearness are gone from a light that is elected anew
    found = followed(scene, scene.placed(found.lamps, scene.solve(found.correction, None)))
    found = without_idle(scene, with_further(scene, found))
    return found if found.fit.residual < most else None


def looks_near(scene: Photographed, lamp: Lamp) -> float:
    """chi^2 of how much the misfit of the light as from afar looks like a lamp's nearness; 0: like the opposite."""
    fit, solver = scene.light.fit, scene.light.solver
    (own,) = scene.mounds(fit, [lamp])
    column = solver.smoother(fit)(scene.nearness(lamp.away, own.profile)) / solver.basis.response
    found = effect(scene.residual(fit, 0.0), column[None], scene.blocks)
    return found.chi2 if found.size[0] > 0 else 0.0


def with_further(scene: Photographed, found: Placed) -> Placed:
    """The same with further lamps of its light, as long as they explain the photo better."""
    passed = ()
    while len(found.lamps) < MOST and len(passed) < TRIES:
        lamp = Lamp(found.lamps[0].radii * brightest_left(found.fit, (*found.lamps, *passed)))
        if too_dark(scene, found.fit, (*found.lamps, lamp)):
            break
        more = followed(scene, scene.placed((*found.lamps, lamp), found.fit))
        if more.evidence < found.evidence + FURTHER:
            passed = (*passed, lamp)
        else:
            found = followed(scene, scene.placed(more.lamps, scene.solve(more.correction, None)))
    return found


def without_idle(scene: Photographed, found: Placed) -> Placed:
    """The same without lamps that explain no more than if they stood far away."""
    for lamp in found.lamps:
        rest = tuple(other for other in found.lamps if other is not lamp)
        if not rest:
            break
        less = followed(scene, scene.placed(rest, found.fit))
        if less.evidence > found.evidence - FURTHER:
            return without_idle(scene, less)
    return found


def search(scene: Photographed, starts, afar: Fit) -> Placed:
    """The most probable places of lamps, from the best of a few distances on, if one is better than afar.

    ``starts`` : of lamps that may stand near, of which those are moved that explain most
    """
    tried = []
    for lamps in starts:
        fit, last = afar, -np.inf
        for radii in RADII:
            at = scene.placed(tuple(Lamp(radii * lamp.direction) for lamp in lamps), fit, turns=1)
            tried.append(at)
            if at.evidence < last:
                break
            fit, last = at.fit, at.evidence
    best = max(tried, key=lambda p: p.evidence)
    # where a lamp is believed, the best of these explains the photo clearly better already
    if best.evidence < afar.election.evidence_of_photo:
        return best
    return followed(scene, scene.placed(best.lamps, best.fit))


def followed(scene: Photographed, at: Placed) -> Placed:
    """Places moved where their misfit asks for it, as long as the evidence rises."""
    for _ in range(MOVES):
        steps = scene.next_step(at)[0].reshape(-1, 3)
        turn, zoom = np.linalg.norm(steps[:, :2], axis=1).max(), np.abs(steps[:, 2]).max()
        steps *= min(1.0, FARTHEST_TURN / max(turn, 1e-9), FARTHEST_ZOOM / max(zoom, 1e-9))
        for part in (steps, steps / 3):
            lamps = tuple(Lamp(moved(lamp.away, step)) for lamp, step in zip(at.lamps, part, strict=True))
            trial = scene.placed(lamps, at.fit, turns=1)
            if trial.evidence > at.evidence + WORTH:
                break
        else:
            break
        at = trial
    return at


def nearer(scene: Photographed, model, light, found: Placed):
    """The model whose photos are less what lamps at their places make of them, its light, and what is said of it."""
    spread, lamps = np.sqrt(np.diag(scene.next_step(found)[1])).reshape(-1, 3)[:, 2], []
    for lamp, sigma in zip(found.lamps, np.hypot(spread, BLUR), strict=True):
        between = np.clip(lamp.radii * np.exp(1.96 * sigma * np.array([-1, 1])), NEAREST, FARTHEST)
        distance, (low, high) = scene.radius * lamp.radii, scene.radius * between
        lamps.append((lamp.direction, Near(scene.centre, distance, float(low), float(high))))
    fit = max(scene.solve(found.correction, None), found.fit, key=lambda f: f.evidence)
    parts = np.split(found.correction, np.cumsum([len(p.pixels) for p in model.problems])[:-1])
    parts = [part * e for part, e in zip(parts, light.exposures, strict=True)]
    model = model.changed(lambda p, part: replace(p, correction=part), parts)
    metres = model.problems[0].scene.job.metres_per_unit
    each = [f"{metres * n.distance:.2g} m ({metres * n.low:.2g} to {metres * n.high:.2g} m)" for _, n in lamps]
    what = f"{'a lamp stands' if len(each) == 1 else f'{len(each)} lamps stand'} {' and '.join(each)}"
    why = f"{what} from the objects' middle, for which the light is stated (by evidence)"
    return model, replace(light, fit=fit, near=tuple(lamps)), {"near": why}
