# SPDX-License-Identifier: GPL-3.0-or-later
"""What an EXR holds: its parts and layers, which of them is the picture, and where in the picture its data lie."""

import contextlib
import io
import math
from pathlib import Path

import numpy as np
import OpenEXR

from btfsep_engine import MAX_PIXELS
from btfsep_engine.errors import InputError

MAX_SIDE = 20000  # pixels; more than any camera has, and a guard against files that claim absurd sizes
WHOLE = ("combined", "beauty", "rgba")  # what renderers and compositors call the layer that is the picture


def check_size(path: Path, width: int, height: int, max_pixels: int | None = None) -> None:
    if width < 1 or height < 1:
        raise InputError(path.name, f"the image has no pixels ({width} x {height})", "export it again")
    most = MAX_PIXELS if max_pixels is None else min(max_pixels, MAX_PIXELS)
    if max(width, height) > MAX_SIDE or width * height > most:
        got = f"it claims {width} x {height} pixels; the limit is {MAX_SIDE} a side, {most} in all"
        raise InputError(path.name, got, "make it smaller")


def is_text(path: Path) -> bool:
    """Whether a path is UTF-8; the names of files need not be."""
    try:
        return bool(str(path).encode())
    except UnicodeEncodeError:
        return False


def parts_of(path: Path, max_pixels: int | None = None):
    """The parts of an EXR as (channels by name, header), flat images only. Raises InputError where it is damaged.

    The library prints its complaints about damaged parts and leaves the part out; they are caught here.
    """
    count = len(windows_of(path, max_pixels)) // 2
    parts = _opened(path, separate_channels=True)
    if len(parts) != count:
        raise InputError(path.name, "the EXR is truncated or damaged", "export it again")
    return [(part.channels, part.header) for part in parts if "deep" not in str(part.header.get("type", ""))]


def windows_of(path: Path, max_pixels: int | None = None) -> list:
    """The display and the data window of each part, (low, high) corners, by the headers alone; sizes are checked."""
    parts = _opened(path, header_only=True)
    windows = [part.header[name] for part in parts for name in ("displayWindow", "dataWindow")]
    for window in windows:
        check_size(path, *extent(window), max_pixels)
    return windows


def extent(window) -> tuple[int, int]:
    """Width and height of a window, of its corners (low, high)."""
    low, high = window
    return tuple(int(h) - int(l) + 1 for l, h in zip(low, high, strict=True))


def _opened(path: Path, **how) -> list:
    """The library's own parts; at least one."""
    try:
        with contextlib.redirect_stdout(io.StringIO()):
            parts = OpenEXR.File(str(path) if is_text(path) else io.BytesIO(path.read_bytes()), **how).parts
    except (RuntimeError, ValueError, TypeError, KeyError, MemoryError) as error:
        raise InputError(path.name, "the EXR is truncated or damaged", "export it again") from error
    if not parts:
        raise InputError(path.name, "the EXR is truncated or damaged", "export it again")
    return parts


def read_colours(path: Path, max_pixels: int | None = None):
    """(h, w, 1 or 3) floats, alpha or None, where the data are, and the header, of the first part with colours.

    Raises InputError where none has, or they are luminance and chroma.
    """
    for channels, header in parts_of(path, max_pixels):
        names = set(channels)
        for layer in _layers(names)[:1]:
            alpha = [layer + "A"] if layer + "A" in names else []
            planes = [channels[layer + c].pixels for c in "RGB"] + [channels[a].pixels for a in alpha]
            a, inside = placed(path, header, planes)
            return a[..., :3], a[..., 3] if alpha else None, inside, header
        if "Y" in names:
            if "RY" in names or "BY" in names:
                raise InputError(path.name, "the EXR is coded as luminance and chroma", "save it as RGB")
            a, inside = placed(path, header, [channels[n].pixels for n in ("Y", "A") if n in names])
            return a[..., :1], a[..., 1] if a.shape[2] == 2 else None, inside, header
    raise InputError(path.name, "the EXR has no channels R, G, B or Y", "save the picture's colours in it")


def _layers(names) -> list[str]:
    """What stands before R, G and B of each layer of a part: "" first, then that whose name is a whole picture's."""
    found = {n[:-1] for n in names if n == "R" or n.endswith(".R")}
    return sorted((n for n in found if {n + c for c in "RGB"} <= set(names)), key=lambda n: (n != "", _rank(n), n))


def _rank(name: str) -> int:
    """Where a name stands in `WHOLE`; behind them where it has none of them."""
    told = [word in name.lower() for word in WHOLE]
    return told.index(True) if any(told) else len(WHOLE)


def guessed(path: Path) -> list[str]:
    """The layers that could be the picture, that which `read_colours` takes first; [] where no name leaves it open."""
    parts = [part.header for part in _opened(path, header_only=True)]
    parts = [header for header in parts if "deep" not in str(header.get("type", ""))]
    found = []
    for header in parts:
        name = header.get("name", "")
        found += [(name, layer) for layer in _layers({c.name for c in header["channels"]})]
    named = [" ".join(filter(None, (part, layer.rstrip(".")))) for part, layer in found]
    if len(found) < 2 or not named[0] or _rank(named[0]) < len(WHOLE) or (len(parts) == 1 and not found[0][1]):
        return []
    return named


def pixel_aspect(path: Path) -> float:
    """How many times as wide as high the pixels are, as the file says; 1 where that is no ratio."""
    told = float(_opened(path, header_only=True)[0].header.get("pixelAspectRatio", 1.0))
    return told if 0 < told < math.inf else 1.0


def placed(path: Path, header: dict, planes):
    """The planes as (h, w, n) float32 over the display window, and (h, w) bool: where the data window covers it.

    Raises InputError where they are of different sizes.
    """
    (x0, y0), (x1, y1) = header["displayWindow"]
    (u0, v0), (u1, v1) = header["dataWindow"]
    x0, y0, x1, y1, u0, v0, u1, v1 = (int(n) for n in (x0, y0, x1, y1, u0, v0, u1, v1))
    shape = (v1 - v0 + 1, u1 - u0 + 1)
    if any(p is None or p.shape != shape for p in planes):
        raise InputError(path.name, "its channels have different sizes", "save it with full-size channels")
    out = np.zeros((y1 - y0 + 1, x1 - x0 + 1, len(planes)), np.float32)
    inside = np.zeros(out.shape[:2], bool)
    left, right, top, bottom = max(x0, u0), min(x1, u1), max(y0, v0), min(y1, v1)
    if left <= right and top <= bottom:
        target = np.s_[top - y0 : bottom - y0 + 1, left - x0 : right - x0 + 1]
        inside[target] = True
        for i, plane in enumerate(planes):
            out[(*target, i)] = plane[top - v0 : bottom - v0 + 1, left - u0 : right - u0 + 1]
    return out, inside
