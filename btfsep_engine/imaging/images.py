# SPDX-License-Identifier: GPL-3.0-or-later
"""Reading and writing images: everything becomes linear Rec.709, with the pixels that cannot be trusted marked.

The stored orientation is kept (EXIF rotation is not applied, as Blender does not): a camera in pixels refers to the
pixels as stored. The colours are what the file says that they are (`colour_profile`).
"""

import contextlib
import io
import os
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import OpenEXR

from btfsep_engine.errors import InputError
from btfsep_engine.imaging import blender_views, camera_curve, colour_profile, exr, image_headers
from btfsep_engine.imaging.colour_profile import Profile
from btfsep_engine.imaging.srgb import linear_to_srgb, srgb_to_linear
from btfsep_engine.storage import atomic

SATURATED = 0.999  # of the largest code of an integer format
OPAQUE = 0.999
COLORSPACES = ("auto", "srgb", "camera", "linear", *blender_views.VIEWS)
SUFFIXES = (".exr", ".hdr", ".png", ".jpg", ".jpeg", ".tif", ".tiff", ".webp")  # of what is read, in small letters
_EXR = b"\x76\x2f\x31\x01"
_MAGIC = (b"\x89PNG", b"\xff\xd8", b"II*\0", b"MM\0*", b"RIFF", b"#?")
_KINDS = "save it as EXR, HDR, PNG, JPEG, TIFF or WebP"


@dataclass(frozen=True)
class Image:
    """An image as read.

    Attributes
    ----------
    pixels : (h, w, 3) float32, linear Rec.709; floats may be NaN, infinite or negative, as in the file
    saturated : (h, w) bool, a channel stands at the largest code (integer formats only)
    usable : (h, w) bool, not saturated, opaque, and within the data of the file
    clipped : (h, w, 3) bool, the channels of opaque pixels that stand at the largest code: lower bounds, no values
    bits : of a code, 8 or 16; None: floats
    coarse_chroma : whether colours are stored at half the resolution (JPEG 4:2:0 and 4:2:2, lossy WebP)
    camera : maker and model of the camera that a file of integers says it is from; empty: it says none
    profile : what its colours were taken to mean; None: what files of its kind mean, of Rec.709's primaries
    orientation : how the file says that its pixels, which are as stored, are to be turned (EXIF, 1 to 8; 1: not)
    is_render : whether a file of integers says that Blender rendered it
    is_jpeg : whether the file is a JPEG
    flash : whether a file of integers says that a flash fired; None: it says nothing
    """

    pixels: np.ndarray
    saturated: np.ndarray
    usable: np.ndarray
    clipped: np.ndarray
    bits: int | None = None
    coarse_chroma: bool = False
    camera: str = ""
    profile: Profile | None = None
    orientation: int = 1
    is_render: bool = False
    is_jpeg: bool = False
    flash: bool | None = None


def read_linear(
    path,
    *,
    colorspace: str = "auto",
    primaries: str = "auto",
    by_camera: bool = False,
    max_pixels: int | None = None,
) -> Image:
    """Reads EXR, HDR, PNG, JPEG, TIFF or WebP as linear Rec.709. Grey images become three equal channels.

    Parameters
    ----------
    path : file
    colorspace : "auto" (as the file's profile says, without one integer formats are sRGB-coded, floating-point ones
        linear), "srgb", "linear", "camera": integers are what cameras make of a photograph (`camera_curve`),
        or a name of `blender_views.VIEWS`: they are a picture that this view made
    primaries : "auto" (as the file says, else Rec.709), or a name of `colour_profile.PRIMARIES`; numbers that are no
        colours are to be read with "rec709". A picture of a view has Rec.709's
    by_camera : "auto" takes integers of a file that names its camera for that camera's own picture
    max_pixels : refuse larger images, and those that do not say their size, before anything is decoded

    Raises InputError: the file is missing, unreadable, truncated, no image, of no size or of an absurd one; or its
    codes are of a kind of display that is not undone.
    """
    if colorspace not in COLORSPACES:
        raise ValueError(colorspace)
    path = Path(path)
    stored, alpha, peak, inside, header, profile = _stored(path, max_pixels)
    if primaries != "auto":
        profile = colour_profile.of_primaries(primaries)
    elif colorspace in blender_views.VIEWS:
        profile = None
    if profile is not None and profile.hdr:
        got = f"its codes are those of {profile.name}, which are not undone"
        raise InputError(path.name, got, "export it for a usual display (SDR), or as linear EXR")
    camera = "" if peak is None else image_headers.camera(header)
    decode = _decoder(colorspace, profile, peak is not None, stored.shape[-1], bool(by_camera and camera))
    clipped = np.zeros(stored.shape, bool) if peak is None else stored >= SATURATED * peak
    if peak is not None and colorspace in blender_views.VIEWS:
        stored = np.repeat(stored, 3, -1) if stored.shape[-1] == 1 else stored
        pixels = blender_views.to_linear(stored / peak, colorspace).astype(np.float32)
        clipped = clipped | blender_views.near_white(stored / peak, pixels, colorspace)
    elif peak is not None:
        codes = np.arange(peak + 1) / peak
        tables = decode(np.repeat(codes[:, None], stored.shape[-1], -1)).astype(np.float32).T
        if (tables == tables[0]).all():
            pixels = tables[0][stored]
        else:
            pixels = np.stack([table[stored[..., i]] for i, table in enumerate(tables)], -1)
    else:
        pixels = decode(stored).astype(np.float32, copy=False)
    if pixels.shape[-1] == 1:
        pixels = np.repeat(pixels, 3, -1)
    elif profile is not None and profile.to_rec709 is not None:
        pixels = pixels @ profile.to_rec709.T.astype(np.float32)
    opaque = inside if alpha is None else inside & (alpha >= OPAQUE)
    saturated = clipped.any(-1)
    clipped = np.broadcast_to(clipped, pixels.shape) & opaque[..., None]
    bits = None if peak is None else peak.bit_length()
    said = image_headers.has_coarse_chroma(header), camera, profile, image_headers.orientation(header)
    said += peak is not None and image_headers.is_render(header), image_headers.is_jpeg(header)
    said += (None if peak is None else image_headers.flash_fired(header),)
    return Image(np.ascontiguousarray(pixels), saturated, opaque & ~saturated, clipped, bits, *said)


def _decoder(colorspace: str, profile: Profile | None, integers: bool, channels: int, by_camera: bool):
    """The function that makes stored values (..., channels), integers from 0 to 1, linear in their own primaries."""
    curves = () if profile is None else profile.curves
    if colorspace in ("auto", "camera") and len(set(curves)) in (1, channels):
        shown = profile.decode
    elif colorspace == "linear" or not (integers or colorspace in ("srgb", "camera")):
        return lambda values: values
    else:
        shown = srgb_to_linear
    is_photo = colorspace == "camera" or (colorspace == "auto" and by_camera and not (profile and profile.linear))
    return (lambda values: camera_curve.to_scene(shown(values))) if integers and is_photo else shown


def declared_size(path) -> tuple[int, int] | None:
    """(width, height) that an image claims, before any of its pixels is decoded; None where it does not say.

    Raises InputError: the file cannot be read, is of a kind that is not, or claims an absurd size.
    """
    path = Path(path)
    data = atomic.read_bytes(path)
    if not data.startswith(_EXR):
        _refuse(path, data)
        return image_headers.size(data)
    return exr.extent(exr.windows_of(path)[0])


def data_size(path) -> tuple[int, int] | None:
    """(width, height) of the data window of an EXR; None: it is none. Raises InputError as :func:`declared_size`."""
    path = Path(path)
    return exr.extent(exr.windows_of(path)[1]) if atomic.read_bytes(path).startswith(_EXR) else None


def layers(path) -> list[str]:
    """Names of the layers that could be the picture of an EXR, that which is read first; [] where it is not open."""
    path = Path(path)
    return exr.guessed(path) if atomic.read_bytes(path).startswith(_EXR) else []


def pixel_aspect(path) -> float:
    """How many times as wide as high an EXR says that its pixels are; 1 of any other file."""
    path = Path(path)
    return exr.pixel_aspect(path) if atomic.read_bytes(path).startswith(_EXR) else 1.0


def orientation(path) -> int:
    """How a file says that its pixels are to be turned (EXIF, 1 to 8). Raises InputError where it cannot be read."""
    return image_headers.orientation(atomic.read_bytes(Path(path)))


def resized(pixels, side: int) -> np.ndarray:
    """An image (h, w, c) float32 as (side, side, c), stretched: axes are averaged where they shrink, else linear."""
    h, w = pixels.shape[:2]
    across = cv2.resize(pixels, (side, h), interpolation=cv2.INTER_AREA if side < w else cv2.INTER_LINEAR)
    return cv2.resize(across, (side, side), interpolation=cv2.INTER_AREA if side < h else cv2.INTER_LINEAR)


def read_mask(path) -> np.ndarray:
    """Reads a mask: (h, w) bool, true where any colour channel is not zero and, if there is alpha, it is not zero."""
    stored, alpha, *_ = _stored(Path(path))
    mask = (stored != 0).any(-1)
    return mask if alpha is None else mask & (alpha > 0)


def read_depth(path) -> np.ndarray:
    """Reads the depth channel of an EXR: (h, w) float32, as stored (Z, depth, V, Y, or an only channel).

    Raises InputError as :func:`read_linear`, or no channel looks like depth.
    """
    path = Path(path)
    if not atomic.read_bytes(path).startswith(_EXR):
        raise InputError(path.name, "this is not an OpenEXR file", "save the depth as EXR")
    for channels, header in exr.parts_of(path):
        names = list(channels)
        wanted = [n for n in names if n.split(".")[-1].lower() in ("z", "depth")]
        wanted += [n for n in names if "depth" in n.lower()] + [n for n in ("V", "Y") if n in names]
        if not wanted and (len(names) == 1 or {"R", "G", "B"} <= set(names)):
            wanted = ["R"] if len(names) > 1 else names  # a depth saved as a grey picture
        if wanted:
            return exr.placed(path, header, [channels[wanted[0]].pixels])[0][..., 0].astype(np.float32)
    raise InputError(path.name, "no channel in it is a depth", "save the depth as channel Z or as the only one")


def write_exr(path, array, *, half: bool = False, compressed: bool = True) -> None:
    """Writes ``array : (h, w), (h, w, 1), (h, w, 3) or (h, w, 4) float`` as an EXR, whole or not at all.

    One channel is named Y (shown as grey), three RGB, four RGBA. ``half`` stores 16-bit floats, ``compressed`` by ZIP.
    """
    with atomic.replacing(path) as scratch:
        fill_exr(scratch, array, half=half, compressed=compressed)


def fill_exr(path, array, *, half: bool = False, compressed: bool = True) -> None:
    """As `write_exr`, straight into the file ``path``: for what replaces several files at once. Raises OSError."""
    a = np.asarray(array, np.float16 if half else np.float32)
    if a.ndim == 2:
        a = a[..., None]
    name = {1: "Y", 3: "RGB", 4: "RGBA"}[a.shape[2]]
    channels = {name: np.ascontiguousarray(a[..., 0] if name == "Y" else a)}
    compression = OpenEXR.ZIP_COMPRESSION if compressed else OpenEXR.NO_COMPRESSION
    header = {"compression": compression, "type": OpenEXR.scanlineimage}
    with contextlib.redirect_stdout(io.StringIO()):
        try:
            OpenEXR.File(header, channels).write(str(path) if exr.is_text(path) else os.fsencode(path))
        except RuntimeError as error:
            raise OSError(str(error)) from error


def write_png(path, array) -> None:
    """Writes an 8-bit PNG, whole or not at all.

    Parameters
    ----------
    path : file
    array : (h, w), (h, w, 3) float linear Rec.709 (encoded to sRGB and clipped), or uint8 or bool as it is
    """
    a = np.asarray(array)
    if a.dtype == bool:
        a = a.astype(np.uint8) * 255
    elif a.dtype != np.uint8:
        a = np.nan_to_num(a.astype(np.float64), nan=0.0, posinf=1.0, neginf=0.0)
        a = np.round(np.clip(linear_to_srgb(a), 0, 1) * 255).astype(np.uint8)
    done, data = cv2.imencode(".png", a[..., ::-1] if a.ndim == 3 else a)
    if not done:
        raise ValueError(f"cannot encode an array of shape {a.shape}")
    atomic.write_bytes(path, data.tobytes())


def _refuse(path: Path, data: bytes) -> None:
    """InputError where a file is of a kind that is not read, or not rightly."""
    why = image_headers.refused(data)
    if why is not None:
        raise InputError(path.name, *why)


def _stored(path: Path, max_pixels: int | None = None):
    """(h, w, 1 or 3) RGB as stored, (h, w) alpha in [0, 1] or None, the largest code (None for floats), where the file
    has data, (h, w) bool, the file's bytes, and what it says of its colours.
    """
    data = atomic.read_bytes(path)
    if data.startswith(_EXR):
        stored, alpha, inside, header = exr.read_colours(path, max_pixels)
        said = header.get("chromaticities")
        return stored, alpha, None, inside, data, None if said is None else colour_profile.of_chromaticities(said)
    _refuse(path, data)
    size = image_headers.size(data)
    if size is not None:
        exr.check_size(path, *size, max_pixels)
    elif max_pixels is not None:
        raise InputError(path.name, "it does not say its size as PNG, JPEG, TIFF, WebP or HDR do", _KINDS)
    stored, alpha, peak = _decode(path, image_headers.as_stored(data))
    return stored, alpha, peak, np.ones(stored.shape[:2], bool), data, colour_profile.of_file(data)


def _decode(path: Path, data: bytes):
    """The first three of `_stored`, of what OpenCV reads."""
    try:
        a = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        a = None
    if a is None or a.size == 0:
        if not data.startswith(_MAGIC):
            raise InputError(path.name, "this is not an image of a known kind", _KINDS)
        got, do = "the image is truncated or damaged", "export it again"
        if image_headers.is_tiff(data):
            got += ", or its pixels are of a kind that is not read"
            do = "save it as RGB of 8 or 16 bits or 32-bit floats, without more channels than alpha"
        raise InputError(path.name, got, do)
    exr.check_size(path, a.shape[1], a.shape[0])
    if a.dtype == np.float64:
        a = a.astype(np.float32)
    if a.dtype not in (np.uint8, np.uint16, np.float32):
        raise InputError(path.name, f"its pixels are of the kind {a.dtype}", "save 8-bit, 16-bit or float pixels")
    peak = None if a.dtype == np.float32 else int(np.iinfo(a.dtype).max)
    if a.ndim == 2:
        a = a[..., None]
    alpha = None
    if a.shape[2] in (2, 4):
        alpha = a[..., -1].astype(np.float32) / (peak or 1)
    rgb = a[..., 2::-1] if a.shape[2] >= 3 else a[..., :1]
    return rgb, alpha, peak
