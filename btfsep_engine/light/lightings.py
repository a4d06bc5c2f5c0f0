# SPDX-License-Identifier: GPL-3.0-or-later
"""Lightings, as the transport sees them: M lights at once, each the radiance that arrives from a direction.

Light is linear, so one pass of the transport serves all M. Two questions can be asked of every lighting:

- ``radiance(directions)``: the radiance from each direction. For mirrors and single directions.
- ``cell_averages(directions)``: for n directions spread over the whole sphere, each standing for 4 pi / n. The sum
  of what is returned times 4 pi / n is the whole light, exactly: the sun is in it, however small it is.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from scipy.sparse import csr_matrix
from scipy.spatial import ConvexHull, QhullError, cKDTree

from btfsep_engine import sh
from btfsep_engine.conventions import direction_to_equirect, pixel_directions, pixel_solid_angles

SAMPLES_PER_CELL = 24  # map samples that share out the light around a direction
WITHIN = 1e-6  # share of each corner, in the triangle around a sample: far above what rounding does


class Lightings(Protocol):
    """M lights. The last axis of the arrays has 3 channels, or 1 where all channels are alike."""

    returns: bool
    """Whether every photo asks for the same ones again: what is made of them is kept."""

    @property
    def count(self) -> int:
        """M"""

    @property
    def names(self) -> tuple[str, ...]:
        """M names, for people"""

    def radiance(self, directions) -> np.ndarray:
        """(n, M, 3 or 1) float64 from ``directions : (n, 3) float, unit, world``."""

    def cell_averages(self, directions) -> np.ndarray:
        """(n, M, 3 or 1) float64 for n directions that share out the whole sphere."""


def cap_factors(order: int, solid_angle: float) -> np.ndarray:
    """What averaging over a cap does to each order of spherical harmonics: (order + 1,) float64, 1 at order 0.

    By Funk and Hecke, (P_{l-1}(c) - P_{l+1}(c)) / ((2 l + 1) (1 - c)) with c the cosine of the cap's half angle.
    """
    c = 1 - min(solid_angle, 4 * np.pi) / (2 * np.pi)
    if solid_angle <= 1e-9:
        return np.ones(order + 1)
    p = np.ones(order + 2)
    p[1] = c
    for l in range(1, order + 1):
        p[l + 1] = ((2 * l + 1) * c * p[l] - l * p[l - 1]) / (l + 1)
    l = np.arange(1, order + 1)
    return np.concatenate([[1.0], (p[:-2] - p[2:]) / ((2 * l + 1) * (1 - c))])


@dataclass(frozen=True)
class SHBasis:
    """The spherical harmonics up to ``order`` as (order + 1)^2 lights, the same in all channels; they go negative."""

    order: int
    returns = True

    @property
    def count(self) -> int:
        return sh.term_count(self.order)

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(f"Y {l} {m}" for l in range(self.order + 1) for m in range(-l, l + 1))

    def radiance(self, directions) -> np.ndarray:
        return sh.evaluate(self.order, directions)[..., None]

    def cell_averages(self, directions) -> np.ndarray:
        """Point values: the basis hardly changes over a cell, and the sum over cells is a good quadrature."""
        return self.radiance(directions)


class _SmoothLight:
    """One light that hardly changes over a cell, as the basis."""

    count, returns = 1, False

    @property
    def names(self) -> tuple[str, ...]:
        return (self.name,)

    def cell_averages(self, directions) -> np.ndarray:
        """Point values."""
        return self.radiance(directions)


@dataclass(frozen=True)
class SHLighting(_SmoothLight):
    """One light given by its coefficients : ((L + 1)^2, 3), linear Rec.709; it may go negative."""

    coefficients: np.ndarray
    name: str = "light"

    def radiance(self, directions) -> np.ndarray:
        return sh.series(self.coefficients, directions)[:, None, :]


@dataclass(frozen=True)
class EnvironmentMaps:
    """M environment maps of one size.

    Attributes
    ----------
    maps : (M, h, w, 3) float, equirectangular as in :mod:`btfsep_engine.conventions`, linear Rec.709, >= 0
    names : M texts
    """

    maps: np.ndarray
    names: tuple[str, ...]
    returns = False

    def __post_init__(self):
        object.__setattr__(self, "maps", np.asarray(self.maps))
        object.__setattr__(self, "names", tuple(self.names))
        if self.maps.ndim != 4 or self.maps.shape[-1] != 3 or len(self.names) != len(self.maps):
            raise ValueError(f"maps of shape {self.maps.shape} with {len(self.names)} names")

    @property
    def count(self) -> int:
        return len(self.maps)

    @cached_property
    def _table(self) -> np.ndarray:
        """(h * w, M * 3): the values of a pixel in all maps, side by side."""
        return np.ascontiguousarray(np.moveaxis(self.maps, 0, 2), np.float64).reshape(-1, 3 * self.count)

    def coefficients(self, order: int) -> np.ndarray:
        """(M, (order + 1)^2, 3) float64, the spherical harmonics of each map."""
        h, w = self.maps.shape[1:3]
        x = sh.project_map(self._table.reshape(h, w, -1), order)
        return np.moveaxis(x.reshape(-1, self.count, 3), 1, 0)

    def selected(self, indices) -> "EnvironmentMaps":
        """The maps with the given numbers."""
        indices = list(indices)
        return EnvironmentMaps(self.maps[indices], tuple(self.names[i] for i in indices))

    def radiance(self, directions) -> np.ndarray:
        """As :class:`Lightings` says, bilinear between the pixels' centres."""
        weights = bilinear(np.asarray(directions, np.float64), *self.maps.shape[1:3])
        return (weights @ self._table).reshape(-1, self.count, 3)

    def cell_averages(self, directions) -> np.ndarray:
        """Each map's energy is shared out among the three directions around it, exactly, by finely divided pixels.

        The shares keep the place of a light too: the sun does not jump to the nearest direction.
        """
        n = len(directions)
        h, w = self.maps.shape[1:3]
        split = max(1, int(np.ceil(np.sqrt(SAMPLES_PER_CELL * n / (h * w)))))
        samples = pixel_directions(h * split, w * split).reshape(-1, 3)
        receivers, shares = _around(np.asarray(directions, np.float64), samples)
        row, column = np.divmod(np.arange(len(samples)), w * split)
        pixel = row // split * w + column // split
        weight = np.repeat(pixel_solid_angles(h * split, w * split), w * split) * (n / (4 * np.pi))
        taps = receivers.shape[1]
        matrix = csr_matrix(
            ((weight[:, None] * shares).ravel(), (receivers.ravel(), np.repeat(pixel, taps))), shape=(n, h * w)
        )
        return (matrix @ self._table).reshape(n, self.count, 3)


def _around(directions, samples):
    """Which directions are around each sample, and its shares in them.

    Parameters
    ----------
    directions : (n, 3) float64, unit, over the whole sphere
    samples : (s, 3) float64, unit

    Returns
    -------
    indices : (s, 3) int, corners of the triangle of the directions' hull that the sample goes through, or
        (s, 1), the nearest one, where the directions have no hull around the origin
    shares : of the same shape, >= 0, sum 1; barycentric, so that the shared directions add up to the sample's
    """
    try:
        hull = ConvexHull(directions)
    except (QhullError, ValueError):
        hull = None
    if hull is None or (hull.equations[:, 3] > -1e-6).any():
        return cKDTree(directions).query(samples)[1][:, None], np.ones((len(samples), 1))
    triangles = hull.simplices
    corners = directions[triangles]  # (t, 3 corners, 3)
    inverse = np.linalg.inv(corners.transpose(0, 2, 1))
    centres = corners.mean(1)
    centres /= np.linalg.norm(centres, axis=-1, keepdims=True)
    tree = cKDTree(centres)
    _, nearest = tree.query(samples)
    shares = np.einsum("sij,sj->si", inverse[nearest], samples)
    indices = triangles[nearest].astype(np.int64)
    left = np.flatnonzero(shares.min(-1) < WITHIN)  # a sample well within a triangle is in no other
    if len(left):
        some, best = samples[left], np.full(len(left), -np.inf)
        _, near = tree.query(some, k=min(12, len(triangles)))
        for candidate in near.T:
            w = np.einsum("sij,sj->si", inverse[candidate], some)
            least = w.min(-1)
            better = least > best
            best[better] = least[better]
            indices[left[better]], shares[left[better]] = triangles[candidate[better]], w[better]
    shares = np.maximum(shares, 0)
    return indices, shares / shares.sum(-1, keepdims=True)


def bilinear_taps(directions, h: int, w: int) -> tuple[np.ndarray, np.ndarray]:
    """The four pixels around each direction, (n, 4) int, row * w + column, and their weights (n, 4).

    Around the seam, and at the poles the nearest row.
    """
    u, v = direction_to_equirect(directions)
    x, y = u * w - 0.5, np.clip((1 - v) * h - 0.5, 0, h - 1)
    x0, y0 = np.floor(x).astype(np.int64), np.minimum(np.floor(y).astype(np.int64), max(h - 2, 0))
    fx, fy = x - x0, y - y0
    y1 = np.minimum(y0 + 1, h - 1)
    columns = [y0 * w + x0 % w, y0 * w + (x0 + 1) % w, y1 * w + x0 % w, y1 * w + (x0 + 1) % w]
    weights = [(1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy]
    return np.stack(columns, 1), np.stack(weights, 1)


def bilinear(directions, h: int, w: int) -> csr_matrix:
    """The same as sparse weights (n, h * w)."""
    pixels, weights = bilinear_taps(directions, h, w)
    starts = np.arange(0, pixels.size + 1, pixels.shape[1])
    return csr_matrix((weights.ravel(), pixels.ravel(), starts), shape=(len(pixels), h * w))


def shrink(radiance, factor: int) -> np.ndarray:
    """An environment map made smaller by a whole factor, averaged by solid angle: no energy is lost.

    Parameters
    ----------
    radiance : (h, w, c) float; ``factor`` divides h and w

    Returns
    -------
    (h / factor, w / factor, c) float64
    """
    a = np.asarray(radiance, np.float64)
    h, w, c = a.shape
    if h % factor or w % factor:
        raise ValueError(f"{factor} does not divide {w} x {h}")
    weight = pixel_solid_angles(h, w)
    rows = (a * weight[:, None, None]).reshape(h // factor, factor, w // factor, factor, c).sum((1, 3))
    return rows / (factor * weight.reshape(-1, factor).sum(1))[:, None, None]


def turned(radiance, degrees: float) -> np.ndarray:
    """An environment map turned about the vertical: light from azimuth a then comes from a + ``degrees``.

    To the nearest whole pixel, so that no light is blurred.
    """
    a = np.asarray(radiance)
    return np.roll(a, -round(degrees / 360 * a.shape[1]), axis=1)
