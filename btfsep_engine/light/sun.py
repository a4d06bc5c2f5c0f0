# SPDX-License-Identifier: GPL-3.0-or-later
"""A key light: a part of a light that comes from one direction, from a disc so small that a series cannot hold it."""

from dataclasses import dataclass

import numpy as np

from btfsep_engine import sh
from btfsep_engine.conventions import across, pixel_directions, pixel_solid_angles
from btfsep_engine.light.lightings import cap_factors

NARROWEST = 3.0  # pixels of a map: a sun is no narrower in it


@dataclass(frozen=True)
class Near:
    """How near a lamp stands: its light is other at every point, and what is said of it is said of ``centre``.

    Attributes
    ----------
    centre : (3,) float64, world: the middle of the objects
    distance : from it, in the lamp's direction, world units
    low, high : between which the distance lies with 95 %
    """

    centre: np.ndarray
    distance: float
    low: float
    high: float

    def __post_init__(self):
        object.__setattr__(self, "centre", np.asarray(self.centre, np.float64).reshape(3))


@dataclass(frozen=True)
class Sun:
    """A key light.

    Attributes
    ----------
    direction : (3,) float64, unit, world, to the light
    irradiance : (3,) float64, linear Rec.709, >= 0, on a surface that faces it, in the photo's own scale
    stddev : (3,) of the irradiance
    size_degrees : its most probable width; 0: a point will do
    direction_stddev_degrees : of the direction
    share : of the light's mean radiance, its own; None: what the irradiance is of the light that it is put into
    share_stddev : of the share
    near : where it is a lamp nearby; None: it is far away
    given : whether its direction was, and not found
    """

    direction: np.ndarray
    irradiance: np.ndarray
    stddev: np.ndarray
    size_degrees: float = 0.0
    direction_stddev_degrees: float = 0.0
    share: float | None = None
    share_stddev: float = 0.0
    near: Near | None = None
    given: bool = False

    def __post_init__(self):
        for name in ("direction", "irradiance", "stddev"):
            object.__setattr__(self, name, np.asarray(getattr(self, name), np.float64).reshape(3))
        object.__setattr__(self, "direction", self.direction / np.linalg.norm(self.direction))

    def coefficients(self, order: int) -> np.ndarray:
        """The sun in spherical harmonics: ((order + 1)^2, 3)."""
        return beam_shape(self.direction, order, size_degrees=self.size_degrees)[:, None] * self.irradiance

    def share_of(self, coefficients) -> float:
        """Its part of the mean radiance of the whole light with these coefficients ((L + 1)^2, 3); 0 of a black one."""
        whole = np.sqrt(4 * np.pi) * np.mean(coefficients[0])
        return float(self.irradiance.mean() / whole) if whole > 0 else 0.0

    def directions(self, count: int) -> np.ndarray:
        """Directions to points spread evenly over the disc: (count, 3), or (1, 3) where a point will do."""
        half = np.radians(self.size_degrees) / 2
        return cap_around(self.direction, half, count) if half > 0 else self.direction[None]

    def to_map(self, height: int, width: int) -> np.ndarray:
        """Radiance (height, width, 3): a disc of the sun's irradiance, at least `NARROWEST` pixels wide."""
        half = max(np.radians(self.size_degrees), NARROWEST * np.pi / height) / 2
        cosine = pixel_directions(height, width) @ self.direction
        # the edge is a pixel soft, so that the middle of a small disc stays where it is
        disc = np.clip((half - np.arccos(np.clip(cosine, -1, 1))) / (np.pi / height) + 0.5, 0, 1)
        received = (disc * np.clip(cosine, 0, 1) * pixel_solid_angles(height, width)[:, None]).sum()
        return disc[..., None] * (self.irradiance / received)


def beam_shape(direction, order: int, *, size_degrees: float = 0.0) -> np.ndarray:
    """The spherical harmonics ((order + 1)^2,) of a disc of unit irradiance about a direction."""
    cap = cap_factors(order, 2 * np.pi * (1 - np.cos(np.radians(size_degrees) / 2)))
    return sh.evaluate(order, np.asarray(direction, np.float64)) * cap[sh.degrees(order)]


def cap_around(direction, half_angle: float, count: int) -> np.ndarray:
    """``count`` directions spread evenly over the cap of ``half_angle`` radians about a unit direction: (count, 3)."""
    direction = np.asarray(direction, np.float64)
    a, b = across(direction)
    i = np.arange(count) + 0.5
    cosine = 1 - (1 - np.cos(half_angle)) * i / count
    azimuth = 2 * np.pi * i / ((1 + np.sqrt(5)) / 2)
    sine = np.sqrt(1 - cosine**2)[:, None]
    return cosine[:, None] * direction + sine * (np.cos(azimuth)[:, None] * a + np.sin(azimuth)[:, None] * b)
