# SPDX-License-Identifier: GPL-3.0-or-later
"""Lights without extent: M points, or M directions. Their shadows are exact, one ray for each point and light."""

from dataclasses import dataclass

import numpy as np


def _checked(a, count: int | None = None) -> np.ndarray:
    a = np.atleast_2d(np.asarray(a, np.float64))
    if a.ndim != 2 or a.shape[1] != 3 or not np.isfinite(a).all() or (count is not None and len(a) != count):
        raise ValueError(f"an array of shape {a.shape} instead of ({'M' if count is None else count}, 3), finite")
    return a


@dataclass(frozen=True)
class PointLights:
    """M points that send light evenly in all directions, each a light of its own.

    Attributes
    ----------
    positions : (M, 3) float64, world
    intensities : (M, 3) float64, linear Rec.709, radiant intensity: at distance r (world units) a surface that faces
        the light receives intensity / r^2
    """

    positions: np.ndarray
    intensities: np.ndarray

    def __post_init__(self):
        object.__setattr__(self, "positions", _checked(self.positions))
        object.__setattr__(self, "intensities", _checked(self.intensities, len(self.positions)))

    @property
    def count(self) -> int:
        return len(self.positions)

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(f"point {i}" for i in range(self.count))

    def arriving(self, number: int, positions) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """What light ``number`` sends to ``positions : (n, 3)``, as if nothing were in between.

        Returns
        -------
        directions : (n, 3) float64, unit, to the light
        distances : (n,) float64, world units
        irradiance : (n, 3) float64, on a surface at right angles to the direction
        """
        towards = self.positions[number] - np.asarray(positions, np.float64)
        distance = np.maximum(np.linalg.norm(towards, axis=1), 1e-300)
        return towards / distance[:, None], distance, self.intensities[number] / distance[:, None] ** 2


@dataclass(frozen=True)
class DirectionalLights:
    """M lights from infinitely far away, each from one direction.

    Attributes
    ----------
    directions : (M, 3) float64, unit, world, **to** the light (they are normalised here)
    irradiances : (M, 3) float64, linear Rec.709, on a surface that faces the light
    """

    directions: np.ndarray
    irradiances: np.ndarray

    def __post_init__(self):
        directions = _checked(self.directions)
        length = np.linalg.norm(directions, axis=1, keepdims=True)
        if not (length > 0).all():
            raise ValueError("a direction of length 0")
        object.__setattr__(self, "directions", directions / length)
        object.__setattr__(self, "irradiances", _checked(self.irradiances, len(directions)))

    @property
    def count(self) -> int:
        return len(self.directions)

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(f"direction {i}" for i in range(self.count))

    def arriving(self, number: int, positions) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """As `PointLights.arriving`; the distance is infinite."""
        n = len(positions)
        return (
            np.broadcast_to(self.directions[number], (n, 3)),
            np.full(n, np.inf),
            np.broadcast_to(self.irradiances[number], (n, 3)),
        )
