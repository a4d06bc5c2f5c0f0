# SPDX-License-Identifier: GPL-3.0-or-later
"""UBO2014 ``.btf`` files: the full-matrix-factorised layouts ``!FMF…`` and ``!DFMF…``.

Little-endian and packed: a common header, the angular sampling, then the factors U (one row per view and light)
and SxV (one row per texel). In a file, cos(theta_i) may be multiplied in (the header's flag says so); in memory
it never is. Files whose factors live in the log domain (dynamic range reduction, colour models other than none)
are told and refused: they would have to be decoded texel by texel and factorised anew.

Every count is checked against what is left of the file before anything is allocated.
"""

import struct
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from btfsep_engine.atomic import replacing
from btfsep_engine.btf.model import Tabulated
from btfsep_engine.conventions import local_direction
from btfsep_engine.errors import InputError

FMF_SIGNATURES = (b"!FMF12FCER", b"!FMF06FCR", b"!FMF06FC")  # the longest match wins
DFMF_SIGNATURES = (b"!DFMF08FCR",)
UNSUPPORTED = {b"!PVF06FC": "a per-view PCA file", b"!BDIF06R2": "an uncompressed measurement"}
SCALARS = {2: np.dtype("<f2"), 4: np.dtype("<f4"), 8: np.dtype("<f8")}
CLASSES = ("carpet", "fabric", "felt", "leather", "stone", "wallpaper", "wood")
MAX_FILE_BYTES = 4 << 30
MAX_TEXELS = 4096 * 4096
EXPORT = "export or download the file again"


@dataclass(frozen=True)
class Header:
    """What a ``.btf`` file says about itself, before the factors.

    Attributes
    ----------
    signature : str
    pixels_per_mm : float, 0 when the file does not say
    cosine_in_data : bool, cos(theta_i) is multiplied into the data
    channels : tuple of str
    views, lights : (n, 3) float64, unit, local frame
    width, height : texels
    setup, sensor, light_source, xml : str, free text
    """

    signature: str
    pixels_per_mm: float
    cosine_in_data: bool
    channels: tuple
    views: np.ndarray
    lights: np.ndarray
    width: int
    height: int
    setup: str = ""
    sensor: str = ""
    light_source: str = ""
    xml: str = ""
    height_mm: np.ndarray | None = field(default=None, repr=False)


class _Cursor:
    """Reads packed values from a file, never past its end."""

    def __init__(self, handle, size: int, path: Path):
        self.handle, self.size, self.path = handle, size, path

    def fail(self, got: str, do: str = EXPORT):
        return InputError(str(self.path), got, do)

    def raw(self, count: int, what: str) -> bytes:
        left = self.size - self.handle.tell()
        if count > left:
            raise self.fail(f"the file is cut short: {what} needs {count} bytes, {left} are left")
        return self.handle.read(count)

    def unpack(self, layout: str, what: str):
        values = struct.unpack("<" + layout, self.raw(struct.calcsize("<" + layout), what))
        return values if len(values) > 1 else values[0]

    def text(self, count: int, what: str) -> str:
        return self.raw(count, what).split(b"\0")[0].decode("utf-8", "replace").strip()

    def array(self, dtype, shape: tuple, what: str) -> np.ndarray:
        dtype, count = np.dtype(dtype), 1
        for extent in shape:
            count *= int(extent)
        return np.frombuffer(self.raw(count * dtype.itemsize, what), dtype).reshape(shape)


def read(
    path,
    *,
    name: str | None = None,
    material_class: str | None = None,
    cosine: bool | None = None,
    flip_v: bool = False,
) -> Tabulated:
    """Reads a ``.btf`` file.

    Parameters
    ----------
    path : path of the file
    name, material_class : as the material is to be called; None: from the file's name
    cosine : whether cos(theta_i) is in the data; None: as the header says
    flip_v : turns the rows of texels over (files with row 0 at the largest v)

    Raises
    ------
    InputError
        Not such a file, cut short, inconsistent, not finite, or of a kind that is not supported yet.
    """
    path = Path(path)
    with _opened(path) as (handle, size):
        cursor = _Cursor(handle, size, path)
        header = _read_header(cursor)
        layout = _read_fmf if header.signature.startswith("!FMF") else _read_dfmf
        angular, texels, _ = layout(cursor, header)
    for factor, label in ((angular, "the angular factor"), (texels, "the spatial factor")):
        if not np.isfinite(factor).all():
            raise InputError(str(path), f"{label} holds NaN or infinite values", EXPORT)
    if header.cosine_in_data if cosine is None else cosine:
        angular /= np.maximum(header.lights[:, 2], 1e-3).astype(np.float32)[None, :, None, None]
    if flip_v:
        texels = texels[::-1]
    stem = path.name.split(".")[0]
    if material_class is None:
        material_class = next((c for c in CLASSES if stem.lower().startswith(c)), "unknown")
    return Tabulated(
        name=name or stem,
        material_class=material_class,
        texels=np.ascontiguousarray(texels),
        angular=np.ascontiguousarray(angular),
        views=header.views,
        lights=header.lights,
        texel_mm=1 / header.pixels_per_mm if header.pixels_per_mm > 0 else 0.25,
    )


def read_header(path) -> Header:
    """The :class:`Header` of a ``.btf`` file, with its height map (mm) when it holds one. Errors as :func:`read`."""
    path = Path(path)
    with _opened(path) as (handle, size):
        cursor = _Cursor(handle, size, path)
        header = _read_header(cursor)
        height = _read_fmf_preamble(cursor, header) if header.signature.startswith("!FMF12") else None
    return Header(**{**header.__dict__, "height_mm": height})


class _opened:
    """The open file and its size; OS errors become InputError."""

    def __init__(self, path: Path):
        self.path = path

    def __enter__(self):
        try:
            size = self.path.stat().st_size
            self.handle = self.path.open("rb")
        except OSError as error:
            raise InputError(f"cannot read {self.path}", error.strerror or str(error), "check the path") from error
        if size > MAX_FILE_BYTES:
            self.handle.close()
            raise InputError(str(self.path), f"{size} bytes are more than a .btf file can have", EXPORT)
        return self.handle, size

    def __exit__(self, *exception):
        self.handle.close()


def _read_header(cursor: _Cursor) -> Header:
    start = cursor.handle.read(10)
    signature = next((s for s in FMF_SIGNATURES + DFMF_SIGNATURES if start.startswith(s)), None)
    if signature is None:
        for known, words in UNSUPPORTED.items():
            if start.startswith(known):
                raise cursor.fail(f"{words} is not supported yet", "use the resampled, factorised .btf file")
        raise cursor.fail("it does not begin like a UBO2014 .btf file", "give a file of the !FMF or !DFMF kind")
    begin = len(signature)
    cursor.handle.seek(begin)
    struct_size, version = cursor.unpack("II", "the header")
    setup, sensor, source = (cursor.text(80, "the header") for _ in range(3))
    pixels_per_mm = cursor.unpack("f", "the header")
    cursor.unpack("3f", "the header")
    cosine = bool(cursor.unpack("I", "the header")) if version > 1 else False
    xml = cursor.text(cursor.unpack("I", "the header"), "the XML text") if version > 2 else ""
    channels = ("R", "G", "B")
    if version > 3:
        count = cursor.unpack("I", "the header")
        if count != 3:
            raise cursor.fail(f"{count} colour channels; only RGB is supported", "give an RGB file")
        channels = tuple(cursor.text(cursor.unpack("I", "a name"), "a channel's name") for _ in range(count))
    if cursor.handle.tell() != begin + struct_size:
        raise cursor.fail("the header's length does not agree with its content")
    if not (np.isfinite(pixels_per_mm) and 0 <= pixels_per_mm < 1e4):
        raise cursor.fail(f"{pixels_per_mm} pixels per millimetre")
    views, lights = _read_directions(cursor)
    width, height = cursor.unpack("II", "the texel counts")
    if not (0 < width and 0 < height and width * height <= MAX_TEXELS):
        raise cursor.fail(f"{width} x {height} texels")
    if signature.endswith(b"R"):
        rotations = cursor.unpack("I", "the local frames")
        cursor.array("<f4", (rotations, 9), "the local frames")
    return Header(
        signature=signature.decode(),
        pixels_per_mm=pixels_per_mm,
        cosine_in_data=cosine,
        channels=channels,
        views=views,
        lights=lights,
        width=width,
        height=height,
        setup=setup,
        sensor=sensor,
        light_source=source,
        xml=xml,
    )


def _read_directions(cursor: _Cursor):
    """Views (n, 3) and the light list (m, 3), which has to be the same in every view."""
    count = cursor.unpack("I", "the views")
    if count < 1 or count * 12 > cursor.size:
        raise cursor.fail(f"{count} view directions")
    views, lights = [], None
    for _ in range(count):
        views.append(cursor.unpack("2f", "a view direction"))
        n = cursor.unpack("I", "the lights")
        if n < 1:
            raise cursor.fail("a view without lights")
        here = cursor.array("<f4", (n, 2), "the light directions")
        if lights is not None and not (len(lights) == n and np.array_equal(lights, here)):
            raise cursor.fail("views with different light lists are not supported yet", "resample the file")
        lights = here
    angles = [np.array(views, np.float64), np.array(lights, np.float64)]
    for a in angles:
        if not np.isfinite(a).all():
            raise cursor.fail("directions that are not finite")
        if a[:, 0].min() < -1e-6 or a[:, 0].max() >= np.pi / 2:
            raise cursor.fail("directions at or below the horizon")
    return tuple(local_direction(*a.T) for a in angles)


def _read_fmf_preamble(cursor: _Cursor, header: Header) -> np.ndarray | None:
    """The extra header of ``!FMF12FCER``: refuses log-domain data; the height map (h, w) float32 mm, or None."""
    version = cursor.unpack("B", "the extra header")
    if version >= 1 and cursor.unpack("I", "the extra header"):
        raise cursor.fail("its factors are in the log domain, which is not supported yet", "use a linear .btf file")
    if version >= 2:
        width, height = cursor.unpack("II", "the height map")
        if width > 0 and height > 0:
            return cursor.array("<f2", (height, width), "the height map").astype(np.float32)
    return None


def _read_factor_pair(cursor: _Cursor):
    """One block of scalar size, K, rows, cols, S, U, SxV: U (rows, K) and SxV (cols, K), float32."""
    scalar, k, rows, cols = cursor.unpack("BIII", "the factors")
    if scalar not in SCALARS:
        raise cursor.fail(f"scalars of {scalar} bytes")
    if k < 1:
        raise cursor.fail("no components")
    cursor.array(SCALARS[scalar], (k,), "the singular values")
    u = cursor.array(SCALARS[scalar], (rows, k), "the angular factor").astype(np.float32)
    return u, cursor.array(SCALARS[scalar], (cols, k), "the spatial factor").astype(np.float32)


def _read_fmf(cursor: _Cursor, header: Header):
    """angular (V, L, 3, k), texels (h, w, k), height map or None."""
    height_mm = _read_fmf_preamble(cursor, header) if header.signature.startswith("!FMF12") else None
    cursor.unpack("I", "the component count")
    u, sxv = _read_factor_pair(cursor)
    n_views, n_lights, texels = len(header.views), len(header.lights), header.width * header.height
    if len(u) != n_views * n_lights * 3 or len(sxv) != texels:
        raise cursor.fail(f"factors of {len(u)} and {len(sxv)} rows do not fit the directions and texels")
    k = u.shape[1]
    return u.reshape(n_views, n_lights, 3, k), sxv.reshape(header.height, header.width, k), height_mm


def _read_dfmf(cursor: _Cursor, header: Header):
    """As :func:`_read_fmf`; each channel's components follow each other, zero in the other channels."""
    _, model = cursor.unpack("Ii", "the colour model")
    cursor.array("<f4", (12,), "the colour transform")
    if model != 0:
        raise cursor.fail(f"colour model {model} (not linear RGB) is not supported yet", "use a linear .btf file")
    n_views, n_lights, texels = len(header.views), len(header.lights), header.width * header.height
    pairs = []
    for _ in range(3):
        u, sxv = _read_factor_pair(cursor)
        if len(u) == texels and len(sxv) == n_views * n_lights and len(u) != len(sxv):
            u, sxv = sxv, u  # the transposed layout
        if len(u) != n_views * n_lights or len(sxv) != texels:
            raise cursor.fail(f"factors of {len(u)} and {len(sxv)} rows do not fit the directions and texels")
        pairs.append((u, sxv))
    total = sum(u.shape[1] for u, _ in pairs)
    angular = np.zeros((n_views, n_lights, 3, total), np.float32)
    at = 0
    for channel, (u, _) in enumerate(pairs):
        angular[:, :, channel, at : at + u.shape[1]] = u.reshape(n_views, n_lights, -1)
        at += u.shape[1]
    texels = np.concatenate([sxv for _, sxv in pairs], 1)
    return angular, texels.reshape(header.height, header.width, total), None


def write(
    path, material: Tabulated, *, height_mm=None, setup: str = "", layout: str = "fmf", cosine: bool = True
) -> None:
    """Writes a linear, half-float ``.btf`` file, whole or not at all.

    Parameters
    ----------
    path : path of the file
    material : Tabulated, without cos(theta_i); three channels
    height_mm : (h, w) float, mm, or None; held by the "fmf" layout only
    setup : free text for the header, at most 79 bytes
    layout : "fmf" (``!FMF12FCER``, one spatial factor) or "dfmf" (``!DFMF08FCR``, one a channel)
    cosine : multiply cos(theta_i) in, and set the flag (as the public data are)

    Raises
    ------
    InputError
        Values that are not finite or beyond half floats; a folder that cannot be written.
    """
    angular = np.asarray(material.angular, np.float32)
    n_views, n_lights, channels, k = angular.shape
    h, w, k_texels = material.texels.shape
    if channels != 3 or k != k_texels or (n_views, n_lights) != (len(material.views), len(material.lights)):
        raise ValueError("the factors of the material do not fit each other")
    if cosine:
        angular = angular * np.asarray(material.lights, np.float32)[None, :, 2, None, None]
    with np.errstate(over="ignore"):
        u, sxv = angular.astype("<f2"), np.asarray(material.texels).reshape(h * w, k).astype("<f2")
    if not (np.isfinite(u).all() and np.isfinite(sxv).all()):
        raise InputError(material.name, "values that half floats cannot hold", "check the material's measurement")
    singular = np.zeros(k, "<f2")
    with replacing(path) as scratch, open(scratch, "wb") as out:
        out.write(FMF_SIGNATURES[0] if layout == "fmf" else DFMF_SIGNATURES[0])
        text = b"".join(s.encode()[:79].ljust(80, b"\0") for s in (setup, "BTFsep", "directional"))
        names = b"".join(struct.pack("<I", 1) + c for c in (b"R", b"G", b"B"))
        body = text + struct.pack("<4fIII", 1 / material.texel_mm, 1, 1, 1, int(cosine), 0, 3) + names
        out.write(struct.pack("<II", len(body) + 8, 4) + body)
        out.write(_direction_block(material.views, material.lights))
        out.write(struct.pack("<III", w, h, 0))
        if layout == "fmf":
            height = None if height_mm is None else np.asarray(height_mm).astype("<f2")
            shape = (0, 0) if height is None else height.shape
            out.write(struct.pack("<BIII", 2, 0, shape[1], shape[0]))
            out.write(b"" if height is None else height.tobytes())
            out.write(struct.pack("<IBIII", k, 2, k, n_views * n_lights * 3, h * w))
            out.write(singular.tobytes() + u.tobytes() + sxv.tobytes())
        elif layout == "dfmf":
            out.write(struct.pack("<Ii12f", k, 0, 0, 0, 0, *np.eye(3).ravel()))
            for channel in range(3):
                out.write(struct.pack("<BIII", 2, k, n_views * n_lights, h * w) + singular.tobytes())
                out.write(np.ascontiguousarray(u[:, :, channel]).tobytes() + sxv.tobytes())
        else:
            raise ValueError(f"no layout {layout!r}")


def _direction_block(views, lights) -> bytes:
    def angles(directions):
        d = np.asarray(directions, np.float64)
        theta = np.arctan2(np.hypot(d[:, 0], d[:, 1]), d[:, 2])
        return np.stack([theta, np.arctan2(d[:, 1], d[:, 0])], 1).astype("<f4")

    light_block = struct.pack("<I", len(lights)) + angles(lights).tobytes()
    return struct.pack("<I", len(views)) + b"".join(v.tobytes() + light_block for v in angles(views))
