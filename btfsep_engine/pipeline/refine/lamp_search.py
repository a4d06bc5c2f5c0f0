# SPDX-License-Identifier: GPL-3.0-or-later
"""Where a lamp may stand that is sharper than the harmonics are: what the light leaves over looks like its image.

Beams from all over the sphere have images of their own. What each has beside the basis images is laid against what a
light leaves over, as in matching pursuit (Mallat and Zhang 1993): the beam of which the largest part is found there is
the likeliest lamp. On five of six photographs under two to four bare lamps it lies within 5 degrees of one of them.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from btfsep_engine import sh
from btfsep_engine.conventions import fibonacci_sphere
from btfsep_engine.light.sun import cap_around
from btfsep_engine.linear_algebra import product
from btfsep_engine.render.beams import beam_radiance

BEAMS = 600  # 8 degrees apart
AROUND, FINE = np.radians(6), 60  # about the best of them, and how many beams there: on gloss an image is as narrow
PIXELS = 1500  # of which a photograph's images are
APART = np.radians(15)  # from a lamp that has an image of its own: nearer, another is that one once more
LEAST = 0.02  # of what is left over
HIDDEN = 0.05  # of the brightest beam's: what the basis images have of one that lights hardly anything is their error


@dataclass(frozen=True)
class LikelyLamp:
    """A direction (3,) and an irradiance (3,), and how much of what a light leaves over such a lamp explains."""

    direction: np.ndarray
    irradiance: np.ndarray
    part: float


class LampSearch:
    """The images of beams, of photographs' pixels: made where they are asked for, once.

    Parameters
    ----------
    problems : the photographs' `Problem`s; known : (p, 3), the weights of their pixels
    """

    def __init__(self, problems, *, known):
        used = [np.arange(len(p.pixels)) % -(-len(p.pixels) // PIXELS) == 0 for p in problems]
        self._used = np.concatenate(used)
        self._problems = [p.subset(u) for p, u in zip(problems, used, strict=True)]
        self._known = known[self._used].astype(np.float32)

    @cached_property
    def _beams(self) -> tuple[np.ndarray, np.ndarray]:
        """Directions from which a lamp lights the pixels, (n, 3), and what the basis images lack of its image."""
        directions = fibonacci_sphere(BEAMS)
        brightness, lacking = self.images(directions)
        lit = brightness > HIDDEN * brightness.max()
        return directions[lit], lacking[:, lit]

    def images(self, directions) -> tuple[np.ndarray, np.ndarray]:
        """How bright beams from directions (n, 3) make the pixels, (n,), and what the basis images lack of that.

        The latter : (p, n, 3) float32.
        """
        brightness, lacking = [], []
        for problem in self._problems:
            by_order = sh.evaluate(sh.order_of(problem.basis[0].shape[1]), directions).astype(np.float32)
            for points, material, basis in zip(problem.points, problem.materials, problem.basis, strict=True):
                unit = problem.scene.millimetres_per_unit
                own = beam_radiance(problem.scene.tracer, points, material, directions, millimetres_per_unit=unit)
                brightness.append(own.mean((0, 2)))
                lacking.append(own - np.stack([product(basis[..., c], by_order.T) for c in range(3)], 2))
        return np.mean(brightness, 0), np.concatenate(lacking)

    def likeliest(self, left_over, *, beside) -> LikelyLamp | None:
        """The lamp that explains most; None where none explains anything.

        Parameters
        ----------
        left_over : (p, 3), what a light leaves over
        beside : (k, 3), directions of lamps that have images of their own
        """
        left = left_over[self._used].astype(np.float32)
        energy, left = float((self._known * left**2).sum()), self._known * left
        directions, lacking = self._beams
        part = explained(lacking, left, self._known)[0]
        part[(directions @ beside.T > np.cos(APART)).any(1)] = 0
        if not part.max(initial=0) > LEAST * energy:
            return None
        near = cap_around(directions[part.argmax()], AROUND, FINE)
        finer, irradiance = explained(self.images(near)[1], left, self._known)
        best = int(finer.argmax())
        return LikelyLamp(near[best], np.full(3, float(irradiance[best])), float(finer[best]) / energy)


def explained(lacking, left, known) -> tuple[np.ndarray, np.ndarray]:
    """How much of what is left over each beam explains, (n,), and of which irradiance it is then, (n,).

    ``lacking`` : (p, n, 3); ``left`` : (p, 3), what is left over times its weights ``known``
    """
    seen = np.einsum("pdc,pc->d", lacking, left)
    own = np.maximum(np.einsum("pdc,pdc,pc->d", lacking, lacking, known), 1e-30)
    return np.maximum(seen, 0) ** 2 / own, seen / own
