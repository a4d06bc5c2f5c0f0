# SPDX-License-Identifier: GPL-3.0-or-later
"""Places of lamps that stand near, and how well a photograph is explained by them: what `near.py` searches.

Places are judged by the photograph less what the lamps' nearness makes of it (`fit.near_lamp`), fitted as one of light
from afar, from the last places' light on: how bright the lamps are, and how wide, that fit says. They go where the
misfit asks for it, all together (Gauss and Newton, the light projected out), as long as the evidence rises.
"""

from dataclasses import dataclass

import numpy as np

from btfsep_engine import sh
from btfsep_engine.conventions import across
from btfsep_engine.fit.near_lamp import mounds, nearness
from btfsep_engine.fit.stated import Fit
from btfsep_engine.linear_algebra import product
from btfsep_engine.pipeline.together import all_weights, stacked

TURNS = 2  # of how bright the lamp is, at one place
MOVES, WORTH = 8, 1.0  # of the place; of the logarithm of the evidence: less is no move worth taking
FARTHEST_TURN, FARTHEST_ZOOM = np.radians(10), np.log(1.5)  # of one move
NEAREST, FARTHEST = 1.1, 40.0  # radii
# Of what a lamp is likely to be: between its place and where the fit, of the light at the middle, has it, twice (4
# degrees); of the logarithm of its distance over the first lamp's
SPREADS = np.array([np.radians(4), np.radians(4), 0.7])
SMALL = 0.01  # radians, and of a distance: of a numerical derivative


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
        self.centre, self.radius = middle_of(self.problems[0])

    def nearness(self, away, profile=None) -> np.ndarray:
        """`fit.near_lamp.nearness` (p, 3) of a lamp so far away, in radii, (3,)."""
        return nearness(self.basis, self.position, self.centre + self.radius * away, self.centre, profile)

    def nearness_of(self, lamps, mounds) -> list[np.ndarray]:
        """The nearness (p, 3) of each of some lamps that are as bright, and as wide, as a fit's ``mounds``."""
        return [m.irradiance * self.nearness(lamp.away, m.profile) for lamp, m in zip(lamps, mounds, strict=True)]

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
            correction = sum(self.nearness_of(lamps, found))
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


def middle_of(problem) -> tuple[np.ndarray, float]:
    """The middle (3,) of the box around the objects, and half its diagonal."""
    corners = np.concatenate([o.mesh.vertices for o in problem.scene.job.objects])
    low, high = corners.min(0), corners.max(0)
    return (low + high) / 2, float(np.linalg.norm(high - low)) / 2


def moved(away, step) -> np.ndarray:
    """A place (3,) turned by two angles, and moved by the logarithm of a factor: the first of ``step``."""
    distance = np.linalg.norm(away)
    direction = away / distance
    turned = direction + step[:2] @ across(direction)
    return turned * (np.clip(distance * np.exp(step[2]), NEAREST, FARTHEST) / np.linalg.norm(turned))


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
