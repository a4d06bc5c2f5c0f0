# SPDX-License-Identifier: GPL-3.0-or-later
"""The most probable lights of many small problems at once: what `fit.search` finds of each, in less time.

Of basis images of a low order, steps are small, and what one costs is what every NumPy call costs. Here all problems
take their steps together: their rows stand in one array, padded with rows of zeros, which say nothing. Each has its own
noise, damping and end, by the rules of `search.solve`, and differs from that one's answer by rounding alone.
"""

from dataclasses import dataclass

import numpy as np

from btfsep_engine.fit import search
from btfsep_engine.fit.light_model import LightModel
from btfsep_engine.fit.products import NEARLY_RIGHT, Photograph, Rows
from btfsep_engine.fit.search import FIRST_NOISE, FLOOR, ROUNDS, SETTLED, STEPS, Solution
from btfsep_engine.linear_algebra import lower_gram


def solve_abreast(
    photos: list[Photograph], model: LightModel, *, white, v=None, steps=(STEPS,) * ROUNDS
) -> list[Solution]:
    """What `search.solve` gives for each of ``photos``.

    Parameters
    ----------
    photos : of as many basis images each
    model : of a field alone
    white : (photos, unknowns) or (unknowns,), v : (photos, 3), (3,) or None, where the searches begin
    steps : of the light, at most, at each of the rounds of the noise
    """
    count = len(photos)
    white = np.array(np.broadcast_to(white, (count, model.unknowns)), np.float64)
    unit = np.array([photo.noise_unit for photo in photos])
    v = np.maximum(FIRST_NOISE**2 * unit if v is None else v, FLOOR**2 * unit)
    taken, found, going = np.zeros(count, int), [None] * count, np.arange(count)
    for left, most in zip(reversed(range(len(steps))), steps, strict=True):
        each = [photos[i].rows(v[i], NEARLY_RIGHT) for i in going]
        descent = _Descent(each, model, white[going])
        descent.run(most)
        white[going] = descent.white
        taken[going] += descent.steps
        now = np.array([photos[i].noise(x, v[i], NEARLY_RIGHT) for i, x in zip(going, descent.x, strict=True)])
        now = np.maximum(now, FLOOR**2 * unit[going])
        ended = (np.abs(np.log(now / v[going])).max(1) < SETTLED) | (left == 0)
        slopes = descent.slopes_at(np.flatnonzero(ended))
        for j in np.flatnonzero(ended):
            i, light = going[j], (descent.x[j], descent.radiance[j])
            ends = white[i], light, v[i], NEARLY_RIGHT, each[j], float(descent.now[j]), int(taken[i])
            found[i] = search.solution(photos[i], model, *ends, next(slopes))
        going, now = going[~ended], now[~ended]
        if not len(going):
            break
        v[going] = now
    return found


def near_lights(photos: list[Photograph], other: Solution, steps: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Some steps from another basis's light towards each photograph's own, of a field alone.

    Returns
    -------
    unknowns (photos, unknowns), noises (photos, 3) and coefficients (photos, 3, terms)
    """
    v = np.array([np.maximum(other.v, FLOOR**2 * photo.noise_unit) for photo in photos])
    rows = [photo.rows(own, NEARLY_RIGHT) for photo, own in zip(photos, v, strict=True)]
    descent = _Descent(rows, other.model, np.repeat(other.white[None], len(photos), 0))
    descent.run(steps)
    return descent.white, v, descent.x


@dataclass
class _Descent:
    """The steps of `search.solve` for many rows at once.

    Attributes
    ----------
    rows : Rows of each; model : LightModel of a field alone; white : (m, unknowns), theta; later the most probable one
    x : (m, 3, terms); radiance : (m, 3, n); now : (m,), (|r|^2 + |theta|^2) / 2; steps : (m,), that were taken
    """

    rows: list[Rows]
    model: LightModel
    white: np.ndarray

    def __post_init__(self):
        count = len(self.rows)
        size = max(len(y) for rows in self.rows for y in rows.target)
        self.root = np.zeros((count, 3, size, self.rows[0].root[0].shape[1]))
        self.target = np.zeros((count, 3, size))
        for i, rows in enumerate(self.rows):
            for c, (root, target) in enumerate(zip(rows.root, rows.target, strict=True)):
                self.root[i, c, : len(target)], self.target[i, c, : len(target)] = root, target
        (by_direction,) = self.model.field.by_direction([self.root.reshape(count * 3 * size, -1)], np.float32)
        self.by_direction = by_direction.reshape(count, 3, size, -1)
        self.steps = np.zeros(count, int)
        self.x, self.radiance = self.model.light(self.white)
        self.r = self._residual(np.arange(count), self.x)
        self.now = self._value(self.r, self.white)

    def _residual(self, of, x) -> np.ndarray:
        """R x - y: (problems ``of``, 3, rows)."""
        everyone = len(of) == len(self.root)
        root, target = (self.root, self.target) if everyone else (self.root[of], self.target[of])
        return (root @ x[..., None])[..., 0] - target

    @staticmethod
    def _value(r, white) -> np.ndarray:
        return 0.5 * (np.square(r).sum((1, 2)) + np.square(white).sum(1))

    def _slopes(self, of) -> np.ndarray:
        """J of problems ``of`` : (len(of), 3 rows, unknowns), single precision."""
        return self.model.field.jacobians(self.by_direction[of], self.radiance[of])

    def slopes_at(self, of):
        """J of each of the problems ``of``, without the rows of zeros."""
        size = self.target.shape[2]
        for i, slopes in zip(of, self._slopes(of) if len(of) else (), strict=True):
            yield np.concatenate([slopes[c * size :][: len(y)] for c, y in enumerate(self.rows[i].target)])

    def run(self, most: int) -> None:
        """The steps, ``most`` whole ones of each at most."""
        count, unknowns = self.white.shape
        damping, again, active = np.full(count, 1e-2), np.zeros(count, int), np.ones(count, bool)
        slopes, gradient = np.empty((count, 3 * self.target.shape[2], unknowns), np.float32), np.empty_like(self.white)
        grams, lower, once_more = [None] * count, [None] * count, np.zeros(count, bool)
        while True:
            active &= (again > 0) | once_more | (self.steps < most)
            on = np.flatnonzero(active)
            if not len(on):
                return
            whole, known = on[(again[on] == 0) & ~once_more[on]], on[again[on] > 0]
            if len(whole):
                slopes[whole] = self._slopes(whole)
                for i in whole:
                    grams[i] = lower_gram(slopes[i])
                    lower[i] = search.small_factor(grams[i], damping[i])
                r = self.r[whole].reshape(len(whole), 1, -1).astype(np.float32)
                gradient[whole] = (r @ slopes[whole])[:, 0] + self.white[whole]
                self.steps[whole] += 1
            if len(known):
                r = self.r[known].astype(np.float32)
                gradient[known] = self.model.field.gradients(self.by_direction[known], self.radiance[known], r)
                gradient[known] += self.white[known]
            steps = [search.answer_to(slopes[i], lower[i], gradient[i], damping[i]) for i in on]
            moved = self.white[on] - np.array(steps)
            x, radiance = self.model.light(moved)
            r = self._residual(on, x)
            there = self._value(r, moved)
            better, unit = there < self.now[on], np.maximum(1.0, 0.01 * there)
            gain = self.now[on] - there
            for j, i in enumerate(on):
                if better[j]:
                    once_more[i] = False
                    if gain[j] < search.GAIN * unit[j] / (search.SLOWER if again[i] else 1):
                        active[i] = False
                    again[i] = again[i] - 1 if again[i] else search.AGAIN * (gain[j] < search.NEAR * unit[j])
                    if not again[i]:
                        damping[i] = damping[i] / 8 if damping[i] > 1e-5 else 0.0
                elif again[i]:
                    again[i] = 0
                elif damping[i] > search.STIFFEST:
                    active[i] = once_more[i] = False
                else:
                    once_more[i], damping[i] = True, max(5 * damping[i], 1e-3)
                    lower[i] = search.small_factor(grams[i], damping[i])
            to = on[better]
            self.white[to], self.x[to], self.radiance[to] = moved[better], x[better], radiance[better]
            self.r[to], self.now[to] = r[better], there[better]
