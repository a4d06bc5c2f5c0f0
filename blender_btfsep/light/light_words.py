# SPDX-License-Identifier: GPL-3.0-or-later
"""A light in an artist's words: from where, how hard, how warm. No bpy in this file."""

import colorsys
import math

import numpy as np

from ..basics.harmonics import LUMINANCE, evaluate

HARD, SOFT = 1.5, 8.0  # degrees: the width of a lamp whose shadows are sharp, and of one whose shadows have no edge
EVEN, ONE_SIDED = 0.3, 1.0  # how much brighter than the mean the brighter side is
WARMTH = (  # up to so many kelvin; 6500 is Blender's white
    (3200, "orange"),
    (4500, "warm"),
    (5700, "warm white"),
    (7500, "white"),
    (10000, "cool"),
    (15000, "blue"),
)
FROM_PLANCK = 0.02  # of the CIE 1960 chromaticity: further from it no temperature says what the colour is
TO_XYZ = ((0.4124, 0.3576, 0.1805), (0.2126, 0.7152, 0.0722), (0.0193, 0.1192, 0.9505))  # of linear Rec.709
HUES = ("red", "orange", "yellow", "green", "green", "green", "cyan", "blue", "blue", "violet", "magenta", "pink")


def angles(direction, to_world=None) -> tuple[float, float]:
    """Where a light stands, in degrees: round from the camera's own side (right: positive), and above the horizon.

    Parameters
    ----------
    direction : (3,) float, to the light, world, z up
    to_world : (4, 4) float, of the camera; None: round from +X towards +Y
    """
    d = np.asarray(direction, float) / np.linalg.norm(direction)
    up = math.degrees(math.asin(np.clip(d[2], -1, 1)))
    if to_world is None:
        return math.degrees(math.atan2(d[1], d[0])), up
    m = np.asarray(to_world, float)
    # The horizontal way back to the camera; of one that looks straight down or up, from the picture's lower edge.
    back = m[:2, 2] if np.hypot(*m[:2, 2]) > 0.1 else -m[:2, 1]
    back = back / max(np.hypot(*back), 1e-9)
    right = np.array([-back[1], back[0]])
    return math.degrees(math.atan2(d[:2] @ right, d[:2] @ back)), up


def direction_words(direction, to_world) -> str:
    """From where a light comes, seen from the camera: "front left, 40° up"."""
    around, up = angles(direction, to_world)
    if abs(up) > 70:
        return f"{'above' if up > 0 else 'below'}, {abs(up):.0f}°"
    side = "right" if around > 0 else "left"
    sector = round(abs(around) / 45)
    place = ("the front", f"front {side}", side, f"back {side}", "behind")[sector]
    degrees = f" ({abs(around):.0f}° round)" if 0 < sector < 4 else ""
    return f"{place}{degrees}, {abs(up):.0f}° {'up' if up >= 0 else 'down'}"


def size_words(degrees: float) -> str:
    """How sharp the shadows of a lamp of that width are."""
    return "hard" if degrees < HARD else "fairly hard" if degrees < SOFT else "soft"


def kelvin(rgb) -> float | None:
    """Correlated colour temperature of linear Rec.709 ``rgb``; None where no temperature has that colour.

    McCamy's formula (1992); the distance is to Krystek's approximation (1985) of the Planckian locus.
    """
    xyz = np.array(TO_XYZ) @ np.maximum(np.asarray(rgb, float), 0)
    if xyz.sum() <= 0:
        return None
    x, y = xyz[:2] / xyz.sum()
    if abs(0.1858 - y) < 1e-6:
        return None
    n = (x - 0.3320) / (0.1858 - y)
    t = ((449 * n + 3525) * n + 6823.3) * n + 5520.33
    if not 1700 <= t <= 15000:
        return None
    u = (0.860117757 + 1.54118254e-4 * t + 1.28641212e-7 * t * t) / (1 + 8.42420235e-4 * t + 7.08145163e-7 * t * t)
    v = (0.317398726 + 4.22806245e-5 * t + 4.20481691e-8 * t * t) / (1 - 2.89741816e-5 * t + 1.61456053e-7 * t * t)
    d = -2 * x + 12 * y + 3
    return t if math.hypot(4 * x / d - u, 6 * y / d - v) < FROM_PLANCK else None


def colour_words(rgb) -> str:
    """The colour of a light: "warm (3400 K)", or its hue where no temperature has it."""
    t = kelvin(rgb)
    if t is not None:
        return f"{next(word for end, word in WARMTH if t <= end)} ({round(t, -2):.0f} K)"
    rgb = np.maximum(np.asarray(rgb, float), 0)
    return HUES[round(12 * colorsys.rgb_to_hsv(*rgb)[0]) % 12] if rgb.max() > 0 else "dark"


def brighter_side(coefficients) -> tuple[np.ndarray, float]:
    """Direction (3,) from which more light comes, and how much more: 0 even, 3 a single lamp.

    ``coefficients`` : ((L + 1)^2, 3). Of a radiance a + b . d the answer is b / |b| and |b| / a.
    """
    c = np.asarray(coefficients, float) @ LUMINANCE
    if len(c) < 4 or c[0] <= 0:
        return np.array([0.0, 0.0, 1.0]), 0.0
    b = np.array([-c[3], -c[1], c[2]])
    length = float(np.linalg.norm(b))
    return (b / length if length else np.array([0.0, 0.0, 1.0])), length * math.sqrt(3) / float(c[0])


def irradiance(coefficients, normals) -> np.ndarray:
    """(..., 3) irradiance by a light of ``coefficients`` ((L + 1)^2, 3) on surfaces of ``normals`` (..., 3), unit.

    The cosine's own harmonics end, but for 4 %, with order 2 (Ramamoorthi and Hanrahan 2001).
    """
    c = np.asarray(coefficients, float)[:9]
    order = math.isqrt(len(c)) - 1
    cosine = np.repeat([np.pi, 2 * np.pi / 3, np.pi / 4][: order + 1], 2 * np.arange(order + 1) + 1)
    return np.maximum(evaluate(order, normals) @ (cosine[:, None] * c), 0)
