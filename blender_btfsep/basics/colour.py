# SPDX-License-Identifier: GPL-3.0-or-later
"""The engine's colours, linear Rec.709, and those of the file's working space, which may be another in Blender 5."""

import numpy as np
from mathutils import Color

from .harmonics import LUMINANCE


def _matrix(convert) -> np.ndarray:
    """(3, 3) of a linear conversion, told by what it makes of red, green and blue; of none, exactly none."""
    found = np.array([convert(Color(row)) for row in np.eye(3)]).T
    return np.eye(3) if np.abs(found - np.eye(3)).max() < 1e-5 else found


def to_working(colours) -> np.ndarray:
    """(..., 3) linear Rec.709 in the working space."""
    return np.asarray(colours, np.float64) @ _matrix(Color.from_rec709_linear_to_scene_linear).T


def to_rec709(colours) -> np.ndarray:
    """(..., 3) of the working space in linear Rec.709."""
    return np.asarray(colours, np.float64) @ _matrix(Color.from_scene_linear_to_rec709_linear).T


def adjusted(colours, *, tint=(1.0, 1.0, 1.0), saturation: float = 1.0) -> np.ndarray:
    """``colours : (..., 3)`` as the node group's Saturation and Tint make them; not negative."""
    colours = np.asarray(colours, np.float64)
    grey = (colours @ LUMINANCE)[..., None]
    return np.maximum((grey + saturation * (colours - grey)) * np.asarray(tint), 0.0)
