# SPDX-License-Identifier: GPL-3.0-or-later
"""Factorisation of a BTF that is too large to hold, in one pass over its views.

M (angular rows x texels) arrives view by view and is never stored. What is kept are its exact mean over the texels,
and two random sketches of the rest (Tropp, Yurtsever, Udell, Cevher, "Practical sketching algorithms for low-rank
matrix approximation", 2017), here with sparse signs instead of Gaussians:

    W = Psi M   (few rows)      -> the leading texel patterns V, from an SVD of W
    Y = M Omega (few columns)   -> the angular factor U, least squares of  Y = U (V^T Omega)

The first component is always the constant texel, so that the mean ABRDF is that of the measurement exactly.
"""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Factors:
    """M ~ angular @ texels.T

    Attributes
    ----------
    angular : (rows, k) float32; column 0 is the mean over the texels
    texels : (t, k) float32; column 0 is 1, the others have mean 0 and mean square 1, sorted by their weight
    relative_error : ||M - angular @ texels.T|| / ||M|| (Frobenius), estimated from the sketch; it includes the
        measurement's noise, which the factors average out
    """

    angular: np.ndarray
    texels: np.ndarray
    relative_error: float


class StreamingFactoriser:
    """Takes blocks of rows one after the other, then gives :class:`Factors`.

    Parameters
    ----------
    texels : number of columns
    components : k, the constant one included
    seed : of the random signs; the same blocks and seed give the same factors
    kept_rows : rows of W for each block; kept_columns : columns of Y
    """

    def __init__(self, texels: int, components: int, *, seed: int = 0, kept_rows: int = 24, kept_columns: int = 1024):
        self.rng = np.random.default_rng([seed, 0xB7F])
        self.texels, self.components, self.kept_rows = texels, components, kept_rows
        self.columns = _SparseSigns(texels, min(kept_columns, texels), self.rng)
        self.means, self.row_sketches, self.column_sketches = [], [], []
        self.total = 0.0

    def add(self, block) -> None:
        """One block of rows, (rows, texels) float32."""
        block = np.asarray(block, np.float32)
        mean = block.mean(1)
        self.total += float(np.einsum("ij,ij->", block, block, dtype=np.float64))
        rest = block - mean[:, None]
        self.means.append(mean)
        self.column_sketches.append(self.columns.of_columns(rest))
        signs = _SparseSigns(len(block), min(self.kept_rows, len(block)), self.rng)
        self.row_sketches.append(signs.of_columns(np.ascontiguousarray(rest.T)).T)

    def finish(self) -> Factors:
        """The factors of all blocks, in the order they came."""
        mean = np.concatenate(self.means)
        w = np.concatenate(self.row_sketches)
        y = np.concatenate(self.column_sketches)
        k = min(self.components - 1, *w.shape, y.shape[1] // 2)
        patterns = _leading_patterns(w, k, self.rng) if k > 0 else np.zeros((self.texels, 0))
        patterns = patterns - patterns.mean(0)
        patterns /= np.maximum(np.sqrt((patterns**2).mean(0)), 1e-30)
        projected = self.columns.of_columns(np.ascontiguousarray(patterns.T.astype(np.float32)))  # (k, columns)
        u = np.linalg.lstsq(projected.T.astype(np.float64), y.T.astype(np.float64), rcond=None)[0].T
        free = max(y.shape[1] - k, 1) / y.shape[1]  # the fit took k of the columns' degrees of freedom
        residual = float(((y - u @ projected) ** 2).sum()) / free
        return Factors(
            angular=np.concatenate([mean[:, None], u], 1).astype(np.float32),
            texels=np.concatenate([np.ones((self.texels, 1)), patterns], 1).astype(np.float32),
            relative_error=float(np.sqrt(residual / max(self.total, 1e-300))),
        )


class _SparseSigns:
    """A random matrix with one +-1 a row: sums of columns with random signs. E ||x S||^2 = ||x||^2."""

    def __init__(self, size: int, kept: int, rng):
        bucket = np.concatenate([np.arange(kept), rng.integers(0, kept, size - kept)])  # no bucket is empty
        where = rng.permutation(size)
        order = np.argsort(bucket, kind="stable")
        self.order = where[order]
        self.starts = np.searchsorted(bucket[order], np.arange(kept))
        self.signs = rng.choice(np.array([-1.0, 1.0], np.float32), size)[self.order]

    def of_columns(self, matrix) -> np.ndarray:
        """(rows, size) -> (rows, kept)"""
        return np.add.reduceat(matrix[:, self.order] * self.signs, self.starts, axis=1)


def _leading_patterns(w, k: int, rng) -> np.ndarray:
    """The k leading right singular vectors of w, (columns, k), by subspace iteration."""
    q = np.linalg.qr(w.T @ (w @ rng.standard_normal((w.shape[1], min(k + 12, *w.shape))).astype(np.float32)))[0]
    for _ in range(4):
        q = np.linalg.qr(w.T @ (w @ q))[0]
    _, _, vt = np.linalg.svd(w @ q, full_matrices=False)
    return (q @ vt.T)[:, :k].astype(np.float64)
