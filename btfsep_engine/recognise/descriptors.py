# SPDX-License-Identifier: GPL-3.0-or-later
"""Dense colour patches and dense SIFT over the masked region of one image (the paper, section 3.2).

The exposure of a photo and the colour of its light are unknown, so both are normalised before anything is
measured: radiance is divided by the region's mean luminance, its colour is moved part of the way to grey,
and the logarithm makes shading an offset. Only whole patches inside the mask are used.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np

from btfsep_engine.conventions import REC709_LUMINANCE
from btfsep_engine.errors import InputError
from btfsep_engine.imaging.srgb import linear_to_srgb
from btfsep_engine.recognise.masked import Masked

TAPS = 3  # a colour patch has TAPS x TAPS samples
CELLS, DIRECTIONS = 4, 8  # of SIFT: cells along an edge of its patch, and directions of gradients
SIFT_LENGTH = CELLS * CELLS * DIRECTIONS
LARGEST = 0.2  # of a SIFT vector's numbers, before its length is made 1 again
DIFFERENCE = np.float32([[-0.5, 0, 0.5]])
GREY = 0.18  # what the mean luminance becomes where colours are those of a display
FALLBACK_BINS = (3, 2)  # pixels; tried one after the other where the object is too small for the usual ones


@dataclass(frozen=True)
class Settings:
    """How an image is described. Stored with every recogniser.

    Attributes
    ----------
    colours : "opponent" (log2 lightness and two colour differences) or "display" (sRGB of an even exposure)
    bins : pixels, edges of one of the 4 x 4 cells of a SIFT patch; one scale each
    sift_sigma : pixels, blur before the gradients are taken, so that the sharpness of a photo matters little
    target : number of descriptors wished for per scale; the grid's step (1 to ``max_step`` pixels) follows
    max_step : pixels
    minimum : fewest descriptors with which a region is described at all
    white_balance : 0 to 1, how far the mean colour is moved to grey (0 keeps it, 1 is grey world)
    floor : radiance, relative to the mean luminance, added before the logarithm, so that black stays finite
    chroma : weight of the two colour-difference samples against lightness
    contrast : standard deviation of the log2 luminance within a patch at which its SIFT counts half
    shading : pixels; the lightness of colour patches is taken relative to its mean over this radius, which
        removes the shading that the light makes and leaves the texture; 0 keeps the shading
    """

    colours: str = "opponent"
    bins: tuple[int, ...] = (4, 7)
    sift_sigma: float = 1.0
    target: int = 900
    max_step: int = 8
    minimum: int = 40
    white_balance: float = 0.3
    floor: float = 0.03
    chroma: float = 1.0
    contrast: float = 0.05
    shading: float = 20.0


DEFAULT = Settings()
# the paper's patches and SIFT as they are; of light and exposure only what has to be taken out is
PAPER = Settings(colours="display", white_balance=0.0, contrast=0.0, shading=0.0)


@dataclass(frozen=True)
class Descriptors:
    """What was measured at n places (a place is a position and a scale).

    Attributes
    ----------
    colour : (n, 27) float32, 3 x 3 samples of the colours of `normalised`
    sift : (n, 128) uint8, upright SIFT of their lightness, as OpenCV scales it
    contrast : (n,) float32, standard deviation of the lightness within the SIFT patch
    xy : (n, 2) float32, pixels of the whole image, centres of the patches
    """

    colour: np.ndarray
    sift: np.ndarray
    contrast: np.ndarray
    xy: np.ndarray

    def __len__(self):
        return len(self.xy)

    def picked(self, which) -> "Descriptors":
        """Some of the places."""
        return Descriptors(*(values[which] for values in vars(self).values()))

    def compact(self) -> "Descriptors":
        """The same in half floats, to be kept."""
        return Descriptors(
            self.colour.astype(np.float16), self.sift, self.contrast.astype(np.float16), self.xy.astype(np.float32)
        )


def joined(parts) -> Descriptors:
    """Of several, one after the other."""
    return Descriptors(*map(np.concatenate, zip(*(vars(part).values() for part in parts), strict=True)))


def normalised(colours, *, settings=DEFAULT) -> np.ndarray:
    """Colours with exposure and part of the light's colour taken out.

    Parameters
    ----------
    colours : (n, 3) float, linear Rec.709, finite, of the pixels of a region

    Returns
    -------
    (n, 3) float32. Log2 units: lightness, red - green, (red + green) / 2 - blue; or, as ``settings.colours`` asks,
    display values 0 to 1: red, green, blue

    Raises
    ------
    InputError
        Where the region is black.
    """
    colours = np.maximum(colours, 0)
    largest = float(colours.max(initial=0))
    if not largest > 0:
        raise InputError("the region to recognise", "is black in the photo", "use a photo in which it is lit")
    colours = (colours / largest).astype(np.float32)  # of any unit
    # a few highlights must not darken all the rest: the mean is taken below the 98th percentile
    luminance = colours @ np.float32(REC709_LUMINANCE)
    ordinary = luminance <= np.percentile(luminance, 98)
    mean_luminance = luminance[ordinary].mean()
    if not mean_luminance > 0:
        raise InputError("the region to recognise", "is black but for a few pixels", "use a photo in which it is lit")
    mean = np.maximum(colours[ordinary].mean(0), 1e-3 * mean_luminance)
    cast = (mean / mean_luminance) ** settings.white_balance
    colours /= (mean_luminance * cast).astype(np.float32)
    if settings.colours == "display":
        return linear_to_srgb(np.clip(GREY * colours, 0, 1)).astype(np.float32)
    logs = np.log2(colours + np.float32(settings.floor))
    red, green, blue = logs.T
    return np.stack(
        [
            logs @ np.float32(REC709_LUMINANCE),
            settings.chroma * (red - green),
            settings.chroma * ((red + green) / 2 - blue),
        ],
        1,
    )


def extract(radiance, mask, *, settings=DEFAULT, what="the region to recognise", shared=None) -> Descriptors:
    """The descriptors of one masked image.

    Pixels that are not finite (mark saturated ones as NaN) are filled from their neighbours; a patch is used
    when all of it lies in the mask and nine tenths of it are finite.

    Parameters
    ----------
    radiance : (h, w, 3) float32, linear Rec.709, any exposure
    mask : (h, w) bool
    what : names the region in errors, as in "object 'bunny'"
    shared : a dict, empty at first, in which what depends on the usable pixels alone goes from image to image

    Raises
    ------
    InputError
        Where the mask holds too few whole patches.
    """
    radiance, mask = np.asarray(radiance, np.float32), np.asarray(mask, bool)
    if radiance.ndim != 3 or radiance.shape[2] != 3 or mask.shape != radiance.shape[:2]:
        raise ValueError(f"radiance (h, w, 3) and mask (h, w) do not match: {radiance.shape}, {mask.shape}")
    rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    if not len(rows):
        raise InputError(what, "covers no pixel of the photo", "check the camera and the mask")
    top, left = rows[0], columns[0]
    window = np.s_[top : rows[-1] + 1, left : columns[-1] + 1]
    radiance, mask = radiance[window], mask[window]
    valid = mask & np.isfinite(radiance).all(-1)
    if not valid.any():
        raise InputError(what, "has no finite pixel in the photo", "export the image again")
    key, shared = (mask.shape, mask.tobytes(), valid.tobytes()), {} if shared is None else shared
    if key not in shared:
        shared.clear()
        shared[key] = Masked(mask, valid)
    seen = shared[key]
    every = described(seen.values_of(radiance), seen, settings=settings, what=what)
    return replace(every, xy=every.xy + np.array([left, top], np.float32))


def described(radiance, seen: Masked, *, settings=DEFAULT, what="the region to recognise") -> Descriptors:
    """As `extract`, of the usable pixels alone, places in the mask's own image.

    Parameters
    ----------
    radiance : (n, 3) float32, of ``seen.pixels``
    """
    image = seen.image(normalised(radiance, settings=settings))
    first = image[..., 0]
    shade = seen.mean(np.ascontiguousarray(first), settings.shading) if settings.shading else 0
    seen.fill(image, _reach(settings))
    first -= shade
    opponent = settings.colours == "opponent"
    lightness = np.ascontiguousarray(first) if opponent else image @ np.float32(REC709_LUMINANCE)
    of_image = image, lightness, orientation_maps(lightness, settings.sift_sigma), seen
    parts = [_at_scale(*of_image, edge, settings) for edge in settings.bins]
    for edge in FALLBACK_BINS:
        if sum(map(len, parts)) >= settings.minimum:
            break
        parts.append(_at_scale(*of_image, edge, settings))
    if (count := sum(map(len, parts))) < settings.minimum:
        raise InputError(
            what,
            f"covers only {int(seen.mask.sum())} pixels, room for {count} of the {settings.minimum} patches needed",
            "take a closer or larger photo, or name the material in the job",
        )
    return joined(parts)


def _reach(settings) -> int:
    """How far from the mask pixels are looked at: by the mean about a pixel at the edge of a patch that lies in it."""
    return max(2 * max(*settings.bins, *FALLBACK_BINS), int(5 * settings.sift_sigma)) + CELLS


def _places(seen: Masked, half, settings):
    """Centres (x, y) of a regular grid of patches of edge 2 half + 1 that lie in the mask whole."""
    mask, valid = seen.mask, seen.valid
    # with a border of zeros a patch cannot reach beyond the image either
    inside = cv2.erode(mask.astype(np.uint8), np.ones((2 * half + 1,) * 2, np.uint8), borderValue=0) > 0
    finite = cv2.blur(valid.astype(np.float32), (2 * half + 1,) * 2)
    near = cv2.erode(valid.astype(np.uint8), np.ones((TAPS, TAPS), np.uint8), borderValue=0) > 0
    inside &= (finite > 0.9) & near
    step = int(np.clip(np.sqrt(inside.sum() / settings.target), 1, settings.max_step))
    grid = np.zeros_like(inside)
    grid[half % step :: step, half % step :: step] = True
    y, x = np.nonzero(inside & grid)
    return x, y


def orientation_maps(lightness, sigma: float) -> np.ndarray:
    """(h, w, 8) float32, the length of the gradient of ``lightness`` (h, w), shared by the two nearest of 8 directions.

    ``sigma`` : pixels, of the blur before
    """
    smooth = cv2.GaussianBlur(lightness, (0, 0), sigma)
    right, up = cv2.filter2D(smooth, -1, DIFFERENCE), cv2.filter2D(smooth, -1, -DIFFERENCE.T)
    size, angle = cv2.cartToPolar(right, up, angleInDegrees=True)
    place = angle.ravel() * np.float32(DIRECTIONS / 360)
    below = place.astype(int)
    above = (place - below) * size.ravel()
    out, first = (
        np.zeros((lightness.size, DIRECTIONS), np.float32),
        np.arange(0, lightness.size * DIRECTIONS, DIRECTIONS),
    )
    out.ravel()[first + below % DIRECTIONS] = size.ravel() - above
    out.ravel()[first + (below + 1) % DIRECTIONS] = above
    return out.reshape(*lightness.shape, DIRECTIONS)


def dense_sift(maps, x, y, edge: int) -> np.ndarray:
    """Upright SIFT (n, 128) uint8, in OpenCV's unit, of patches of 4 x 4 cells of ``edge`` pixels about (x, y).

    Of gradients that `orientation_maps` has sorted: a cell is their sum under a triangle (bilinear shares), and the
    window about the patch has one weight for each cell, not for each pixel (Vedaldi and Fulkerson 2010: on a dense
    grid a filter and a look-up). Vectors have length 1, none of their numbers above `LARGEST`.
    """
    triangle = 1 - np.abs(np.arange(1 - edge, edge, dtype=np.float32)) / edge
    cells = cv2.sepFilter2D(maps, -1, triangle, triangle, borderType=cv2.BORDER_REPLICATE)
    place = np.arange(CELLS) - (CELLS - 1) / 2  # of a cell's middle, in cells
    offset = np.floor(place * edge).astype(int)
    window = np.exp(-(place**2) / (2 * (CELLS / 2) ** 2)).astype(np.float32)
    h, w = maps.shape[:2]
    rows = np.clip(y[:, None] + offset, 0, h - 1)[:, :, None]
    columns = np.clip(x[:, None] + offset, 0, w - 1)[:, None, :]
    out = cells[rows, columns]
    out *= np.outer(window, window)[..., None]
    out = _of_length_1(out.reshape(len(x), -1))
    for _ in range(2):
        out = _of_length_1(np.minimum(out, LARGEST, out=out))
    out *= 512
    return np.rint(np.minimum(out, 255, out=out), out=out).astype(np.uint8)


def _of_length_1(vectors) -> np.ndarray:
    """Vectors (n, k) float32 over their lengths, in place."""
    vectors /= np.maximum(np.sqrt(np.einsum("ij,ij->i", vectors, vectors)), 1e-12)[:, None]
    return vectors


def _at_scale(image, lightness, maps, seen: Masked, edge, settings) -> Descriptors:
    """The descriptors of one scale; ``edge`` is the edge of a SIFT cell in pixels."""
    half = 2 * edge
    x, y = seen.once((half, settings), lambda: _places(seen, half, settings))
    if not len(x):
        none = np.zeros((0, 3 * TAPS * TAPS), np.float32), np.zeros((0, SIFT_LENGTH), np.uint8)
        return Descriptors(*none, np.zeros(0, np.float32), np.zeros((0, 2), np.float32))
    # SIFT is normalised for contrast, so a flat patch would be described by its noise: the contrast is kept beside
    box = (2 * half + 1,) * 2
    local_mean = cv2.blur(lightness, box)
    # its running sums leave less than nothing where all is black but for a lamp's spot beside
    variance = np.maximum(cv2.blur((lightness - local_mean) ** 2, box)[y, x], 0)
    return Descriptors(
        _patches(image, x, y, edge),
        dense_sift(maps, x, y, edge),
        np.sqrt(variance).astype(np.float32),
        np.stack([x, y], 1).astype(np.float32) + 0.5,
    )


def _patches(image, x, y, edge: int) -> np.ndarray:
    """Colour patches (n, 27) float32: taps a quarter of a cell apart, on an image blurred to match."""
    spread = max(1, edge // 4)
    smooth = cv2.GaussianBlur(image, (0, 0), 0.5 * spread)
    h, w = image.shape[:2]
    offsets = spread * (np.arange(TAPS) - TAPS // 2)
    taps = [smooth[np.clip(y + dy, 0, h - 1), np.clip(x + dx, 0, w - 1)] for dy in offsets for dx in offsets]
    return np.concatenate(taps, 1).astype(np.float32)
