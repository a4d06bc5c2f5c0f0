# SPDX-License-Identifier: GPL-3.0-or-later
"""The light that explains the photo: min ||b - A x||^2 (the paper's eq. 11), per colour channel.

With G = A^T A and g = A^T b the solution is x = G^-1 g. One Gram matrix holds every lower order: its leading
(L + 1)^2 block. The spread of x is stated by the sandwich

    cov x = G^-1 (sum over blocks of A_b^T r_b r_b^T A_b) G^-1

over blocks of neighbouring pixels, because misfit (texture, shape, what the basis leaves out) is structured:
counting every pixel as an independent measurement would state a spread that is far too small.
"""

from dataclasses import dataclass, replace

import numpy as np

from btfsep_engine import sh
from btfsep_engine.errors import InputError

BLOCK = 16  # edge in pixels of the blocks whose residuals are taken to be one piece of evidence
WORST_CONDITION = 1e10
DETERMINED = 0.5  # of what nature varies a coefficient by: known to better than that


@dataclass(frozen=True)
class Fit:
    """A fitted lighting.

    Attributes
    ----------
    coefficients : (terms, 3) float64
    stddev : (terms, 3) float64
    residual : relative root mean square of b - A x, over all pixels and channels
    residual_per_channel : (3,)
    condition : 2-norm condition number of A (the worst channel)
    singular_values : (terms,) of A, descending, of the channel with the worst condition
    pixels : number of pixels used
    effective_degrees_of_freedom : of a channel's unknowns, how many the photo decides (all, without a prior)
    all_coefficients : with all orders of the fit, where it has more than it reports; else None
    determined : (terms,) bool, where the fit itself can say (with a prior); else None
    all_determined : the same of all orders of the fit
    noise : a pixel's own misfit over the photo's root mean square; None without a prior
    left_over : (p, 3) float64, b - A x; None with a prior
    samples : (n, all terms, 3), lights as probable as the posterior has them; None without a prior
    interval : (2, terms, 3), the ends of the range that holds 95 % of them
    lamps : log_normal.Lamp, the brightest first
    tint : colour.Tint, what of the light's colour was taken to be the object's; None without a prior
    evidence : logarithm of how probable the photo is under the model, comparable for the same photo alone
    found : log_normal.Found, how the fit was found
    """

    coefficients: np.ndarray
    stddev: np.ndarray
    residual: float
    residual_per_channel: np.ndarray
    condition: float
    singular_values: np.ndarray
    pixels: int
    effective_degrees_of_freedom: float
    all_coefficients: np.ndarray | None = None
    determined: np.ndarray | None = None
    all_determined: np.ndarray | None = None
    noise: float | None = None
    left_over: np.ndarray | None = None
    samples: np.ndarray | None = None
    interval: np.ndarray | None = None
    lamps: tuple = ()
    tint: object | None = None
    evidence: float | None = None
    found: object | None = None

    @property
    def every(self) -> np.ndarray:
        """The coefficients of all orders of the fit."""
        return self.coefficients if self.all_coefficients is None else self.all_coefficients

    @property
    def shown(self) -> np.ndarray:
        """The coefficients whose A x is the photo: as `every`, in the colour that the object gives them."""
        return self.every if self.tint is None else self.every / self.tint.gain


def reported_up_to(fit: Fit, order: int, solver) -> Fit:
    """The same fit, of a `log_normal.LightSolver`, with fewer orders reported."""
    terms = sh.term_count(order)
    singular = solver.basis.singular_values(terms)
    return replace(
        fit,
        coefficients=fit.coefficients[:terms],
        stddev=fit.stddev[:terms],
        determined=fit.determined[:terms],
        interval=fit.interval[:, :terms],
        singular_values=singular,
        condition=float(singular[0] / max(singular[-1], singular[0] * 1e-15)),
    )


def block_labels(pixels) -> np.ndarray:
    """Numbers of the image blocks that pixels (n, 2) row and column lie in: (n,) int."""
    pixels = np.asarray(pixels, np.int64)
    _, labels = np.unique((pixels[:, 0] // BLOCK) * (1 << 20) + pixels[:, 1] // BLOCK, return_inverse=True)
    return labels.reshape(-1)


def solve(basis, radiance, *, blocks) -> Fit:
    """Plain least squares.

    Parameters
    ----------
    basis : (p, terms, 3) float, A: radiance of each pixel under each basis light
    radiance : (p, 3) float, b: the photograph's, linear
    blocks : (p,) int, block number of each pixel (`block_labels`)

    Returns
    -------
    Fit

    Raises
    ------
    InputError
        When there are fewer pixels than unknowns, or the pixels cannot tell the basis lights apart at all.
    """
    p, terms, _ = basis.shape
    if p < terms:
        raise InputError(
            "the fit",
            f"{p} usable pixels for {terms} unknowns",
            "use a larger picture, a wider mask or a lower --order",
        )
    x, stddev = np.empty((2, terms, 3))
    by_block = np.argsort(blocks, kind="stable")
    starts = np.flatnonzero(np.diff(blocks[by_block], prepend=-1))
    residual = np.empty((p, 3))
    condition, singular = 0.0, np.zeros(terms)
    for c in range(3):
        a, b = basis[:, :, c].astype(np.float64), radiance[:, c].astype(np.float64)
        gram = a.T @ a
        eigenvalues, vectors = np.linalg.eigh(gram)
        if not eigenvalues[-1] > 0:
            raise InputError(
                "the fit",
                f"the material reflects nothing towards the camera in the {('red', 'green', 'blue')[c]} channel",
                "choose another material",
            )
        worst = float(np.sqrt(eigenvalues[-1] / max(eigenvalues[0], eigenvalues[-1] * 1e-30)))
        if worst > WORST_CONDITION:
            raise InputError(
                "the fit",
                f"the pixels cannot tell {terms} basis lights apart (condition number {worst:.1e})",
                "use a lower --order or show more of the object",
            )
        if worst > condition:
            condition, singular = worst, np.sqrt(np.maximum(eigenvalues[::-1], 0))
        inverse = (vectors / eigenvalues) @ vectors.T
        x[:, c] = inverse @ (a.T @ b)
        residual[:, c] = b - a @ x[:, c]
        scores = np.add.reduceat((a * residual[:, c, None])[by_block], starts, 0)
        count = len(scores)
        spread = inverse @ (scores.T @ scores) @ inverse * (count / max(count - 1, 1))
        # few blocks cannot show a spread in many unknowns: never less than pixel noise alone would give
        white = inverse * (residual[:, c] @ residual[:, c] / max(p - terms, 1))
        stddev[:, c] = np.sqrt(np.maximum(np.diag(spread), np.diag(white)))
    energy = np.maximum((radiance.astype(np.float64) ** 2).sum(0), 1e-300)
    per_channel = np.sqrt((residual**2).sum(0) / energy)
    total = float(np.sqrt((residual**2).sum() / energy.sum()))
    return Fit(x, stddev, total, per_channel, condition, singular, p, float(terms), left_over=residual)


def determined(coefficients, stddev, natural_amplitude) -> np.ndarray:
    """Which coefficients the photo determines: those it knows to better than half of what nature varies them by.

    Parameters
    ----------
    coefficients, stddev : (terms, 3)
    natural_amplitude : (terms,) typical size of each coefficient of natural light, relative to the first

    Returns
    -------
    (terms,) bool
    """
    level = np.abs(coefficients[0]).mean()
    spread = np.sqrt((np.asarray(stddev) ** 2).mean(1))
    return spread < DETERMINED * np.asarray(natural_amplitude) * level
