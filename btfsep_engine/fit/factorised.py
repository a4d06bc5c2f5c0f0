# SPDX-License-Identifier: GPL-3.0-or-later
"""Basis images made ready for any number of photographs: their Gram matrix, block sums, and the prior's factor.

The unknowns are scaled, x[m, c] = deviation[m] z[m, c], and channels are brought to unit response. The prior of z is
then C (x) I, except for the terms that have a mean (the level): `special`. Its factor acts on the three channels of a
term alone, so that whitening a Gram matrix is a product of 9 x 9 by 9 x terms^2 numbers and not one of full matrices:

    F^T (R^-1 o G) F = sum over c, d of L[c, a] L[d, b] (R^-1)[c, d] G[c, d],    C = L L^T.
"""

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.linalg import lapack

from btfsep_engine.errors import InputError

CHANNELS = ("red", "green", "blue")
FEWEST_BLOCKS = 12  # from which on misfit that pixels share is told from misfit of their own
CHUNK = 1 << 14  # pixels converted at once: the basis images of a large photo are never copied whole
STRIP = 500  # pixels whose rows stay in the cache while a photograph is multiplied with them


@dataclass(frozen=True)
class Measured:
    """The products of one photograph, b at unit response, with the basis images.

    Attributes
    ----------
    level : the light's mean radiance over sqrt(4 pi) of a first fit by even light
    energies : (3, 3), b^T b; moments : (3, terms, 3), A_c^T b_d; sums : (blocks, 3), of b
    """

    level: float
    energies: np.ndarray
    moments: np.ndarray
    sums: np.ndarray


class Factorised:
    """A and the blocks of its pixels.

    Parameters
    ----------
    basis : (p, terms, 3) float, A: radiance of each pixel under each basis light
    blocks : (p,) int, block number of each pixel (`least_squares.block_labels`)
    prior : light.natural.NaturalPrior of as many terms

    Raises
    ------
    InputError
        Without pixels, or where the material reflects nothing.
    """

    def __init__(self, basis, blocks, prior):
        basis = np.asarray(basis)
        self.pixels, self.terms = basis.shape[:2]
        if self.terms != len(prior.mean):
            raise ValueError(f"{self.terms} basis lights for a prior of {len(prior.mean)} terms")
        if self.pixels == 0:
            raise InputError("the fit", "no usable pixels", "use a wider mask or a shorter exposure")
        self.prior = prior
        self.response = np.sqrt(np.einsum("pc,pc->c", basis[:, 0], basis[:, 0], dtype=np.float64) / self.pixels)
        for c, value in enumerate(self.response):
            if not value > 0:
                raise InputError(
                    "the fit",
                    f"the material reflects nothing towards the camera in the {CHANNELS[c]} channel",
                    "choose another material",
                )
        self.flat = np.ascontiguousarray(basis).reshape(self.pixels, 3 * self.terms)  # term by term
        self.scale = (prior.deviation[:, None] / self.response).ravel()
        self._rows = self.flat * self.scale if self.pixels <= CHUNK else None
        _, labels, self.block_sizes = np.unique(blocks, return_inverse=True, return_counts=True)
        self.gather = sparse.csr_matrix(
            (np.ones(self.pixels), (labels.reshape(-1), np.arange(self.pixels))),
            shape=(len(self.block_sizes), self.pixels),
        )
        gram = 0
        self.sums = 0
        for part in self._parts():
            rows = self.rows(part)
            gram = gram + rows.T @ rows
            self.sums = self.sums + self.gather[:, part] @ rows
        self.gram = gram
        self._by_correlation = {}
        self._set_prior()

    def _parts(self):
        return [slice(i, min(i + CHUNK, self.pixels)) for i in range(0, self.pixels, CHUNK)]

    def rows(self, part: slice) -> np.ndarray:
        """Rows of the scaled A, term by term: (pixels of the part, 3 terms) float64."""
        return self._rows[part] if self._rows is not None else self.flat[part] * self.scale

    def all_rows(self) -> np.ndarray:
        """All rows of the scaled A, term by term: (p, 3 terms) float64."""
        return np.concatenate([self.rows(part) for part in self._parts()])

    def _set_prior(self):
        prior = self.prior
        channels = np.full((3, 3), prior.correlation) + (1 - prior.correlation) * np.eye(3)
        self.mix = np.linalg.cholesky(channels)
        self.special = np.flatnonzero((prior.mean != 0) | (np.arange(self.terms) == 0))
        count = len(self.special)
        # x of the special terms = plain factor times y; y = `turn` times white numbers
        scaled = prior.covariance().reshape(3, self.terms, 3, self.terms)
        scaled = scaled[:, self.special][:, :, :, self.special]
        deviation = prior.deviation[self.special]
        scaled = scaled / deviation[:, None, None] / deviation
        back = np.linalg.inv(self.mix)
        plain = np.einsum("ac,cidj,bd->aibj", back, scaled, back).reshape(3 * count, 3 * count)
        self.turn = np.linalg.cholesky(plain)
        self.special_rows = (np.arange(3)[:, None] * self.terms + self.special).ravel()

    def gram_of(self, c: float) -> np.ndarray:
        """A_a^T N^-1 A_b for the block correlation c, of the scaled A: (9, terms * terms)."""
        if c not in self._by_correlation:
            gram = self.gram
            if c > 0:
                weighted = self.sums * np.sqrt(c / (1 + c * self.block_sizes))[:, None]
                gram = gram - weighted.T @ weighted  # one matrix with itself: half the work
            blocks = gram.reshape(self.terms, 3, self.terms, 3).transpose(1, 3, 0, 2)
            self._by_correlation[c] = np.ascontiguousarray(blocks).reshape(9, -1)
        return self._by_correlation[c]

    def whitened_gram(self, c: float, inverse) -> np.ndarray:
        """F^T A^T N^-1 A F for the block correlation c and R^-1 (3, 3): (3 terms, 3 terms), channel by channel."""
        weights = np.einsum("ca,db,cd->abcd", self.mix, self.mix, inverse).reshape(9, 9)
        out = (weights @ self.gram_of(c)).reshape(3, 3, self.terms, self.terms)
        out = out.transpose(0, 2, 1, 3).reshape(3 * self.terms, 3 * self.terms)
        rows = self.special_rows
        out[rows] = self.turn.T @ out[rows]
        out[:, rows] = out[:, rows] @ self.turn
        return out.T  # symmetric: the same matrix, in the order of columns that LAPACK overwrites

    def whitened_moments(self, measured: Measured, c: float, inverse) -> np.ndarray:
        """F^T A^T N^-1 b: (3 terms,)."""
        moments = measured.moments
        if c > 0:
            weight = c / (1 + c * self.block_sizes)
            less = ((measured.sums.T * weight) @ self.sums).reshape(3, self.terms, 3)
            moments = moments - less.transpose(2, 1, 0)
        out = np.einsum("ca,cd,cmd->am", self.mix, inverse, moments).ravel()
        out[self.special_rows] = self.turn.T @ out[self.special_rows]
        return out

    def energy(self, measured: Measured, c: float, inverse) -> float:
        """b^T N^-1 b."""
        weight = c / (1 + c * self.block_sizes)
        return float(((measured.energies - (measured.sums.T * weight) @ measured.sums) * inverse).sum())

    def log_determinant(self, c: float, channels) -> float:
        """log det of the noise's covariance R (x) N."""
        return float(3 * np.log1p(c * self.block_sizes).sum() + self.pixels * np.linalg.slogdet(channels)[1])

    def coefficients(self, white) -> np.ndarray:
        """x = F white: (terms, 3, …) from (3 terms, …) white numbers, channel by channel."""
        white = np.array(white, np.float64)
        white[self.special_rows] = self.turn @ white[self.special_rows]
        mixed = np.tensordot(self.mix, white.reshape(3, self.terms, -1), 1)  # (3, terms, …)
        out = mixed.transpose(1, 0, 2) * self.prior.deviation[:, None, None]
        return out.reshape(self.terms, 3, *white.shape[1:])

    def root(self, factor) -> tuple[np.ndarray, float]:
        """F K^-T of the lower Cholesky factor K (3 terms, 3 terms), and the trace of (K K^T)^-1.

        Returns
        -------
        (3, terms, 3 terms), whose square, R R^T, is F (K K^T)^-1 F^T; float
        """
        white = np.ascontiguousarray(lapack.dtrtri(factor, lower=1)[0].T)
        trace = float(np.vdot(white, white))
        white[self.special_rows] = self.turn @ white[self.special_rows]
        mixed = (self.mix @ white.reshape(3, -1)).reshape(3, self.terms, -1)
        mixed *= self.prior.deviation[:, None]
        return mixed, trace

    @staticmethod
    def variances(root) -> np.ndarray:
        """The diagonal of ``root``'s square as (terms, 3)."""
        return np.einsum("ctr,ctr->tc", root, root)

    @staticmethod
    def covariance(root, terms: int) -> np.ndarray:
        """The square of ``root``'s first ``terms``, rows and columns term by term: (3 terms, 3 terms)."""
        few = root[:, :terms].transpose(1, 0, 2).reshape(3 * terms, -1)
        return few @ few.T

    def products(self, b) -> Measured:
        """The products of b (p, 3), at unit response, with the basis images."""
        moments = np.zeros((3, 3 * self.terms))
        for i in range(0, self.pixels, STRIP):
            moments += b[i : i + STRIP].T @ self.rows(slice(i, i + STRIP))
        moments = moments.reshape(3, self.terms, 3).transpose(2, 1, 0)
        level = float(np.trace(moments[:, 0]) / self.prior.deviation[0] / (3 * self.pixels))
        return Measured(level, b.T @ b, moments, self.gather @ b)

    def measure(self, radiance) -> Measured:
        """The products of a photograph's pixels (p, 3) with the basis images.

        Raises
        ------
        InputError
            When the photo is black there.
        """
        measured = self.products(np.asarray(radiance, np.float64) / self.response)
        if not measured.level > 0:
            raise InputError("the fit", "the photo is black where the object is", "use a longer exposure")
        return measured

    def predicted(self, x) -> np.ndarray:
        """A x: (p, 3), of coefficients (terms, 3)."""
        columns = self._columns(x)
        return np.concatenate([self.rows(part) @ columns for part in self._parts()]) * self.response

    def _columns(self, x) -> np.ndarray:
        """Coefficients (terms, 3) as what the scaled A's rows are multiplied with: (3 terms, 3)."""
        columns = np.zeros((self.terms, 3, 3))
        columns[:, np.arange(3), np.arange(3)] = x / self.prior.deviation[:, None]
        return columns.reshape(3 * self.terms, 3)

    def misfit(self, measured: Measured, x) -> np.ndarray:
        """(b - A x)^T (b - A x), the channels at unit response: (3, 3), of x (terms, 3).

        From the Gram matrix, so that no pixel is looked at; exact to 1e-15 of b^T b.
        """
        columns = self._columns(x)
        cross = np.einsum("mc,cmd->cd", x / self.prior.deviation[:, None], measured.moments)
        out = measured.energies - cross - cross.T + columns.T @ (self.gram @ columns)
        return (out + out.T) / 2  # of an exact photo only rounding is left over, which has no symmetry

    def shared_misfit(self, measured: Measured, x) -> float:
        """What of the misfit b - A x the pixels of a block share, root mean square over the photo's.

        The variance between blocks that a one-way analysis of variance finds: the spread of the blocks' means, less
        what independent misfits of their pixels give them. All of the misfit where fewer than `FEWEST_BLOCKS` blocks,
        or blocks of one pixel each, cannot say.
        """
        left, blocks = np.maximum(np.diag(self.misfit(measured, x)), 0), len(self.block_sizes)
        shared = left
        if blocks >= FEWEST_BLOCKS and self.pixels > blocks:
            means = measured.sums - self.sums @ self._columns(x)
            between = (np.square(means) / self.block_sizes[:, None]).sum(0)
            alone = np.maximum(left - between, 0) / (self.pixels - blocks)
            shared = np.maximum(between - blocks * alone, 0)
        unit = self.response**2
        return float(np.sqrt(shared @ unit / max(np.diag(measured.energies) @ unit, 1e-300)))

    def singular_values(self, terms: int) -> np.ndarray:
        """Of A's first ``terms`` columns, descending, of the channel with the worst condition: (terms,)."""
        unit, gram = 1 / self.prior.deviation[:terms], self.gram.reshape(self.terms, 3, self.terms, 3)
        each = [np.linalg.eigvalsh(gram[:terms, c, :terms, c] * unit * unit[:, None])[::-1] for c in range(3)]
        worst = min(range(3), key=lambda c: each[c][-1] / each[c][0])
        return np.sqrt(np.maximum(each[worst], 0)) * self.response[worst]
