# SPDX-License-Identifier: GPL-3.0-or-later
"""Factorisation of a BTF that is too large to hold, in one pass over its views.

M (texels x angular columns) arrives in blocks of columns and is never stored. What is kept are its exact mean over
the texels, and two random sketches of the rest (Tropp, Yurtsever, Udell, Cevher, "Practical sketching algorithms for
low-rank matrix approximation", 2017), here with signs instead of Gaussians:

    W = M Psi    (few columns)  -> the leading texel patterns V, from an SVD of W
    Y = Omega M  (few rows)     -> the angular factor U, least squares of  Y = (Omega V) U^T

The first component is always the constant texel, so that the mean ABRDF is that of the measurement exactly.
The texel patterns are those of *relative* deviations: each column is divided by its mean (plus a little, for the
dark ones), and a deviation counts at most CLIP times the mean. Otherwise the few columns with a highlight, and in
them the glints of single texels, would be all that the patterns explain.
"""

import json
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from btfsep_engine.linear_algebra import product

CLIP = 2.0
KEPT_ROWS = 1024  # of Y
FLOOR = 0.5  # of the mean of the first block: below this a column's mean is not made 1


@dataclass(frozen=True)
class Factors:
    """M ~ texels @ angular.T

    Attributes
    ----------
    texels : (t, k) float32; column 0 is 1, the others have mean 0 and mean square 1, sorted by their weight
    angular : (columns, k) float32; column 0 is the mean over the texels
    relative_error : ||(M - texels @ angular.T) / m|| / ||M / m|| (Frobenius; m as above), estimated from the sketch.
        It includes the measurement's noise, which the factors average out
    """

    texels: np.ndarray
    angular: np.ndarray
    relative_error: float


class StreamingFactoriser:
    """Takes blocks of columns one after the other, then gives :class:`Factors`.

    Parameters
    ----------
    texels : number of rows
    components : k, the constant one included
    seed : of the random signs; the same blocks and seed give the same factors
    kept_columns : columns of W for each block
    """

    def __init__(self, texels: int, components: int, *, seed: int = 0, kept_columns: int = 8):
        self.rng = np.random.default_rng([seed, 0xB7F])
        self.texels, self.components, self.kept_columns = texels, components, kept_columns
        kept_rows = min(KEPT_ROWS, texels)
        # one sign a column: row sums over random groups of texels, E ||Omega x||^2 = ||x||^2
        group = self.rng.permutation(np.arange(texels) % kept_rows)
        signs = self.rng.choice(np.array([-1.0, 1.0], np.float32), texels)
        self.omega = csr_array((signs, (group, np.arange(texels))), shape=(kept_rows, texels))
        self.omega_sum = self.omega.sum(1)
        self.means, self.scales, self.w, self.y = [], [], [], []
        self.total, self.floor = 0.0, None

    def add(self, block) -> None:
        """One block of columns, (texels, columns) float32."""
        block = np.ascontiguousarray(block, np.float32)
        mean = block.mean(0, dtype=np.float64).astype(np.float32)
        if self.floor is None:
            self.floor = FLOOR * max(float(np.abs(mean).mean()), 1e-6)
        scale = 1 / (np.abs(mean) + np.float32(self.floor))
        kept = min(self.kept_columns, block.shape[1])
        psi = self.rng.choice(np.array([-1.0, 1.0], np.float32), (block.shape[1], kept))
        self.total += float(np.einsum("ij,ij,j->", block, block, scale**2, dtype=np.float64, optimize=False))
        self.means.append(mean)
        self.scales.append(scale)
        self.w.append(product(np.clip((block - mean) * scale, -CLIP, CLIP), psi))
        self.y.append(self.omega @ block - np.outer(self.omega_sum, mean))

    def state(self, start: int = 0) -> dict:
        """All that is kept of the blocks from number ``start`` on, as arrays by name; for :meth:`restore`."""
        floor = np.nan if self.floor is None else self.floor
        return {
            "start": np.array(start),
            "lengths": np.array([len(m) for m in self.means[start:]]),
            "means": np.concatenate(self.means[start:]),
            "scales": np.concatenate(self.scales[start:]),
            "w": np.concatenate(self.w[start:], 1),
            "y": np.concatenate(self.y[start:], 1),
            "total_and_floor": np.array([self.total, floor]),
            "random": np.frombuffer(json.dumps(self.rng.bit_generator.state).encode(), np.uint8),
        }

    def restore(self, state: dict) -> None:
        """Goes on after the blocks that :meth:`state` gave, in a factoriser made alike; bit by bit the same factors.

        Raises ValueError: they do not follow on what is here.
        """
        if int(state["start"]) != len(self.means):
            raise ValueError(f"blocks from number {int(state['start'])} on, after {len(self.means)} blocks")
        ends = np.cumsum(state["lengths"])[:-1]
        self.means += np.split(state["means"], ends)
        self.scales += np.split(state["scales"], ends)
        self.w += np.split(state["w"], np.cumsum(np.minimum(state["lengths"], self.kept_columns))[:-1], 1)
        self.y += np.split(state["y"], ends, 1)
        self.total, self.floor = (float(v) for v in state["total_and_floor"])
        self.rng.bit_generator.state = json.loads(bytes(state["random"]))

    def finish(self) -> Factors:
        """The factors of all blocks, in the order they came."""
        mean, w, scale = np.concatenate(self.means), np.concatenate(self.w, 1), np.concatenate(self.scales)
        rows = len(self.omega_sum)
        k = max(min(self.components - 1, *w.shape, rows // 2), 0)
        patterns = _leading_patterns(w, k, self.rng)
        patterns -= patterns.mean(0)
        patterns /= np.maximum(np.sqrt((patterns**2).mean(0)), 1e-30)
        q, r = np.linalg.qr(self.omega @ patterns)
        qt, back = np.ascontiguousarray(q.T, np.float32), np.linalg.pinv(r).T  # patterns may be fewer than k
        u, residual, at = np.empty((len(mean), k), np.float32), 0.0, 0
        for y in self.y:  # block by block: all of them are hundreds of megabytes
            end, along = at + y.shape[1], product(qt, y)
            u[at:end] = product(along.T, back)
            left = np.einsum("ij,ij->j", y, y) - np.einsum("ij,ij->j", along, along)  # least squares: Pythagoras
            left = np.maximum(left, 0)  # of exact rank only rounding is left, of either sign
            residual, at = residual + float(left @ scale[at:end].astype(np.float64) ** 2), end
        residual /= max(rows - k, 1) / rows  # the fit took k of the rows' degrees of freedom
        return Factors(
            texels=np.concatenate([np.ones((self.texels, 1)), patterns], 1).astype(np.float32),
            angular=np.concatenate([mean[:, None], u], 1),
            relative_error=float(np.sqrt(residual / max(self.total, 1e-300))),
        )


def _leading_patterns(w, k: int, rng) -> np.ndarray:
    """The k leading left singular vectors of w, (rows, k) float64, by subspace iteration."""
    q = product(w, rng.standard_normal((w.shape[1], min(k + 12, *w.shape))).astype(np.float32))
    for _ in range(4):
        q = np.linalg.qr(product(w, product(w.T, np.linalg.qr(q)[0])))[0]
    u, _, _ = np.linalg.svd(product(q.T, w), full_matrices=False)
    return product(q, u)[:, :k].astype(np.float64)
