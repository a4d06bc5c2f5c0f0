# SPDX-License-Identifier: GPL-3.0-or-later
"""What is true of every light because radiance is not negative, said of a truncated series.

A series cut off at order L is negative somewhere even for a light that is not: its ringing. But blurred by a kernel
that is nowhere negative itself, every light stays non-negative, and a kernel of order L needs no more than the orders
up to L. Of these kernels the narrowest is the one whose mean cosine is largest,

    K(cos t) = p(cos t)^2,    p of order L // 2, with int x p^2 dx / int p^2 dx largest:

the eigenvector of the Legendre polynomials' Jacobi matrix with the largest eigenvalue (as in Gauss's quadrature).
At order 9 its mean cosine is 0.906, 25 degrees.

Where only a series is given and it is negative somewhere, :func:`positive_radiance` makes light of it
(``docs/method.md``).
"""

from functools import lru_cache

import numpy as np

from btfsep_engine import sh
from btfsep_engine.conventions import luminance, pixel_directions, pixel_solid_angles

FLOOR = 0.5  # of the blurred luminance: no place is darker
ROUNDING = 1e-6  # of the brightest radiance: less below zero than that is none


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


def positive_radiance(coefficients, directions) -> np.ndarray:
    """The light that a series x stands for: x itself, or as far as it is negative somewhere, in its place

        g max(Y, FLOOR Y_w) W / Y_w

    with Y the luminance of x, W the series blurred by :func:`positive_window` and clamped at 0, Y_w its luminance. The
    colour is that of the blurred light, which does not ring, so that what rings is brightness and no hue.

    Parameters
    ----------
    coefficients : ((L + 1)^2, 3) float, linear Rec.709
    directions : (..., 3) float, unit, world

    Returns
    -------
    (..., 3) float64, >= 0
    """
    x = np.asarray(coefficients, np.float64)
    share, gain = positive_share(x)
    series, windowed = _both(x, directions)
    return np.maximum((1 - share) * series + share * gain * _positive(series, windowed), 0)


def positive_share(coefficients) -> tuple[float, float]:
    """How far :func:`positive_radiance` puts another light in the place of a series, and its gain g.

    Returns
    -------
    share : 0 for a series that is nowhere negative; else twice the least at which nothing is negative, at most 1
    gain : gives the whole the luminance that the series has, one number for all channels
    """
    x = np.asarray(coefficients, np.float64)
    height = max(64, 4 * sh.order_of(len(x)))
    series, windowed = _both(x, pixel_directions(height, 2 * height))
    negative = series < -ROUNDING * np.abs(series).max()
    if not negative.any():
        return 0.0, 1.0
    positive = _positive(series, windowed)
    area = pixel_solid_angles(height, 2 * height)[:, None]
    whole, other = ((area * luminance(values)).sum() for values in (series, positive))
    gain = max(whole, 0.0) / max(other, 1e-300)
    depth = -series[negative]
    return min(1.0, 2 * float((depth / (depth + gain * positive[negative])).max())), float(gain)


def _both(x, directions):
    """The series, and the series blurred: (..., 3) each."""
    order = sh.order_of(len(x))
    windowed = positive_window(order)[sh.degrees(order), None] * x
    both = sh.series(np.concatenate([x, windowed], 1), directions)
    return both[..., :3], both[..., 3:]


def _positive(series, windowed) -> np.ndarray:
    colour = np.maximum(windowed, 0)
    y = luminance(colour)[..., None]
    level = np.maximum(luminance(series)[..., None], FLOOR * y)
    return colour * np.divide(level, y, out=np.zeros_like(y), where=y > 0)
