# SPDX-License-Identifier: GPL-3.0-or-later
"""What a photo shows of the finest detail, and renderings that show as much of it.

A photo out of focus, enlarged or coded as JPEG has lost its finest detail, and one taken in the dark has noise over it.
Both change all that `recognise.contrast` measures, and by more than one material differs from another; and how much was
lost cannot be told from a texture that nobody knows. But it can be told beside a candidate: its rendering is blurred
until its finest detail is as weak beside the next octave as the photo's, or has noise laid over it until its colours
are as grainy, and then the two are compared as images by one camera.
"""

from bisect import bisect_left
from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np

from btfsep_engine.recognise.contrast import BORDER, FEWEST, GREY_WORLD
from btfsep_engine.recognise.descriptors import normalised
from btfsep_engine.recognise.masked import Masked

CLEAR, SPOILT, NOISY = "verified", "spoilt", "grainy"  # models of `judgement.judgements`
FINEST = (0.8, 1.6)  # pixels, of the octave beside which the finest detail is looked at
SHARP = 0.45  # finest detail over that of this octave: less is a photo out of focus, or smoothed;
GRAINY = 1.6  # of a colour difference more is noise: it has 4.2, textures up to 1.3,
FAINT = 1e-4  # of it, and log2 units of this octave, at least,
ROUNDED = 0.02  # of colours: of less, what is found is how 8 bits are rounded
BLOCK = 8  # pixels, of JPEG
BLOCKS = 1.12  # steps between blocks over those within
CORNERS = np.outer([1, -2, 1], [1, -2, 1]).astype(np.float32) / 6  # noise alone is left of most images (Immerkaer 1996)
BLURS = (0.0, 0.35, 0.45, 0.55, 0.65, 0.75, 0.85, 1.0, 1.15, 1.35, 1.6, 1.9, 2.3)  # pixels, tried on renderings
SHOT, MOST_SHOT = 0.1, 0.5  # noise over the root of radiance times its mean: what is tried on renderings, and the most


@dataclass(frozen=True)
class Finest:
    """What an image shows of the finest detail.

    Attributes
    ----------
    sharp : finest detail over that of the octave beside it, of lightness, above 0; 0.9 in the median of 150 clear
        photographs of textures
    grain : log2 units, finest detail of the two colour differences
    model : which of `judgement.judgements` a photo is judged by: "spoilt" where its finest detail is lost, by blur or
        JPEG's blocks, "grainy" where noise lies over it, else "verified"
    """

    sharp: float
    grain: float
    model: str = CLEAR


def finest(colours, seen: Masked) -> Finest:
    """Of the usable pixels ``colours`` (n, 3) of an image, linear.

    A texture's contrast is that of the camera where its finest detail is lost, and judged beside photographs like it.
    So is a surface that has no fine detail to lose.
    """
    image = seen.image(normalised(colours, settings=GREY_WORLD))
    inside = _inside(seen)
    if inside.sum() < FEWEST:
        return Finest(np.inf, 0.0)
    corners, octave = _magnitudes(image, inside)
    sharp = corners / np.maximum(octave, (FAINT, ROUNDED, ROUNDED))
    lightness = np.ascontiguousarray(image[..., 0])
    blocks = max(_blocks(lightness, inside), _blocks(lightness.T, inside.T))
    spoilt, grainy = sharp[0] < SHARP or blocks > BLOCKS, sharp[1:].max() > GRAINY
    model = SPOILT if spoilt else NOISY if grainy else CLEAR
    return Finest(_over(corners[0], octave[0]), float(corners[1:].mean()), model)


def judged_as(radiance, mask) -> str:
    """`Finest.model` of a photo (h, w, 3), NaN where unusable, within ``mask`` (h, w) bool."""
    seen = Masked(mask, mask & np.isfinite(radiance).all(-1))
    return finest(seen.values_of(radiance), seen).model


def as_kept(picture, seen: Masked, photo: Finest) -> np.ndarray:
    """A rendering (n, 3) of the usable pixels as a camera would have kept it that has lost as much as the photo's.

    Of a photo that is neither spoilt nor grainy the rendering as it is.
    """
    if photo.model == SPOILT:
        return _blurred(picture, seen, photo.sharp)
    return _noisy(picture, seen, photo.grain) if photo.model == NOISY else picture


def _blurred(picture, seen: Masked, sharp: float) -> np.ndarray:
    """The picture, blurred until it is as sharp; as far as `BLURS` go."""
    image, variances = seen.image(picture), np.square(BLURS)

    def by(variance) -> np.ndarray:
        return seen.mean(image, np.sqrt(variance), seen.pixels) if variance else picture

    @cache
    def sharp_at(k: int) -> float:
        return _sharp(by(variances[k]), seen)

    enough = bisect_left(range(len(BLURS)), -sharp, key=lambda k: -sharp_at(k))
    if enough in (0, len(BLURS)):
        return by(variances[min(enough, len(BLURS) - 1)])
    # between two of them sharpness falls as an exponential of the variance
    share = np.log(sharp_at(enough - 1) / sharp) / np.log(sharp_at(enough - 1) / sharp_at(enough))
    return by(variances[enough - 1] + share * (variances[enough] - variances[enough - 1]))


def _noisy(picture, seen: Masked, grain: float) -> np.ndarray:
    """The picture with shot noise, always the same, until its colours are as grainy."""
    draws = np.random.default_rng(0).standard_normal(picture.shape).astype(np.float32)
    shot = np.sqrt(np.maximum(picture, 0) * picture.mean()) * draws
    before, trial = (_grain(each, seen) for each in (picture, picture + SHOT * shot))
    wanted, brought = max(grain**2 - before**2, 0), max(trial**2 - before**2, 1e-9)  # variances add up
    return picture + min(SHOT * np.sqrt(wanted / brought), MOST_SHOT) * shot


def _sharp(picture, seen: Masked) -> float:
    lightness = seen.image(normalised(picture, settings=GREY_WORLD)[:, 0])
    corners, octave = _magnitudes(lightness, _inside(seen))
    return _over(corners, octave)


def _over(corners, octave) -> float:
    """Above 0, of an even image, too: of sharpness logarithms are taken."""
    return max(float(corners / max(octave, FAINT)), FAINT)


def _grain(picture, seen: Masked) -> float:
    colours = seen.image(normalised(picture, settings=GREY_WORLD)[:, 1:])
    return float(_magnitudes(colours, _inside(seen))[0].mean())


def _inside(seen: Masked) -> np.ndarray:
    """(h, w) bool, usable pixels away from those that are not."""
    return seen.once("away", lambda: cv2.erode(seen.weight, np.ones((BORDER, BORDER)), borderValue=0) > 0)


def _magnitudes(image, inside) -> tuple[np.ndarray, np.ndarray]:
    """Medians of an image (h, w, …) within ``inside`` (h, w): of its finest detail, and of the octave `FINEST`."""
    octave = np.subtract(*(cv2.GaussianBlur(image, (0, 0), sigma) for sigma in FINEST))
    corners = cv2.filter2D(image, -1, CORNERS)
    return tuple(np.median(np.abs(each[inside]), axis=0) for each in (corners, octave))


def _blocks(image, inside) -> float:
    """The mean step between columns at the border of JPEG's blocks, wherever these begin, over that between others."""
    both = inside[:, 1:] & inside[:, :-1]
    count, total = both.sum(0), (np.abs(np.diff(image, axis=1)) * both).sum(0)
    phase = np.arange(len(count)) % BLOCK
    of_phase = np.array([[total[phase == k].sum(), count[phase == k].sum()] for k in range(BLOCK)])
    rest = of_phase.sum(0) - of_phase
    means = of_phase[:, 0] / np.maximum(of_phase[:, 1], 1), rest[:, 0] / np.maximum(rest[:, 1], 1)
    return float((means[0] / np.maximum(means[1], 1e-6)).max())
