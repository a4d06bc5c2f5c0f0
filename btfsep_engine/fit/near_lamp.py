# SPDX-License-Identifier: GPL-3.0-or-later
"""A lamp that stands near: what a photograph shows of it that one far away would not leave.

A lamp at the place p sends a point X light from (p - X) / |p - X|, weaker by the square of the distance. With the basis
images A, whose row of a point is its answer to light from anywhere, it adds

    E (|p - c|^2 / |p - X|^2) A(X) Y(direction of p from X)

to a point's radiance, E being its irradiance at c, the middle of the objects. What the point would show of a lamp of
the same irradiance at c, far away in the direction of p, is E A(X) Y(direction of p from c). The photograph less the
difference is one of light from far away: linear in it, as all of the method is.

A lamp with a width, a softbox or a window, is the mound of light about its direction (`mounds`), alike in all azimuths:
its harmonics are Y(direction of the lamp), those of each order times the mound's. They turn and fade with the point as
the lamp does.
"""

from dataclasses import dataclass

import numpy as np

from btfsep_engine import sh
from btfsep_engine.fit.elected import Election
from btfsep_engine.light.sun import cap_around

CLOSEST = 0.05  # of the lamp's distance from the middle: nearer to it no point is taken to be
# Of the softboxes of a studio, 6 to 20 degrees from the middle to the edge, the field has about all within 30 degrees.
MOUND, RING = 30.0, 60.0  # degrees about a lamp: what is its own, and up to where what lies around it is looked at
SPREAD = 800  # directions within the ring


@dataclass(frozen=True)
class Mound:
    """What a light has about a direction.

    ``irradiance`` : (3,), at the middle, on what faces the direction; ``profile`` : (order + 1,), its zonal harmonics,
    of each order over those of a point; ``middle`` : (3,), unit, the mean of its directions; ``base`` : (3,), what the
    field is around it
    """

    irradiance: np.ndarray
    profile: np.ndarray
    middle: np.ndarray
    base: np.ndarray

    @property
    def size_degrees(self) -> float:
        """The width of a disc of the same mean cosine."""
        return float(2 * np.degrees(np.arccos(np.clip(2 * self.profile[1] - 1, -1, 1))))


def mounds(election: Election, directions, order: int) -> tuple[Mound, ...]:
    """Lamps and field of a light within `MOUND` of each of some directions (k, 3), above what the field is around that.

    What lies between two belongs to the nearer one.
    """
    return tuple(_mound(election, i, np.asarray(directions), order) for i in range(len(directions)))


def _mound(election: Election, number: int, directions, order: int) -> Mound:
    photo, solution, direction = election.photo, election.solution, directions[number]
    around = cap_around(direction, np.radians(RING), SPREAD)

    def own(towards):
        return towards @ direction > np.cos(np.radians(MOUND)), (towards @ directions.T).argmax(1) == number

    within, nearest = own(around)
    radiance = solution.model.radiance(solution.white, around) * photo.level
    base = np.median(radiance[~within & nearest], axis=0) if (~within & nearest).any() else np.zeros(3)
    inside = within & nearest
    above = np.maximum(radiance[inside] - base, 0) * (2 * np.pi * (1 - np.cos(np.radians(RING))) / SPREAD)
    towards, parts = [around[inside]], [above]
    for lamp, irradiance in election.lamps:
        if np.all(own(lamp[None])):
            towards.append(lamp[None])
            parts.append(irradiance[None])
    towards, parts = np.concatenate(towards), np.concatenate(parts)
    each = np.polynomial.legendre.legvander(np.clip(towards @ direction, -1, 1), order)
    grey = parts.mean(1) / max(parts.mean(1).sum(), 1e-300)
    middle = grey @ towards
    middle = middle / np.linalg.norm(middle) if grey.any() else direction
    return Mound(parts.sum(0), grey @ each, middle, base)


def nearness(basis, position, place, centre, profile=None) -> np.ndarray:
    """What a lamp of irradiance 1 at ``centre`` adds to every point for being near, instead of far away: (p, 3).

    Parameters
    ----------
    basis : (p, terms, 3), A; position : (p, 3), X, world
    place : (3,), p; centre : (3,), c
    profile : (order + 1,), as of `Mound`; None: a point's
    """
    to_lamp = np.asarray(place) - np.asarray(position, np.float64)
    away = np.asarray(place, np.float64) - centre
    distance = np.linalg.norm(away)
    each = np.maximum(np.linalg.norm(to_lamp, axis=1), CLOSEST * distance)
    order = sh.order_of(basis.shape[1])
    seen = sh.evaluate(order, to_lamp / each[:, None]) * np.square(distance / each)[:, None]
    more = seen - sh.evaluate(order, away / distance)
    if profile is not None:
        more *= profile[sh.degrees(order)]
    return np.einsum("ptc,pt->pc", basis, more, optimize=True)
