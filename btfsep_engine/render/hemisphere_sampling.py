# SPDX-License-Identifier: GPL-3.0-or-later
"""Light directions drawn for a tabulated material, in Dr.Jit.

They are drawn from a piecewise-constant density on the square that the cosine-weighted hemisphere is
mapped from (Shirley and Chiu's concentric map, then Malley's lift): inside a cell the density over solid angle is
cell probability x CELLS^2 x cos(theta) / pi, so the cosine is followed exactly and the table follows the ABRDF.
"""

import numpy as np

from btfsep_engine.btf.directions import interpolator
from btfsep_engine.btf.model import Tabulated
from btfsep_engine.render.arrays import dr, floats, mi

CELLS = 32  # cells along an edge of the square; the lists' 15 degrees are 5 of them
PER_CELL = 3  # nodes along an edge of a cell, over which the ABRDF is averaged
COSINE_SHARE = 0.15  # of the samples follow the cosine alone: bounds the weight where the mean ABRDF is dark


def cell_probabilities(material: Tabulated) -> np.ndarray:
    """The probability of each cell of the square, for every view of the material's list.

    It is the mean ABRDF (positive part, mean of the channels) averaged over the cell, mixed with COSINE_SHARE of
    the even density.

    Gives (views, CELLS, CELLS) float64, [row, column]; each view sums to 1.
    """
    n = CELLS * PER_CELL
    x, y = np.meshgrid((np.arange(n) + 0.5) / n, (np.arange(n) + 0.5) / n)
    square = mi.Point2f(x.ravel().astype(np.float32), y.ravel().astype(np.float32))
    disk = np.array(mi.warp.square_to_uniform_disk_concentric(square), np.float64).T
    nodes = np.concatenate([disk, np.sqrt(np.maximum(1 - (disk**2).sum(1, keepdims=True), 0))], 1)
    taps, weights = interpolator(material.lights).weights(nodes)
    brightness = np.maximum(material.mean_abrdf.astype(np.float64), 0).mean(-1)  # (views, lights)
    values = sum(brightness[:, taps[:, i]] * weights[:, i] for i in range(3))
    cells = values.reshape(-1, CELLS, PER_CELL, CELLS, PER_CELL).mean((2, 4))
    total = cells.sum((1, 2), keepdims=True)
    even = 1 / CELLS**2
    return np.where(total > 0, (1 - COSINE_SHARE) * cells / np.maximum(total, 1e-300) + COSINE_SHARE * even, even)


class LightSampling:
    """Draws light directions for a view given by its taps.

    ``material`` : Tabulated
    """

    def __init__(self, material: Tabulated):
        cells = cell_probabilities(material)
        rows = np.cumsum(cells.sum(2), 1).astype(np.float32)
        columns = np.cumsum(cells / cells.sum(2, keepdims=True), 2).astype(np.float32)
        rows[:, -1], columns[..., -1] = 1, 1
        # the density is that of the rounded tables which are drawn from
        drawn = np.diff(rows, axis=1, prepend=0)[..., None] * np.diff(columns, axis=2, prepend=0)
        self.rows, self.columns = floats(rows), floats(columns)
        self.density = floats(drawn * CELLS**2 / np.pi)

    def pdf(self, views, shares, direction, active):
        """Density over solid angle of drawing a local ``direction``, for the view with the taps ``views, shares``."""
        square = mi.warp.uniform_disk_to_square_concentric(mi.Point2f(direction.x, direction.y))
        column, row = (mi.UInt32(dr.clip(s * CELLS, 0, CELLS - 1)) for s in (square.x, square.y))
        density = mi.Float(0)
        for view, share in zip(views, shares, strict=True):
            density += share * dr.gather(mi.Float, self.density, (view * CELLS + row) * CELLS + column, active)
        return dr.select(active & (direction.z > 0), density * direction.z, 0)

    def draw(self, views, shares, sample1, sample2, active):
        """A local direction from uniform numbers: one of the three views by its share, then a cell, then a place."""
        view = dr.select(sample1 < shares[0], views[0], dr.select(sample1 < shares[0] + shares[1], views[1], views[2]))
        row, y = self._invert(self.rows, view, sample2.y, active)
        column, x = self._invert(self.columns, view * CELLS + row, sample2.x, active)
        square = mi.Point2f((mi.Float(column) + x) / CELLS, (mi.Float(row) + y) / CELLS)
        disk = mi.warp.square_to_uniform_disk_concentric(square)
        return mi.Vector3f(disk.x, disk.y, dr.safe_sqrt(1 - dr.squared_norm(disk)))

    def _invert(self, table, number, u, active):
        """The cell of table row ``number`` that ``u`` falls into, and where in it (0 to 1)."""
        base = number * CELLS
        cell = dr.binary_search(0, CELLS - 1, lambda i: dr.gather(mi.Float, table, base + mi.UInt32(i), active) <= u)
        cell = mi.UInt32(cell)
        high = dr.gather(mi.Float, table, base + cell, active)
        low = dr.select(cell > 0, dr.gather(mi.Float, table, base + cell - 1, active & (cell > 0)), 0)
        return cell, dr.clip((u - low) / dr.maximum(high - low, 1e-20), 0, dr.one_minus_epsilon(mi.Float))
