# SPDX-License-Identifier: GPL-3.0-or-later
"""How strong a texture is, octave by octave: what a vector of visual words, normalised as it is, does not say.

The logarithm of an image is cut into octaves (differences of Gaussians within the mask). Of each: the standard
deviation of lightness and of two colour differences, how these go together (a grain that is darker and redder, a thread
that is bright and blue), and the skewness of lightness (pits are dark, grains are bright). Two images of the same
geometry under the same light have the same shading in them: what differs is the material.
"""

from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np

from btfsep_engine.recognise.descriptors import Settings, normalise, normalised
from btfsep_engine.recognise.masked import Masked

SIGMAS = (0.8, 1.6, 3.2, 6.4, 12.8)  # pixels; an octave lies between two
BORDER = 7  # pixels of the outline: a silhouette is no texture
FEWEST = 500  # pixels: a smaller object keeps its border
UNSEEN = 0.03  # log2 units: a contrast that noise might be
LARGEST_SKEWNESS = 3.0
GREY_WORLD = Settings(white_balance=1.0)
SHARP = 0.45  # finest detail over that of the next octave: less is a photo out of focus, or smoothed
BLOCK = 8  # pixels, of JPEG
BLOCKS = 1.12  # steps between blocks over those within


@dataclass(frozen=True)
class Contrast:
    """Of one masked image, for each octave.

    Attributes
    ----------
    deviation : (octaves, 3), log2 units: of lightness, and of the colour differences of `descriptors.normalise`
    skewness : (octaves,), of lightness
    correlation : (octaves, 2), of lightness with each colour difference
    """

    deviation: np.ndarray
    skewness: np.ndarray
    correlation: np.ndarray


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
    octaves = np.stack([fine - coarse for fine, coarse in pairwise(means)])
    octaves -= octaves.mean(2, keepdims=True)
    deviation = np.sqrt(np.square(octaves).mean(2))
    octaves /= np.maximum(deviation, 1e-6)[..., None]
    lightness = octaves[:, :1]
    skewness = (lightness[:, 0] ** 2 * lightness[:, 0]).mean(1)
    return Contrast(deviation, skewness, (lightness * octaves[:, 1:]).mean(2))


def _inside(seen: Masked) -> np.ndarray:
    """(h, w) bool, usable pixels away from those that are not, where these are enough."""
    inside = cv2.erode(seen.weight, np.ones((BORDER, BORDER)), borderValue=0) > 0
    return inside if inside.sum() >= FEWEST else seen.valid


def unlike(a: Contrast, b: Contrast) -> dict[str, float]:
    """How unlike two images of a geometry are, each >= 0, and 0 where there is too little texture to tell by.

    "contrast" and "chroma": logarithm of the ratio of the deviations; "skewness" and "correlation": their difference.
    """
    ratio = np.abs(np.log((a.deviation + UNSEEN) / (b.deviation + UNSEEN)))
    strength = a.deviation[:, 0] * b.deviation[:, 0]
    certain = strength / (strength + (2 * UNSEEN) ** 2)  # where there is hardly any texture, skewness is noise
    limits = -LARGEST_SKEWNESS, LARGEST_SKEWNESS
    turned = np.abs(np.clip(a.skewness, *limits) - np.clip(b.skewness, *limits))
    # of a correlation, the weaker of the two that it is between counts
    weaker = [np.minimum(c.deviation[:, 1:], c.deviation[:, :1]) for c in (a, b)]
    both = np.sqrt(weaker[0] * weaker[1])
    apart = both / (both + UNSEEN) * np.abs(a.correlation - b.correlation)
    differences = {
        "contrast": ratio[:, 0].mean(),
        "chroma": ratio[:, 1:].mean(),
        "skewness": (certain * turned).mean(),
        "correlation": apart.mean(),
    }
    return {name: float(value) for name, value in differences.items()}


def spoilt(radiance, mask) -> bool:
    """Whether a photo (h, w, 3), NaN where unusable, has lost its finest detail, by blur or by JPEG's blocks.

    A texture's contrast is then that of the camera, and judged beside photographs like it. So is a surface that has no
    fine detail to lose.
    """
    valid = mask & np.isfinite(radiance).all(-1)
    image = np.ascontiguousarray(normalise(radiance, valid, settings=GREY_WORLD)[..., 0])
    inside = cv2.erode(valid.astype(np.uint8), np.ones((BORDER, BORDER)), borderValue=0) > 0
    if inside.sum() < FEWEST:
        return False
    corners = cv2.filter2D(image, -1, np.outer([1, -2, 1], [1, -2, 1]).astype(np.float32) / 6)
    octave = cv2.GaussianBlur(image, (0, 0), SIGMAS[0]) - cv2.GaussianBlur(image, (0, 0), SIGMAS[1])
    sharp = np.median(np.abs(corners[inside])) / max(np.median(np.abs(octave[inside])), 1e-4)
    return bool(sharp < SHARP or max(_blocks(image, inside), _blocks(image.T, inside.T)) > BLOCKS)


def _blocks(image, inside) -> float:
    """The mean step between columns at the border of JPEG's blocks, wherever these begin, over that between others."""
    both = inside[:, 1:] & inside[:, :-1]
    count, total = both.sum(0), (np.abs(np.diff(image, axis=1)) * both).sum(0)
    phase = np.arange(len(count)) % BLOCK
    of_phase = np.array([[total[phase == k].sum(), count[phase == k].sum()] for k in range(BLOCK)])
    rest = of_phase.sum(0) - of_phase
    means = of_phase[:, 0] / np.maximum(of_phase[:, 1], 1), rest[:, 0] / np.maximum(rest[:, 1], 1)
    return float((means[0] / np.maximum(means[1], 1e-6)).max())
