# SPDX-License-Identifier: GPL-3.0-or-later
"""From tangent-space normal maps to heights: periodic integration in the Fourier domain.

The least-squares height of a slope field (p, q) with periodic borders is, for each frequency k but 0,

    H = -i (k_u P + k_v Q) / |k|^2        (Frankot and Chellappa 1988)

and what it leaves, the curl, tells whether the green channel was read the right way round: the slopes of a real
surface have none, and with the sign of one slope wrong they have.
Where a height map is there too, its long waves and the normal map's short ones are joined (after Nehab et al. 2005).
Axes: u to the right (columns), v upwards; row 0 is the smallest v.
"""

import numpy as np

from btfsep_engine.errors import InputError

STEEPEST = 0.05  # of the normal's z: beyond 87 degrees a slope counts as this
CLEARLY = 0.8  # one convention's curl is below this share of the other's: it is that one
CROSSOVER = 16  # pixels; longer waves are the height map's, shorter ones the normal map's
AGREES = 0.3  # least correlation of the two maps' slopes


def slopes(pixels, name: str) -> np.ndarray:
    """Slopes that a normal map shows whose green points up (OpenGL).

    Parameters
    ----------
    pixels : (h, w, 3) float, 0 to 1 as coded in pictures, or -1 to 1 (floating-point files); row 0 is the smallest v
    name : of the file, for errors

    Returns
    -------
    (h, w, 2) float64, dh/du and dh/dv

    Raises InputError: the picture is no tangent-space normal map.
    """
    n = np.asarray(pixels, np.float64)
    if n.min() >= -0.01:
        n = 2 * n - 1
    length = np.linalg.norm(n, axis=-1)
    if np.median(n[..., 2]) < 0.2 or not 0.7 < np.median(length) < 1.3:
        raise InputError(
            name,
            "it is no tangent-space normal map: its vectors are not of length 1 around +Z (blue)",
            "give a tangent-space normal map, or a height map",
        )
    z = np.maximum(n[..., 2], STEEPEST * np.maximum(length, 1e-6))
    return np.stack([-n[..., 0] / z, -n[..., 1] / z], -1)


def _frequencies(shape):
    """k_u, k_v : radians a pixel, of numpy's rfft2; an even Nyquist frequency is 0: it has no sign, thus no slope."""
    h, w = shape
    kv, ku = 2 * np.pi * np.fft.fftfreq(h)[:, None], 2 * np.pi * np.fft.rfftfreq(w)[None]
    ku = np.where(np.isclose(ku, np.pi), 0, ku)
    return ku, np.where(np.isclose(np.abs(kv), np.pi), 0, kv)


def integrate(slope) -> np.ndarray:
    """The periodic height whose slopes come nearest; the mean is 0.

    Parameters
    ----------
    slope : (h, w, 2) float; of a square pixel

    Returns
    -------
    (h, w) float64, in pixels (multiply by a pixel's edge)
    """
    ku, kv = _frequencies(slope.shape[:2])
    p, q = np.fft.rfft2(slope[..., 0]), np.fft.rfft2(slope[..., 1])
    k2 = ku**2 + kv**2
    return np.fft.irfft2(-1j * (ku * p + kv * q) / np.where(k2 > 0, k2, np.inf), s=slope.shape[:2])


def gradient(height) -> np.ndarray:
    """(h, w, 2) float64: slopes of a periodic height in pixels, exact for what its pixels can hold."""
    ku, kv = _frequencies(height.shape)
    transform = np.fft.rfft2(height)
    return np.stack([np.fft.irfft2(1j * k * transform, s=height.shape) for k in (ku, kv)], -1)


def curl_share(slope) -> float:
    """The part of the slopes' variance that no periodic height has, 0 to 1; 0 for a flat field."""
    varying = slope - slope.mean((0, 1))
    total = float((varying**2).sum())
    return float(((varying - gradient(integrate(varying))) ** 2).sum()) / total if total > 1e-12 else 0.0


def guess_convention(slope, height=None) -> str | None:
    """ "opengl" or "directx" for slopes read as OpenGL's, None where they do not tell (grooves along an edge, flat).

    Parameters
    ----------
    slope : (h, w, 2) float
    height : (h, w) float, any unit, or None: the height map beside it
    """
    if height is not None:
        known = gradient(height)[..., 1]
        agreement = correlation(slope[..., 1], known)
        if abs(agreement) > AGREES:
            return "opengl" if agreement > 0 else "directx"
    as_opengl, as_directx = curl_share(slope), curl_share(slope * [1, -1])
    if min(as_opengl, as_directx) < CLEARLY * max(as_opengl, as_directx):
        return "opengl" if as_opengl < as_directx else "directx"
    return None


def correlation(a, b) -> float:
    """Cosine of the angle between two fields, the mean of each taken out; 0 where one of them is constant."""
    a, b = a - a.mean((0, 1)), b - b.mean((0, 1))
    return float((a * b).sum() / max(np.sqrt((a * a).sum() * (b * b).sum()), 1e-300))


def join(height, slope):
    """The height map with the normal map's fine detail.

    The normal map's slopes are scaled to the height map's where both show the same waves: how high the material is
    says the height map alone.

    Parameters
    ----------
    height : (h, w) float, in pixels; slope : (h, w, 2) float

    Returns
    -------
    (h, w) float64 in pixels, or None where the two maps do not agree
    """
    ku, kv = _frequencies(height.shape)
    k2, crossover = ku**2 + kv**2, (2 * np.pi / CROSSOVER) ** 2
    h = np.fft.rfft2(height)
    detail = np.fft.rfft2(integrate(slope))
    shared = np.exp(-k2 / (2 * crossover))  # the waves that both maps hold
    a, b = (gradient(np.fft.irfft2(f * shared, s=height.shape)) for f in (detail, h))
    scale = (a * b).sum() / max((a * a).sum(), 1e-300)
    if correlation(a, b) < AGREES:
        return None
    return np.fft.irfft2((crossover * h + scale * k2 * detail) / (crossover + k2), s=height.shape)
