# SPDX-License-Identifier: GPL-3.0-or-later
"""What a value of a table stands for: the average over the hat of its direction.

Between the directions of a table one interpolates (:mod:`btfsep_engine.btf.directions`): a value f_j counts for all
directions w that its hat h_j reaches, h_j(w) being its weight there. So the value that is stored is

    f_j = <h_j, f cos> / <h_j, cos>        (<a, b>: the integral of a b over the hemisphere)

and since the hats sum to 1, every view's reflected energy in the table is that of the material, however narrow its
highlights are. (Samples at the directions alone have no such law: a lobe narrower than their spacing is lost, or taken
for as wide.)

Averaging smooths, and interpolating between averages smooths again. :func:`sharpened` takes the second smoothing back
as far as values stay positive: a few steps of Richardson and Lucy's iteration (Richardson 1972, Lucy 1974), which keeps
the energy of each view exactly (docs/library.md).
"""

from functools import lru_cache

import numpy as np

from btfsep_engine.btf.directions import hemisphere_quadrature, interpolator
from btfsep_engine.conventions import fibonacci_sphere
from btfsep_engine.render.arrays import DirectionTaps, dr, floats, mi
from btfsep_engine.render.sampling import morton

DRAWN = 256  # directions in the table of a hat; a power of two
FINE = 800_000  # directions over the sphere that they are taken from, 0.2 degrees apart
STEPS = 8  # of the sharpening; more change little


class Hats:
    """The hats of a list of lights, for Dr.Jit.

    Parameters
    ----------
    lights : (n, 3) float, unit, above the horizon
    averaged : whether a light stands for its hat; else for itself alone, a point
    """

    def __init__(self, lights, *, averaged: bool):
        self.averaged, self.count = averaged, len(lights)
        if averaged:
            table, self.drawn = _table(np.ascontiguousarray(lights, np.float64).tobytes(), len(lights)), DRAWN
        else:
            points = np.concatenate([lights, np.ones((len(lights), 1))], 1)
            table, self.drawn = (points[:, None], np.ones(len(lights)), np.zeros(len(lights))), 1
        directions, norm, scale = table
        self.directions, self.cosine = floats(directions), floats(np.asarray(lights)[:, 2])
        self.norm, self.scale = floats(norm), floats(scale)
        if averaged:
            self.taps = DirectionTaps(lights)

    def draw(self, light, entry):
        """A direction of the hat of ``light``, and what is needed to weigh it.

        Parameters
        ----------
        light, entry : UInt32, the number of the hat and of its direction, in [0, ``drawn``)

        Returns
        -------
        direction : Vector3f
        density : Float, per steradian, over h_j(direction); and 1 / h_j(direction)
        scale : Float; the mean over the entries of f(direction) cos * scale / density is f_j cos_j
        """
        row = dr.gather(mi.Vector4f, self.directions, light * self.drawn + entry)
        direction = mi.Vector3f(row.x, row.y, row.z)
        if not self.averaged:
            return direction, mi.Float(1), row.w, mi.Float(1)
        return direction, self._density(light, direction.z), row.w, dr.gather(mi.Float, self.scale, light)

    def _density(self, light, z):
        return (z + dr.gather(mi.Float, self.cosine, light)) * dr.gather(mi.Float, self.norm, light)

    def hats_at(self, direction):
        """The hats that reach a direction (above the horizon): three of (number, h_j, density over h_j, scale)."""
        taps = self.taps(direction)
        total = taps[0][1] + taps[1][1] + taps[2][1]
        return [
            (light, share / total, self._density(light, direction.z), dr.gather(mi.Float, self.scale, light))
            for light, share in taps
        ]


@lru_cache(maxsize=4)
def _table(key: bytes, count: int):
    """Directions drawn from each hat with density h_j (cos + cos_j) norm_j.

    Some weight near the horizon, where the cosine alone has none: there stand facets that face the light.

    Returns
    -------
    (count, DRAWN, 4) : direction and 1 / h_j there; neighbours in the list are neighbours in the hat
    (count,) : norm; (count,) : scale, cos_j / <h_j, cos>
    """
    lights = np.frombuffer(key, np.float64).reshape(count, 3)
    fine = fibonacci_sphere(FINE)
    fine = fine[fine[:, 2] > 0]
    index, share = interpolator(lights).weights(fine)
    order = np.argsort(index.ravel(), kind="stable")
    starts = np.searchsorted(index.ravel()[order], np.arange(count + 1))
    area = 4 * np.pi / FINE
    table, norm, scale = np.empty((count, DRAWN, 4)), np.empty(count), np.empty(count)
    for j in range(count):
        taps = order[starts[j] : starts[j + 1]]
        nodes, h = fine[taps // 3], share.ravel()[taps]
        curve = np.argsort(_along_curve(nodes, lights[j]), kind="stable")
        nodes, h = nodes[curve], h[curve]
        density = h * (nodes[:, 2] + lights[j, 2])
        norm[j], scale[j] = 1 / (density.sum() * area), lights[j, 2] / ((h * nodes[:, 2]).sum() * area)
        reached = np.cumsum(density)
        taken = np.searchsorted(reached, (np.arange(DRAWN) + 0.5) / DRAWN * reached[-1])
        table[j, :, :3], table[j, :, 3] = nodes[taken], 1 / np.maximum(h[taken], 1e-6)
    return table, norm, scale


def _along_curve(nodes, centre) -> np.ndarray:
    """The place of each direction on a Z-order curve over the tangent plane at ``centre``."""
    aside = np.linalg.svd(np.asarray(centre)[None])[2][1:]
    xy = nodes @ aside.T
    cells = ((xy - xy.min(0)) / np.maximum(np.ptp(xy, axis=0), 1e-9) * 1023).astype(np.int64)
    return morton(cells[:, ::-1], bits=10)


@lru_cache(maxsize=4)
def _smoothing(key: bytes, count: int) -> np.ndarray:
    """(count, count): S f are the averages, over the hats, of what is interpolated between the values f."""
    nodes, weights = hemisphere_quadrature()
    hats = interpolator(np.frombuffer(key, np.float64).reshape(count, 3)).hats(nodes)
    mass = ((hats * (weights * nodes[:, 2])) @ hats.T).toarray()
    return mass / mass.sum(1, keepdims=True)


def sharpened(angular, lights) -> np.ndarray:
    """Averages over the hats, sharpened so that what is interpolated between them has these averages.

    The mean of each view and channel is sharpened: f <- f S(a / S f), a the averages; it stays positive, and its energy
    stays. All other components are scaled as the mean is.

    Parameters
    ----------
    angular : (views, lights, 3, k) float, without the cosine; component 0 is the mean
    lights : (lights, 3) float

    Returns
    -------
    as ``angular``, float32
    """
    smoothing = _smoothing(np.ascontiguousarray(lights, np.float64).tobytes(), len(lights))
    averages = np.maximum(np.asarray(angular[..., 0], np.float64).transpose(1, 0, 2), 1e-12)
    averages = averages.reshape(len(lights), -1)
    sharp = averages
    for _ in range(STEPS):
        sharp = sharp * (smoothing @ (averages / (smoothing @ sharp)))
    ratio = (sharp / averages).reshape(len(lights), -1, 3).transpose(1, 0, 2)
    return (angular * ratio[..., None]).astype(np.float32)
