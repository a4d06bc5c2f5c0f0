# SPDX-License-Identifier: GPL-3.0-or-later
"""A lamp that stands near: what a photograph shows of it that one far away would not leave.

A lamp at the place p sends a point X light from (p - X) / |p - X|, weaker by the square of the distance. With the basis
images A, whose row of a point is its answer to light from anywhere, it adds

    E (|p - c|^2 / |p - X|^2) A(X) Y(direction of p from X)

to a point's radiance, E being its irradiance at c, the middle of the objects. What the point would show of a lamp of
the same irradiance at c, far away in the direction of p, is E A(X) Y(direction of p from c). The photograph less the
difference is one of light from far away: linear in it, as all of the method is.
"""

import numpy as np

from btfsep_engine import sh

CLOSEST = 0.05  # of the lamp's distance from the middle: nearer to it no point is taken to be


def nearness(basis, position, place, centre) -> np.ndarray:
    """What a lamp of irradiance 1 at ``centre`` adds to every point for being near, instead of far away: (p, 3).

    Parameters
    ----------
    basis : (p, terms, 3), A; position : (p, 3), X, world
    place : (3,), p; centre : (3,), c
    """
    to_lamp = np.asarray(place) - np.asarray(position, np.float64)
    away = np.asarray(place, np.float64) - centre
    distance = np.linalg.norm(away)
    each = np.maximum(np.linalg.norm(to_lamp, axis=1), CLOSEST * distance)
    order = sh.order_of(basis.shape[1])
    seen = sh.evaluate(order, to_lamp / each[:, None]) * np.square(distance / each)[:, None]
    return np.einsum("ptc,pt->pc", basis, seen - sh.evaluate(order, away / distance), optimize=True)
