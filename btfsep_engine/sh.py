# SPDX-License-Identifier: GPL-3.0-or-later
"""Real spherical harmonics: evaluation, projection of maps, rotation, diffuse shading.

Index l^2 + l + m, orthonormal, with the Condon-Shortley sign: the sign of ``drjit.sh_eval``,
Y_1 = (-0.4886 y, 0.4886 z, -0.4886 x).
"""

from functools import lru_cache

import numpy as np

from btfsep_engine.conventions import fibonacci_sphere, pixel_directions, pixel_solid_angles

BLOCK = 1 << 12  # directions evaluated at once: enough that NumPy's calls cost little, few enough for the cache
FEW, LOW = 24, 12  # so many directions, to such an order, as polynomials: there NumPy's calls are all that it costs


def term_count(order: int) -> int:
    """Number of coefficients up to and with ``order``."""
    return (order + 1) ** 2


def order_of(terms: int) -> int:
    """The order that has ``terms`` coefficients. ValueError if there is none."""
    order = round(np.sqrt(terms)) - 1
    if order < 0 or term_count(order) != terms:
        raise ValueError(f"{terms} is not (L + 1)^2 for any order L")
    return order


def degrees(order: int) -> np.ndarray:
    """The degree of every term: ((order + 1)^2,) int."""
    return np.repeat(np.arange(order + 1), 2 * np.arange(order + 1) + 1)


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
    return np.ascontiguousarray(_rows(order, d.reshape(-1, 3)).T).reshape(*d.shape[:-1], term_count(order))


def _rows(order: int, directions) -> np.ndarray:
    """The same of (n, 3), a row each: (terms, n)."""
    x, y, z = directions.T
    if len(x) <= FEW and order <= LOW:
        return _of_few(order, x, y, z)
    turn = np.ones((order + 1, len(x)), complex)  # (x + i y)^m, times sqrt(2) where m > 0
    if order:
        np.multiply.accumulate(np.broadcast_to(x + 1j * y, (order, len(x))), out=turn[1:])
        turn[1:] *= np.sqrt(2)
    step, before_last, diagonal = _recurrence(order)
    even, odd = np.ascontiguousarray(turn.real), np.ascontiguousarray(turn.imag)
    out = np.empty((term_count(order), len(x)))
    last = now = None  # normalised P_l^m / sin^m of the degrees before, (m, directions)
    for l in range(order + 1):
        older, last, now = last, now, np.empty((l + 1, len(x)))
        now[l] = diagonal[l]
        if l:
            now[:l] = z * last
        if l > 1:
            now[: l - 1] -= before_last[l, : l - 1, None] * older
        now[:l] *= step[l, :l, None]
        np.multiply(now, even[: l + 1], out=out[l * l + l : (l + 1) ** 2])
        np.multiply(now[:0:-1], odd[l:0:-1], out=out[l * l : l * l + l])
    return out


def _of_few(order: int, x, y, z) -> np.ndarray:
    """`_rows` by polynomials."""
    by_power, m = _polynomials(order)
    powers = np.ones((order + 1, 2, len(x)), complex)  # of z, and (x + i y)^m
    if order:
        np.multiply.accumulate(np.broadcast_to([z, x + 1j * y], (order, 2, len(x))), out=powers[1:])
    turn = np.concatenate([powers[:, 1].real, powers[:, 1].imag])
    return (by_power @ powers[:, 0].real) * turn[m]


@lru_cache(maxsize=16)
def _polynomials(order: int) -> tuple[np.ndarray, np.ndarray]:
    """P_l^|m| / sin^|m| of every term by powers of z, times sqrt(2) where m is not 0, (terms, order + 1); and its row
    among Re and Im (x + i y)^|m|."""
    step, before_last, diagonal = _recurrence(order)
    p = np.zeros((order + 1, order + 1, order + 1))  # (l, m, power)
    for l in range(order + 1):
        p[l, l, 0] = diagonal[l]
        if l:
            p[l, :l, 1:] = p[l - 1, :l, :-1]
        if l > 1:
            p[l, : l - 1] -= before_last[l, : l - 1, None] * p[l - 2, : l - 1]
        p[l, :l] *= step[l, :l, None]
    l = degrees(order)
    m = np.arange(term_count(order)) - l * l - l
    return p[l, np.abs(m)] * np.where(m, np.sqrt(2), 1)[:, None], np.where(m < 0, order + 1 - m, m)


@lru_cache(maxsize=16)
def _recurrence(order: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Factors of P_l^m = step (z P_(l-1)^m - before_last P_(l-2)^m), (l, m), and P_m^m / sin^m, (m,)."""
    l, m = np.mgrid[: order + 1, : order + 1].astype(float)
    with np.errstate(divide="ignore", invalid="ignore"):
        step = np.sqrt((4 * l * l - 1) / (l * l - m * m))
        before_last = np.sqrt(((l - 1) ** 2 - m * m) / (4 * (l - 1) ** 2 - 1))
    k = np.arange(1, order + 1)
    diagonal = np.cumprod([np.sqrt(1 / (4 * np.pi)), *-np.sqrt((2 * k + 1) / (2 * k))])
    return step, before_last, diagonal


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


def series(coefficients, directions) -> np.ndarray:
    """The sums (..., n) of ``coefficients : ((L + 1)^2, n)`` in ``directions : (..., 3)``; by blocks."""
    x, d = np.asarray(coefficients, np.float64), np.asarray(directions, np.float64)
    order, flat = order_of(len(x)), d.reshape(-1, 3)
    if len(flat) > BLOCK and (on_map := _on_map(x, order, d)) is not None:
        return on_map
    parts = [_rows(order, flat[start : start + BLOCK]).T @ x for start in range(0, max(len(flat), 1), BLOCK)]
    return np.concatenate(parts).reshape(*d.shape[:-1], x.shape[1])


def _on_map(x, order: int, directions):
    """The sums on (part of) an equirectangular map (h, w, 3): harmonics are products of a row's and a column's factor.

    None where the directions are no such map.
    """
    if directions.ndim != 3 or np.ptp(directions[..., 2], 1).any():
        return None
    turned, z = directions[..., 0] + 1j * directions[..., 1], directions[:, 0, 2]
    away = np.abs(turned[:, 0])  # sin of the angle from z
    widest = away.argmax()
    columns = turned[widest] / max(away[widest], 1e-300)  # exp(i phi)
    if np.abs(turned - away[:, None] * columns).max() > 1e-12:
        return None
    along = _rows(order, np.stack([away, 0 * z, z], 1))  # at phi = 0
    m = np.arange(-order, order + 1)
    turns = columns ** np.abs(m)[:, None]
    turns = np.where(m[:, None] < 0, turns.imag, turns.real)
    l = degrees(order)
    of = np.arange(len(x)) - l * l - l
    upright = along[l * l + l + np.abs(of)]
    by_turn = np.stack([upright[of == k].T @ x[of == k] for k in m], -1)  # (h, n, 2 L + 1)
    return np.ascontiguousarray((by_turn @ turns).transpose(0, 2, 1))


def to_map(coefficients, height: int, width: int) -> np.ndarray:
    """The environment map (height, width, 3) float64 of ``coefficients : ((L + 1)^2, 3)``; may be negative."""
    return series(coefficients, pixel_directions(height, width))


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
    return series(cosine_lobe(order)[degrees(order), None] * coefficients, normals)
