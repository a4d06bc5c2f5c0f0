# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures in the panel: the traffic light, the light that was found, thumbnails of materials."""

import hashlib

import bpy.utils.previews
import numpy as np

from ..basics import pixels

LIGHTS = {"GREEN": (0.25, 0.75, 0.3), "AMBER": (1.0, 0.65, 0.1), "RED": (0.9, 0.22, 0.2), "NONE": (0.45, 0.45, 0.45)}
SIDE = 32  # pixels of a traffic light
KEPT = 8  # pictures of lights: of more scenes than that at once, all are made anew each time
OF_IMAGE = "image "

_previews = None


def light(trust: str) -> int:
    """The icon of a traffic light: GREEN, AMBER, RED or NONE."""
    trust = trust if trust in LIGHTS else "NONE"
    if trust not in _previews:
        c = (np.arange(SIDE) + 0.5) / SIDE * 2 - 1
        disc = np.clip((0.72 - np.hypot(*np.meshgrid(c, c))) * SIDE / 2 + 0.5, 0, 1)
        rgba = np.concatenate([np.tile(LIGHTS[trust], (SIDE, SIDE, 1)), np.ones((SIDE, SIDE, 1))], -1)
        rgba = rgba * disc[..., None]  # icons have their alpha multiplied in
        _put(_previews.new(trust), rgba)
        _put(_previews[trust], rgba, icon=True)
    return _previews[trust].icon_id


def of_image(image) -> int:
    """The icon of a packed image, made anew where the image is another one."""
    key = OF_IMAGE + hashlib.sha256(image.packed_file.data if image.packed_file else image.name.encode()).hexdigest()
    if key not in _previews:
        old = [each for each in _previews if each.startswith(OF_IMAGE)]
        for each in old[: max(len(old) + 1 - KEPT, 0)]:  # Live brings a picture with each light
            del _previews[each]
        _put(_previews.new(key), pixels.read(image))
    return _previews[key].icon_id


def of_file(path: str) -> int:
    """The icon of a picture file; 0 where it cannot be read."""
    preview = preview_of_file(path)
    return 0 if preview is None else preview.icon_id


def preview_of_file(path: str):
    """The bpy.types.ImagePreview of a picture file; None where it cannot be read."""
    if path not in _previews:
        try:
            _previews.load(path, path, "IMAGE")
        except (KeyError, RuntimeError):
            return None
    return _previews[path]


def _put(preview, rgba, *, icon: bool = False) -> None:
    """Gives a preview, or its small icon, the pixels (h, w, 4), the lowest row first."""
    name = "icon" if icon else "image"
    setattr(preview, f"{name}_size", rgba.shape[1::-1])
    getattr(preview, f"{name}_pixels_float").foreach_set(np.asarray(rgba, np.float32).ravel())


def register():
    global _previews
    _previews = bpy.utils.previews.new()


def unregister():
    global _previews
    bpy.utils.previews.remove(_previews)
    _previews = None
