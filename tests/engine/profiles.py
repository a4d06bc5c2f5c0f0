# SPDX-License-Identifier: GPL-3.0-or-later
"""Colour profiles (ICC), written out by hand as cameras and editors embed them, and files that have one."""

import struct
import zlib

import cv2
import numpy as np

# The colorants that the published profiles have, relative to D50.
COLORANTS = {
    "p3": ((0.51512, 0.24120, -0.00105), (0.29198, 0.69225, 0.04189), (0.15710, 0.06657, 0.78407)),
    "adobe": ((0.60974, 0.31111, 0.01947), (0.20528, 0.62567, 0.06087), (0.14919, 0.06322, 0.74457)),
    "prophoto": ((0.79767, 0.28804, 0), (0.13519, 0.71188, 0), (0.03134, 0.00009, 0.82491)),
    "srgb": ((0.43607, 0.22249, 0.01392), (0.38515, 0.71687, 0.09708), (0.14307, 0.06061, 0.71410)),
}


def fixed(*values) -> bytes:
    """s15Fixed16Numbers."""
    return b"".join(struct.pack(">i", round(v * 65536)) for v in values)


SRGB_CURVE = b"para\0\0\0\0\0\3\0\0" + fixed(2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045)
LINEAR_CURVE = b"curv\0\0\0\0\0\0\0\0"


def power(gamma: float) -> bytes:
    """The curve of an exponent."""
    return b"curv\0\0\0\0" + struct.pack(">IH", 1, round(gamma * 256))


def table(function, count: int = 1024) -> bytes:
    """The curve of a function, in a table."""
    values = [round(65535 * function(i / (count - 1))) for i in range(count)]
    return b"curv\0\0\0\0" + struct.pack(f">I{count}H", count, *values)


def icc(name: str, curve: bytes, kind: bytes = b"RGB ") -> bytes:
    """A profile of colorants and a curve; of ``kind`` b"GRAY" the curve alone."""
    tags = {b"wtpt": b"XYZ \0\0\0\0" + fixed(0.9642, 1, 0.8249)}
    if kind == b"GRAY":
        tags[b"kTRC"] = curve
    else:
        for channel, colorant in zip((b"r", b"g", b"b"), COLORANTS[name], strict=True):
            tags |= {channel + b"XYZ": b"XYZ \0\0\0\0" + fixed(*colorant), channel + b"TRC": curve}
    head = b"\0\0\0\0lcms\x02\x40\0\0mntr" + kind + b"XYZ " + bytes(12) + b"acsp" + bytes(28) + fixed(0.9642, 1, 0.8249)
    at, listed, body = 132 + 12 * len(tags), struct.pack(">I", len(tags)), b""
    for tag, value in tags.items():
        listed += tag + struct.pack(">II", at + len(body), len(value))
        body += value + bytes(-len(value) % 4)
    whole = head.ljust(128, b"\0") + listed + body
    return struct.pack(">I", len(whole)) + whole[4:]


def chunk(kind: bytes, content: bytes) -> bytes:
    """A chunk of PNG."""
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))


def png(picture, *chunks: bytes) -> bytes:
    """A PNG of codes (h, w, 3 or 1) with chunks behind its header."""
    data = cv2.imencode(".png", picture[..., ::-1])[1].tobytes()
    return data[:33] + b"".join(chunks) + data[33:]


def with_profile(suffix: str, picture, profile: bytes) -> bytes:
    """A file of codes (h, w, 3 or 1) with a profile; that of a JPEG lies in two segments, the second one first."""
    if suffix == ".png":
        return png(picture, chunk(b"iCCP", b"any\0\0" + zlib.compress(profile)))
    if suffix == ".jpg":
        data = cv2.imencode(suffix, picture[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 100])[1].tobytes()
        half, segments = len(profile) // 2, b""
        for number, part in ((2, profile[half:]), (1, profile[:half])):
            content = b"ICC_PROFILE\0" + bytes((number, 2)) + part
            segments += b"\xff\xe2" + struct.pack(">H", len(content) + 2) + content
        return data[:2] + segments + data[2:]
    if suffix == ".webp":
        data = cv2.imencode(suffix, picture[..., ::-1], [cv2.IMWRITE_WEBP_QUALITY, 101])[1].tobytes()
        height, width = (n - 1 for n in picture.shape[:2])
        vp8x = struct.pack("<IB3x", 10, 0x20) + width.to_bytes(3, "little") + height.to_bytes(3, "little")
        body = b"WEBPVP8X" + vp8x + b"ICCP" + struct.pack("<I", len(profile)) + profile + bytes(len(profile) % 2)
        body += data[12:]
        return b"RIFF" + struct.pack("<I", len(body)) + body
    return tiff(picture, {34675: (7, len(profile), profile)})


def tiff(picture, more=None, *, photometric: int = 2) -> bytes:
    """A little-endian TIFF of codes (h, w, c), 8 or 16 bit, with ``more`` entries: tag to (type, count, content)."""
    h, w, c = picture.shape
    bits = 8 * picture.dtype.itemsize
    pixels = np.ascontiguousarray(picture).tobytes()
    entries = {
        256: (3, 1, struct.pack("<H", w)),
        257: (3, 1, struct.pack("<H", h)),
        258: (3, c, struct.pack(f"<{c}H", *[bits] * c)),
        259: (3, 1, struct.pack("<H", 1)),
        262: (3, 1, struct.pack("<H", photometric)),
        273: (4, 1, b""),
        277: (3, 1, struct.pack("<H", c)),
        278: (3, 1, struct.pack("<H", h)),
        279: (4, 1, struct.pack("<I", len(pixels))),
    } | (more or {})
    at = 8 + 2 + 12 * len(entries) + 4
    directory, beyond = struct.pack("<H", len(entries)), b""
    long = sum(len(content) + len(content) % 2 for _, _, content in entries.values() if len(content) > 4)
    for tag, (kind, count, content) in sorted(entries.items()):
        if tag == 273:
            content = struct.pack("<I", at + long)
        directory += struct.pack("<HHI", tag, kind, count)
        if len(content) > 4:
            directory += struct.pack("<I", at + len(beyond))
            beyond += content + bytes(len(content) % 2)
        else:
            directory += content.ljust(4, b"\0")
    return b"II*\0" + struct.pack("<I", 8) + directory + bytes(4) + beyond + pixels
