# SPDX-License-Identifier: GPL-3.0-or-later
"""Is a part of the light one narrow beam? The evidence for it, direction by direction, in closed form.

The truncated series of `fit.map_estimate` cannot hold a sun: what is beyond its order is misfit, with sharp shadows.
So the photo is asked whether a beam from direction d, irradiance s (3,), stands beside the series,

    b = A x + K(d) s + n,    s ~ N(0, T),    x ~ N(x^, R R^T) after the fit without a beam,

K(d) (p, 3) the radiance of each pixel per unit irradiance from d, shadows included. With W the inverse of the noise's
covariance (as the fit found it) and r = b - A x^,

    S = K^T W K - (R^T A^T W K)^T (R^T A^T W K),    g = K^T W r,
    2 log evidence ratio = g^T (S + T^-1)^-1 g - log det (I + T S),    s = (S + T^-1)^-1 g:

what the series could imitate of the beam is taken out. The likelihood is coarsened as in the fit. Once a direction is
found, the beam becomes one more column beside the series' (`with_beam`), and noise, prior and light are found anew.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from btfsep_engine import sh
from btfsep_engine.fit.least_squares import Fit
from btfsep_engine.fit.map_estimate import DETERMINED, EXPECTED_ORDER, REFLECTANCE_SPREAD, LightSolver, model_variance
from btfsep_engine.fit.positive import positive_light

SPREAD = 3.0  # of a beam's irradiance before the photo is looked at, over pi times the light's mean radiance
ALIKE = 0.9  # correlation of its channels: beams are seldom coloured
LEVEL = np.sqrt(4 * np.pi)  # the first coefficient of light of radiance 1


@dataclass(frozen=True)
class Beams:
    """What the photo says of n beams, each alone.

    Attributes
    ----------
    evidence : (n,) logarithm of the ratio of the evidence with the beam to that without; -inf where it lights nothing
        or its light would be negative
    irradiance : (n, 3), most probable, on a surface that faces the beam
    """

    evidence: np.ndarray
    irradiance: np.ndarray


class BeamTest:
    """One photograph, fitted without a beam, to be asked for beams.

    Parameters
    ----------
    solver : map_estimate.LightSolver
    found : map_estimate.Found: the noise and the prior's scale that are taken for true
    radiance : (p, 3), the photograph
    """

    def __init__(self, solver, found, radiance):
        f = self.factorised = solver.factorised
        b = np.asarray(radiance, np.float64)
        self.residual = solver.left_over(found, b) / f.response
        self.noise = found.v * solver.coarsening
        self.inverse = np.linalg.inv(found.channels)
        spread = SPREAD * np.pi * f.measure(b).level / LEVEL
        self.prior = spread**2 * (ALIKE + (1 - ALIKE) * np.eye(3))
        c = found.correlation
        self._gather = f.gather.astype(np.float32)
        self._back = (f.gather.T @ sparse.diags_array(c / (1 + c * f.block_sizes))).astype(np.float32).tocsr()
        rows = self._weighted(f.all_rows().astype(np.float32))
        self._rows = np.ascontiguousarray(rows.reshape(len(rows), 3, f.terms).transpose(1, 2, 0))
        root = solver.posterior_factor(found).reshape(3, f.terms, -1)
        self._root = (root / f.prior.deviation[None, :, None]).astype(np.float32)  # of the scaled unknowns

    def _weighted(self, columns):
        """N^-1 times columns (p, k), of the blocks' correlation."""
        return columns - self._back @ (self._gather @ columns)

    def ask(self, response) -> Beams:
        """The evidence for each beam.

        Parameters
        ----------
        response : (p, n, 3) float32, K: radiance of each pixel per unit irradiance
        """
        f, inverse = self.factorised, self.inverse
        k = np.ascontiguousarray(np.moveaxis(response, 2, 0), np.float32)
        k = k / f.response.astype(np.float32)[:, None, None]  # (3, p, n)
        n = k.shape[2]
        weighted = [self._weighted(each) for each in k]
        score = np.stack([weighted[d].T @ (self.residual @ inverse[d]).astype(np.float32) for d in range(3)], 1)
        own = np.empty((n, 3, 3))
        imitated = np.zeros((n, 3, self._root.shape[2]))
        for d in range(3):
            for e in range(d, 3):
                own[:, d, e] = own[:, e, d] = np.einsum("pn,pn->n", k[d], weighted[e]) * inverse[d, e]
            for c in range(3):  # the channel c of A meets the channel d of K through the noise
                imitated[:, d] += inverse[c, d] * ((self._rows[c] @ k[d]).T @ self._root[c])
        imitated /= self.noise
        precision = own / self.noise - imitated @ imitated.transpose(0, 2, 1) + np.linalg.inv(self.prior)
        score = score.astype(np.float64) / self.noise
        irradiance = np.linalg.solve(precision, score[..., None])[..., 0]
        sign, growth = np.linalg.slogdet(precision @ self.prior)
        evidence = 0.5 * (score * irradiance).sum(1) - 0.5 * growth
        real = (sign > 0) & (own[:, range(3), range(3)] > 0).all(1) & (irradiance.mean(1) > 0)
        return Beams(np.where(real, evidence, -np.inf), irradiance)


def over_the_sky(evidence) -> float:
    """The evidence for a beam from somewhere, of beams (n,) from all over the sky: the log of their mean."""
    top = evidence.max()
    return float(top + np.log(np.mean(np.exp(evidence - top)))) if np.isfinite(top) else -np.inf


def with_beam(basis, response, *, blocks, prior, order: int, coarsening: float | None = None) -> LightSolver:
    """The solver with the beam as the last of the unknowns' rows.

    Parameters
    ----------
    basis : (p, terms, 3), A; response : (p, 3), K of one direction
    blocks, prior, order, coarsening : of `LightSolver`
    """
    spread = SPREAD * np.pi / LEVEL
    wider = replace(prior, mean=np.append(prior.mean, 0.0), deviation=np.append(prior.deviation, spread))
    rows = np.concatenate([basis, np.asarray(response, basis.dtype)[:, None]], 1)
    return LightSolver(rows, blocks=blocks, prior=wider, order=order, coarsening=coarsening)


@dataclass(frozen=True)
class Split:
    """A light that is a series and a beam.

    Attributes
    ----------
    fit : Fit of all of the light, the beam projected into its coefficients
    sky : (terms, 3), all orders of the series alone
    irradiance, stddev : (3,), of the beam
    """

    fit: Fit
    sky: np.ndarray
    irradiance: np.ndarray
    stddev: np.ndarray


def split_fit(plain: Fit, solver: LightSolver, fit: Fit, radiance, *, shapes, weights, positive: bool) -> Split:
    """The whole light of a fit with a beam.

    Parameters
    ----------
    plain : Fit without a beam, of the same photograph; what varies in natural light is judged by its scale
    solver, fit : of `with_beam`
    radiance : (p, 3), the photograph
    shapes : (k, terms) the beam per unit irradiance in spherical harmonics, the first as it is taken to be, the others
        as it might be, too (from a direction nearby)
    weights : (k,) their probabilities
    positive : whether series and beam are kept from being negative (`fit.positive`)
    """
    f = solver.factorised
    terms, reported = f.terms - 1, len(plain.coefficients)
    measured = f.measure(radiance)
    root, z = solver.posterior_factor(fit.found), fit.all_coefficients
    free, free_residual = None, None
    if positive:
        free, free_residual = z[:reported] + shapes[0][:reported, None] * z[terms], fit.residual
        z = positive_light(z, root)
    left = np.diag(f.misfit(measured, z)) * f.response**2
    energy = np.diag(measured.energies) * f.response**2
    residual = float(np.sqrt(max(left.sum(), 0) / energy.sum()))
    sky, irradiance = z[:terms], z[terms]
    x = sky + shapes[0][:, None] * irradiance
    root = root.reshape(3, terms + 1, -1)
    own = np.sqrt(np.square(root[:, terms]).sum(1))
    root = root[:, :terms] + shapes[0][:, None] * root[:, terms:]
    moved = (shapes - shapes[0])[:, :, None] * irradiance  # by the direction's uncertainty
    variance = np.square(root).sum(2).T + np.einsum("k,ktc->tc", weights, moved**2)
    model = model_variance(x, f.shared_misfit(measured, z))
    stddev = np.sqrt(variance + model + (REFLECTANCE_SPREAD * x) ** 2)
    few = min(terms, sh.term_count(EXPECTED_ORDER))
    part = root[:, :few].transpose(1, 0, 2).reshape(3 * few, -1)
    shift = moved[:, :few].reshape(len(moved), -1) * np.sqrt(weights)[:, None]
    low = REFLECTANCE_SPREAD * x[:few].ravel()
    covariance = part @ part.T + shift.T @ shift + np.outer(low, low)
    covariance += np.diag(np.broadcast_to(model, x.shape)[:few].ravel())
    varies = plain.prior_scale * measured.level * f.prior.deviation[:terms]
    varies[0] = measured.level
    known = (variance + model).mean(1) / varies**2 < DETERMINED
    whole = replace(
        fit,
        coefficients=x[:reported],
        stddev=stddev[:reported],
        residual=residual,
        residual_per_channel=np.sqrt(np.maximum(left, 0) / np.maximum(energy, 1e-300)),
        all_coefficients=x,
        determined=known[:reported],
        all_determined=known,
        covariance=covariance,
        free_coefficients=free,
        free_residual=free_residual,
    )
    return Split(whole, sky, irradiance, np.hypot(own, REFLECTANCE_SPREAD * irradiance))
