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

so for a given c one tridiagonal reduction (`fit.tridiagonal`) serves every q, and v is closed form: the search is
one-dimensional, over q. c is what a one-way analysis of variance finds in the residuals of the first fit (the evidence
for each of a few c chooses no better, and takes a third of the time). The effective degrees of freedom are
tr((G + P^-1)^-1 G) = sum q d / (1 + q d). What depends on A alone is kept (`fit.factorised`).

Misfit by a wrong material or shape is also correlated from block to block, and many orders of light can explain it
away, so that residuals do not show it. Two measures against that. Evidence counts less than its number: the
likelihood of n pixels is taken to the power 1 / (1 + n / `EVIDENCE`), so that it never counts as more than that many
(Miller and Dunson 2019, "coarsened" posteriors: a model that is nearly right). And the spread has a second part, the
misfit that neighbouring pixels share: its relative size times the coefficients' size in each row. A model that misses
blocks of the image by a tenth is not trusted to know its response to any coefficient better than to a tenth; what
pixels miss each for itself (texture that the mean ABRDF does not have) is noise, which the posterior has already. A
third part is `REFLECTANCE_SPREAD`, one factor on all: a piece of a material is lighter or darker than the one that was
measured. All were chosen on photographs by Cycles under four lights; docs/fit.md has the figures under three others,
too.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import lapack
from scipy.optimize import minimize_scalar

from btfsep_engine import sh
from btfsep_engine.fit.factorised import Factorised, Measured
from btfsep_engine.fit.least_squares import Fit
from btfsep_engine.fit.linear_algebra import one_thread
from btfsep_engine.fit.positive import positive_light
from btfsep_engine.fit.tridiagonal import PRECISE, Tridiagonal, TridiagonalBlocks

EVIDENCE = 1000  # pixels: alpha of a coarsened posterior
BLOCK_CORRELATIONS = (0.01, 0.03, 0.1, 0.3)  # c: a Gram matrix for each is kept; finer steps change no estimate
FIRST_CORRELATION = 0.1  # c of the first fit, whose residuals show how channels and blocks go together
LOG_RATIOS = (-8.0, 30.0)  # of q, for A of unit response to the first basis light
STEP = 2.0  # of the grid over log q: the evidence is wider than that
FINE = 1e-4  # of log q: so closely its best is found
PAST = 30.0  # of the logarithm of the evidence: so far below the top, no larger q is tried
NEAR = 3.0  # how far from the first fit's log q the others are looked for first
LEAST_NOISE = 1e-12  # of the photo's energy: noiseless synthetic photos
CHANNEL_SHRINKAGE = 0.05  # towards channels whose misfits are independent
REFLECTANCE_SPREAD = 0.1  # of all coefficients together: a material's reflectance differs from piece to piece
DETERMINED = 0.25  # of the prior's variance; for the first coefficient, of the level squared
EXPECTED_ORDER = 2  # up to here the joint covariance is kept


@dataclass(frozen=True)
class Found:
    """What the evidence chooses: prior over noise q, noise v, the blocks' correlation c, and R (3, 3)."""

    evidence: float
    q: float
    v: float
    correlation: float
    channels: np.ndarray


class LightSolver:
    """Basis images factorised once, solved for any number of photographs of them.

    Parameters
    ----------
    basis : (p, terms, 3) float, A, at the prior's order
    blocks : (p,) int, block number of each pixel (`least_squares.block_labels`)
    prior : light.natural.NaturalPrior
    order : the order that is reported, at most the prior's; it does not change the numbers
    positive : whether the light is the most probable of those that are nowhere too dark (`fit.positive`)
    coarsening : 1 over the likelihood's power, 1 where the noise model is exactly true; None: by the number of pixels
        (`coarsening_of`)

    Raises
    ------
    InputError
        Without pixels, or where the material reflects nothing.
    """

    def __init__(self, basis, *, blocks, prior, order: int, positive: bool = False, coarsening: float | None = None):
        self.factorised = Factorised(basis, blocks, prior)
        self.prior, self.order, self.positive = prior, order, positive
        self.coarsening = coarsening_of(self.factorised.pixels) if coarsening is None else coarsening
        self._first = None
        self._singular = self.factorised.singular_values(sh.term_count(order))

    def solve(self, radiance) -> Fit:
        """The most probable light for the photograph ``radiance : (p, 3)``, linear.

        Returns
        -------
        Fit, of the reported order; `effective_degrees_of_freedom` and `residual` are of all orders of the fit

        Raises
        ------
        InputError
            Without light in the photo.
        """
        with one_thread():
            measured = self.factorised.measure(radiance)
            near, x = self._first_fit(measured)
            misfit = self.factorised.misfit(measured, x)
            channels = misfit_channels(misfit, measured.energies)
            shared = self.factorised.block_correlation(measured, x, misfit)
            c = FIRST_CORRELATION if shared is None else nearest(shared, BLOCK_CORRELATIONS)
            return self.fit(measured, self._search(measured, c, channels, near))

    def _system(self, measured: Measured | None, c: float, channels, q: float):
        """The lower Cholesky factor of I + q M, and F^T A^T N^-1 b."""
        inverse = np.linalg.inv(channels)
        matrix = self.factorised.whitened_gram(c, inverse)
        matrix *= q / self.coarsening
        np.einsum("ii->i", matrix)[:] += 1
        moments = None if measured is None else self.factorised.whitened_moments(measured, c, inverse)
        return cholesky(matrix), moments

    def _value(self, measured: Measured, c: float, channels):
        """(q, log det (I + q M), q h^T (I + q M)^-1 h) -> the logarithm of the evidence, and v."""
        f, n, level = self.factorised, 3 * self.factorised.pixels, math.log(measured.level)
        energy, constant = f.energy(measured, c, np.linalg.inv(channels)), f.log_determinant(c, channels)

        def value(q: float, log_det: float, explained: float):
            v = max(energy - explained, LEAST_NOISE * energy) / n
            scale = (0.5 * math.log(q * v) - level) / self.prior.log_scale_spread
            return -0.5 * (log_det + (n * math.log(v) + constant) / self.coarsening + scale**2), v

        return value

    def _first_fit(self, measured: Measured) -> tuple[float, np.ndarray]:
        """The best log q and the coefficients (terms, 3), light and misfit taken to be independent in the channels.

        Three problems of a third of the size, which are reduced once for all photographs: this fit only serves to find
        how channels and blocks go together, and where the search for q begins.
        """
        f, c = self.factorised, FIRST_CORRELATION
        moments = f.moments_alone(measured, c)
        if self._first is None:
            reduced = self._first = TridiagonalBlocks(f.grams_alone(c), moments)
        else:
            reduced = self._first.with_vector(moments)
        near = self._peak(self._evidence(measured, c, np.eye(3), reduced), *LOG_RATIOS)
        white = reduced.solved(math.exp(near) / self.coarsening).reshape(3, -1)
        return near, (white * f.whitening.alone * self.prior.deviation).T

    def _evidence(self, measured: Measured, c: float, channels, reduced: Tridiagonal):
        """log q -> the logarithm of the evidence, and v."""
        value = self._value(measured, c, channels)

        def at(log_q):
            q = math.exp(log_q)
            return value(q, *reduced.log_det_and_explained(q / self.coarsening))

        return at

    def _search(self, measured: Measured, c: float, channels, near: float) -> Found:
        """The best ratio q of prior to noise for one c and R; ``near`` is a first guess of log q."""
        f, inverse = self.factorised, np.linalg.inv(channels)
        reduced = Tridiagonal(f.whitened_gram(c, inverse), f.whitened_moments(measured, c, inverse))
        at = self._evidence(measured, c, channels, reduced)
        low, high = max(LOG_RATIOS[0], near - NEAR), min(LOG_RATIOS[1], near + NEAR)
        best = self._peak(at, low, high)
        if min(best - low, high - best) < 0.1 * NEAR:
            best = self._peak(at, *LOG_RATIOS)
        evidence, v = at(best)
        return Found(evidence, math.exp(best), v, c, channels)

    @staticmethod
    def _peak(at, low, high) -> float:
        """The log q of the largest evidence: a grid, uphill from low to well past the top, then Brent's method."""
        grid = np.linspace(low, high, int(np.ceil((high - low) / STEP)) + 1)
        values = []
        for x in grid:
            values.append(at(x)[0])
            if values[-1] < max(values) - PAST:
                break
        i = int(np.argmax(values))
        around = grid[max(i - 1, 0)], grid[min(i + 1, len(grid) - 1)]
        found = minimize_scalar(lambda x: -at(x)[0], bounds=around, method="bounded", options={"xatol": FINE})
        return float(found.x)

    def fit(self, measured: Measured, found: Found) -> Fit:
        """The posterior at a given point of the evidence."""
        f, terms = self.factorised, sh.term_count(self.order)
        factor, moments = self._system(measured, found.correlation, found.channels, found.q)
        x = f.whitening.coefficients(lapack.dpotrs(factor, found.q / self.coarsening * moments, lower=1)[0])
        root, unknown = f.whitening.root(factor)
        freedom = 3 * f.terms - unknown
        scale2 = found.v * found.q
        variance = scale2 * f.variances(root)
        few = min(f.terms, sh.term_count(EXPECTED_ORDER))
        covariance = scale2 * f.covariance(root, few)
        energy = np.diag(measured.energies) * f.response**2
        misfit, free, free_residual = f.misfit(measured, x), None, None
        left = np.diag(misfit) * f.response**2
        if self.positive:
            free, free_residual = x[:terms], float(np.sqrt(max(left.sum(), 0) / energy.sum()))
            x = positive_light(x, math.sqrt(scale2) * root.reshape(3 * f.terms, -1))
            misfit = f.misfit(measured, x)
            left = np.diag(misfit) * f.response**2
        residual = float(np.sqrt(max(left.sum(), 0) / energy.sum()))
        shared = f.shared_misfit(measured, x, misfit)
        model = model_variance(x, shared)
        stddev = np.sqrt(variance + model + (REFLECTANCE_SPREAD * x) ** 2)
        covariance += np.diag(np.broadcast_to(model, x.shape)[:few].ravel())
        low = REFLECTANCE_SPREAD * x[:few].ravel()
        covariance += low[:, None] * low
        scale = float(np.sqrt(scale2))
        varies = scale * self.prior.deviation
        varies[0] = measured.level
        share = (variance + model).mean(1) / varies**2
        singular = self._singular
        return Fit(
            x[:terms],
            stddev[:terms],
            residual,
            np.sqrt(np.maximum(left, 0) / np.maximum(energy, 1e-300)),
            float(singular[0] / max(singular[-1], singular[0] * 1e-15)),
            singular,
            f.pixels,
            all_coefficients=x,
            effective_degrees_of_freedom=freedom / 3,
            noise=float(np.sqrt(found.v * 3 * f.pixels / np.trace(measured.energies))),
            block_correlation=found.correlation,
            prior_scale=scale / measured.level,
            determined=(share < DETERMINED)[:terms],
            all_determined=share < DETERMINED,
            covariance=covariance,
            found=found,
            shared_residual=shared,
            free_residual=free_residual,
            free_coefficients=free,
        )

    def left_over(self, found: Found, values) -> np.ndarray:
        """b - A x(b) of any ``values : (p, 3)``, with the smoother that ``found`` makes of the fit: (p, 3).

        The photograph's own where ``values`` is the photograph; for another column, what no light can imitate of it.
        """
        return self.smoother(found)(values)

    def smoother(self, found: Found):
        """`left_over` for many columns: a function of ``values : (p, 3)``, factorised once."""
        f, inverse = self.factorised, np.linalg.inv(found.channels)
        with one_thread():
            factor, _ = self._system(None, found.correlation, found.channels, found.q)

        def left(values):
            b = np.asarray(values, np.float64)
            with one_thread():
                moments = f.whitened_moments(f.products(b / f.response), found.correlation, inverse)
                x = f.whitening.coefficients(lapack.dpotrs(factor, found.q / self.coarsening * moments, lower=1)[0])
                return b - f.predicted(x)

        return left

    def posterior_factor(self, found: Found) -> np.ndarray:
        """R (3 terms, 3 terms), channel by channel, of the posterior's covariance R R^T (of all orders, no model part).

        ``found`` is `Fit.found`.
        """
        factor, _ = self._system(None, found.correlation, found.channels, found.q)
        root, _ = self.factorised.whitening.root(factor)
        return math.sqrt(found.q * found.v) * root.reshape(len(factor), -1)


def coarsening_of(pixels: int) -> float:
    """1 over the power that the likelihood of so many pixels is taken to (Miller and Dunson 2019, section 2.3)."""
    return 1 + pixels / EVIDENCE


def nearest(value: float, grid) -> float:
    """The number of a grid, all above 0, whose ratio to a value is closest to 1."""
    return min(grid, key=lambda each: abs(math.log(each / max(value, 1e-9))))


def solve_map(basis, radiance, *, blocks, prior, order: int, coarsening: float | None = None) -> Fit:
    """One photograph: `LightSolver` and its `solve`."""
    return LightSolver(basis, blocks=blocks, prior=prior, order=order, coarsening=coarsening).solve(radiance)


def reported_up_to(fit: Fit, order: int, solver: LightSolver) -> Fit:
    """The same fit with fewer orders reported."""
    terms = sh.term_count(order)
    singular = solver.factorised.singular_values(terms)
    return replace(
        fit,
        coefficients=fit.coefficients[:terms],
        stddev=fit.stddev[:terms],
        determined=fit.determined[:terms],
        free_coefficients=None if fit.free_coefficients is None else fit.free_coefficients[:terms],
        singular_values=singular,
        condition=float(singular[0] / max(singular[-1], singular[0] * 1e-15)),
    )


def cholesky(matrix) -> np.ndarray:
    """The lower factor of I + q M, n^3 / 3; where rounding could hide the I, M's eigenvalues are cut off at zero."""
    if np.trace(matrix) < PRECISE:
        factor, failed = lapack.dpotrf(matrix, lower=1, clean=1)
        if not failed:
            return factor
    values, vectors = np.linalg.eigh(matrix)
    upper = np.linalg.qr((vectors * np.sqrt(np.maximum(values, 1))).T, mode="r")
    return upper.T * np.where(np.diag(upper) < 0, -1.0, 1.0)


def model_variance(x, missed: float) -> np.ndarray:
    """The variance of coefficients x (terms, 3) by a wrong model, (terms, 1): a part ``missed`` of their size."""
    return (min(missed, 1.0) ** 2) * (x**2).mean(1, keepdims=True)


def misfit_channels(misfit, energies) -> np.ndarray:
    """How misfit goes together in the channels: (3, 3), mean of the diagonal 1, never singular.

    ``misfit`` and ``energies`` (3, 3) are the products of the channels of b - A x and of b, summed over the pixels.
    """
    covariance = misfit + LEAST_NOISE * np.trace(energies) / 3 * np.eye(3)
    covariance *= 3 / np.trace(covariance)
    shrunk = (1 - CHANNEL_SHRINKAGE) * covariance + CHANNEL_SHRINKAGE * np.diag(np.diag(covariance))
    return shrunk + 1e-3 * np.eye(3)
