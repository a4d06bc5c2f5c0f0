# SPDX-License-Identifier: GPL-3.0-or-later
"""What a photo's file says beside its pixels: how it is to be turned; why Blender may not read it. No bpy here."""

import struct
from pathlib import Path

_HEADER = 2**18  # bytes in which the tag is looked for
_ORIENTATION = 274
_EXPORT = "export it as JPEG, or as 16-bit TIFF"
_DEVELOP = "develop it, without a tone curve if you can, and save it as EXR or as 16-bit TIFF"
_RAW = ("3fr", "arw", "cr2", "cr3", "dng", "iiq", "nef", "nrw", "orf", "pef", "raf", "raw", "rw2", "srw", "x3f")
_UNREAD = (
    dict.fromkeys(("heic", "heif", "hif"), f"is a HEIC picture, which Blender does not read: {_EXPORT}")
    | {"avif": f"is an AVIF picture, which Blender does not read: {_EXPORT}"}
    | {"jxl": f"is a JPEG XL picture, which Blender does not read: {_EXPORT}"}
    | dict.fromkeys(_RAW, f"is a camera's raw file: {_DEVELOP}")
)


def unread(path) -> str:
    """Why Blender reads no pixels of a file of this name, and what to do, with a colon between; empty: not known."""
    return "" if path is None else _UNREAD.get(Path(path).suffix.lower().lstrip("."), "")


def orientation(path) -> int:
    """How the file at ``path`` says that its pixels are to be turned (EXIF, 1 to 8; 1: not, or not said)."""
    try:
        with open(path, "rb") as file:
            head = file.read(_HEADER)
    except OSError:
        return 1
    begin = 0 if head[:4] in (b"II*\0", b"MM\0*") else head.find(b"Exif\0\0") + 6
    if begin == 5:  # PNG and WebP have no such mark
        begin = max(head.find(mark) for mark in (b"eXIf", b"EXIF")) + (4 if head[:4] == b"\x89PNG" else 8)
    order = {b"II*\0": "<", b"MM\0*": ">"}.get(head[begin : begin + 4])
    if order is None:
        return 1
    try:
        (at,) = struct.unpack_from(order + "I", head, begin + 4)
        (count,) = struct.unpack_from(order + "H", head, begin + at)
        for place in range(begin + at + 2, begin + at + 2 + 12 * count, 12):
            tag, kind, length, value = struct.unpack_from(order + "HHIH", head, place)
            if (tag, kind, length) == (_ORIENTATION, 3, 1):
                return value if 1 <= value <= 8 else 1
    except struct.error:
        pass
    return 1
