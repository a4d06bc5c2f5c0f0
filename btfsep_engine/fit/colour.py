# SPDX-License-Identifier: GPL-3.0-or-later
"""Is it the light that is coloured, or the object? One photograph shows their product; what each usually does decides.

The tint t = (log R/B, log G/sqrt(R B)) of all of the light, with the material's colour taken for true, is the light's
own plus that by which the object departs from its material:

    t = light + object,    light ~ N(0, LIGHT^2),    object ~ N(0, DYE^2), or with the probability UNKNOWN N(0, ANY^2),

where of an object whose colour somebody stated the probability is MISSTATED, and with the probability FILTERED light ~
N(0, VIVID^2) and object ~ N(0, DYE^2): a lamp's filter makes colours that no dye does. The posterior of the light's
tint is a mixture of Gaussians. Where the second has the upper hand, the object's colour is not known, and most of the
tint is the object's. LIGHT is what the training lights' tints scatter by, and as much again for lamps (their log R/B
scatters by 0.13, their green by 0.07). Where the photo shows lights of strong colours (`pipeline.refine.vivid`), all
light is N(0, VIVID^2).
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import softmax

from btfsep_engine.light.log_field import CHROMA

LIGHT = np.array([0.30, 0.10])
VIVID = np.array([1.5, 0.8])  # of light of strong colours, as on a stage
DYE = np.array([0.05, 0.03])
ANY = np.array([1.0, 0.6])
UNKNOWN = 0.25  # of a material by its name: what people photograph seldom has the colour that a library holds
MISSTATED, FILTERED = 0.05, 0.01  # of a colour that somebody stated


@dataclass(frozen=True)
class Tint:
    """What of a tint is the light's.

    Attributes
    ----------
    object_tint : (2,), the most probable part of the object's
    gain : (3,), by which the channels of the light are multiplied to take the object's part out, luminance kept
    covariance : (2, 2) of the light's tint
    unknown : probability that the object's colour is not its material's, 0 to 1
    filtered : probability that it is, and the light has a strong colour
    dye : (2,), what of ``object_tint`` the basis images have already
    """

    object_tint: np.ndarray
    gain: np.ndarray
    covariance: np.ndarray
    unknown: float
    filtered: float = 0.0
    dye: np.ndarray | float = 0.0

    @property
    def reflected(self) -> np.ndarray:
        """(3,), by how much more than its material the object was taken to reflect each channel."""
        return np.exp(CHROMA[:, 1:] @ np.broadcast_to(self.dye, 2)) / self.gain

    def draw(self, count: int, random) -> np.ndarray:
        """Factors (count, 3) by which the light's channels may be wrong."""
        shifts = random.standard_normal((count, 2)) @ np.linalg.cholesky(self.covariance + 1e-12 * np.eye(2)).T
        return np.exp(shifts @ CHROMA[:, 1:].T)


def tint_of(colour) -> np.ndarray:
    """(log R/B, log G/sqrt(R B)) of a colour (3,) > 0."""
    r, g, b = np.log(np.maximum(colour, 1e-6 * np.max(colour)))
    return np.array([r - b, g - (r + b) / 2])


def as_of_two_lights(one, other) -> float:
    """How much two colours (3,) >= 0 speak for differing as two lights do, against as paints that nobody knows do: log
    odds."""
    tint = tint_of(one) - tint_of(other)
    of_light, of_paint = (-0.5 * np.square(tint / each) - np.log(each) for each in (np.sqrt(2) * LIGHT, ANY))
    return float((of_light - of_paint).sum())


def base_colour(tint) -> np.ndarray:
    """The colour (3,) of a tint (2,), its brightest channel 1."""
    colour = np.exp(CHROMA[:, 1:] @ np.asarray(tint))
    return colour / colour.max()


def split(level, dye=0.0, *, stated: bool = False, vivid: bool = False) -> Tint:
    """The tint of the light's mean radiance (3,), found with the material's colour, split between light and object.

    ``dye`` : (2,), the tint of a colour that was taken from the photo, in the place of the material's: it is the
    object's as far as the tint of both together is; ``stated`` : whether somebody told the object's colour by its
    numbers; ``vivid`` : whether the photo shows light of strong colours
    """
    left = tint_of(level)
    tint = left + dye
    hypotheses = []
    unknown = MISSTATED if stated else UNKNOWN
    filtered = 1 - unknown if vivid else FILTERED * stated
    usual, known = VIVID if vivid else LIGHT, 1 - unknown - filtered
    for of_light, spread, probability in ((LIGHT, DYE, known), (usual, ANY, unknown), (VIVID, DYE, filtered)):
        total = of_light**2 + spread**2
        log = np.log(max(probability, 1e-300)) - 0.5 * float((tint**2 / total + np.log(total)).sum())
        hypotheses.append((log, tint * of_light**2 / total, of_light**2 * spread**2 / total))
    share = softmax([h[0] for h in hypotheses])
    mean = sum(s * h[1] for s, h in zip(share, hypotheses, strict=True))
    covariance = sum(
        s * (np.diag(h[2]) + np.outer(h[1] - mean, h[1] - mean)) for s, h in zip(share, hypotheses, strict=True)
    )
    gain = np.exp(CHROMA[:, 1:] @ (mean - left))
    gain *= np.sum(level) / np.sum(gain * level)
    return Tint(tint - mean, gain, covariance, *map(float, share[-2:]), dye)
