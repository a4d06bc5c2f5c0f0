# SPDX-License-Identifier: GPL-3.0-or-later
"""Basis images made ready for any number of photographs: their Gram matrix, block sums, and the prior's factor.

The unknowns are scaled, x[m, c] = deviation[m] z[m, c], and channels are brought to unit response, so that the prior of
z is almost white; what is left of it is `fit.whitening`'s.
"""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

import numpy as np
from scipy import sparse

from btfsep_engine.errors import InputError
from btfsep_engine.fit.linear_algebra import one_thread
from btfsep_engine.fit.whitening import whitening

CHANNELS = ("red", "green", "blue")
FEWEST_BLOCKS = 12  # from which on misfit that pixels share is told from misfit of their own
CHUNK = 1 << 14  # pixels converted at once: the basis images of a large photo are never copied whole
STRIP = 500  # pixels whose rows stay in the cache while they are multiplied


@dataclass(frozen=True)
class Measured:
    """The products of one photograph, b at unit response, with the basis images.

    Attributes
    ----------
    level : the light's mean radiance over sqrt(4 pi) of a first fit by even light
    energies : (3, 3), b^T b; moments : (3, terms, 3), A_c^T b_d; sums : (blocks, 3), of b
    weighted : {c: (energies, moments)} with N^-1 of the block correlation c between the factors, those that were asked
    """

    level: float
    energies: np.ndarray
    moments: np.ndarray
    sums: np.ndarray
    weighted: dict = field(default_factory=dict, compare=False, repr=False)


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
        self.prior, self.whitening = prior, whitening(prior)
        self.response = np.sqrt(np.einsum("pc,pc->c", basis[:, 0], basis[:, 0], dtype=np.float64) / self.pixels)
        for c, value in enumerate(self.response):
            if not value > 0:
                raise InputError(
                    "the fit",
                    f"the material reflects nothing towards the camera in the {CHANNELS[c]} channel",
                    "choose another material",
                )
        self.basis = basis
        self.scale = (prior.deviation / self.response[:, None]).ravel()
        by_block = np.argsort(blocks, kind="stable")
        labels = np.asarray(blocks)[by_block]
        place = np.flatnonzero(np.concatenate([[True], labels[1:] != labels[:-1], [True]]))
        self.block_sizes = np.diff(place)
        self.gather = sparse.csr_matrix((np.ones(self.pixels), by_block, place), shape=(len(place) - 1, self.pixels))
        self.gram, self.sums = self._gram_and_sums(by_block)
        self._by_correlation = {}

    def _gram_and_sums(self, by_block):
        """A^T A, (3 terms, 3 terms), and the blocks' sums, (blocks, 3 terms), of the scaled A.

        Each of two threads has half of the pixels, in strips that stay in its cache and are always in the same memory:
        pages that are new take as long as the numbers in them. ``by_block``: the pixels' numbers, block by block.
        """
        labels = np.repeat(np.arange(len(self.block_sizes)), self.block_sizes)
        columns = 3 * self.terms

        def products(first: int, last: int):
            strip, gram = np.empty((STRIP, 3, self.terms)), np.zeros((columns, columns))
            sums = np.zeros((len(self.block_sizes), columns))
            for i in range(first, last, STRIP):
                j = min(i + STRIP, last)
                rows = self._scaled(by_block[i:j], strip[: j - i])
                gram += rows.T @ rows
                starts = np.flatnonzero(np.diff(labels[i:j], prepend=-1))
                sums[labels[i:j][starts]] += np.add.reduceat(rows, starts)
            return gram, sums

        with one_thread(), ThreadPoolExecutor(1) as other:
            second = other.submit(products, self.pixels // 2, self.pixels)
            gram, sums = products(0, self.pixels // 2)
            return gram + second.result()[0], sums + second.result()[1]

    def _parts(self):
        return [slice(i, min(i + CHUNK, self.pixels)) for i in range(0, self.pixels, CHUNK)]

    def _scaled(self, which, out) -> np.ndarray:
        """Rows of the scaled A into ``out`` (n, 3, terms), which is given back as (n, 3 terms).

        Channel by channel, because that is how the transport leaves them in memory.
        """
        for c in range(3):
            np.multiply(self.basis[:, :, c][which], self.scale[c * self.terms : (c + 1) * self.terms], out=out[:, c])
        return out.reshape(len(out), -1)

    def rows(self, part: slice) -> np.ndarray:
        """Rows of the scaled A, channel by channel: (pixels of the part, 3 terms) float64."""
        return self._scaled(part, np.empty((len(range(self.pixels)[part]), 3, self.terms)))

    def all_rows(self) -> np.ndarray:
        """All rows of the scaled A, channel by channel: (p, 3 terms) float64."""
        return np.concatenate([self.rows(part) for part in self._parts()])

    def gram_of(self, c: float) -> np.ndarray:
        """A_a^T N^-1 A_b for the block correlation c, of the scaled A: (9, terms * terms)."""
        if c not in self._by_correlation:
            weighted = self.sums * np.sqrt(c / (1 + c * self.block_sizes))[:, None]
            gram = self.gram - weighted.T @ weighted  # one matrix with itself: half the work
            blocks = gram.reshape(3, self.terms, 3, self.terms).transpose(0, 2, 1, 3)
            self._by_correlation[c] = np.ascontiguousarray(blocks).reshape(9, -1)
        return self._by_correlation[c]

    def whitened_gram(self, c: float, inverse) -> np.ndarray:
        """F^T A^T N^-1 A F for the block correlation c and R^-1 (3, 3): (3 terms, 3 terms), channel by channel."""
        return self.whitening.gram(self.gram_of(c), inverse)

    def whitened_moments(self, measured: Measured, c: float, inverse) -> np.ndarray:
        """F^T A^T N^-1 b: (3 terms,)."""
        return self.whitening.moments(self._weighted(measured, c)[1], inverse)

    def moments_alone(self, measured: Measured, c: float) -> np.ndarray:
        """The moments as if no channel knew of another, (3, terms): see `grams_alone`."""
        return np.einsum("cmc->cm", self._weighted(measured, c)[1]) * self.whitening.alone

    def grams_alone(self, c: float) -> np.ndarray:
        """F^T A^T N^-1 A F of each channel, were light and noise independent in them: (3, terms, terms)."""
        own, alone = self.gram_of(c)[::4].reshape(3, self.terms, self.terms), self.whitening.alone
        return own * alone * alone[:, None]

    def energy(self, measured: Measured, c: float, inverse) -> float:
        """b^T N^-1 b."""
        return float((self._weighted(measured, c)[0] * inverse).sum())

    def _weighted(self, measured: Measured, c: float) -> tuple[np.ndarray, np.ndarray]:
        """b^T N^-1 b (3, 3) and A^T N^-1 b (3, terms, 3) for the block correlation c, but for R."""
        if c not in measured.weighted:
            sums = measured.sums * (c / (1 + c * self.block_sizes))[:, None]
            less = (sums.T @ self.sums).reshape(3, 3, self.terms).transpose(1, 2, 0)
            measured.weighted[c] = measured.energies - sums.T @ measured.sums, measured.moments - less
        return measured.weighted[c]

    def log_determinant(self, c: float, channels) -> float:
        """log det of the noise's covariance R (x) N."""
        return float(3 * np.log1p(c * self.block_sizes).sum() + self.pixels * np.linalg.slogdet(channels)[1])

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
        moments = np.zeros((3, self.terms, 3))
        for i in range(0, self.pixels, STRIP):
            for c in range(3):
                rows = self.basis[i : i + STRIP, :, c].astype(np.float64)
                moments[c] += rows.T @ b[i : i + STRIP]
        moments *= self.scale.reshape(3, self.terms, 1)
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
        columns = np.zeros((3, self.terms, 3))
        for c in range(3):
            columns[c, :, c] = x[:, c] / self.prior.deviation
        return columns.reshape(3 * self.terms, 3)

    def misfit(self, measured: Measured, x) -> np.ndarray:
        """(b - A x)^T (b - A x), the channels at unit response: (3, 3), of x (terms, 3).

        From the Gram matrix, so that no pixel is looked at; exact to 1e-15 of b^T b.
        """
        columns = self._columns(x)
        cross = np.einsum("mc,cmd->cd", x / self.prior.deviation[:, None], measured.moments)
        out = measured.energies - cross - cross.T + columns.T @ (self.gram @ columns)
        return (out + out.T) / 2  # of an exact photo only rounding is left over, which has no symmetry

    def shared_misfit(self, measured: Measured, x, misfit=None) -> float:
        """What of the misfit b - A x the pixels of a block share, root mean square over the photo's.

        ``misfit`` is `misfit` of the same, where it is known already.

        The variance between blocks that a one-way analysis of variance finds: the spread of the blocks' means, less
        what independent misfits of their pixels give them. All of the misfit where fewer than `FEWEST_BLOCKS` blocks,
        or blocks of one pixel each, cannot say.
        """
        misfit = self.misfit(measured, x) if misfit is None else misfit
        found = self._between_blocks(measured, x, misfit)
        shared = np.maximum(np.diag(misfit), 0) if found is None else found[0]
        unit = self.response**2
        return float(np.sqrt(shared @ unit / max(np.diag(measured.energies) @ unit, 1e-300)))

    def block_correlation(self, measured: Measured, x, misfit) -> float | None:
        """The variance that a block's pixels share of the misfit over a pixel's own; None where blocks cannot say."""
        found = self._between_blocks(measured, x, misfit)
        if found is None:
            return None
        shared, alone = found
        return float(shared.sum() / max(self.pixels * alone.sum(), 1e-300))

    def _between_blocks(self, measured: Measured, x, misfit):
        """One-way analysis of variance: sums of squares that blocks share (3,), and a pixel's own variance (3,)."""
        blocks = len(self.block_sizes)
        if blocks < FEWEST_BLOCKS or self.pixels <= blocks:
            return None
        means = measured.sums - self.sums @ self._columns(x)
        between = (np.square(means) / self.block_sizes[:, None]).sum(0)
        alone = np.maximum(np.diag(misfit) - between, 0) / (self.pixels - blocks)
        return np.maximum(between - blocks * alone, 0), alone

    def singular_values(self, terms: int) -> np.ndarray:
        """Of A's first ``terms`` columns, descending, of the channel with the worst condition: (terms,)."""
        unit, gram = 1 / self.prior.deviation[:terms], self.gram.reshape(3, self.terms, 3, self.terms)
        each = [np.linalg.eigvalsh(gram[c, :terms, c, :terms] * unit * unit[:, None])[::-1] for c in range(3)]
        worst = min(range(3), key=lambda c: each[c][-1] / each[c][0])
        return np.sqrt(np.maximum(each[worst], 0)) * self.response[worst]
