# SPDX-License-Identifier: GPL-3.0-or-later
"""Real spherical harmonics: evaluation, projection of maps, rotation, diffuse shading.

Index l^2 + l + m, orthonormal, with the Condon-Shortley sign: the sign of ``drjit.sh_eval``,
Y_1 = (-0.4886 y, 0.4886 z, -0.4886 x).
"""

import numpy as np

from btfsep_engine.conventions import fibonacci_sphere, pixel_directions, pixel_solid_angles

BLOCK = 1 << 12  # directions evaluated at once: enough that NumPy's calls cost little, few enough for the cache


def term_count(order: int) -> int:
    """Number of coefficients up to and with ``order``."""
    return (order + 1) ** 2


def order_of(terms: int) -> int:
    """The order that has ``terms`` coefficients. ValueError if there is none."""
    order = round(np.sqrt(terms)) - 1
    if order < 0 or term_count(order) != terms:
        raise ValueError(f"{terms} is not (L + 1)^2 for any order L")
    return order


def evaluate(order: int, directions) -> np.ndarray:
    """All basis functions up to ``order``.

    Uses the polynomial recurrences of the associated Legendre functions divided by sin^m, and
    cos(m phi) sin^m = Re (x + i y)^m, so that poles and seam need no care.

    Parameters
    ----------
    order : int, >= 0
    directions : (..., 3) float, unit

    Returns
    -------
    (..., (order + 1)^2) float64
    """
    d = np.asarray(directions, np.float64)
    x, y, z = d[..., 0], d[..., 1], d[..., 2]
    out = np.empty((*d.shape[:-1], term_count(order)))
    cos_m, sin_m = np.ones_like(x), np.zeros_like(x)  # Re and Im of (x + i y)^m
    p_mm = np.full_like(x, np.sqrt(1 / (4 * np.pi)))  # normalised P_m^m / sin^m
    for m in range(order + 1):
        if m:
            cos_m, sin_m = x * cos_m - y * sin_m, x * sin_m + y * cos_m
            p_mm = -p_mm * np.sqrt((2 * m + 1) / (2 * m))
        previous, current = np.zeros_like(x), p_mm
        for l in range(m, order + 1):
            if l > m:
                a = np.sqrt((4 * l * l - 1) / (l * l - m * m))
                b = np.sqrt(((l - 1) ** 2 - m * m) / (4 * (l - 1) ** 2 - 1)) if l > m + 1 else 0.0
                previous, current = current, a * (z * current - b * previous)
            centre = l * l + l
            if m == 0:
                out[..., centre] = current
            else:
                out[..., centre + m] = np.sqrt(2) * current * cos_m
                out[..., centre - m] = np.sqrt(2) * current * sin_m
    return out


def project_map(radiance, order: int) -> np.ndarray:
    """Coefficients of an environment map, by its pixels' exact solid angles.

    Parameters
    ----------
    radiance : (h, w, 3) float, equirectangular, linear Rec.709
    order : int

    Returns
    -------
    ((order + 1)^2, 3) float64
    """
    h, w = radiance.shape[:2]
    weights = pixel_solid_angles(h, w)
    directions = pixel_directions(h, w)
    x = np.zeros((term_count(order), radiance.shape[2]))
    step = max(1, BLOCK // w)
    for start in range(0, h, step):
        rows = slice(start, start + step)
        part = np.asarray(radiance[rows], np.float64) * weights[rows, None, None]
        basis = evaluate(order, directions[rows])
        x += basis.reshape(-1, len(x)).T @ part.reshape(-1, part.shape[2])
    return x


def to_map(coefficients, height: int, width: int) -> np.ndarray:
    """The environment map (height, width, 3) float64 of ``coefficients : ((L + 1)^2, 3)``; may be negative."""
    coefficients = np.asarray(coefficients, np.float64)
    basis = evaluate(order_of(len(coefficients)), pixel_directions(height, width))
    return basis @ coefficients


def rotation_matrix(order: int, rotation) -> np.ndarray:
    """D such that the light turned by ``rotation`` has the coefficients D @ x, block-diagonal over l.

    Found as the change of basis on a set of directions that determines every order exactly
    (least squares on more directions than terms; exact to rounding).

    Parameters
    ----------
    order : int
    rotation : (3, 3) float, a rotation; light that came from d then comes from ``rotation @ d``

    Returns
    -------
    ((order + 1)^2, (order + 1)^2) float64
    """
    directions = fibonacci_sphere(8 * term_count(order) + 32)
    here = evaluate(order, directions)
    there = evaluate(order, directions @ np.asarray(rotation, np.float64).T)
    matrix = np.zeros((term_count(order),) * 2)
    for l in range(order + 1):
        block = slice(l * l, (l + 1) ** 2)
        # f_rot(R d) = f(d) for all d:  there @ D = here
        matrix[block, block] = np.linalg.lstsq(there[:, block], here[:, block], rcond=None)[0]
    return matrix


def cosine_lobe(order: int) -> np.ndarray:
    """A_l of max(cos, 0) for l = 0 … order (Ramamoorthi and Hanrahan 2001, eq. 8): pi, 2 pi / 3, pi / 4, 0, …"""
    a = np.zeros(order + 1)
    a[0] = np.pi
    if order >= 1:
        a[1] = 2 * np.pi / 3
    for l in range(2, order + 1, 2):
        k = l // 2
        binomial = 1.0
        for i in range(1, k + 1):
            binomial *= (l - i + 1) / i
        a[l] = 2 * np.pi * (-1) ** (k - 1) / ((l + 2) * (l - 1)) * binomial / 2**l
    return a


def irradiance(coefficients, normals) -> np.ndarray:
    """Unshadowed irradiance (..., 3) at ``normals : (..., 3)`` under ``coefficients : ((L + 1)^2, 3)``."""
    coefficients = np.asarray(coefficients, np.float64)
    order = order_of(len(coefficients))
    per_term = np.repeat(cosine_lobe(order), 2 * np.arange(order + 1) + 1)
    return evaluate(order, normals) @ (per_term[:, None] * coefficients)
