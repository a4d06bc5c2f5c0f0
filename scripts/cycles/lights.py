# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender's own environment maps, which are the test lights and never used for training; read without Blender."""

import importlib.util
from functools import lru_cache
from pathlib import Path

import numpy as np

from btfsep_engine import sh
from btfsep_engine.light.maps import read_map

AROUND = "around.exr"  # of a scene: the map of what is seen from the object's middle, where maps do not say all


@lru_cache(maxsize=1)
def studio_lights() -> dict:
    """name -> path."""
    blender = Path(importlib.util.find_spec("bpy").origin).parent
    return {path.stem: path for path in sorted(blender.glob("*/datafiles/studiolights/world/*.exr"))}


def light_path(light) -> Path:
    """The path of a light: one of :func:`studio_lights` by name, or a path as it is."""
    return studio_lights().get(str(light)) or Path(light)


@lru_cache(maxsize=16)
def _projected(path: str, order: int) -> np.ndarray:
    return sh.project_map(read_map(path), order)


def true_lighting(light, order: int, *, rotation=None) -> np.ndarray:
    """SH coefficients of a light, turned by a 3 x 3 ``rotation``: ((order + 1)^2, 3) float64."""
    x = _projected(str(light_path(light)), order)
    return x if rotation is None else sh.rotation_matrix(order, rotation) @ x
