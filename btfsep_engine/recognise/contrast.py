# SPDX-License-Identifier: GPL-3.0-or-later
"""What a texture looks like, whatever its light: what a vector of visual words, normalised as it is, does not say.

The logarithm of an image is cut into bands half an octave wide (differences of Gaussians within the mask), and of these
statistics are taken, as of a steerable pyramid by Portilla and Simoncelli (2000, "A parametric texture model based on
joint statistics of complex wavelet coefficients"): how strong each band is; how its lightness is distributed (pits have
a tail of dark values, grains of bright ones); how lightness and colours go together (a grain that is darker and redder,
a thread that is bright and blue); how the strengths of neighbouring bands go together (an edge is in all of them at one
place, noise is not); and how much a place has one direction (the coherence of the structure tensor; Bigun and Granlund
1987): wood and threads do, felt does not.

Two images of the same geometry under the same light have the same shading in them: what differs is the material. Of
coarse bands shading is most, and it is as right as the light is: only the fine ones, and of coarse ones the strength,
are looked at.
"""

from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np

from btfsep_engine.recognise.descriptors import Settings, normalised
from btfsep_engine.recognise.masked import Masked, smoothed

SIGMAS = (0.57, 0.8, 1.13, 1.6, 2.26, 3.2)  # pixels; a band lies between two
COARSE = (3.2, 6.4, 12.8)  # the same, of which the strength alone is asked
DIRECTED = (0.8, 1.6, 3.2)  # pixels at which directions are looked at,
ABOUT = 2.5  # and so many times as far about a place they are compared
SHARES = (0.02, 0.1, 0.9, 0.98)  # of pixels that are darker: where the tails of a band begin
BORDER = 7  # pixels of the outline: a silhouette is no texture
FEWEST = 500  # pixels: a smaller object keeps its border
UNSEEN = 0.03  # log2 units: a contrast that noise might be
GREY_WORLD = Settings(white_balance=1.0)


@dataclass(frozen=True)
class Contrast:
    """Of one masked image, for each band of `SIGMAS`.

    Attributes
    ----------
    deviation : (bands, 3), log2 units: of lightness, and of the colour differences of `descriptors.normalised`
    tails : (bands, 4), lightness at `SHARES`, in deviations
    correlation : (bands, 2), of lightness with each colour difference
    together : (bands - 1,), correlation of a band's magnitude of lightness with that of the next
    directed : (3,), coherence at `DIRECTED`, 0 to 1
    coarse : (2,), log2 units, deviation of lightness of the bands of `COARSE`
    """

    deviation: np.ndarray
    tails: np.ndarray
    correlation: np.ndarray
    together: np.ndarray
    directed: np.ndarray
    coarse: np.ndarray


def contrast(radiance, mask) -> Contrast:
    """The contrast of ``radiance`` (h, w, 3), linear, NaN where unusable, within ``mask`` (h, w) bool."""
    seen = Masked(mask, mask & np.isfinite(radiance).all(-1))
    return contrast_of(seen.values_of(radiance), seen)


def contrast_of(radiance, seen: Masked) -> Contrast:
    """The same of the usable pixels alone: ``radiance`` (n, 3), of ``seen.pixels``."""
    image = seen.image(normalised(radiance, settings=GREY_WORLD))
    inside = seen.once("inside", lambda: np.flatnonzero(_inside(seen)))
    # a channel's pixels side by side: they are summed
    means = [np.ascontiguousarray(seen.mean(image, sigma, inside).T) for sigma in SIGMAS]
    bands = np.stack([fine - coarse for fine, coarse in pairwise(means)])
    bands -= bands.mean(2, keepdims=True)
    deviation = np.sqrt(np.square(bands).mean(2))
    bands /= np.maximum(deviation, 1e-6)[..., None]
    lightness = bands[:, :1]
    alone = np.ascontiguousarray(image[..., 0])
    smooth = [means[-1][0], *(seen.mean(alone, sigma, inside) for sigma in COARSE[1:])]
    return Contrast(
        deviation,
        np.quantile(lightness[:, 0], SHARES, axis=1).T,
        (lightness * bands[:, 1:]).mean(2),
        _of_neighbours(np.abs(lightness[:, 0])),
        np.array([_coherence(alone, seen, sigma, inside) for sigma in DIRECTED]),
        np.array([(fine - coarse).std() for fine, coarse in pairwise(smooth)]),
    )


def _inside(seen: Masked) -> np.ndarray:
    """(h, w) bool, usable pixels away from those that are not, where these are enough."""
    inside = cv2.erode(seen.weight, np.ones((BORDER, BORDER)), borderValue=0) > 0
    return inside if inside.sum() >= FEWEST else seen.valid


def _of_neighbours(bands) -> np.ndarray:
    """(bands - 1,), correlation of each of ``bands`` (bands, n) with the next; 0 of even ones."""
    bands = bands - bands.mean(1, keepdims=True)
    size = np.maximum(np.sqrt(np.square(bands).mean(1)), 1e-6)
    return (bands[1:] * bands[:-1]).mean(1) / (size[1:] * size[:-1])


def _coherence(image, seen: Masked, sigma: float, inside) -> float:
    """How much places of an ``image`` (h, w) have one direction, 0 to 1, by gradients at ``sigma`` pixels."""
    smooth = seen.mean(image, sigma)
    across, down = (cv2.Sobel(smooth, cv2.CV_32F, *order) for order in ((1, 0), (0, 1)))
    products = np.stack([across * across, down * down, across * down], 2)
    xx, yy, xy = smoothed(products, ABOUT * sigma).reshape(-1, 3)[inside].T
    return float(np.hypot(xx - yy, 2 * xy).sum() / max(float((xx + yy).sum()), 1e-9))


def unlike(a: Contrast, b: Contrast) -> dict[str, float]:
    """How unlike two images of a geometry are, each >= 0.

    "contrast", "coarse": logarithm of the ratio of the deviations; the others: the difference. Where there is hardly
    any texture, tails and correlations of noise do not count.
    """
    lightness = a.deviation[:, 0] * b.deviation[:, 0]
    certain = lightness / (lightness + (2 * UNSEEN) ** 2)
    # of a correlation, the weaker of the two that it is between counts; a texture without colours has none
    weaker = np.mean([np.minimum(c.deviation[:, 1:], c.deviation[:, :1]) for c in (a, b)], axis=0)
    differences = {
        "contrast": _apart(a.deviation[:, 0], b.deviation[:, 0]),
        "tails": certain[:, None] * np.abs(a.tails - b.tails),
        "correlation": weaker / (weaker + UNSEEN) * np.abs(a.correlation - b.correlation),
        "together": np.abs(a.together - b.together),
        "directed": np.abs(a.directed - b.directed),
        "coarse": _apart(a.coarse, b.coarse),
    }
    return {name: float(value.mean()) for name, value in differences.items()}


def _apart(a, b) -> np.ndarray:
    return np.abs(np.log((a + UNSEEN) / (b + UNSEEN)))
