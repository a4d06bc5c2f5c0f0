# SPDX-License-Identifier: GPL-3.0-or-later
"""Images of Blender as arrays, and arrays as images. Blender's first row is the lowest."""

import bpy
import numpy as np


def read(image) -> np.ndarray:
    """(h, w, channels) float32 of an image, the lowest row first; empty where it has no pixels."""
    flat = np.empty(image.size[0] * image.size[1] * image.channels, np.float32)
    image.pixels.foreach_get(flat)
    return flat.reshape(image.size[1], image.size[0], image.channels)


def colours(image) -> np.ndarray:
    """As :func:`read`, red, green and blue alone: (h, w, 3); grey is all three."""
    pixels = read(image)
    return pixels[..., :3] if image.channels > 2 else np.repeat(pixels[..., :1], 3, -1)


def move(image, into) -> bool:
    """Gives ``into`` the pixels of ``image``, which goes, and packs it; gives whether their kinds let it."""
    if image.channels != into.channels or image.is_float != into.is_float:
        return False
    if tuple(into.size) != tuple(image.size):
        into.scale(*image.size)
    into.pixels.foreach_set(read(image).ravel())
    into.update()
    into.pack()
    bpy.data.images.remove(image)
    return True


def repack(image, data: bytes) -> None:
    """Gives a packed image of a file the bytes of another such file, whatever its size."""
    image.pack(data=data, data_len=len(data))
    image.buffers_free()  # what was read of the file before
    image.gl_free()


def new(name: str, values, *, floats: bool = True):
    """An image of ``values`` (h, w, 3) or (h, w), the lowest row first; ``floats``: numbers, kept as they are.

    Without ``floats`` they are 0 to 1, coded in sRGB.
    """
    height, width = values.shape[:2]
    image = bpy.data.images.new(name, width, height, alpha=False, float_buffer=floats, is_data=floats)
    rgba = np.ones((height, width, 4), np.float32)
    rgba[..., :3] = values if values.ndim == 3 else values[..., None]
    image.pixels.foreach_set(rgba.ravel())
    image.update()
    return image
