# SPDX-License-Identifier: GPL-3.0-or-later
"""The factor F of the prior's covariance, P = F F^T: white numbers to coefficients, and Gram matrices the other way.

The unknowns are scaled, x[m, c] = deviation[m] z[m, c]. The prior of z is then C (x) I, except for the terms that have
a mean (the level): `special`. Its factor acts on the three channels of a term alone, so that whitening a Gram matrix
is a product of 9 x 9 by 9 x terms^2 numbers and not one of full matrices:

    F^T (R^-1 o G) F = sum over c, d of L[c, a] L[d, b] (R^-1)[c, d] G[c, d],    C = L L^T.
"""

from functools import lru_cache

import numpy as np

from btfsep_engine.fit.linear_algebra import triangular_inverse


class Whitening:
    """F of a light.natural.NaturalPrior."""

    def __init__(self, prior):
        self.terms, self.deviation = len(prior.mean), prior.deviation
        channels = np.full((3, 3), prior.correlation) + (1 - prior.correlation) * np.eye(3)
        self.mix = np.linalg.cholesky(channels)
        self._mixes = np.kron(self.mix.T, self.mix.T)  # row (a, b), column (c, d): mix[c, a] mix[d, b]
        variance = np.diag(prior.covariance())[: self.terms]
        self.alone = np.sqrt(variance) / self.deviation  # of the scaled unknowns, a channel for itself
        special = np.flatnonzero((prior.mean != 0) | (np.arange(self.terms) == 0))
        count = len(special)
        # x of the special terms = plain factor times y; y = `turn` times white numbers
        scaled = prior.covariance().reshape(3, self.terms, 3, self.terms)
        scaled = scaled[:, special][:, :, :, special]
        scaled = scaled / self.deviation[special][:, None, None] / self.deviation[special]
        back = np.linalg.inv(self.mix)
        plain = np.einsum("ac,cidj,bd->aibj", back, scaled, back).reshape(3 * count, 3 * count)
        self._turn = np.linalg.cholesky(plain)
        self._special = (np.arange(3)[:, None] * self.terms + special).ravel()

    def gram(self, gram, inverse) -> np.ndarray:
        """F^T A^T N^-1 A F, (3 terms, 3 terms), channel by channel; the transposed is contiguous.

        Parameters
        ----------
        gram : (9, terms * terms), a channel of the scaled A with a channel: `Factorised.gram_of`
        inverse : (3, 3), R^-1
        """
        out = ((self._mixes * inverse.ravel()) @ gram).reshape(3, 3, self.terms, self.terms)
        out = out.transpose(0, 2, 1, 3).reshape(3 * self.terms, 3 * self.terms)
        rows = self._special
        out[rows] = self._turn.T @ out[rows]
        out[:, rows] = out[:, rows] @ self._turn
        return out.T  # symmetric: the same matrix, in the order of columns that LAPACK overwrites

    def moments(self, moments, inverse) -> np.ndarray:
        """F^T A^T N^-1 b, (3 terms,), of ``moments`` (3, terms, 3), A_c^T b_d of the scaled A, and R^-1 (3, 3)."""
        out = (self.mix.T @ (moments * inverse[:, None]).sum(-1)).ravel()
        out[self._special] = self._turn.T @ out[self._special]
        return out

    def coefficients(self, white) -> np.ndarray:
        """x = F white: (terms, 3, …) from (3 terms, …) white numbers, channel by channel."""
        white = np.array(white, np.float64)
        white[self._special] = self._turn @ white[self._special]
        mixed = np.tensordot(self.mix, white.reshape(3, self.terms, -1), 1)  # (3, terms, …)
        out = mixed.transpose(1, 0, 2) * self.deviation[:, None, None]
        return out.reshape(self.terms, 3, *white.shape[1:])

    def root(self, factor) -> tuple[np.ndarray, float]:
        """F K^-T of the lower Cholesky factor K (3 terms, 3 terms), and the trace of (K K^T)^-1.

        Returns
        -------
        (3, terms, 3 terms), whose square, R R^T, is F (K K^T)^-1 F^T; float
        """
        white = np.ascontiguousarray(triangular_inverse(factor).T)
        trace = float(np.vdot(white, white))
        white[self._special] = self._turn @ white[self._special]
        mixed = (self.mix @ white.reshape(3, -1)).reshape(3, self.terms, -1)
        mixed *= self.deviation[:, None]
        return mixed, trace


@lru_cache(maxsize=10)
def whitening(prior) -> Whitening:
    """The `Whitening` of a prior, kept: it takes a tenth of the time of a fit."""
    return Whitening(prior)
