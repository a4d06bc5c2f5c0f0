# SPDX-License-Identifier: GPL-3.0-or-later
"""What a photo's file says beside its pixels: how to turn it, of what kind they are, who made it. No bpy here."""

import io
import struct
from pathlib import Path
from typing import NamedTuple

_HEADER = 2**18  # bytes in which the tag is looked for
_MAKER, _MODEL, _ORIENTATION, _SAMPLE_FORMAT = 271, 272, 274, 339
_RENDERED = (b"tEXtRenderTime\0", b"Blender:RenderTime:")
_OF_A_SCENE = ((b"tEXtScene\0", b"tEXtFrame\0"), (b"Blender:Scene:", b"Blender:Frame:"))
PHONES = (
    "apple", "google", "samsung", "xiaomi", "redmi", "poco", "huawei", "honor", "oneplus", "oppo", "realme", "vivo",
    "motorola", "hmd", "nokia", "nothing", "fairphone", "lge", "lg electronics", "htc", "zte", "tecno", "infinix",
)  # fmt: skip
# makers of phones, as the engine has them; SAMSUNG in capitals made cameras
_LONGEST = 64  # bytes of a maker's name
_TIFF = {b"II*\0": "<", b"MM\0*": ">"}
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


class FileFacts(NamedTuple):
    """What a file says: how its pixels are to be turned (EXIF, 1 to 8; 1: not), who made it."""

    orientation: int = 1
    is_by_camera: bool = False
    is_render: bool = False
    is_by_phone: bool = False


def facts_of(file) -> FileFacts:
    """What a file (its path, or its bytes) says."""
    head, tags = _begin(file), _tags(file)
    turned = tags.get(_ORIENTATION)
    rendered = any(mark in head for mark in _RENDERED) or any(all(m in head for m in marks) for marks in _OF_A_SCENE)
    made = " ".join(tags[tag] for tag in (_MAKER, _MODEL) if isinstance(tags.get(tag), str)) + " "
    by_phone = made.casefold().startswith(tuple(f"{maker} " for maker in PHONES)) and not made.startswith("SAMSUNG ")
    return FileFacts(turned if turned in range(1, 9) else 1, bool({_MAKER, _MODEL} & set(tags)), rendered, by_phone)


def holds_floats(path, file: bytes | None = None) -> bool:
    """Whether the file at ``path`` is a TIFF of floating-point numbers, which Blender takes for coded ones.

    ``file`` : its bytes, where it may not lie there
    """
    is_tiff = Path(path).suffix.lower() in (".tif", ".tiff")
    return is_tiff and _tags(path if file is None else file).get(_SAMPLE_FORMAT) == 3


def _begin(source) -> bytes:
    """The first bytes of a file; none where it cannot be read."""
    if isinstance(source, bytes):
        return source[:_HEADER]
    try:
        with open(source, "rb") as file:
            return file.read(_HEADER)
    except OSError:
        return b""


def _tags(source) -> dict:
    """The tags of a TIFF, or of the EXIF in another file, each with its text, its (first) 16-bit number, or None."""
    tags = {}
    try:
        with io.BytesIO(source) if isinstance(source, bytes) else open(source, "rb") as file:
            head = file.read(_HEADER)
            begin = 0 if head[:4] in _TIFF else head.find(b"Exif\0\0") + 6
            if begin == 5:  # PNG and WebP have no such mark
                begin = max(head.find(mark) for mark in (b"eXIf", b"EXIF")) + (4 if head[:4] == b"\x89PNG" else 8)
            order = _TIFF.get(head[begin : begin + 4])
            if order is None:
                return tags
            file.seek(begin + struct.unpack_from(order + "I", head, begin + 4)[0])  # of a TIFF it may lie at the end
            (count,) = struct.unpack(order + "H", file.read(2))
            for tag, kind, length, value in struct.iter_unpack(order + "HHI4s", file.read(12 * count)):
                if kind == 3 and length > 2:
                    file.seek(begin + struct.unpack(order + "I", value)[0])
                    value = file.read(2)
                if kind == 2 and tag in (_MAKER, _MODEL):
                    tags.setdefault(tag, _text(file, begin, order, length, value))
                else:
                    tags.setdefault(tag, struct.unpack(order + "H", value[:2])[0] if kind == 3 else None)
    except (OSError, struct.error):
        pass
    return tags


def _text(file, begin: int, order: str, length: int, value: bytes) -> str:
    """A tag's text of ``length`` bytes: ``value`` itself, or what stands in a TIFF's bytes from ``begin`` on there."""
    if length > 4:
        file.seek(begin + struct.unpack(order + "I", value)[0])
        value = file.read(min(length, _LONGEST))
    return value[:length].partition(b"\0")[0].decode("ascii", "replace").strip()
