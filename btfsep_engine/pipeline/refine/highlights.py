# SPDX-License-Identifier: GPL-3.0-or-later
"""Which points of objects may show highlights, and which of those that are bright do.

A highlight is seen wherever a surface reflects the same direction; a thing in front, or a piece of paint, at one place.
"""

import numpy as np
from scipy.spatial import cKDTree

from btfsep_engine import sh

GLOSSY = 0.03  # of the even light's image, root mean square, of those of order 9: roughness 0.4; matte 0.01
AS_GLOSSY = 0.5  # of a point's: less glossy ones do not show what it does
NEIGHBOURS, SAME, ELSEWHERE = 40, 0.1, 0.1  # points that reflect the same direction; radians; of the extent
TOLD, SHARED = 0.3, 0.15  # share of bright points that others tell of; of these others that are bright, too: 0.25 and
# more of highlights, 0 to 0.15 of things in front


def shining(problem, *, beyond: float = GLOSSY) -> tuple[np.ndarray, np.ndarray]:
    """(p,) bool: points of objects that may show highlights, whose basis images do not fade with the order; and (p,)
    how little those of each point fade: of several materials one shines and another does not.

    ``beyond`` : as `GLOSSY`
    """
    out, each = [], []
    for basis in problem.basis:
        power = np.square(basis.mean(2, dtype=np.float64))
        sharpest, size = sh.term_count(sh.order_of(power.shape[1]) - 1), power.mean(0)
        out.append(np.full(len(basis), size[sharpest:].mean() > beyond**2 * size[0]))
        each.append(np.sqrt(power[:, sharpest:].mean(1) / np.maximum(power[:, 0], 1e-300)))
    return np.concatenate(out), np.concatenate(each)


def mirrored_alike(problem, asked, bright) -> tuple[float, float]:
    """Of the points ``asked`` (a,), the share of which others tell, elsewhere, that reflect the same direction and are
    about as glossy; and the share of these others that are ``bright`` (p,) bool, too (0 where none tell)."""
    gloss = shining(problem)[1]
    normal, eye = problem.normals, np.concatenate([p.to_eye for p in problem.points])
    mirrored = 2 * (normal * eye).sum(1, keepdims=True) * normal - eye
    places = problem.pixels / np.ptp(problem.pixels, 0).max()
    far, near = cKDTree(mirrored).query(mirrored[asked], NEIGHBOURS, distance_upper_bound=SAME)
    there = np.isfinite(far)
    near = np.where(there, near, 0)
    there &= np.linalg.norm(places[near] - places[asked, None], axis=2) > ELSEWHERE
    there &= gloss[near] > AS_GLOSSY * gloss[asked, None]
    votes = there.any(1)
    shared = (bright[near] & there).sum(1)[votes] / there.sum(1)[votes]
    return float(votes.mean()), float(shared.mean()) if len(shared) else 0.0


def highlights(problem, bright) -> np.ndarray:
    """(p,) bool: which of the points that are too ``bright`` (p,) bool may be highlights.

    A highlight is seen wherever the surface reflects the same direction, a thing in front at one place: other places
    that reflect it, and are about as glossy, tell. Where there are none, it may be one.
    """
    asked = np.flatnonzero(bright & shining(problem)[0])
    out = np.zeros(len(bright), bool)
    out[asked] = True
    if len(asked) < 2:
        return out
    told, shared = mirrored_alike(problem, asked, bright)
    if told > TOLD and shared < SHARED:
        out[:] = False
    return out
