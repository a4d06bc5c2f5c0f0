# SPDX-License-Identifier: GPL-3.0-or-later
"""The light that reaches an object beside a wall which nobody tells of: the most that its photograph could show."""

from functools import lru_cache

import numpy as np

from btfsep_engine import sh
from btfsep_engine.conventions import pixel_directions, pixel_solid_angles
from btfsep_engine.light.lightings import shrink
from btfsep_engine.light.maps import read_map
from scripts.cycles.lights import light_path
from scripts.studies.stability import scenes

ROWS = 256  # of a map that is looked at


@lru_cache(maxsize=16)
def coefficients(light: str, distance: float) -> np.ndarray:
    """The light (terms, 3) at the object's middle, of order `scenes.ORDER`: that of the map, and of the wall before it.

    The wall is `scripts.cycles.studio.add_wall`'s: matt, lit by the map alone, as it is at its own middle.

    Parameters
    ----------
    light : of the studio, by name, or a map's path
    distance : of the wall, in the object's radii
    """
    radiance = read_map(light_path(light))
    radiance = np.array(shrink(radiance, max(1, len(radiance) // ROWS)), np.float64)
    directions, towards = pixel_directions(*radiance.shape[:2]), scenes.unit(scenes.WALL_FROM)
    facing, weights = directions @ towards, pixel_solid_angles(*radiance.shape[:2])[:, None]
    irradiance = np.einsum("hw,hwc->c", weights * np.maximum(-facing, 0), radiance)
    up = scenes.unit(np.array([0, 0, 1]) - towards[2] * towards)
    along = np.stack([directions @ up, directions @ np.cross(towards, up)])
    inside = (facing > 0) & (np.abs(along).max(0) * distance < facing * scenes.WALL_EDGE / 2)
    radiance[inside] = np.array(scenes.WALL_COLOUR) / np.pi * irradiance
    return sh.project_map(radiance, scenes.ORDER)
