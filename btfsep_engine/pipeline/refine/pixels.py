# SPDX-License-Identifier: GPL-3.0-or-later
"""All photographs' pixels, as the search for what lights, paints or covers a part of them needs them."""

from functools import cached_property

import numpy as np
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from btfsep_engine.fit.colour import LIGHT
from btfsep_engine.fit.two_kinds import FINE, FINEST, HOPEFUL, NEARER_OFF, OFF, TwoKinds, neighbours
from btfsep_engine.pipeline.together import APART, all_weights

SOME = 700  # pixels, of which what they are is asked first
# What a lamp leaves over where pixels stand apart, over what one colour for each part of them leaves: of six plates in
# a shadow 0.1 to 0.4, of things in front of 12 plates 1.0 to 2.4.
AS_LIT = 0.6
AS_LIGHT = 2.0  # deviations of a light's tint: what differs more is not of less light


def objects_apart(problems) -> np.ndarray:
    """(p, 2), where all photographs' pixels are, each object's beside the others'."""
    each = [points.pixels for p in problems for points in p.points]
    return np.concatenate([pixels + np.array([i * APART, 0]) for i, pixels in enumerate(each)])


class Pixels:
    """All photographs' pixels as the search for their parts needs them.

    Attributes
    ----------
    b : (p, 3), what is fitted; known : (p, 3), how much it counts; rms : (3,), of b
    at : (p, 2), where they are, objects apart; around : `neighbours` of them
    some : (p,) bool, those that are asked first; around_some : `neighbours` of these
    """

    def __init__(self, model, light):
        self.problems, self.light = model.problems, light
        self.b, own = light.radiance(self.problems), all_weights(self.problems)
        clipped = np.concatenate([p.clipped for p in self.problems])
        self.known = np.where(clipped, 0.0, 1.0 if own is None else own)
        self.rms = np.sqrt((self.known * self.b**2).sum(0) / np.maximum(self.known.sum(0), 1.0))
        self.at = objects_apart(self.problems)
        self.some = np.arange(len(self.b)) % -(-len(self.b) // SOME) == 0
        self.around = neighbours(self.at, deviation=FINE, farthest=FINEST)
        self.around_some = neighbours(self.at[self.some])

    @cached_property
    def basis(self) -> np.ndarray:
        """(p, terms, 3)."""
        return np.concatenate([p.all_basis for p in self.problems])

    @cached_property
    def kinds(self) -> TwoKinds:
        """Of some."""
        some = self.some
        return TwoKinds(self.basis[some], self.b[some], self.known[some], self.around_some)

    def apart(self) -> np.ndarray:
        """(p,) bool, those that are of no object, as far as smooth light tells; none where that is most of them."""
        some = self.some
        around = neighbours(self.at[some], deviation=FINE, farthest=FINEST)
        kinds = TwoKinds(self.basis[some], self.b[some], self.known[some], around)
        starts = [np.zeros(some.sum(), bool), *kinds.unlike()]
        for off in (OFF, NEARER_OFF):
            likely, left = min((kinds.apart(start, off) for start in starts), key=lambda one: one[1])
            if left < HOPEFUL * kinds.left:
                break
        kinds = TwoKinds(self.basis, self.b, self.known, self.around)
        apart, left = kinds.apart(self.of_all(likely) > 0.5, off)
        return apart & np.isfinite(left)

    def darker(self, light) -> np.ndarray:
        """(p,) bool, those that would show what ``light`` (p, 3) makes of the objects if they had less of it."""
        b, light = (np.maximum(self.around @ each, 1e-6 * self.rms) for each in (self.b, light))
        r, g, blue = np.log(b / light).T
        tints = np.stack([r - blue, g - (r + blue) / 2], 1)  # as of `fit.colour`
        return ((b / light).mean(1) < 1) & (np.square(tints / (np.sqrt(2) * LIGHT)).sum(1) < AS_LIGHT**2)

    def unlike_the_rest(self, apart, left) -> bool:
        """Whether what some model leaves over, (a, 3), of pixels that stand ``apart`` (p,) bool is about as much as one
        colour for each part of them leaves."""
        known, b, part = self.known[apart], self.b[apart], connected_components(neighbours(self.at[apart]))[1]
        sums, counts = (np.stack([np.bincount(part, v) for v in each.T], 1) for each in (known * b, known))
        uneven = b - (sums / np.maximum(counts, 1e-12))[part]
        return float((known * np.square(left)).sum()) >= AS_LIT**2 * float((known * np.square(uneven)).sum())

    @cached_property
    def _nearest(self) -> np.ndarray:
        return cKDTree(self.at[self.some]).query(self.at)[1]

    def of_all(self, values) -> np.ndarray:
        """(p,) float, those of some (some,), each pixel's as the nearest one's."""
        return values[self._nearest].astype(np.float64)

    def of_mean(self, factor) -> np.ndarray:
        """A factor (p, 3) on objects' reflectance, over its mean of each object."""
        return np.concatenate([f / np.average(f, axis=0) for p in self.split(factor, True) for f in p if len(f)])

    def split(self, values, by_object=False) -> list:
        """Rows of all pixels cut by photograph, maybe those by object."""
        each = np.split(values, np.cumsum([len(p.pixels) for p in self.problems])[:-1])
        return [p.by_object(v) for p, v in zip(self.problems, each, strict=True)] if by_object else each

    def share(self, left, weights) -> float:
        """What is left over of pixels that count by ``weights``, relative."""
        return float(np.sqrt((weights * left**2).sum() / max(float((weights * self.b**2).sum()), 1e-300)))
