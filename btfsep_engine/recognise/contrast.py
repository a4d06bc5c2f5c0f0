# SPDX-License-Identifier: GPL-3.0-or-later
"""How strong a texture is, octave by octave: what a vector of visual words, normalised as it is, does not say.

The logarithm of an image's luminance is cut into octaves (differences of Gaussians within the mask). Of each: the
standard deviation, and the skewness (pits are dark, grains are bright). Two images of the same geometry under the same
light have the same shading in them: what differs is the material. (Colour differences add nothing to that: how much of
them is a photo's noise, is not known.)
"""

from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np

from btfsep_engine.recognise.descriptors import Settings, normalise

SIGMAS = (0.8, 1.6, 3.2, 6.4, 12.8)  # pixels; an octave lies between two
BORDER = 7  # pixels of the outline: a silhouette is no texture
FEWEST = 500  # pixels: a smaller object keeps its border
UNSEEN = 0.03  # log2 units: a contrast that noise might be
LARGEST_SKEWNESS = 3.0
PLAIN = Settings(white_balance=0.0)


@dataclass(frozen=True)
class Contrast:
    """Of one masked image: ``deviation`` (octaves,), log2 units, and ``skewness`` (octaves,)."""

    deviation: np.ndarray
    skewness: np.ndarray


def contrast(radiance, mask) -> Contrast:
    """The contrast of ``radiance`` (h, w, 3), linear, NaN where unusable, within ``mask`` (h, w) bool."""
    valid = mask & np.isfinite(radiance).all(-1)
    image, weight = normalise(radiance, valid, settings=PLAIN)[..., 0], valid.astype(np.float32)
    smooth = [
        cv2.GaussianBlur(image, (0, 0), sigma) / np.maximum(cv2.GaussianBlur(weight, (0, 0), sigma), 1e-3)
        for sigma in SIGMAS
    ]
    inside = cv2.erode(weight, np.ones((BORDER, BORDER)), borderValue=0) > 0
    inside = inside if inside.sum() >= FEWEST else valid
    octaves = np.stack([(fine - coarse)[inside] for fine, coarse in pairwise(smooth)]).astype(np.float64)
    deviation = octaves.std(1)
    third = ((octaves - octaves.mean(1, keepdims=True)) ** 3).mean(1)
    return Contrast(deviation, third / np.maximum(deviation, 1e-6) ** 3)


def unlike(a: Contrast, b: Contrast) -> tuple[float, float]:
    """How unlike two images of a geometry are, in contrast (logarithm of the ratio) and in skewness; each >= 0."""
    ratio = np.abs(np.log((a.deviation + UNSEEN) / (b.deviation + UNSEEN)))
    strength = a.deviation * b.deviation
    certain = strength / (strength + (2 * UNSEEN) ** 2)  # where there is hardly any texture, skewness is noise
    limits = -LARGEST_SKEWNESS, LARGEST_SKEWNESS
    turned = np.abs(np.clip(a.skewness, *limits) - np.clip(b.skewness, *limits))
    return float(ratio.mean()), float((certain * turned).mean())
