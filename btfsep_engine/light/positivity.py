# SPDX-License-Identifier: GPL-3.0-or-later
"""What is true of every light because radiance is not negative, said of a truncated series.

A series cut off at order L is negative somewhere even for a light that is not: its ringing. But blurred by a kernel
that is nowhere negative itself, every light stays non-negative, and a kernel of order L needs no more than the orders
up to L. Of these kernels the narrowest is the one whose mean cosine is largest,

    K(cos t) = p(cos t)^2,    p of order L // 2, with int x p^2 dx / int p^2 dx largest:

the eigenvector of the Legendre polynomials' Jacobi matrix with the largest eigenvalue (as in Gauss's quadrature).
At order 9 its mean cosine is 0.906, 25 degrees.
"""

from functools import lru_cache

import numpy as np

from btfsep_engine import sh
from btfsep_engine.conventions import fibonacci_sphere
from btfsep_engine.light.maps import training_lights

DIRECTIONS = 400  # 10 degrees apart, finer than the kernel is wide


@lru_cache(maxsize=10)
def positive_window(order: int) -> np.ndarray:
    """Factors of the orders 0 to ``order`` that blur by the kernel above: (order + 1,) float64, the first is 1."""
    half = order // 2
    node, weight = np.polynomial.legendre.leggauss(order + 2)
    legendre = np.polynomial.legendre.legvander(node, order)
    k = np.arange(half)
    beside = (k + 1) / np.sqrt((2 * k + 1) * (2 * k + 3))
    _, vectors = np.linalg.eigh(np.diag(beside, 1) + np.diag(beside, -1))
    polynomial = (legendre[:, : half + 1] * np.sqrt(np.arange(half + 1) + 0.5)) @ vectors[:, -1]
    moments = legendre.T @ (weight * polynomial**2)
    return moments / moments[0]


@lru_cache(maxsize=10)
def blurred_basis(order: int) -> np.ndarray:
    """The light blurred, in :data:`DIRECTIONS` directions: (directions, terms) float64, to be multiplied with x."""
    per_term = np.repeat(positive_window(order), 2 * np.arange(order + 1) + 1)
    return sh.evaluate(order, fibonacci_sphere(DIRECTIONS)) * per_term


@lru_cache(maxsize=10)
def darkest_share(order: int) -> float:
    """The darkest place of any training light, blurred, in any channel, over that light's mean radiance: above 0.

    No light of nature is black over a third of the sky: what this says beyond "not negative".
    """
    x = training_lights(rotations=1).coefficients(order)
    mean = x[:, 0].mean(-1) * sh.evaluate(0, np.array([[0.0, 0.0, 1.0]]))[0, 0]
    blurred = np.einsum("dt,mtc->mdc", blurred_basis(order), x)
    return float(max(0.0, (blurred.min((1, 2)) / mean).min()))
