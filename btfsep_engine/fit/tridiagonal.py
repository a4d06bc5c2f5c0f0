# SPDX-License-Identifier: GPL-3.0-or-later
"""log det (I + q M) and h^T (I + q M)^-1 h for many q, at the price of one tridiagonal reduction.

M = Q T Q^T with T tridiagonal takes a fifth of the time of a full eigen-decomposition (LAPACK dsytrd); after that
each q costs O(n). T is what an eigen-solver makes first and then throws away.
"""

from copy import copy

import numpy as np
from scipy.linalg import eigh_tridiagonal, lapack

BLOCK = 12  # columns that dsytrd takes together; with its own choice, 32, it is slower by an eighth
PRECISE = 1e13  # trace of q M: from here on rounding is as large as the I in I + q M


class Tridiagonal:
    """A symmetric positive semidefinite matrix M, reduced, and a vector h in its basis.

    Parameters
    ----------
    matrix : (n, n) float64, symmetric; its content is overwritten where it is in Fortran order
    vector : (n,) float64, h
    """

    def __init__(self, matrix, vector):
        n = len(matrix)
        reduced, self.diagonal, self.beside, tau, _ = lapack.dsytrd(
            np.asfortranarray(matrix), lower=1, lwork=BLOCK * n, overwrite_a=1
        )
        # the reflectors stand below the first subdiagonal, as those of a QR decomposition of rows 1 to n do
        self._reflectors, self._tau = np.asfortranarray(reduced[1:, :-1]), tau
        self.vector = self._turned(vector, "T")
        self._spectrum = None

    def _turned(self, vector, how: str) -> np.ndarray:
        """Q^T times a vector for "T", Q times it for "N"."""
        out = np.array(vector, np.float64)
        if len(out) > 1:
            # one reflector after the other (lwork=1): for one vector, blocks of them take four times as long
            turned, _, _ = lapack.dormqr("L", how, self._reflectors, self._tau, out[1:, None], lwork=1)
            out[1:] = turned[:, 0]
        return out

    def with_vector(self, vector) -> "Tridiagonal":
        """The same matrix with another h."""
        other = copy(self)
        other.vector = self._turned(vector, "T")
        return other

    def log_det_and_explained(self, q: float) -> tuple[float, float]:
        """log det (I + q M) and q h^T (I + q M)^-1 h."""
        if q * self.diagonal.sum() < PRECISE:
            pivots, factors, failed = lapack.dpttrf(1 + q * self.diagonal, q * self.beside)
            if not failed:
                solved, _ = lapack.dpttrs(pivots, factors, self.vector)
                return float(np.log(pivots).sum()), float(q * (self.vector @ solved))
        values, _, inside = self._eigen()
        growth = 1 + q * values
        return float(np.log(growth).sum()), float((q * inside**2 / growth).sum())

    def solved(self, q: float) -> np.ndarray:
        """q (I + q M)^-1 h, in M's own basis: (n,)."""
        if q * self.diagonal.sum() < PRECISE:
            pivots, factors, failed = lapack.dpttrf(1 + q * self.diagonal, q * self.beside)
            if not failed:
                inside, _ = lapack.dpttrs(pivots, factors, self.vector)
                return self._turned(q * inside, "N")
        values, vectors, inside = self._eigen()
        return self._turned(vectors @ (q * inside / (1 + q * values)), "N")

    def _eigen(self):
        """T's eigenvalues, cut off at zero, its eigenvectors, and h among them."""
        if self._spectrum is None:
            values, vectors = eigh_tridiagonal(self.diagonal, self.beside)
            self._spectrum = np.maximum(values, 0), vectors
        return *self._spectrum, self._spectrum[1].T @ self.vector


class TridiagonalBlocks(Tridiagonal):
    """The same of a matrix of blocks of one size on its diagonal, each reduced for itself.

    Parameters
    ----------
    matrices : (k, n, n) float64, symmetric; vectors : (k, n) float64
    """

    def __init__(self, matrices, vectors):
        self._blocks = [Tridiagonal(matrix, vector) for matrix, vector in zip(matrices, vectors, strict=True)]
        self.diagonal = np.concatenate([block.diagonal for block in self._blocks])
        self.beside = np.concatenate([np.append(block.beside, 0.0) for block in self._blocks])[:-1]
        self.vector = np.concatenate([block.vector for block in self._blocks])
        self._spectrum = None

    def _turned(self, vector, how: str) -> np.ndarray:
        parts = np.split(np.ravel(vector), len(self._blocks))
        return np.concatenate([block._turned(part, how) for block, part in zip(self._blocks, parts, strict=True)])
