# SPDX-License-Identifier: GPL-3.0-or-later
"""What the headers of image files say: kind, size, how they store and code colours, which camera they are from.

Nothing here decodes a picture, and nothing that a header claims is trusted: what cannot be followed says nothing.
"""

import contextlib
import re
import struct
import zlib
from typing import NamedTuple

_TIFF = (b"II*\0", b"MM\0*")
_PNG = b"\x89PNG\r\n\x1a\n"
_JPEG = b"\xff\xd8"
_WIDTH, _HEIGHT, _MAKER, _MODEL = 256, 257, 271, 272  # tags of TIFF, and of EXIF in it
_SUBFILE, _PHOTOMETRIC, _ORIENTATION, _SUBSAMPLING, _ICC, _DNG = 254, 262, 274, 530, 34675, 50706
_EXIF, _INTEROPERABILITY, _INDEX, _FLASH = 0x8769, 0xA005, 1, 0x9209
_INTEGERS = {3: "H", 4: "I"}  # types of TIFF
_TEXT = 2
_COMMENT = 0xFE  # a segment of JPEG
_LONGEST = 100  # bytes of a name
_LARGEST_PROFILE = 2**22  # bytes
_MOST_PARTS = 2**17  # segments or chunks that are looked through: pictures have fewer, files that lie may have millions
_KINDS = "save it as EXR, HDR, PNG, JPEG, TIFF or WebP"
_DEVELOP = "develop it, without a tone curve if you can, and save it as EXR or as 16-bit TIFF"
_TO_TIFF = "export it as JPEG, or as 16-bit TIFF"
_TO_PNG = "export it as JPEG, PNG or 16-bit TIFF"
_TO_EXR = "convert it to scene-linear and save it as EXR"
_OTHERS = (  # files that are not read: what they are, what to do, and how they begin, or go on from the fifth byte
    ("a camera's raw file", _DEVELOP, (b"FUJIFILMCCD-RAW", b"IIRO", b"IIRS", b"IIU\0", b"\0MRM"), b"ftypcrx"),
    ("a HEIC picture", _TO_TIFF, (), (b"ftyphei", b"ftyphev")),
    ("a HEIC or AVIF picture", _TO_TIFF, (), (b"ftypmif", b"ftypmsf")),
    ("an AVIF picture", _TO_PNG, (), b"ftypavi"),
    ("a movie", "save its frames as PNG, EXR or 16-bit TIFF", b"\x1aE\xdf\xa3", b"ftyp"),
    ("a JPEG XL picture", _TO_PNG, b"\xff\x0a", b"JXL "),
    ("a DPX picture", _TO_EXR, (b"SDPX", b"XPDS"), ()),
    ("a Cineon picture", _TO_EXR, b"\x80\x2a\x5f\xd7", ()),
    ("a Photoshop document", _KINDS, b"8BPS", ()),
    ("a GIMP document", _KINDS, b"gimp xcf", ()),
    ("a GIF", "save what it was made from as PNG: a GIF has 256 colours", b"GIF8", ()),
    ("a PDF", _KINDS, b"%PDF", ()),
    ("a drawing", _KINDS, b"<svg", ()),
)


class Coding(NamedTuple):
    """What a file says of what its codes mean, as it says it.

    ``icc`` : the bytes of a profile; ``cicp`` : primaries, transfer, matrix and range (ITU-T H.273); ``gamma`` : the
    exponent by which codes become light; ``chromaticities`` : x, y of red, green, blue and white; ``is_adobe`` : EXIF's
    R03.
    """

    icc: bytes | None = None
    cicp: bytes | None = None
    is_srgb: bool = False
    gamma: float | None = None
    chromaticities: tuple | None = None
    is_adobe: bool = False


def size(data: bytes) -> tuple[int, int] | None:
    """(width, height) that the header of a PNG, JPEG, TIFF, WebP or HDR claims, before anything is decoded, or None."""
    with contextlib.suppress(struct.error, IndexError):
        if data[:8] == _PNG:
            return struct.unpack(">II", data[16:24])
        if data[:2] == _JPEG:
            return _size_of_jpeg(data)
        if data[:4] in _TIFF:
            return _size_of_tiff(data)
        if data[:4] == b"RIFF" and data[8:12] == b"WEBP":
            return _size_of_webp(data)
        if data[:2] == b"#?":
            found = re.search(rb"\n-Y (\d{1,9}) \+X (\d{1,9})\s", data[:65536])
            return (int(found[2]), int(found[1])) if found else None
    return None


def is_jpeg(data: bytes) -> bool:
    """Whether a file that begins so is a JPEG."""
    return data[:2] == _JPEG


def has_coarse_chroma(data: bytes) -> bool:
    """Whether a file stores colours at less resolution than brightness; a PNG, whether EXIF says that of its source."""
    with contextlib.suppress(struct.error, IndexError):
        if data[:2] == _JPEG:
            at = _jpeg_frame(data)
            if at is None or data[at + 5] < 3:
                return False
            luma, *chroma = (data[at + 7 + 3 * i] for i in range(3))  # sampling factors, of columns and of rows
            return any(luma > other for other in chroma)
        exif = _exif(data) if data[:8] == _PNG else None
        for tag, kind, length, at in () if exif is None else _entries(exif):
            if (tag, kind, length) == (_SUBSAMPLING, 3, 2):
                return max(struct.unpack(("<" if exif[:2] == b"II" else ">") + "HH", exif[at : at + 4])) > 1
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


def flash_fired(data: bytes) -> bool | None:
    """Whether a camera says that its flash fired (EXIF); None where it says nothing."""
    with contextlib.suppress(struct.error, IndexError):
        exif = _exif(data)
        at = None if exif is None else _tags(exif).get(_EXIF)
        said = _tags(exif, at).get(_FLASH) if isinstance(at, int) and 0 < at < len(exif) else None
        return bool(said & 1) if isinstance(said, int) else None
    return None


def is_render(data: bytes) -> bool:
    """Whether Blender says in a PNG or JPEG that it rendered it: the time that this took, or which scene it was."""
    said = []
    with contextlib.suppress(struct.error, IndexError):
        if data[:8] == _PNG:
            each = _chunks(data, 8, ">", before_kind=True, tail=4)
            texts = (data[at : at + min(length, _LONGEST)] for kind, at, length in each if kind == b"tEXt")
            said = [text.partition(b"\0")[0] for text in texts]
        elif data[:2] == _JPEG:
            comments = (data[at : at + length] for marker, at, length in _jpeg_segments(data) if marker == _COMMENT)
            said = [text[8:].partition(b":")[0] for text in comments if text.startswith(b"Blender:")]
    return b"RenderTime" in said or {b"Scene", b"Frame"} <= set(said)


def is_tiff(data: bytes) -> bool:
    """Whether bytes begin as a TIFF does."""
    return data[:4] in _TIFF


def refused(data: bytes) -> tuple[str, str] | None:
    """Why a file is not read though it may be decodable, or what it is that is not, and what to do; else None."""
    with contextlib.suppress(struct.error, IndexError):
        for what, do, begins, goes_on in _OTHERS:
            if data.startswith(begins) or data[4:12].startswith(goes_on):
                return f"it is {what}", do
        if data[:4] in _TIFF:
            tags = _tags(data)
            small = isinstance(tags.get(_SUBFILE), int) and tags[_SUBFILE] & 1
            if data[8:10] == b"CR" or small or _DNG in tags or tags.get(_PHOTOMETRIC) in (32803, 34892):
                return "it is a camera's raw file, or a preview of one", _DEVELOP
            if tags.get(_PHOTOMETRIC) in (5, 8, 9, 10):
                return "its colours are not RGB (CMYK or Lab)", "convert it to RGB and save it again"
        at = _jpeg_frame(data) if data[:2] == _JPEG else None
        if at is not None and data[at + 5] == 4:
            return "its colours are CMYK, for printing", "convert it to RGB and save it again"
    return None


def orientation(data: bytes) -> int:
    """How a file says that it is to be turned and mirrored (EXIF, 1 to 8); 1 where it says nothing: as stored."""
    with contextlib.suppress(struct.error, IndexError):
        exif = _exif(data)
        found = None if exif is None else _tags(exif).get(_ORIENTATION)
        return found if found in range(1, 9) else 1
    return 1


def as_stored(data: bytes) -> bytes:
    """The bytes of a TIFF that does not say that it is to be turned, of which decoders take notice; others as is."""
    if data[:4] not in _TIFF:
        return data
    with contextlib.suppress(struct.error, IndexError):
        order = "<" if data[:2] == b"II" else ">"
        for tag, kind, length, at in _entries(data):
            if tag == _ORIENTATION and kind == 3 and length == 1:
                return data[:at] + struct.pack(order + "H", 1) + data[at + 2 :]
    return data


def coding(data: bytes) -> Coding:
    """What a PNG, JPEG, TIFF or WebP says of the meaning of its codes."""
    said = {}
    with contextlib.suppress(struct.error, IndexError, zlib.error):
        if data[:8] == _PNG:
            said = _coding_of_png(data)
        elif data[:2] == _JPEG:
            said["icc"] = _icc_of_jpeg(data)
        elif data[:4] in _TIFF:
            found = next((entry for entry in _entries(data) if entry[0] == _ICC), None)
            if found is not None:
                (at,) = struct.unpack(("<" if data[:2] == b"II" else ">") + "I", data[found[3] : found[3] + 4])
                said["icc"] = data[at : at + min(found[2], _LARGEST_PROFILE)]
        elif data[:4] == b"RIFF":
            said["icc"] = _chunk(data, 12, b"ICCP", "<", before_kind=False, tail=0)
        said["is_adobe"] = _is_adobe(data)
    return Coding(**said)


def _coding_of_png(data: bytes) -> dict:
    said, kinds = {}, (b"cICP", b"iCCP", b"sRGB", b"gAMA", b"cHRM")
    chunks = {kind: _chunk(data, 8, kind, ">", before_kind=True, tail=4) for kind in kinds}
    if chunks[b"cICP"] and len(chunks[b"cICP"]) == 4:
        said["cicp"] = chunks[b"cICP"]
    if chunks[b"iCCP"]:
        packed = chunks[b"iCCP"].partition(b"\0")[2][1:]
        said["icc"] = b""
        with contextlib.suppress(zlib.error):
            said["icc"] = zlib.decompressobj().decompress(packed, _LARGEST_PROFILE)
    said["is_srgb"] = chunks[b"sRGB"] is not None
    if chunks[b"gAMA"]:
        (times,) = struct.unpack(">I", chunks[b"gAMA"][:4])
        said["gamma"] = 1e5 / times if times else 0.0
    if chunks[b"cHRM"]:
        white, *primaries = struct.iter_unpack(">2I", chunks[b"cHRM"][:32])
        said["chromaticities"] = tuple(n / 1e5 for pair in (*primaries, white) for n in pair)
    return said


def _icc_of_jpeg(data: bytes) -> bytes | None:
    """The profile, which may lie in several segments."""
    parts = {}
    for marker, at, length in _jpeg_segments(data):
        if marker == 0xDA:  # the picture begins
            break
        if marker == 0xE2 and data[at : at + 12] == b"ICC_PROFILE\0":
            parts[data[at + 12]] = data[at + 14 : at + length]
    return b"".join(parts[number] for number in sorted(parts))[:_LARGEST_PROFILE] if parts else None


def _is_adobe(data: bytes) -> bool:
    """Whether EXIF says R03: Adobe RGB, as cameras state it that embed no profile."""
    exif = _exif(data)
    tags = {} if exif is None else _tags(exif)
    for tag in (_EXIF, _INTEROPERABILITY):
        at = tags.get(tag)
        tags = _tags(exif, at) if isinstance(at, int) and 0 < at < len(exif) else {}
    return tags.get(_INDEX) == "R03"


def _jpeg_segments(data: bytes):
    """Of the header of a JPEG each segment's marker, where its contents begin, and their length."""
    at = 2
    for _ in range(_MOST_PARTS):
        if at >= len(data) or data[at] != 0xFF:
            return
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
    if data[:2] == _JPEG:
        for marker, at, length in _jpeg_segments(data):
            if marker == 0xE1 and data[at : at + 6] == b"Exif\0\0":
                return data[at + 6 : at + length]
    elif data[:8] == _PNG:
        return _chunk(data, 8, b"eXIf", ">", before_kind=True, tail=4)
    elif data[:4] == b"RIFF":
        found = _chunk(data, 12, b"EXIF", "<", before_kind=False, tail=0)
        return found.removeprefix(b"Exif\0\0") if found else None
    return None


def _chunk(data: bytes, at: int, wanted: bytes, order: str, *, before_kind: bool, tail: int) -> bytes | None:
    """Of a file of chunks the first that is ``wanted``."""
    each = _chunks(data, at, order, before_kind=before_kind, tail=tail)
    return next((data[place : place + length] for kind, place, length in each if kind == wanted), None)


def _chunks(data: bytes, at: int, order: str, *, before_kind: bool, tail: int):
    """Kind, place and length of each of a file's chunks; their length stands before their kind, or behind it."""
    for _ in range(_MOST_PARTS):
        head = data[at : at + 8]
        if len(head) < 8:
            return
        kind, length = (head[4:], head[:4]) if before_kind else (head[:4], head[4:])
        (length,) = struct.unpack(order + "I", length)
        yield kind, at + 8, length
        at += 8 + length + tail + (0 if before_kind else length % 2)


def _entries(data: bytes, at: int | None = None):
    """Of a directory of a TIFF, the first or that ``at`` a place, each entry's tag, type, length and place of value."""
    order = "<" if data[:2] == b"II" else ">"
    if at is None:
        (at,) = struct.unpack(order + "I", data[4:8])
    (count,) = struct.unpack(order + "H", data[at : at + 2])
    for place in range(at + 2, at + 2 + 12 * count, 12):
        tag, kind, length = struct.unpack(order + "HHI", data[place : place + 8])
        yield tag, kind, length, place + 8


def _tags(data: bytes, at: int | None = None) -> dict:
    """The integers and texts of a directory of a TIFF (as of `_entries`), by their tags."""
    order = "<" if data[:2] == b"II" else ">"
    tags = {}
    for tag, kind, length, place in _entries(data, at):
        entry = data[place : place + 4]
        if kind in _INTEGERS and length == 1:
            form = order + _INTEGERS[kind]
            (tags[tag],) = struct.unpack(form, entry[: struct.calcsize(form)])
        elif kind == _TEXT and length <= _LONGEST:
            (begin,) = struct.unpack(order + "I", entry)
            text = entry[:length] if length <= 4 else data[begin : begin + length]
            tags[tag] = "".join(c for c in text.split(b"\0")[0].decode("ascii", "replace") if c.isprintable()).strip()
        else:
            tags.setdefault(tag, None)
    return tags
