# SPDX-License-Identifier: GPL-3.0-or-later
"""An upright copy of a photo whose file asks to be turned, which Blender does not do.

The copy is a PNG of the photo's own codes, packed into the .blend: nothing is written to a disk, and what the engine
reads (profile, camera, coarse colours) comes along.
"""

import os

import bpy
import numpy as np

from ..basics import pixels
from ..basics.errors import InputError
from ..basics.scratch import scratch
from . import photo, photo_file, upright_png

_EDITOR = "turn it in the program that made it, and open that"


def orientation_of(image) -> int:
    """How the file of ``image`` asks for it to be turned (EXIF, 1 to 8); 1: not, or the image is no file's."""
    return photo.facts_of_image(image).orientation


def copy_of(image):
    """A new bpy.types.Image: ``image`` turned as its file asks for. Raises InputError, and leaves nothing then."""
    named, orientation = f"the photo '{image.name}'", orientation_of(image)
    if orientation == 1:
        raise InputError(named, "its file does not ask to be turned", "leave it as it is")
    if not all(image.size):
        raise InputError(named, *f"it {photo.lacks_pixels(image)}".split(": "))
    path = photo.file_of(image)
    try:
        file = image.packed_file.data if image.packed_file else path.read_bytes()
    except OSError as error:
        raise InputError(named, error, "choose it again") from None
    if photo_file.holds_floats(path, file):
        raise InputError(named, "its pixels are floating-point numbers", _EDITOR)
    with scratch() as own:
        stored = own(image.copy())
        stored.colorspace_settings.name = "Non-Color"  # codes as in the file, whatever its alpha is taken for
        kind = np.uint16 if stored.is_float else np.uint8
        codes = pixels.read(stored)
    codes = np.rint(np.multiply(codes, np.iinfo(kind).max, out=codes), out=codes).astype(kind)[::-1]
    if codes.ndim != 3 or codes.shape[-1] != 4:
        raise InputError(named, "its pixels are neither colours nor grey", _EDITOR)
    try:
        data = upright_png.png_of(upright_png.turned(codes, orientation), file)
    except InputError as error:
        raise InputError(named, error.got, error.do) from None
    upright = bpy.data.images.new(f"{os.path.splitext(image.name)[0]} upright", 1, 1)
    upright.pack(data=data, data_len=len(data))
    upright.source = "FILE"
    # where Unpack puts it; nothing is there now
    upright.filepath_raw = f"{os.path.splitext(str(path) if image.library else image.filepath_raw)[0]} upright.png"
    upright.colorspace_settings.name, upright.alpha_mode = image.colorspace_settings.name, image.alpha_mode
    return upright
