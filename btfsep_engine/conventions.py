# SPDX-License-Identifier: GPL-3.0-or-later
"""Axes, environment maps, angles: every convention of BTFsep, in this one module.

- World: right-handed, Z up (Blender's). Directions point away from the surface.
- Radiance: linear Rec.709.
- Camera: looks along its -Z with +Y up; pixel (0, 0) is the top left one, its centre is (0.5, 0.5).
- Environment maps: equirectangular as Blender reads them,
  u = 1/2 - atan2(y, x) / 2 pi over the width, v = 1/2 + asin(z) / pi upward, row 0 is up (+Z).
- BTF angles: theta from the local normal, phi = atan2 against the tangent; omega_i goes to the light,
  omega_o to the eye.
- Spherical harmonics: see :mod:`btfsep_engine.sh`.

The page for people is ``docs/conventions.md``.
"""

import numpy as np

REC709_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


def luminance(pixels) -> np.ndarray:
    """(...,) luminance of ``pixels : (..., 3) float, linear Rec.709``."""
    return np.asarray(pixels) @ REC709_LUMINANCE.astype(np.asarray(pixels).dtype)


def grey(values, axis: int = -1) -> np.ndarray:
    """Linear Rec.709 floats with their luminance in every channel, as wide; ``axis`` : that of the three."""
    alone = luminance(np.moveaxis(np.asarray(values), axis, -1))
    return np.ascontiguousarray(np.moveaxis(np.repeat(alone[..., None], 3, -1), -1, axis))


def equirect_to_direction(u, v):
    """Directions of equirectangular coordinates.

    Parameters
    ----------
    u, v : array_like, in [0, 1], u to the right from the left edge, v **upward** from the bottom edge

    Returns
    -------
    (..., 3) float64, unit, world, z up
    """
    azimuth = 2 * np.pi * (0.5 - np.asarray(u, np.float64))
    elevation = np.pi * (np.asarray(v, np.float64) - 0.5)
    c = np.cos(elevation)
    return np.stack([c * np.cos(azimuth), c * np.sin(azimuth), np.sin(elevation) * np.ones_like(azimuth)], -1)


def direction_of_angles(elevation, azimuth):
    """(..., 3) float64 unit, world, of degrees above the horizon, and of azimuth from +X towards +Y."""
    return equirect_to_direction(0.5 - np.asarray(azimuth) / 360, 0.5 + np.asarray(elevation) / 180)


def angles_of_direction(direction):
    """Degrees above the horizon, and azimuth from +X towards +Y in (-180, 180], of a unit vector (3,)."""
    x, y, z = direction
    return float(np.degrees(np.arcsin(np.clip(z, -1, 1)))), float(np.degrees(np.arctan2(y, x)))


def direction_to_equirect(directions):
    """Equirectangular coordinates (u, v) in [0, 1] of ``directions : (..., 3) float, unit``; v is upward."""
    d = np.asarray(directions, np.float64)
    u = 0.5 - np.arctan2(d[..., 1], d[..., 0]) / (2 * np.pi)
    v = 0.5 + np.arcsin(np.clip(d[..., 2], -1, 1)) / np.pi
    return u, v


def pixel_directions(height: int, width: int):
    """Directions of the pixel centres of an equirectangular map.

    Gives (height, width, 3) float64, unit, world; row 0 is up.
    """
    u = (np.arange(width) + 0.5) / width
    v = 1 - (np.arange(height) + 0.5) / height
    return equirect_to_direction(u[None, :], v[:, None])


def pixel_solid_angles(height: int, width: int):
    """Solid angle of each pixel of an equirectangular map, exact.

    Gives (height,) float64, steradians of one pixel in each row; times ``width`` they sum to 4 pi.
    """
    z = np.cos(np.pi * np.arange(height + 1) / height)
    return (z[:-1] - z[1:]) * 2 * np.pi / width


def local_direction(theta, phi):
    """(..., 3) float64 unit vectors, in the local frame (tangent, bitangent, normal), of BTF angles in radians."""
    theta, phi = np.broadcast_arrays(np.asarray(theta, np.float64), np.asarray(phi, np.float64))
    s = np.sin(theta)
    return np.stack([s * np.cos(phi), s * np.sin(phi), np.cos(theta)], -1)


def across(direction) -> np.ndarray:
    """Two unit vectors across a unit direction (3,) and each other: (2, 3)."""
    first = np.cross(direction, np.eye(3)[np.abs(direction).argmin()])
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(direction, first)])


def fibonacci_sphere(n: int):
    """n well-spread directions over the sphere, each standing for the solid angle 4 pi / n.

    Gives (n, 3) float64, unit.
    """
    i = np.arange(n) + 0.5
    z = 1 - 2 * i / n
    azimuth = 2 * np.pi * i / ((1 + np.sqrt(5)) / 2)
    r = np.sqrt(1 - z * z)
    return np.stack([r * np.cos(azimuth), r * np.sin(azimuth), z], -1)
