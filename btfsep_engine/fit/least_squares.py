# SPDX-License-Identifier: GPL-3.0-or-later
"""The light that explains the photo: min ||b - A x||^2 (the paper's eq. 11), per colour channel.

With G = A^T A and g = A^T b the solution is x = G^-1 g. One Gram matrix holds every lower order: its leading
(L + 1)^2 block. The spread of x is stated by the sandwich

    cov x = G^-1 (sum over blocks of A_b^T r_b r_b^T A_b) G^-1

over blocks of neighbouring pixels, because misfit (texture, shape, what the basis leaves out) is structured:
counting every pixel as an independent measurement would state a spread that is far too small.
"""

import numpy as np

from btfsep_engine import sh
from btfsep_engine.errors import InputError
from btfsep_engine.fit.stated import Fit, Stated, determined
from btfsep_engine.linear_algebra import eigh, product

BLOCK = 16  # edge in pixels of the blocks whose residuals are taken to be one piece of evidence
WORST_CONDITION = 1e10


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
    condition = 0.0
    for c in range(3):
        a, b = basis[:, :, c].astype(np.float64), radiance[:, c].astype(np.float64)
        gram = product(a.T, a)
        eigenvalues, vectors = eigh(gram)
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
        condition = max(condition, worst)
        inverse = product(vectors / eigenvalues, vectors.T)
        x[:, c] = inverse @ product(a.T, b)
        residual[:, c] = b - product(a, x[:, c])
        scores = np.add.reduceat((a * residual[:, c, None])[by_block], starts, 0)
        count = len(scores)
        spread = product(product(inverse, product(scores.T, scores)), inverse) * (count / max(count - 1, 1))
        # few blocks cannot show a spread in many unknowns: never less than pixel noise alone would give
        white = inverse * (residual[:, c] @ residual[:, c] / max(p - terms, 1))
        stddev[:, c] = np.sqrt(np.maximum(np.diag(spread), np.diag(white)))
    energy = np.maximum((radiance.astype(np.float64) ** 2).sum(0), 1e-300)
    stated = Stated(stddev, determined(x, stddev))
    return Fit(
        order=sh.order_of(terms),
        all_coefficients=x,
        state=lambda: stated,
        residual=float(np.sqrt((residual**2).sum() / energy.sum())),
        residual_per_channel=np.sqrt((residual**2).sum(0) / energy),
        condition=condition,
        effective_degrees_of_freedom=float(terms),
    )
