# SPDX-License-Identifier: GPL-3.0-or-later
"""The look of a photo that a camera saved: its tone curve as the RGB curves of Blender's colour management.

The engine undoes that curve (its `camera_curve`); a render that is to look as the photo does needs it back.
"""

import numpy as np

from ..light import kept_light
from ..photo import photo

GAIN, POWER = 2.1, 0.58  # as the engine's
READ_BY = "a camera's usual curve"  # the engine's words
BY_CAMERA = ("camera", "phone")  # of the panel's curves
RADIANCE = (0.0, 0.005, 0.015, 0.03, 0.055, 0.09, 0.14, 0.2, 0.28, 0.38, 0.5, 0.63, 0.78, 1.0)
CLOSE = 1e-4


def shown(radiance) -> np.ndarray:
    """What a camera displays, linear, of linear radiance, 1: white; the engine's `camera_curve.to_display`."""
    power = np.asarray(radiance, np.float64) ** (1 + POWER)
    k = np.expm1(GAIN)
    return (1 + k) * power / (1 + k * power)


def is_wanted(scene) -> bool:
    """Whether the scene's photo was, or is to be, read by the usual curve of cameras."""
    settings = scene.btfsep
    if settings.image is None or photo.of_floats(settings.image) or settings.curve not in ("auto", *BY_CAMERA):
        return False
    light = kept_light.kept(scene)
    said = kept_light.card(light).get("details", ()) if light else ()
    return settings.curve in BY_CAMERA or any(READ_BY in each for each in said)


def is_set(view) -> bool:
    """Whether a scene's view settings have the camera's curve, and no other."""
    if not view.use_curve_mapping:
        return False
    *single, combined = view.curve_mapping.curves
    there = np.array([point.location for point in combined.points])
    straight = all(np.allclose([p.location for p in each.points], ((0, 0), (1, 1)), atol=CLOSE) for each in single)
    return straight and len(there) == len(RADIANCE) and np.allclose(there.T, (RADIANCE, shown(RADIANCE)), atol=CLOSE)


def set_curve(view) -> None:
    """Gives a scene's view settings the camera's curve, in place of any other."""
    view.use_curve_mapping = True
    *single, combined = view.curve_mapping.curves
    for curve in single:
        _draw(curve, (0.0, 1.0), (0.0, 1.0))
    _draw(combined, RADIANCE, shown(RADIANCE))
    mapping = view.curve_mapping
    mapping.extend, mapping.black_level, mapping.white_level = "HORIZONTAL", (0, 0, 0), (1, 1, 1)
    mapping.update()


def _draw(curve, x, y) -> None:
    """Gives a curve these points and no others."""
    places = [(float(a), float(b)) for a, b in zip(x, y, strict=True)]
    while len(curve.points) > 2:  # Blender keeps two
        curve.points.remove(curve.points[1])
    curve.points[0].location, curve.points[1].location = places[0], places[-1]
    for place in places[1:-1]:
        curve.points.new(*place)
    for point in curve.points:
        point.handle_type = "AUTO_CLAMPED"
