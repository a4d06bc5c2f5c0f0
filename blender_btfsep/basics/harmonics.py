# SPDX-License-Identifier: GPL-3.0-or-later
"""Real spherical harmonics by one recurrence that serves NumPy arrays and shader nodes alike.

The convention is the engine's (``docs/conventions.md``): index l^2 + l + m, orthonormal, Condon-Shortley sign
included, so that Y_1 = (-0.4886 y, 0.4886 z, -0.4886 x). A test compares every term with the engine's.
"""

from functools import lru_cache
from math import isqrt, pi, sqrt

import numpy as np

LUMINANCE = (0.2126, 0.7152, 0.0722)  # linear Rec.709
FLOOR = 0.5  # of the blurred luminance: no place of a light that was negative somewhere is darker
ROUNDING = 1e-6  # of the brightest radiance: less below zero than that is none
BLOCK = 400_000  # basis values computed at once


def term_count(order: int) -> int:
    """Number of coefficients up to and with ``order``."""
    return (order + 1) ** 2


def order_of(terms: int) -> int:
    """The order that has ``terms`` coefficients. ValueError if there is none."""
    order = isqrt(max(terms, 0)) - 1
    if order < 0 or term_count(order) != terms:
        raise ValueError(f"{terms} is not (L + 1)^2 for any order L")
    return order


def terms(order: int, x, y, z):
    """Yields (l, m, value) of every basis function up to ``order``, each as soon as it can be computed.

    ``x, y, z`` are the parts of a unit direction. They may be anything that can be multiplied by numbers and by
    each other and added: arrays give arrays, shader node sockets give shader nodes. A value may also be a plain
    number (l = 0). Terms come in order of m, so few intermediate values are alive at a time.

    P_l^m / sin^m are polynomials in z, and cos(m phi) sin^m = Re (x + i y)^m: poles and seam need no care.
    """
    cos_m, sin_m = 1.0, 0.0  # Re and Im of (x + i y)^m
    p_mm = sqrt(1 / (4 * pi))  # normalised P_m^m / sin^m, a number
    for m in range(order + 1):
        if m == 1:
            cos_m, sin_m = x, y
        elif m > 1:
            cos_m, sin_m = x * cos_m - y * sin_m, x * sin_m + y * cos_m
        if m:
            p_mm *= -sqrt((2 * m + 1) / (2 * m))
        previous, current = 0.0, p_mm if m == 0 else sqrt(2) * p_mm
        for l in range(m, order + 1):
            if l > m:
                a = sqrt((4 * l * l - 1) / (l * l - m * m))
                raised = (z * a) * current
                if l > m + 1:
                    b = a * sqrt(((l - 1) ** 2 - m * m) / (4 * (l - 1) ** 2 - 1))
                    raised = raised - previous * b
                previous, current = current, raised
            if m == 0:
                yield l, 0, current
            else:
                yield l, m, cos_m * current
                yield l, -m, sin_m * current


@lru_cache(maxsize=8)
def positive_window(order: int) -> np.ndarray:
    """Factors (order + 1,) of the orders: the engine's window that keeps a light from being negative.

    The narrowest blur p(cos t)^2 with p of order // 2 (``docs/method.md``); a test compares it with the engine's.
    """
    half = order // 2
    node, weight = np.polynomial.legendre.leggauss(order + 2)
    legendre = np.polynomial.legendre.legvander(node, order)
    k = np.arange(half)
    beside = (k + 1) / np.sqrt((2 * k + 1) * (2 * k + 3))
    _, vectors = np.linalg.eigh(np.diag(beside, 1) + np.diag(beside, -1))
    polynomial = (legendre[:, : half + 1] * np.sqrt(np.arange(half + 1) + 0.5)) @ vectors[:, -1]
    moments = legendre.T @ (weight * polynomial**2)
    return moments / moments[0]


def evaluate(order: int, directions) -> np.ndarray:
    """All basis functions, (..., (order + 1)^2) float64, at ``directions : (..., 3) float, unit, world, z up``."""
    d = np.asarray(directions, np.float64)
    out = np.empty((*d.shape[:-1], term_count(order)))
    for l, m, value in terms(order, d[..., 0], d[..., 1], d[..., 2]):
        out[..., l * l + l + m] = value
    return out


def map_directions(height: int, width: int) -> np.ndarray:
    """(height, width, 3) unit: where each pixel of an environment map lies, row 0 up (``docs/conventions.md``)."""
    azimuth = 2 * np.pi * (0.5 - (np.arange(width) + 0.5) / width)
    elevation = np.pi * (0.5 - (np.arange(height) + 0.5) / height)[:, None]
    c = np.cos(elevation)
    return np.stack([c * np.cos(azimuth), c * np.sin(azimuth), np.sin(elevation) + 0 * azimuth], -1)


def row_heights(height: int) -> np.ndarray:
    """(height, 1): the share of 4 pi that each row of such a map has, times 2."""
    edges = np.sin(np.pi * (0.5 - np.arange(height + 1) / height))
    return (edges[:-1] - edges[1:])[:, None]


def to_map(coefficients, height: int, width: int) -> np.ndarray:
    """The environment map of ``coefficients : ((L + 1)^2, n)``; may be negative.

    Gives (height, width, n) float64, equirectangular as Blender reads it: u = 1/2 - atan2(y, x) / 2 pi, row 0 **up**.
    """
    coefficients = np.asarray(coefficients, np.float64)
    directions = map_directions(height, width)
    out = np.empty((height, width, coefficients.shape[1]))
    step = max(1, BLOCK // (width * len(coefficients)))
    for start in range(0, height, step):
        rows = slice(start, start + step)
        out[rows] = evaluate(order_of(len(coefficients)), directions[rows]) @ coefficients
    return out


def positive_map(coefficients, height: int, width: int) -> np.ndarray:
    """As :func:`to_map`, for a light that is to be nowhere negative: the rule of ``docs/method.md``."""
    share, gain = positive_share(coefficients)
    series, windowed = _both(coefficients, height, width)
    return np.maximum((1 - share) * series + share * gain * _positive(series, windowed), 0)


def positive_share(coefficients) -> tuple[float, float]:
    """How far :func:`positive_map` puts another light in the place of the series (0 to 1), and that light's gain."""
    height = max(64, 4 * order_of(len(coefficients)))
    series, windowed = _both(coefficients, height, 2 * height)
    negative = series < -ROUNDING * np.abs(series).max()
    if not negative.any():
        return 0.0, 1.0
    positive = _positive(series, windowed)
    area = row_heights(height)
    whole, other = ((area * (values @ LUMINANCE)).sum() for values in (series, positive))
    gain = max(whole, 0.0) / max(other, 1e-300)
    depth = -series[negative]
    return min(1.0, 2 * float((depth / (depth + gain * positive[negative])).max())), float(gain)


def _both(coefficients, height: int, width: int):
    """The map of the series, and that of the series blurred: (height, width, 3) each."""
    x = np.asarray(coefficients, np.float64)
    order = order_of(len(x))
    per_term = np.repeat(positive_window(order), 2 * np.arange(order + 1) + 1)
    both = to_map(np.concatenate([x, per_term[:, None] * x], 1), height, width)
    return both[..., :3], both[..., 3:]


def _positive(series, windowed) -> np.ndarray:
    colour = np.maximum(windowed, 0)
    y = (colour @ LUMINANCE)[..., None]
    level = np.maximum((series @ LUMINANCE)[..., None], FLOOR * y)
    return colour * np.divide(level, y, out=np.zeros_like(y), where=y > 0)
