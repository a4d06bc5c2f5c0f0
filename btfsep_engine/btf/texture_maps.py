# SPDX-License-Identifier: GPL-3.0-or-later
"""A user's texture maps as a patch that the virtual gonioreflectometer measures.

Base colour (sRGB-coded pictures, linear EXR), roughness or gloss, height or normals, metallic if there is any; of any
size, 8 and 16 bits and floats. A height map's value times ``height_mm`` is the height: black to white of a picture is
``height_mm``.
"""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.sparse import csr_array

from btfsep_engine.btf import normal_maps
from btfsep_engine.btf.map_files import MapFiles, find_maps
from btfsep_engine.btf.procedural import MAX_ALBEDO, Maps
from btfsep_engine.errors import InputError
from btfsep_engine.imaging.images import read_linear
from btfsep_engine.progress import Reporter

MIN_SIDE, MAX_SIDE = 4, 8192  # pixels
LEAST_ROUGHNESS = 0.15  # of the reflectometer: its 151 directions show every sharper highlight as wide as this one
MAX_METAL = 0.98  # of the base colour where it is metal
SQUARE = 1.02  # aspect ratios this near to a whole number count as it
SEAM_TO_MEDIAN, SEAM_TO_STEEPEST, SEAM_LEAST = 2.0, 1.25, 0.01
MANY = 0.01  # of the pixels: fewer are changed without a word


@dataclass(frozen=True)
class TextureMaps:
    """Maps as read.

    Attributes
    ----------
    maps : the patch
    files : kind -> file name
    relief_mm : between the 1st and the 99th percentile of the height
    normal_convention : "opengl" or "directx", None without a normal map
    """

    maps: Maps
    files: dict
    relief_mm: float
    normal_convention: str | None


def read_maps(
    folder,
    *,
    name: str,
    size_mm: float,
    height_mm: float | None = None,
    resolution: int = 512,
    f0: float = 0.04,
    normal_convention: str = "auto",
    reporter: Reporter | None = None,
) -> TextureMaps:
    """Reads the maps of a folder.

    Parameters
    ----------
    folder : see :func:`btfsep_engine.btf.map_files.find_maps`
    name : "class/material"
    size_mm : what the (longer) edge of the maps spans on the material
    height_mm : between black and white of the height map; of a normal map alone, from the lowest to the highest place
        (None: as its slopes say)
    resolution : of the result; an elongated map is repeated across to make a square
    f0 : specular reflectance at normal incidence
    normal_convention : "auto" (by name, else by the curl of the slopes), "opengl", "directx"
    reporter : warned of seams, of values out of range, of maps that disagree

    Raises InputError: maps missing, ambiguous, unreadable, not finite, of different shapes; numbers out of range.
    """
    reporter = reporter or Reporter()
    files = find_maps(folder, normal_convention=normal_convention)
    _check_numbers(size_mm, height_mm, f0, needs_height=files.height is not None)
    reader = _Reader(resolution, reporter)
    base = reader.resampled(files.base_colour, reader.read(files.base_colour, "auto"))
    rough = files.roughness or files.gloss
    roughness = reader.resampled(rough, reader.read(rough, "linear")[..., :1])[..., 0]
    if files.roughness is None:
        roughness = 1 - roughness
    metallic = _metallic(files, reader)
    height, convention = _height(files, reader, size_mm, height_mm)
    brightest = MAX_ALBEDO + (0 if metallic is None else metallic[..., None] * (MAX_METAL - MAX_ALBEDO))
    _tell_of_limits(files, base, brightest, roughness, reporter)
    relief = np.percentile(height, [1, 99])
    maps = Maps(
        name=name,
        base_colour=np.clip(base, 0.002, brightest).astype(np.float32),
        height_mm=(height - height.mean()).astype(np.float32),
        roughness=np.clip(roughness, LEAST_ROUGHNESS, 1).astype(np.float32),
        size_mm=float(size_mm),
        f0=float(f0),
        metallic=metallic,
    )
    return TextureMaps(maps, files.file_names(), float(relief[1] - relief[0]), convention)


def _check_numbers(size_mm, height_mm, f0, *, needs_height: bool) -> None:
    if not (np.isfinite(size_mm) and 0.1 <= size_mm <= 10_000):
        raise InputError("the size of the patch", f"{size_mm} mm", "give 0.1 to 10000 mm, what the maps span")
    if height_mm is None and needs_height:
        raise InputError(
            "the height of the patch", "it is not given", "give --height-mm: from black to white of the height map"
        )
    if height_mm is not None and not (np.isfinite(height_mm) and 0 <= height_mm <= size_mm):
        raise InputError("the height of the patch", f"{height_mm} mm", "give 0 mm to the size of the patch")
    if not (np.isfinite(f0) and 0 <= f0 <= 0.2):
        raise InputError("the reflectance f0", f"{f0}", "give 0 to 0.2 (0.04 for most; metal takes a metallic map)")


class _Reader:
    """Reads maps of one material; all must have the shape of the first, whatever their sizes.

    Parameters
    ----------
    resolution : pixels an edge of what :meth:`resampled` gives
    reporter : warned of seams
    """

    def __init__(self, resolution: int, reporter: Reporter):
        self.resolution, self.reporter, self.copies = resolution, reporter, None

    def read(self, path, colorspace: str) -> np.ndarray:
        """(h, w, 3) float32, row 0 is the smallest v (a picture's lowest). Raises InputError."""
        numbers = colorspace == "linear"
        image = read_linear(path, colorspace=colorspace, primaries="rec709" if numbers else "auto")
        h, w = image.saturated.shape
        if min(h, w) < MIN_SIDE or max(h, w) > MAX_SIDE:
            raise InputError(path.name, f"it is {w} x {h} pixels", f"give {MIN_SIDE} to {MAX_SIDE} pixels an edge")
        if not np.isfinite(image.pixels).all():
            raise InputError(path.name, "it holds values that are NaN or infinite", "export it again")
        if not (image.usable | image.saturated).mean() > 1 - MANY:
            self.reporter.warn(f"{path.name} is transparent in places; what lies there is measured as if it were solid")
        copies = _copies(path, h, w)
        if copies != (self.copies or copies):
            got = f"its shape ({w} x {h} pixels) is not that of the other maps"
            raise InputError(path.name, got, "give maps of one shape")
        self.copies = copies
        return image.pixels[::-1]

    def square(self, a) -> np.ndarray:
        """``a : (h, w, c)`` repeated across its shorter edge."""
        return np.tile(a, (*self.copies, 1)) if self.copies != (1, 1) else a

    def resampled(self, path, a) -> np.ndarray:
        """(resolution, resolution, c) float64 of ``a : (h, w, c)``, warned of where it does not tile."""
        for axis, border in ((1, "left to its right border"), (0, "top to its bottom border")):
            if seam(a, axis) > 1:
                self.reporter.warn(
                    f"{path.name} does not tile: from its {border} it jumps much more than anywhere inside; the seam "
                    "will be part of the material"
                )
        return resample(self.square(a), self.resolution)


def _copies(path, h: int, w: int) -> tuple[int, int]:
    """How often a picture is repeated (down, across) to make a square."""
    ratio = max(h, w) / min(h, w)
    times = round(ratio)
    if not times / SQUARE <= ratio <= times * SQUARE or times > 8:
        raise InputError(
            path.name, f"it is {w} x {h} pixels: whole copies of it make no square", "crop it to a tile that is square"
        )
    return (times, 1) if w > h else (1, times)


def seam(a, axis: int) -> float:
    """How much a map jumps across its border, against what would still be unremarkable; above 1 is a seam.

    Parameters
    ----------
    a : (h, w, c) float, nominally 0 to 1
    axis : 0 compares the first row with the last, 1 the columns
    """
    lines = np.moveaxis(np.asarray(a, np.float32), axis, 0)
    inner = np.array([np.abs(lines[i + 1] - lines[i]).mean() for i in range(len(lines) - 1)])
    jump = float(np.abs(lines[0] - lines[-1]).mean())
    usual = max(SEAM_TO_MEDIAN * float(np.median(inner)), SEAM_TO_STEEPEST * float(inner.max()), SEAM_LEAST)
    return jump / usual


def resample(a, n: int) -> np.ndarray:
    """``a : (h, w, c)`` at (n, n, c) float64: periodic, Catmull-Rom, widened where it shrinks; the mean stays."""
    rows, columns = (_kernel(size, n) for size in a.shape[:2])
    out = rows @ np.asarray(a, np.float64).reshape(len(a), -1)
    out = out.reshape(n, a.shape[1], -1).transpose(1, 0, 2).reshape(a.shape[1], -1)
    return (columns @ out).reshape(n, n, -1).transpose(1, 0, 2)


def _kernel(m: int, n: int) -> csr_array:
    """(n, m): from m samples around a circle to n, samples at the cells' centres."""
    wide = max(1.0, m / n)
    centre = (np.arange(n) + 0.5) * (m / n) - 0.5
    reach = int(np.ceil(2 * wide))
    taps = np.floor(centre)[:, None].astype(int) + np.arange(-reach, reach + 2)
    x = np.abs(taps - centre[:, None]) / wide
    weight = np.where(x < 1, (1.5 * x - 2.5) * x * x + 1, np.where(x < 2, ((-0.5 * x + 2.5) * x - 4) * x + 2, 0))
    weight /= weight.sum(1, keepdims=True)
    row = np.repeat(np.arange(n), taps.shape[1])
    return csr_array((weight.ravel(), (row, (taps % m).ravel())), shape=(n, m))


def smooth_steps(height) -> np.ndarray:
    """An 8-bit height map without its terraces: smoothed, but nowhere by more than half a step.

    ``height`` : (h, w) float, 0 to 1. Maps of finer steps are given back as they are
    """
    codes = height * 255.0
    if np.abs(codes - np.round(codes)).max() > 1e-3:
        return height
    smooth = np.asarray(height, np.float64)
    for sigma in (3.0, 2.0, 1.0):
        smooth = np.clip(gaussian_filter(smooth, sigma, mode="wrap"), height - 0.5 / 255, height + 0.5 / 255)
    return smooth


def _height(files: MapFiles, reader: _Reader, size_mm: float, height_mm):
    """(n, n) float64 height in mm, and the convention of the normal map, if there is one."""
    height = slope = convention = None
    n = reader.resolution
    if files.height is not None:
        height = smooth_steps(reader.read(files.height, "linear")[..., 0])[..., None]
        height = reader.resampled(files.height, height)[..., 0] * (height_mm * n / size_mm)  # in cells
    if files.normal is not None:
        slope = normal_maps.slopes(reader.read(files.normal, "linear"), files.normal.name)
        slope = reader.resampled(files.normal, slope)
        convention = files.normal_convention
        if convention == "auto":
            convention = normal_maps.guess_convention(slope, height)
        if convention is None:
            convention = "opengl"
            if np.abs(slope[..., 1] - slope[..., 1].mean()).max() > 0.05:
                reader.reporter.warn(
                    f"{files.normal.name}: whether green points up (OpenGL) or down (DirectX) cannot be told from it; "
                    "OpenGL is taken"
                )
        if convention == "directx":
            slope = slope * [1, -1]
    if height is None:
        height = normal_maps.integrate(slope)
        span = float(height.max() - height.min())
        if height_mm is not None and span > 0:
            height = height * (height_mm * n / size_mm / span)
    elif slope is not None and height_mm > 0 and np.ptp(height) > 0:
        joined = normal_maps.join(height, slope)
        if joined is None:
            reader.reporter.warn(
                f"{files.normal.name} and {files.height.name} do not show the same surface; only the height map is used"
            )
        else:
            height = joined
    return height * (size_mm / n), convention


def _metallic(files: MapFiles, reader: _Reader):
    """(n, n) float32 in [0, 1], or None where nothing is metal."""
    if files.metallic is None:
        return None
    metallic = reader.resampled(files.metallic, reader.read(files.metallic, "linear")[..., :1])[..., 0]
    return np.clip(metallic, 0, 1).astype(np.float32) if metallic.max() > 0 else None


def _tell_of_limits(files: MapFiles, base, brightest, roughness, reporter: Reporter) -> None:
    bright, sharp = float((base > brightest).any(-1).mean()), float((roughness < LEAST_ROUGHNESS).mean())
    if bright > MANY:
        name, limit = files.base_colour.name, f"{MAX_ALBEDO} (linear; {MAX_METAL} where it is metal)"
        reporter.warn(f"{bright:.0%} of {name} is brighter than {limit} and is measured as that")
    if sharp > MANY:
        reporter.warn(f"{sharp:.0%} of it is smoother than roughness {LEAST_ROUGHNESS} and is measured as that")
