# SPDX-License-Identifier: GPL-3.0-or-later
"""The last pixel of a pose: by how much the photo's own edges lie beside known outlines, and what pose goes with that.

Across an outline a photo goes from the object's brightness to that of what is behind it. The area under that passage
tells where the edge lies to a fraction of a pixel, as the slope in which `fit.pose` searches does not: of logarithms it
leans to the darker side, and it hardly changes within a pixel. An object's brightness changes towards its rim, and is
taken to go on changing as it does inside. What that leaves where a rim is glossy, and whatever is wrong with the size
of a mesh, brings all edges together farther in or out; that is a number of its own. Poses are held near the start, as
what is seen of them within a pixel is little: outlines of round things tell no turn.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from btfsep_engine.fit.pose import PARAMETERS, STEP, Frame, Misfit, usual_colour

WINDOW, SIDES = 2.0, 2.0  # pixels to either side of an outline in which its edge is looked for, and of what lies beyond
FAINT = 0.3  # of an edge's step at the rim: a smaller one farther in is no measure
SAMPLES = 4  # a pixel
SURE = 0.15  # pixels, of the best edge
UNEVEN = 1.5  # pixels, of one whose sides are as uneven as they are different
LEAST_STEP = 0.02  # of the objects' median colour, across an edge that is sure to a pixel
ASTRAY = 2.0  # deviations at which an edge counts less: it is another one
RIM = 0.5  # pixels, the deviation of where all edges together lie
HOLD = 0.1  # of the deviations of `Frame`: the prior's
SHIFTS_OF_EDGES, TURNS = 3, 10  # of the marks: steps of the pose; rounds of the weights
LONGEST, SHORTEST = 3.0, 0.03  # pixels, of a step


class Edges:
    """A photograph in which edges are looked for.

    Parameters
    ----------
    radiance : (h, w, 3) linear
    usable : (h, w) bool
    about : (h, w) bool, where the objects are, roughly
    """

    def __init__(self, radiance, usable, about):
        self.radiance = (radiance / usual_colour(radiance[about & usable])).astype(np.float32)
        self.usable = usable.astype(np.float32)

    def beside(self, at, across) -> tuple[np.ndarray, np.ndarray]:
        """How far outwards of image positions (m, 2) edges lie, ``across`` (m, 2) inwards, and the deviation of that:
        (m,) and (m,) pixels, infinite where there is none."""
        reach = WINDOW + SIDES
        t = np.linspace(-reach, reach, round(2 * reach * SAMPLES) + 1)
        places = (at[:, None] - t[:, None] * across[:, None] - 0.5).astype(np.float32)
        x, y = np.ascontiguousarray(places[..., 0]), np.ascontiguousarray(places[..., 1])
        seen = cv2.remap(self.radiance, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE).astype(np.float64)
        known = cv2.remap(self.usable, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0).min(1)
        inside, outside, middle = seen[:, t < -WINDOW], seen[:, t > WINDOW], np.abs(t) <= WINDOW
        deep = t[t < -WINDOW] - t[t < -WINDOW].mean()
        slope = np.einsum("mtc,t->mc", inside, deep) / (deep**2).sum()
        onwards = np.minimum(t[middle], 0) - t[t < -WINDOW].mean()  # as far as the object goes
        object_ = np.maximum(inside.mean(1)[:, None] + slope[:, None] * onwards[:, None], 0)
        step = outside.mean(1)[:, None] - object_
        contrast = np.linalg.norm(step[:, -1], axis=1)
        size = np.maximum(np.linalg.norm(step, axis=-1), FAINT * contrast[:, None] + 1e-12)
        passage = ((seen[:, middle] - object_) * step).sum(-1) / size**2
        # by trapezoids, for which NumPy has no name that it had before 2.0 and still has
        outwards = WINDOW - (np.diff(t[middle]) * (passage[:, 1:] + passage[:, :-1]) / 2).sum(1)
        uneven = np.sqrt((inside.var(1) + outside.var(1)).sum(-1))
        wrong = passage - np.clip(t[middle] - outwards[:, None] + 0.5, 0, 1)  # from a straight passage in a pixel
        relative = (UNEVEN * uneven + LEAST_STEP) / np.maximum(contrast, 1e-12)
        deviation = np.sqrt(SURE**2 + relative**2 + (wrong**2).mean(1))
        there = (known > 0.99) & (np.abs(outwards) < WINDOW)
        return np.where(there, outwards, 0.0), np.where(there, deviation, np.inf)


@dataclass(frozen=True)
class Settled:
    """A pose whose outlines lie where the photo's edges do.

    Attributes
    ----------
    q : (7,) as of `Frame`
    beside : pixels, root mean square by which edges lie beside outlines from the start; left : the same from ``q``
    edges : how many independent edges (tiles of the picture) say so, weighted by how much each is believed
    """

    q: np.ndarray
    beside: float
    left: float
    edges: float

    @property
    def excess(self) -> float:
        """Pixels, root mean square by which edges lie beside outlines and need not."""
        return float(np.sqrt(max(self.beside**2 - self.left**2, 0.0)))


def settled(
    misfit: Misfit, edges: Edges, frame: Frame, q, *, about=None, free, tile: float, hold: float = HOLD
) -> Settled:
    """The pose near seven numbers ``q`` that goes best with edges and shading.

    Parameters
    ----------
    misfit : its marks are seen from about there
    free : (7,) bool, the other numbers stay
    tile : pixels, edge of the squares whose points are one witness
    about : (7,), the prior's middle; None: ``q``
    hold : the prior's deviation, of those of ``frame``
    """
    start, free = np.array(q, np.float64), np.asarray(free, bool)
    about = start if about is None else np.asarray(about, np.float64)
    which, now = np.flatnonzero(free), start.copy()
    n = len(which)
    prior = np.diag(1 / (hold * frame.deviations[free]) ** 2)
    at = frame.at(start).project(misfit.outline)
    witnesses, surface = _tiles(at, tile), _tiles(frame.at(start).project(misfit.surface), tile)
    first = None
    for _ in range(SHIFTS_OF_EDGES):
        around = [now + sign * STEP * np.eye(PARAMETERS)[i] for i in which for sign in (1, -1)]
        cameras = [frame.at(each) for each in [now, *around]]
        seen = np.stack([camera.project(misfit.outline) for camera in cameras])
        outwards, deviation = edges.beside(seen[0], misfit.across)
        slopes = -((seen[1::2] - seen[2::2]) * misfit.across).sum(-1).T / (2 * STEP)
        slopes = np.concatenate([slopes, np.ones((len(slopes), 1))], 1)
        left = misfit.left(cameras) / misfit.scale
        bends = np.moveaxis(left[1::2] - left[2::2], 0, -1) / (2 * STEP)
        soft = surface / max(left[0].size, 1) / np.sqrt(1 + left[0] ** 2)
        fixed, pull = np.zeros((n + 1, n + 1)), np.zeros(n + 1)
        fixed[:n, :n] = np.einsum("pck,pc,pcl->kl", bends, soft, bends) + prior
        fixed[n, n] = 1 / RIM**2
        pull[:n] = -np.einsum("pck,pc,pc->k", bends, soft, left[0]) - prior @ (now - about)[free]
        step = np.zeros(n + 1)
        for _ in range(TURNS):
            r = outwards - slopes @ step
            weight = witnesses / max(len(at), 1) / deviation**2 / (1 + (r / (ASTRAY * deviation)) ** 2)
            step = np.linalg.solve(fixed + slopes.T @ (weight[:, None] * slopes), pull + slopes.T @ (weight * outwards))
        r = outwards - slopes @ step
        if first is None:
            first = outwards - step[n]
        way = step[:n] * min(1.0, LONGEST / max(float(np.linalg.norm(step[:n])), 1e-12))
        now[free] += way
        if np.linalg.norm(way) < SHORTEST:
            break
    total = float(weight.sum())
    return Settled(
        now, *(float(np.sqrt((weight * each**2).sum() / max(total, 1e-300))) for each in (first, r)), total * SURE**2
    )


def _tiles(at, tile: float) -> int:
    return len(np.unique((at / tile).astype(np.int64), axis=0))
