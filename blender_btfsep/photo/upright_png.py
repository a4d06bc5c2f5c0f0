# SPDX-License-Identifier: GPL-3.0-or-later
"""A photo's codes as an upright PNG that says of camera and colours what the photo's own file says. No bpy here.

Chunks are those of the PNG specification, third edition; directories of tags those of TIFF 6.0, as EXIF has them.
"""

import contextlib
import struct
import zlib

import numpy as np

from ..basics.errors import InputError

_MAKER, _MODEL, _ORIENTATION, _SUBSAMPLING, _ICC = 271, 272, 274, 530, 34675
_COLOURS = (b"cICP", b"iCCP", b"sRGB", b"gAMA", b"cHRM")  # chunks that say what codes mean, in the order they are put
_PNG = b"\x89PNG\r\n\x1a\n"
_TIFF = {b"II*\0": "<", b"MM\0*": ">"}
_BROKEN = (struct.error, IndexError, KeyError, zlib.error)


def turned(codes, orientation: int) -> np.ndarray:
    """Codes (h, w, c), the top row first, as EXIF's ``orientation``, 1 to 8, asks for them to be shown."""
    codes = np.swapaxes(codes, 0, 1) if orientation > 4 else codes
    down, across = (-1 if orientation in back else 1 for back in ((3, 4, 7, 8), (2, 3, 6, 7)))
    return codes[::down, ::across]


def png_of(codes, file: bytes) -> bytes:
    """A PNG of upright codes (h, w, 4), uint8 or uint16, with what the bytes of the photo's ``file`` say beside them.

    It has their colour profile and their EXIF, which asks for no turn any more and says how coarse the colours were.
    Alpha is left out where all is opaque. Raises InputError: the file's colours are not RGB or grey.
    """
    said = {}
    with contextlib.suppress(*_BROKEN):
        said = _said(file)
    if not said.get("rgb", True):
        raise InputError("the photo", "its colours are not RGB (CMYK or Lab)", "convert it to RGB and save it again")
    grey = said.get("grey") and (codes[..., :1] == codes[..., 1:3]).all()
    channels = [0] if grey else [0, 1, 2]
    opaque = (codes[..., 3] == np.iinfo(codes.dtype).max).all()
    stored = np.ascontiguousarray(codes[..., channels if opaque else [*channels, 3]])
    height, width, count = stored.shape
    kind = {1: 0, 2: 4, 3: 2, 4: 6}[count]
    step = count * stored.itemsize
    rows = stored.astype(stored.dtype.newbyteorder(">"), copy=False).view(np.uint8).reshape(height, -1)
    filtered = np.empty((height, 1 + rows.shape[1]), np.uint8)
    filtered[:, 0] = 1  # each byte less that of the pixel to its left
    filtered[:, 1 : 1 + step] = rows[:, :step]
    np.subtract(rows[:, step:], rows[:, :-step], out=filtered[:, 1 + step :])
    chunks = [(b"IHDR", struct.pack(">IIBBBBB", width, height, 8 * stored.itemsize, kind, 0, 0, 0))]
    chunks += said.get("colours", [])
    chunks += [(b"eXIf", said["exif"])] if said.get("exif") else []
    chunks += [(b"IDAT", zlib.compress(filtered, 1)), (b"IEND", b"")]
    return _PNG + b"".join(
        struct.pack(">I", len(content)) + name + content + struct.pack(">I", zlib.crc32(name + content))
        for name, content in chunks
    )


def _said(file: bytes) -> dict:
    """Of a photo's file ``colours`` (chunks) and ``exif`` for a PNG, whether it is ``grey``, and ``rgb`` (or grey)."""
    parts, colours, icc, exif, coarse = [], [], None, None, None
    said = {"rgb": True, "grey": False}
    with contextlib.suppress(*_BROKEN):  # what stands before a break counts
        parts.extend(_parts(file))
    if file[:8] == _PNG:
        found = dict(reversed(parts))  # of two of a kind the first
        colours = [(name, found[name]) for name in _COLOURS if name in found]
        said["grey"] = file[25] in (0, 4)
        exif = found.get(b"eXIf")
    elif file[:2] == b"\xff\xd8":
        pieces = sorted(part[12:] for kind, part in parts if kind == 0xE2 and part[:12] == b"ICC_PROFILE\0")
        icc = b"".join(piece[2:] for piece in pieces)
        exif = next((part[6:] for kind, part in parts if kind == 0xE1 and part[:6] == b"Exif\0\0"), None)
        frames = (part for kind, part in parts if 0xC0 <= kind <= 0xCF and kind not in (0xC4, 0xC8, 0xCC))
        frame = next(frames, b"").ljust(11, b"\0")
        said["rgb"] = frame[5] != 4
        if frame[5] == 3:
            luma, chroma = frame[7], frame[10]  # sampling factors, of columns and of rows
            coarse = (luma >> 4) // (chroma >> 4 or 1), (luma & 15) // (chroma & 15 or 1)
    elif file[:4] == b"RIFF":
        found = dict(reversed(parts))
        icc, exif = found.get(b"ICCP"), found.get(b"EXIF", b"").removeprefix(b"Exif\0\0")
        coarse = (2, 2) if b"VP8 " in found else None
    elif file[:4] in _TIFF:
        icc, exif = _value(file, _directory(file).get(_ICC)), file
    if icc:
        colours = [(b"iCCP", b"ICC\0\0" + zlib.compress(icc))]
        said["rgb"], said["grey"] = icc[16:20] in (b"RGB ", b"GRAY"), icc[16:20] == b"GRAY"
    said["colours"] = colours
    if exif or coarse:
        exif = exif or b"II*\0\x08\0\0\0\0\0"
        with contextlib.suppress(*_BROKEN):
            said["exif"] = _upright(exif, coarse, whole=exif is not file)
    return said


def _parts(file: bytes):
    """Kind and content of each segment of a JPEG's header, of each chunk of a PNG or WebP."""
    if file[:2] == b"\xff\xd8":
        at = 2
        while file[at] == 0xFF and file[at + 1] != 0xDA:
            if file[at + 1] == 0xFF:  # padding
                at += 1
                continue
            (length,) = struct.unpack_from(">H", file, at + 2)
            yield file[at + 1], file[at + 4 : at + 2 + length]
            at += 2 + length
    elif file[:8] == _PNG or file[:4] == b"RIFF":
        png = file[:4] != b"RIFF"
        at = 8 if png else 12
        while at + 8 <= len(file):
            first, second = file[at : at + 4], file[at + 4 : at + 8]
            kind, length = (second, int.from_bytes(first)) if png else (first, int.from_bytes(second, "little"))
            yield kind, file[at + 8 : at + 8 + length] if kind not in (b"IDAT", b"VP8 ", b"VP8L") else b""
            at += 8 + length + (4 if png else length % 2)


def _directory(block: bytes) -> dict:
    """The first directory of a TIFF: tag -> its entry of 12 bytes, as it is."""
    order = _TIFF[block[:4]]
    (at,) = struct.unpack_from(order + "I", block, 4)
    (count,) = struct.unpack_from(order + "H", block, at)
    entries = (block[place : place + 12] for place in range(at + 2, at + 2 + 12 * count, 12))
    return {struct.unpack(order + "H", entry[:2])[0]: entry for entry in entries if len(entry) == 12}


def _value(block: bytes, entry: bytes | None) -> bytes:
    """The bytes that an entry of a TIFF, of texts or of bytes, stands for."""
    if entry is None:
        return b""
    length, at = struct.unpack(_TIFF[block[:4]] + "II", entry[4:])
    return entry[8 : 8 + length] if length <= 4 else block[at : at + length]


def _upright(block: bytes, coarse: tuple | None, *, whole: bool) -> bytes:
    """EXIF that asks for no turn; ``coarse`` : how many columns and rows share a colour, None: as it says.

    All of it is kept where it is but the first directory, which is written again at the end. Of a photo that is a TIFF
    itself (not ``whole``) the camera's name is kept.
    """
    order, entries = _TIFF[block[:4]], _directory(block)
    if not whole:
        texts = {tag: _value(block, entries[tag]) for tag in (_MAKER, _MODEL) if tag in entries}
        block, entries = block[:8], {}
        for tag, text in texts.items():
            entries[tag] = struct.pack(order + "HHII", tag, 2, len(text) + 4, len(block))
            block += text + bytes(4)  # longer than four bytes, so that it does not stand in the entry
    entries[_ORIENTATION] = struct.pack(order + "HHIHH", _ORIENTATION, 3, 1, 1, 0)
    if coarse:
        entries[_SUBSAMPLING] = struct.pack(order + "HHIHH", _SUBSAMPLING, 3, 2, *coarse)
    block += bytes(len(block) % 2)
    directory = struct.pack(order + "H", len(entries)) + b"".join(entries[tag] for tag in sorted(entries)) + bytes(4)
    return block[:4] + struct.pack(order + "I", len(block)) + block[8:] + directory
