# SPDX-License-Identifier: GPL-3.0-or-later
"""What the headers of image files say: their size, how they store colours, which camera they are from.

Nothing here decodes a picture, and nothing that a header claims is trusted: what cannot be followed says nothing.
"""

import contextlib
import re
import struct

_TIFF = (b"II*\0", b"MM\0*")
_WIDTH, _HEIGHT, _MAKER, _MODEL = 256, 257, 271, 272  # tags of TIFF, and of EXIF in it
_INTEGERS = {3: "H", 4: "I"}  # types of TIFF
_TEXT = 2
_LONGEST = 100  # bytes of a name


def size(data: bytes) -> tuple[int, int] | None:
    """(width, height) that the header of a PNG, JPEG, TIFF, WebP or HDR claims, before anything is decoded, or None."""
    with contextlib.suppress(struct.error, IndexError):
        if data[:8] == b"\x89PNG\r\n\x1a\n":
            return struct.unpack(">II", data[16:24])
        if data[:2] == b"\xff\xd8":
            return _size_of_jpeg(data)
        if data[:4] in _TIFF:
            return _size_of_tiff(data)
        if data[:4] == b"RIFF" and data[8:12] == b"WEBP":
            return _size_of_webp(data)
        if data[:2] == b"#?":
            found = re.search(rb"\n-Y (\d{1,9}) \+X (\d{1,9})\s", data[:65536])
            return (int(found[2]), int(found[1])) if found else None
    return None


def has_coarse_chroma(data: bytes) -> bool:
    """Whether a file stores colours at less resolution than brightness."""
    with contextlib.suppress(struct.error, IndexError):
        if data[:2] == b"\xff\xd8":
            at = _jpeg_frame(data)
            if at is None or data[at + 5] < 3:
                return False
            luma, *chroma = (data[at + 7 + 3 * i] for i in range(3))  # sampling factors, of columns and of rows
            return any(luma > other for other in chroma)
        return data[:4] == b"RIFF" and data[8:12] == b"WEBP" and b"VP8 " in data[12:64]
    return False


def camera(data: bytes) -> str:
    """Maker and model, as a JPEG, TIFF, PNG or WebP has them from its camera (EXIF); empty where it names none."""
    with contextlib.suppress(struct.error, IndexError):
        exif = _exif(data)
        if exif is not None:
            tags = _tags(exif)
            maker, model = (tags[tag] if isinstance(tags.get(tag), str) else "" for tag in (_MAKER, _MODEL))
            return (model if model.casefold().startswith(maker.casefold()) else f"{maker} {model}").strip()
    return ""


def _jpeg_segments(data: bytes):
    """Of the header of a JPEG each segment's marker, where its contents begin, and their length."""
    at = 2
    while at < len(data) and data[at] == 0xFF:
        marker = data[at + 1]
        if marker == 0xFF:  # padding
            at += 1
            continue
        (length,) = struct.unpack(">H", data[at + 2 : at + 4])
        yield marker, at + 4, length - 2
        at += 2 + length


def _jpeg_frame(data: bytes) -> int | None:
    """Where the contents of the header of a JPEG's frame begin; None: nowhere."""
    kinds = {kind for kind in range(0xC0, 0xD0) if kind not in (0xC4, 0xC8, 0xCC)}
    return next((at for marker, at, _ in _jpeg_segments(data) if marker in kinds), None)


def _size_of_jpeg(data: bytes):
    at = _jpeg_frame(data)
    return None if at is None else struct.unpack(">HH", data[at + 1 : at + 5])[::-1]


def _size_of_tiff(data: bytes):
    tags = _tags(data)
    found = tags.get(_WIDTH), tags.get(_HEIGHT)
    return found if all(isinstance(value, int) for value in found) else None


def _size_of_webp(data: bytes):
    kind = data[12:16]
    if kind == b"VP8X":
        return 1 + int.from_bytes(data[24:27], "little"), 1 + int.from_bytes(data[27:30], "little")
    if kind == b"VP8L":
        bits = int.from_bytes(data[21:25], "little")
        return 1 + (bits & 0x3FFF), 1 + (bits >> 14 & 0x3FFF)
    width, height = struct.unpack("<HH", data[26:30])
    return width & 0x3FFF, height & 0x3FFF


def _exif(data: bytes) -> bytes | None:
    """The block of EXIF of a file, which is a TIFF without a picture; None where it has none."""
    if data[:4] in _TIFF:
        return data
    if data[:2] == b"\xff\xd8":
        for marker, at, length in _jpeg_segments(data):
            if marker == 0xE1 and data[at : at + 6] == b"Exif\0\0":
                return data[at + 6 : at + length]
    elif data[:8] == b"\x89PNG\r\n\x1a\n":
        return _chunk(data, 8, b"eXIf", ">", before_kind=True, tail=4)
    elif data[:4] == b"RIFF":
        found = _chunk(data, 12, b"EXIF", "<", before_kind=False, tail=0)
        return found.removeprefix(b"Exif\0\0") if found else None
    return None


def _chunk(data: bytes, at: int, wanted: bytes, order: str, *, before_kind: bool, tail: int) -> bytes | None:
    """Of a file of chunks the first that is ``wanted``; its length stands before its kind, or behind it."""
    while at + 8 <= len(data):
        head = data[at : at + 8]
        kind, length = (head[4:], head[:4]) if before_kind else (head[:4], head[4:])
        (length,) = struct.unpack(order + "I", length)
        if kind == wanted:
            return data[at + 8 : at + 8 + length]
        at += 8 + length + tail + (0 if before_kind else length % 2)
    return None


def _tags(data: bytes) -> dict:
    """The integers and texts of the first directory of a TIFF, by their tags."""
    order = "<" if data[:2] == b"II" else ">"
    (at,) = struct.unpack(order + "I", data[4:8])
    (count,) = struct.unpack(order + "H", data[at : at + 2])
    tags = {}
    for i in range(count):
        entry = data[at + 2 + 12 * i : at + 14 + 12 * i]
        tag, kind, length = struct.unpack(order + "HHI", entry[:8])
        if kind in _INTEGERS and length == 1:
            form = order + _INTEGERS[kind]
            (tags[tag],) = struct.unpack(form, entry[8 : 8 + struct.calcsize(form)])
        elif kind == _TEXT and length <= _LONGEST:
            (begin,) = struct.unpack(order + "I", entry[8:12])
            text = entry[8 : 8 + length] if length <= 4 else data[begin : begin + length]
            tags[tag] = "".join(c for c in text.split(b"\0")[0].decode("ascii", "replace") if c.isprintable()).strip()
    return tags
