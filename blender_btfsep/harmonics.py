# SPDX-License-Identifier: GPL-3.0-or-later
"""Real spherical harmonics by one recurrence that serves NumPy arrays and shader nodes alike.

The convention is the engine's (``docs/conventions.md``): index l^2 + l + m, orthonormal, Condon-Shortley sign
included, so that Y_1 = (-0.4886 y, 0.4886 z, -0.4886 x). A test compares every term with the engine's.
"""

from math import isqrt, pi, sqrt

import numpy as np


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


def evaluate(order: int, directions) -> np.ndarray:
    """All basis functions, (..., (order + 1)^2) float64, at ``directions : (..., 3) float, unit, world, z up``."""
    d = np.asarray(directions, np.float64)
    out = np.empty((*d.shape[:-1], term_count(order)))
    for l, m, value in terms(order, d[..., 0], d[..., 1], d[..., 2]):
        out[..., l * l + l + m] = value
    return out


def to_map(coefficients, height: int, width: int) -> np.ndarray:
    """The environment map of ``coefficients : ((L + 1)^2, 3)``; may be negative.

    Returns
    -------
    (height, width, 3) float64, equirectangular as Blender reads it, u = 1/2 - atan2(y, x) / 2 pi, row 0 is **up**
    """
    coefficients = np.asarray(coefficients, np.float64)
    azimuth = 2 * np.pi * (0.5 - (np.arange(width) + 0.5) / width)
    elevation = np.pi * (0.5 - (np.arange(height) + 0.5) / height)
    c = np.cos(elevation)[:, None]
    directions = np.stack(
        [c * np.cos(azimuth), c * np.sin(azimuth), np.broadcast_to(np.sin(elevation)[:, None], (height, width))], -1
    )
    return evaluate(order_of(len(coefficients)), directions) @ coefficients
