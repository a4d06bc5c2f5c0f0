# SPDX-License-Identifier: GPL-3.0-or-later
"""The light that is most probable: least squares (eq. 11) beside a prior of natural light, many orders at once.

Cutting the series off at a low order is not safe: real light has all orders, and those that the fit leaves out leak
into those that it keeps. So the fit has all orders up to 9, and a prior decides what the photo does not.

Model, with all channels in one vector x of 3 (L + 1)^2 numbers and s the light's level:

    x ~ N(0, t P)                            P: `light.natural.NaturalPrior.covariance`
    b = A x + n,  n ~ N(0, v R (x) N_b)      one N_b = I + c 1 1^T for each block of neighbouring pixels
    log(sqrt(t) / s) ~ N(0, spread^2)        natural light's scale, from the training lights

R (3 x 3) is how misfit goes together in the channels, found from the residuals of a first fit. By Sherman and
Morrison, N_b^-1 = I - c / (1 + c n_b) 1 1^T: the weighted Gram matrix is the plain one less outer products of the
blocks' sums. With P = F F^T, F^T A^T N^-1 A F = U diag(d) U^T, h = U^T F^T A^T N^-1 b and q = t / v,

    x = F U (q h / (1 + q d)),    cov x = v F U diag(q / (1 + q d)) U^T F^T,
    v = (b^T N^-1 b - sum q h^2 / (1 + q d)) / n,
    -2 log evidence = sum log(1 + q d) + n log v + log det N + (log(sqrt(q v) / s) / spread)^2,

so for each c one eigen-decomposition serves every q, and v is closed form: the search is a grid over c and a
one-dimensional search over q. The effective degrees of freedom are tr((G + P^-1)^-1 G) = sum q d / (1 + q d).

Misfit by a wrong material or shape is also correlated from block to block, and many orders of light can explain it
away, so that residuals do not show it. Two measures against that. Evidence counts less than its number: the
likelihood is taken to the power 1 / `COARSENING` (Miller and Dunson 2019, "coarsened" posteriors). And the spread has
a second part, the residual's relative size times the coefficients' size in each row: a model that misses the
image by a tenth is not trusted to know its response to any coefficient better than to a tenth. Both were chosen on
photographs by Cycles with two of four lights; the figures stated in docs/method.md are of the other two.
"""

from dataclasses import dataclass

import numpy as np

from btfsep_engine import sh
from btfsep_engine.errors import InputError
from btfsep_engine.fit.least_squares import Fit

COARSENING = 5.0
BLOCK_CORRELATIONS = (0.0, 0.03, 0.1, 0.3)  # c: variance that a block's pixels share over a pixel's own
LOG_RATIOS = np.linspace(-8, 30, 153)  # of q, for A of unit response to the first basis light
LEAST_NOISE = 1e-12  # of the photo's energy: noiseless synthetic photos
CHANNEL_SHRINKAGE = 0.05  # towards channels whose misfits are independent
DETERMINED = 0.25  # of the prior's variance; for the first coefficient, of the level squared
CHUNK = 1 << 14  # pixels


@dataclass(frozen=True)
class Evidence:
    """The sufficient statistics of one photo for one block correlation c and one R."""

    eigenvalues: np.ndarray
    vectors: np.ndarray
    projected: np.ndarray
    energy: float
    log_determinant: float


class Photo:
    """Gram matrices and block sums of a photo and its basis images, channels brought to unit response.

    Parameters
    ----------
    basis, radiance, blocks : as for `least_squares.solve`
    """

    def __init__(self, basis, radiance, blocks):
        self.basis, b = np.asarray(basis), np.asarray(radiance, np.float64)
        self.pixels, self.terms = self.basis.shape[:2]
        if self.pixels == 0:
            raise InputError("the fit", "no usable pixels", "use a wider mask or a shorter exposure")
        first = self.basis[:, 0].astype(np.float64)
        self.response = np.sqrt((first**2).mean(0))
        for c, value in enumerate(self.response):
            if not value > 0:
                raise InputError(
                    "the fit",
                    f"the material reflects nothing towards the camera in the {('red', 'green', 'blue')[c]} channel",
                    "choose another material",
                )
        self.b = b / self.response
        self.level = float((first / self.response * self.b).sum() / (3 * self.pixels))
        if not self.level > 0:
            raise InputError("the fit", "the photo is black where the object is", "use a longer exposure")
        _, labels, self.block_sizes = np.unique(blocks, return_inverse=True, return_counts=True)
        unknowns = 3 * self.terms
        self.energies = self.b.T @ self.b
        self.gram, self.moments = np.zeros((unknowns, unknowns)), np.zeros((unknowns, 3))
        self.sums, self.sums_b = np.zeros((len(self.block_sizes), unknowns)), np.zeros((len(self.block_sizes), 3))
        order = np.argsort(labels.reshape(-1), kind="stable")
        for start in range(0, self.pixels, CHUNK):  # a large photo's basis images are never copied whole
            chosen = order[start : start + CHUNK]
            a, b, mine = self._rows(chosen), self.b[chosen], labels.reshape(-1)[chosen]
            self.gram += a.T @ a
            self.moments += a.T @ b
            starts = np.flatnonzero(np.diff(mine, prepend=-1))
            self.sums[mine[starts]] += np.add.reduceat(a, starts, 0)
            self.sums_b[mine[starts]] += np.add.reduceat(b, starts, 0)
        self.sums = self.sums.T

    def _rows(self, chosen) -> np.ndarray:
        """Rows of A of some pixels, channel by channel: (pixels, 3 terms) float64."""
        a = self.basis[chosen].transpose(0, 2, 1) / self.response[:, None]
        return a.astype(np.float64).reshape(len(a), -1)

    def evidence(self, factor, c: float, channels) -> Evidence:
        """Whitened by the prior's ``factor`` F, for the block correlation c and the channels' misfit R (3, 3)."""
        inverse = np.linalg.inv(channels)
        weight = c / (1 + c * self.block_sizes)
        gram = self.gram - (self.sums * weight) @ self.sums.T
        moments = self.moments - (self.sums * weight) @ self.sums_b
        energies = self.energies - (self.sums_b.T * weight) @ self.sums_b
        each = self.terms
        gram = (gram.reshape(3, each, 3, each) * inverse[:, None, :, None]).reshape(3 * each, 3 * each)
        moments = (moments * np.repeat(inverse, each, 0)).sum(1)
        eigenvalues, vectors = np.linalg.eigh(factor.T @ gram @ factor)
        logarithm = 3 * np.log1p(c * self.block_sizes).sum() + self.pixels * np.linalg.slogdet(channels)[1]
        return Evidence(
            np.maximum(eigenvalues, 0),
            vectors,
            vectors.T @ (factor.T @ moments),
            float((energies * inverse).sum()),
            float(logarithm),
        )

    def residual(self, x) -> np.ndarray:
        """b - A x, channels at unit response: (p, 3)."""
        out = self.b.copy()
        for c in range(3):
            out[:, c] -= self.basis[:, :, c] @ x[:, c] / self.response[c]
        return out

    def singular_values(self, terms: int) -> np.ndarray:
        """Of A's first ``terms`` columns, descending, of the channel with the worst condition: (terms,)."""
        first = [c * self.terms for c in range(3)]
        each = [np.linalg.eigvalsh(self.gram[i : i + terms, i : i + terms])[::-1] for i in first]
        worst = min(range(3), key=lambda c: each[c][-1] / each[c][0])
        return np.sqrt(np.maximum(each[worst], 0)) * self.response[worst]


def _search(photo: Photo, evidence: Evidence, spread: float, coarsening: float):
    """The best ratio q of prior to noise: (log evidence, q, v)."""
    n = 3 * photo.pixels

    def at(logs):
        q = np.exp(logs)[:, None] / coarsening
        growth = 1 + q * evidence.eigenvalues
        left = evidence.energy - (q * evidence.projected**2 / growth).sum(1)
        v = np.maximum(left, LEAST_NOISE * evidence.energy) / n
        scale = 0.5 * (logs + np.log(v)) - np.log(photo.level)
        value = np.log(growth).sum(1) + (n * np.log(v) + evidence.log_determinant) / coarsening + (scale / spread) ** 2
        return -0.5 * value, v

    logs = LOG_RATIOS
    for _ in range(3):
        values, v = at(logs)
        best = int(values.argmax())
        found = values[best], float(np.exp(logs[best])), float(v[best])
        step = logs[1] - logs[0]
        logs = logs[best] + np.linspace(-step, step, 21)
    return found


def posterior(evidence: Evidence, factor, q: float, v: float, coarsening: float = 1.0):
    """Mean (terms, 3), standard deviation (terms, 3) and effective degrees of freedom (all channels together)."""
    growth = 1 + q / coarsening * evidence.eigenvalues
    turned = factor @ evidence.vectors
    x = turned @ (q / coarsening * evidence.projected / growth)
    variance = v * q * (turned**2 / growth).sum(1)
    freedom = float((1 - 1 / growth).sum())
    return x.reshape(3, -1).T, np.sqrt(variance).reshape(3, -1).T, freedom


def solve_map(basis, radiance, *, blocks, prior, order: int, coarsening: float = COARSENING) -> Fit:
    """The maximum of the posterior, with its spread.

    Parameters
    ----------
    basis : (p, terms, 3) float, A, at the prior's order
    radiance : (p, 3) float, b: the photograph's, linear
    blocks : (p,) int, block number of each pixel (`least_squares.block_labels`)
    prior : light.natural.NaturalPrior
    order : the order that is reported, at most the prior's; it does not change the numbers
    coarsening : 1 where the noise model is exactly true

    Returns
    -------
    Fit, of the reported order; `effective_degrees_of_freedom`, `condition` and `residual` are of all orders of the fit

    Raises
    ------
    InputError
        Without pixels, without light in the photo, or where the material reflects nothing.
    """
    photo = Photo(basis, radiance, blocks)
    if photo.terms != len(prior.mean):
        raise ValueError(f"{photo.terms} basis lights for a prior of {len(prior.mean)} terms")
    values, vectors = np.linalg.eigh(prior.covariance())
    factor = vectors * np.sqrt(np.maximum(values, 0))
    channels = np.eye(3)
    for correlations in ((BLOCK_CORRELATIONS[2],), BLOCK_CORRELATIONS):
        best = None
        for c in correlations:
            evidence = photo.evidence(factor, c, channels)
            found = _search(photo, evidence, prior.log_scale_spread, coarsening)
            if best is None or found[0] > best[0][0]:
                best = found, c, evidence
        (_, q, v), correlation, evidence = best
        x, stddev, freedom = posterior(evidence, factor, q, v, coarsening)
        left = photo.residual(x)
        channels = _channels(left, photo.b)
    terms = sh.term_count(order)
    left, radiance = left * photo.response, photo.b * photo.response
    residual = float(np.linalg.norm(left) / np.linalg.norm(radiance))
    size = np.sqrt((x**2).mean(1, keepdims=True))
    stddev = np.sqrt(stddev**2 + (min(residual, 1.0) * size) ** 2)
    scale = float(np.sqrt(q * v))
    varies = scale * prior.deviation
    varies[0] = photo.level
    singular = photo.singular_values(terms)
    return Fit(
        x[:terms],
        stddev[:terms],
        residual,
        np.linalg.norm(left, axis=0) / np.maximum(np.linalg.norm(radiance, axis=0), 1e-300),
        float(singular[0] / max(singular[-1], singular[0] * 1e-15)),
        singular,
        photo.pixels,
        all_coefficients=x,
        effective_degrees_of_freedom=freedom / 3,
        noise=float(np.sqrt(v / (photo.b**2).mean())),
        block_correlation=correlation,
        prior_scale=scale / photo.level,
        determined=((stddev**2).mean(1) < DETERMINED * varies**2)[:terms],
    )


def _channels(left, b) -> np.ndarray:
    """How misfit goes together in the channels: (3, 3), mean of the diagonal 1, never singular."""
    covariance = left.T @ left / len(left)
    floor = LEAST_NOISE * (b**2).mean()
    covariance += floor * np.eye(3)
    covariance *= 3 / np.trace(covariance)
    shrunk = (1 - CHANNEL_SHRINKAGE) * covariance + CHANNEL_SHRINKAGE * np.diag(np.diag(covariance))
    return shrunk + 1e-3 * np.eye(3)
