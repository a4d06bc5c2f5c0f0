# SPDX-License-Identifier: GPL-3.0-or-later
"""How far two lightings are apart, up to the order that both have. No single measure agrees with people: read several.

Conventions, the same everywhere:

- Everything is computed up to the smaller order of the two lightings.
- A free scale is **one** factor for all channels and pixels, the best one in the least-squares sense, >= 0.
- The band-limited spheres are seen orthographically from the front (Blender's numpad 1), negative radiance cut to 0.
  They see the light up to that order only, without a tone map: another quantity than what publications state of three
  spheres, never to stand beside it. That one is `three_spheres`.
- si-RMSE: root mean square with a free scale, in units of the reference picture's 99.9th percentile.
- Angular error: between the RGB vectors of a pixel, mean over the pixels where both pictures have light.
- Normalised RMSE: each picture first stretched so that its percentiles 0.01 and 99.9 become 0 and 1.
"""

import numpy as np

from btfsep_engine import sh
from btfsep_engine.conventions import REC709_LUMINANCE
from btfsep_engine.light.files import Lighting

FRONT = (0.0, 1.0, 0.0)
SILVER_ROUGHNESS = 0.5  # Blender's roughness; GGX alpha is its square
GREY = 0.5
PERCENTILES = (0.01, 99.9)
LIMIT = 2.0  # times what is stated: 95 % of a normal distribution, were it all in one coefficient


def compare(estimate: Lighting, reference: Lighting, *, view=FRONT, size: int = 128) -> dict:
    """All error measures of ``estimate`` against ``reference``.

    Parameters
    ----------
    estimate, reference : Lighting
    view : (3,) the direction in which the camera of the spheres looks, world
    size : pixels, edge of the pictures of the spheres

    Returns
    -------
    dict, JSON-ready; what is undefined (a black reference, order 0) is None::

        order                   the order up to which was compared
        coefficients            [{order, relative_l2, relative_l2_free_scale, scale}], cumulative, orders 1, 2, …
        main_direction_degrees  angle between the order-1 vectors of the luminance
        within_two_sigma        share of the coefficients whose truth lies within two stated standard deviations,
                                None where the estimate states none
        agreement               of :func:`agreement`
        band_limited_spheres    {diffuse, silver, mirror: {si_rmse, angular_degrees, normalised_rmse}}
    """
    order = min(estimate.order, reference.order)
    terms = sh.term_count(order)
    a, b = estimate.coefficients[:terms], reference.coefficients[:terms]
    bands = []
    for l in range(min(1, order), order + 1):
        bands.append({"order": l, **relative_l2(a[: sh.term_count(l)], b[: sh.term_count(l)])})
    deviation = estimate.stddev[:terms]
    pictures = [spheres(x, view=view, size=size) for x in (a, b)]
    return {
        "order": order,
        "coefficients": bands,
        "main_direction_degrees": direction_error(a, b),
        "within_two_sigma": float((np.abs(a - b) <= 2 * deviation).mean()) if (deviation > 0).any() else None,
        "agreement": agreement(estimate, reference),
        "band_limited_spheres": {kind: image_errors(pictures[0][kind], pictures[1][kind]) for kind in pictures[0]},
    }


def best_scale(a, b) -> float:
    """The s >= 0 that minimises |s a - b| over all elements; 0 where a is all zero."""
    a, b = np.ravel(a), np.ravel(b)
    norm = float(a @ a)
    return max(0.0, float(a @ b) / norm) if norm > 0 else 0.0


def relative_l2(a, b) -> dict:
    """{relative_l2, relative_l2_free_scale, scale} of coefficients ``a`` against ``b``, of the same shape.

    Both errors are over |b|; ``scale`` is the factor on ``a`` of the second. None where b is all zero.
    """
    norm = float(np.linalg.norm(b))
    scale = best_scale(a, b)
    if norm == 0:
        return {"relative_l2": None, "relative_l2_free_scale": None, "scale": None}
    return {
        "relative_l2": float(np.linalg.norm(a - b)) / norm,
        "relative_l2_free_scale": float(np.linalg.norm(scale * a - b)) / norm,
        "scale": scale,
    }


def main_direction(coefficients) -> np.ndarray | None:
    """(3,) unit, the direction from which most light comes (order 1 of the luminance), None where there is none."""
    x = np.asarray(coefficients, np.float64) @ REC709_LUMINANCE
    if len(x) < 4:
        return None
    vector = np.array([-x[3], -x[1], x[2]])
    length = np.linalg.norm(vector)
    return vector / length if length > 1e-9 * np.abs(x).max() else None


def direction_error(a, b) -> float | None:
    """Degrees between the main directions of two sets of coefficients ((L + 1)^2, 3), None where one has none."""
    p, q = main_direction(a), main_direction(b)
    if p is None or q is None:
        return None
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(p, q)), p @ q)))


def agreement(a: Lighting, b: Lighting) -> dict | None:
    """Whether two estimates of one light differ by no more than what they state, for want of a truth.

    Errors are taken as independent between the two, and as the same in a coefficient's three channels. What both have
    wrong alike (a prior, a tone curve, a table that is left out) no comparison of the two can show.

    Returns
    -------
    None where neither states an uncertainty, else::

        order           up to which: 2, or the smaller of the two
        difference      relative L2 of the coefficients, one free scale; stated: what the deviations make of it
        degrees         between the main directions, None where one has none; stated_degrees
        agree           whether neither is more than `LIMIT` times what is stated
    """
    order = min(a.order, b.order, 2)
    terms = sh.term_count(order)
    x, y = a.coefficients[:terms], b.coefficients[:terms]
    spread = [light.stddev[:terms] for light in (a, b)]
    if not any((s > 0).any() for s in spread) or not np.linalg.norm(y) > 0:
        return None
    found = relative_l2(x, y)
    off, scale = found["relative_l2_free_scale"], found["scale"]
    stated = float(np.hypot(scale * np.linalg.norm(spread[0]), np.linalg.norm(spread[1])) / np.linalg.norm(y))
    degrees = direction_error(x, y)
    turns = [_direction_deviation(*pair) for pair in ((x, spread[0]), (y, spread[1]))]
    stated_degrees = None if degrees is None else float(np.hypot(*turns))
    agree = off <= LIMIT * stated and (degrees is None or degrees <= LIMIT * stated_degrees)
    return {
        "order": order,
        "difference": off,
        "stated": stated,
        "degrees": degrees,
        "stated_degrees": stated_degrees,
        "agree": bool(agree),
    }


def _direction_deviation(coefficients, stddev) -> float:
    """Root mean square angle in degrees, at most 180, by which a main direction may be off."""
    rows = np.array([3, 1, 2])
    if len(coefficients) < 4 or main_direction(coefficients) is None:
        return 180.0
    direction = main_direction(coefficients)
    length = np.linalg.norm(coefficients[rows] @ REC709_LUMINANCE)
    across = 1 - direction**2  # what of an axis lies across the direction
    spread = (stddev[rows] @ REC709_LUMINANCE) ** 2 @ across
    return float(min(np.degrees(np.sqrt(spread) / length), 180.0))


def sphere_normals(size: int, view=FRONT):
    """Normals of a sphere that fills a square picture, seen orthographically.

    Returns
    -------
    normals : (size, size, 3) float64, unit; zero off the sphere
    inside : (size, size) bool
    """
    view = np.asarray(view, np.float64) / np.linalg.norm(view)
    right = np.cross(view, [0, 0, 1] if abs(view[2]) < 0.999 else [0, 1, 0])
    right /= np.linalg.norm(right)
    up = np.cross(right, view)
    x = (np.arange(size) + 0.5) / size * 2 - 1
    x, y = np.meshgrid(x, -x)
    inside = x * x + y * y < 1
    towards = np.sqrt(np.where(inside, 1 - x * x - y * y, 0))
    return (x[..., None] * right + y[..., None] * up - towards[..., None] * view) * inside[..., None], inside


def silver_factors(order: int, roughness: float = SILVER_ROUGHNESS) -> np.ndarray:
    """What a rough metal does to each order: (order + 1,), 1 at order 0.

    The lobe of GGX seen along the normal, D(theta / 2) cos(theta), normalised, taken to be the same around every
    mirrored direction; its Legendre moments are the factors (Funk and Hecke).
    """
    node, weight = np.polynomial.legendre.leggauss(256)
    cosine, weight = (node + 1) / 2, weight / 2  # over the hemisphere
    alpha2 = roughness**4
    half2 = (1 + cosine) / 2  # cos^2 of half the angle
    lobe = weight * cosine / (half2 * (alpha2 - 1) + 1) ** 2
    legendre = np.polynomial.legendre.legvander(cosine, order)
    return lobe @ legendre / lobe.sum()


def spheres(coefficients, *, size: int = 128, view=FRONT) -> dict[str, np.ndarray]:
    """Pictures of a grey diffuse, a matte silver and a mirror sphere, all white in colour, under a light.

    Parameters
    ----------
    coefficients : ((L + 1)^2, 3) float, linear Rec.709
    size, view : as in :func:`compare`

    Returns
    -------
    {"diffuse", "silver", "mirror": (size, size, 3) float64, linear, >= 0, NaN off the sphere}
    """
    x = np.asarray(coefficients, np.float64)
    order = sh.order_of(len(x))
    normals, inside = sphere_normals(size, view)
    n = normals[inside]
    eye = -np.asarray(view, np.float64) / np.linalg.norm(view)
    mirrored = 2 * (n @ eye)[:, None] * n - eye
    basis = sh.evaluate(order, mirrored)
    seen = {
        "diffuse": GREY / np.pi * sh.irradiance(x, n),
        "silver": basis @ (silver_factors(order)[sh.degrees(order), None] * x),
        "mirror": basis @ x,
    }
    out = {}
    for kind, values in seen.items():
        out[kind] = np.full((size, size, 3), np.nan)
        out[kind][inside] = np.maximum(values, 0)
    return out


def image_errors(a, b) -> dict:
    """{si_rmse, angular_degrees, normalised_rmse} of picture ``a`` against ``b : (h, w, 3)``, where neither is NaN."""
    both = np.isfinite(a).all(-1) & np.isfinite(b).all(-1)
    a, b = a[both], b[both]
    peak = float(np.percentile(b, PERCENTILES[1])) if len(b) else 0.0
    if peak <= 0:
        return {"si_rmse": None, "angular_degrees": None, "normalised_rmse": None}
    length_a, length_b = np.linalg.norm(a, axis=-1), np.linalg.norm(b, axis=-1)
    lit = (length_a > 1e-6 * max(length_a.max(), 1e-300)) & (length_b > 1e-6 * length_b.max())
    angle = None
    if lit.any():
        across = np.linalg.norm(np.cross(a[lit], b[lit]), axis=-1)
        angle = float(np.degrees(np.arctan2(across, (a[lit] * b[lit]).sum(-1))).mean())
    return {
        "si_rmse": float(np.sqrt(np.mean((best_scale(a, b) * a - b) ** 2)) / peak),
        "angular_degrees": angle,
        "normalised_rmse": float(np.sqrt(np.mean((_stretched(a) - _stretched(b)) ** 2))),
    }


def _stretched(a) -> np.ndarray:
    low, high = np.percentile(a, PERCENTILES)
    if high - low <= 1e-9 * abs(high):  # a picture of one value has no contrast to stretch
        return np.zeros_like(a)
    return (a - low) / (high - low)
