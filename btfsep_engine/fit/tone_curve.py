# SPDX-License-Identifier: GPL-3.0-or-later
"""A photo's unknown tone curve, by evidence: what cameras do, Blender's views, and a family from linear beyond sRGB.

    g_t(c) = c^(1 - t) s(c)^t,   s : the sRGB curve (IEC 61966-2-1),   t = 0 linear, 1 sRGB, more: steeper,

straight below the codes where s is, after an offset was taken off: c' = (c - o) / (1 - o). How probable the codes are
under a curve is how probable their radiance is (`fit.search`), times the curve's slope in the light's own unit:

    log p(c) = log p(b) + (1 / h) sum w [log g'(c) - log(level)],   level : of the radiance, as the fit takes it out,

tempered like the evidence by its coarsening h. The noise is what is really left over: with the fit's own lower bound of
it (`search.FLOOR`), the curve that spreads the codes most would win where all explain the photo. Two things keep a
misfit from passing for a curve. The brightest pixels count less (`importance`): what a highlight is off by is the
material's, and curves differ there by most. And a difference of evidence counts for 1 / `DOUBT` of itself: texture
errs in proportion to the light, which looks like a flatter curve under noise that is everywhere the same, and a
material that is only nearly right moves the evidence by as much as a camera's curve does. So what files usually are
counts for much: sRGB, or what a camera makes of a photograph (`Camera`); linear codes and AgX have to explain it far
better. Of what Blender says that it rendered, AgX is the most likely, which it saves by if nobody says otherwise; and
views that roll highlights off hardly ever leave pixels at the largest code, as sRGB alone does.
"""

from dataclasses import dataclass

import numpy as np

from btfsep_engine.imaging import blender_views, camera_curve
from btfsep_engine.imaging.srgb import linear_to_srgb, srgb_to_linear

STRAIGHT = 0.04045  # codes below which sRGB is linear
PRIOR = {0.0: 0.01, 0.25: 0.003, 0.5: 0.003, 0.75: 0.01, 1.0: 0.4, 1.25: 0.01}  # of the parameter t
OF_CAMERAS = {0.5: 0.05, 0.75: 0.15, 1.0: 0.25, 1.4: 0.08}  # of the strength s
OF_AGX = 0.003
OF_RENDERS = {  # of what Blender saved: by which view; how often brightest pixels are below, between, above `LEVELS`
    "srgb": (0.24, 0.1, 0.2, 0.7), "agx": (0.6, 0.74, 0.2, 0.06), "agx-punchy": (0.04, 0.74, 0.2, 0.06),
    "agx-medium-high-contrast": (0.03, 0.65, 0.28, 0.07), "agx-high-contrast": (0.03, 0.55, 0.35, 0.1),
    "filmic": (0.04, 0.74, 0.2, 0.06), "khronos": (0.02, 0.1, 0.7, 0.2),
}  # fmt: skip
LEVELS, BRIGHTEST = (0.9, 0.99), 99.9  # codes; percentile of the pixels
OF_RENDERS_DOUBT = 2.0  # times `DOUBT`: the views are nearer to each other than other curves are
OFFSET_PRIOR = 0.2
DOUBT = 20.0
LARGEST_OFFSET = 0.05  # of the largest code
SMALLEST_OFFSET = 1.5 / 255
LEAST_NOISE = 0.01  # of the photo's root mean square: what 8 bits round
DARKEST = 0.1  # percentile of the codes


@dataclass(frozen=True)
class ToneCurve:
    """Radiance as a function of codes; ``steepness`` : t; ``offset`` : the code that is black, of the largest one."""

    steepness: float
    offset: float = 0.0

    def decode(self, codes) -> np.ndarray:
        """Linear radiance of codes (any shape, 1: the largest); below the offset it is negative. float64."""
        c = (np.asarray(codes, np.float64) - self.offset) / (1 - self.offset)
        bright = np.maximum(c, STRAIGHT)
        t = self.steepness
        return np.where(c < STRAIGHT, c * self._foot, bright ** (1 - t) * srgb_to_linear(bright) ** t)

    @property
    def _foot(self) -> float:
        """Radiance over the code in the straight part."""
        return float((srgb_to_linear(STRAIGHT) / STRAIGHT) ** self.steepness)

    def log_slope(self, codes) -> np.ndarray:
        """Logarithm of the derivative of `decode`."""
        c = (np.asarray(codes, np.float64) - self.offset) / (1 - self.offset)
        bright, t = np.maximum(c, STRAIGHT), self.steepness
        s = srgb_to_linear(bright)
        curved = (1 - t) * np.log(bright) + t * np.log(s) + np.log((1 - t) / bright + t * 2.4 / (bright + 0.055))
        return np.where(c < STRAIGHT, np.log(self._foot), curved) - np.log(1 - self.offset)

    @property
    def log_prior(self) -> float:
        """Of a curve among the candidates."""
        return float(np.log(PRIOR[self.steepness]) + np.log(OFFSET_PRIOR if self.offset else 1 - OFFSET_PRIOR))

    @property
    def description(self) -> str:
        """The curve for people."""
        t = self.steepness
        text = {0.0: "linear", 1.0: "sRGB"}.get(
            t, f"steeper than sRGB ({t:g})" if t > 1 else f"between linear (0) and sRGB (1), {t:g}"
        )
        return text + (f", with codes from {255 * self.offset:.0f} of 255 on above black" if self.offset else "")


@dataclass(frozen=True)
class View:
    """One of Blender's view transforms, in the place of a `ToneCurve`: its channels depend on each other.

    ``name`` : of `blender_views.VIEWS`
    """

    name: str

    def decode(self, codes) -> np.ndarray:
        """Linear radiance of codes (..., 3); colours that no light makes are negative. float64."""
        return blender_views.to_linear(codes, self.name)

    def log_slope(self, codes) -> np.ndarray:
        """A third of the logarithm of the derivative's determinant, for each channel: (..., 3)."""
        return np.repeat(blender_views.log_volume(codes, self.name)[..., None] / 3, 3, -1)

    @property
    def log_prior(self) -> float:
        """Of it among the candidates."""
        return float(np.log(OF_AGX) + np.log(1 - OFFSET_PRIOR))

    @property
    def description(self) -> str:
        """For people."""
        return blender_views.VIEWS[self.name].description


@dataclass(frozen=True)
class Camera:
    """What a camera makes of a photograph (`camera_curve`), in the place of a `ToneCurve`; ``strength`` : its s."""

    strength: float = camera_curve.USUAL

    def decode(self, codes) -> np.ndarray:
        """Linear radiance of codes (any shape, 1: the largest). float64."""
        return camera_curve.to_scene(srgb_to_linear(codes), self.strength)

    def encode(self, radiance) -> np.ndarray:
        """Codes of radiance: the inverse of `decode`. float64."""
        return linear_to_srgb(camera_curve.to_display(radiance, self.strength))

    def log_slope(self, codes) -> np.ndarray:
        """Logarithm of the derivative of `decode`."""
        codes = np.maximum(np.asarray(codes, np.float64), camera_curve.DARKEST)
        return camera_curve.log_slope(srgb_to_linear(codes), self.strength) + SRGB.log_slope(codes)

    @property
    def log_prior(self) -> float:
        """Of it among the candidates."""
        return float(np.log(OF_CAMERAS[self.strength]) + np.log(1 - OFFSET_PRIOR))

    @property
    def description(self) -> str:
        """For people."""
        each = {0.5: "half of ", 1.0: ""}.get(self.strength, f"{self.strength:g} times ")
        return f"{each}a camera's usual curve"


VIEWS = {name: View(name) for name in blender_views.VIEWS}
LINEAR, SRGB, AGX, CAMERA = ToneCurve(0.0), ToneCurve(1.0), VIEWS["agx"], Camera()
CANDIDATES = tuple(ToneCurve(t) for t in PRIOR)
CAMERAS = tuple(Camera(s) for s in OF_CAMERAS)


def darkest_offset(codes) -> float:
    """The code that may be black: a low percentile of the photo's ``codes``; 0 where that is black, or no offset."""
    low = float(np.percentile(codes, DARKEST))
    return low if SMALLEST_OFFSET < low <= LARGEST_OFFSET else 0.0


def importance(codes, clipped) -> np.ndarray:
    """How much each code counts for the choice: (p, 3) in [0, 1], nothing where ``clipped``, little in highlights."""
    kept = ~np.asarray(clipped, bool)
    mean = (codes * kept).sum(0) / np.maximum(kept.sum(0), 1)
    return kept / (1 + (codes / np.maximum(mean, 1e-12)) ** 4)


def log_prior_of_render(name: str, codes) -> float:
    """Of a curve among those by which Blender saves; ``name`` : of `OF_RENDERS`; ``codes`` : (h, w, 3)."""
    usual, *levels = OF_RENDERS[name]
    brightest = np.percentile(np.asarray(codes).max(-1), BRIGHTEST)
    return float(np.log(usual) + np.log(levels[np.searchsorted(LEVELS, brightest, "right")]))


def log_probability(fit, log_slopes, weights) -> float:
    """Logarithm of how probable codes are under a curve, its prior aside, up to what all curves have in common.

    Parameters
    ----------
    fit : of the light to what the curve makes of the codes, with ``weights``, by `log_normal.LightSolver`
    log_slopes : (p, 3), logarithm of the derivative of what was fitted by the codes
    weights : (p, 3)
    """
    photo, solution = fit.election.photo, fit.election.solution
    slopes = float((weights * (log_slopes - np.log(photo.level))).sum())
    left = np.maximum(photo.noise(solution.x, solution.v, solution.discrepancy), LEAST_NOISE**2 * photo.mean_square)
    over = np.maximum(solution.v / left, 1.0)
    floor = 0.5 * float((photo.count * (np.log(over) + 1 / over - 1)).sum())
    # the number of independent channels is each fit's own: the sum has to be tempered alike under all curves
    return (fit.evidence * photo.coarsening + slopes + floor) / (photo.coarsening * photo.effective * DOUBT)
