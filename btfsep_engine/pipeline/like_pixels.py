# SPDX-License-Identifier: GPL-3.0-or-later
"""What a textured surface shows on the whole: each pixel of the fit as the mean of those around that show the same.

Texture that nobody has a picture of varies from pixel to pixel by a tenth and more of what a mean ABRDF predicts. It is
noise of which there is enough to average: basis images hardly change over a few pixels. But the fit cannot know that.
It holds what is left over to be structured, however many pixels there are (`fit.products`, the coarsened posterior), so
that strong texture hides what the photo tells of the light. So the value of a pixel of such a photo is the mean over a
grid about it, of opposite pairs: what a slope adds on the one side it takes off on the other. Of a pair both show the
object, within `SAME` of the pixel's own normal, and neither is clipped or left out by a mask.

Not where the photo is smooth: there is nothing to average, and what edges of shadows and highlights lose by it is more
than what is won (of three sets of plates 1.11, 1.08 and 0.98 times the error). Nor where basis images have the texture.

Of gloss, what varies from pixel to pixel is highlights as well, and what is left over of their means is the table's
error, no noise: the fit that takes it for noise believes in sharp light from anywhere. There a pixel counts for less
(`Problem.coarsening`), by how much of the basis images changes fast with the light's direction.
"""

from dataclasses import replace

import numpy as np

from btfsep_engine.pipeline.problem import Problem
from btfsep_engine.pipeline.settings import FitSettings
from btfsep_engine.storage import kept

# How far to either side, of the square root of an object's pixels: 2 pixels of photographs of 256 x 256. With 1 errors
# of those that are textured are 8 % larger, with 4 they are 5 %.
REACH = 1 / 90
STEPS = 2  # to either side, at most: of a larger reach not every pixel is asked
PAIRS = (2 * STEPS + 1) ** 2 // 2
SAME = np.cos(np.radians(12))
# Relative difference of a pixel from its mean, the median: of 43 photographs of textured materials 0.05 to 0.28, of 96
# plates of smooth, painted and glossy things 0.001 to 0.04.
TEXTURED = 0.045
SOME = 400  # points that say whether a photo is textured
# Of lightness, the finest detail over that of the octave beside it (`recognise.finest`): of textures 0.9 to 1.2, of
# noise 4 to 4.7, of fine leather and denim under it 1.5 to 4.3
GRAIN = 2.5
LOOKED_AT = 512  # pixels, the side of what is looked at of a large photo
# Part of the basis images that is above order 3, of the root of their squares: of matte materials 0.11 to 0.13, of the
# library's oak and damask 0.18 and 0.21, of leathers and granite 0.30 to 0.53, of lacquered walnut 0.72
MATTE, SHARP_FROM = 0.18, 16
# How many times less pixels of gloss count, at most. Fits of 120 photographs err the least with 1 where they are matte,
# with 2 to 4 where they are of leather or walnut, with 1 of granite; whole estimates of 72 of the four with 1.5 and 2
# 0.83 to 0.94 times as much as with 1, granite alone 1.10 and 1.15, and with 2 fewer lamps nearby are found
FEWEST = 1.5


def as_seen_on_the_whole(problem: Problem, settings: FitSettings) -> Problem:
    """The problem with the means of like pixels in place of single ones, where its photo is textured."""
    if settings.estimator != "map" or problem.scene.mirrors or any(m.lines_up for m in problem.materials):
        return problem
    few = np.random.default_rng(settings.seed).random(len(problem.pixels)) < SOME / len(problem.pixels)
    if not few.any() or variation(with_like_pixels(problem.subset(few))) < TEXTURED:
        return problem
    out = with_like_pixels(problem)
    values = out.means_of(out.scene.job.photo.radiance)
    return replace(out, measured=values, coarsening=float(np.clip(glossiness(problem) / MATTE, 1, FEWEST)))


def glossiness(problem: Problem) -> float:
    """Which part of the basis images changes fast with the light's direction, from order 4 on."""
    squares = np.square(np.concatenate([a[:: max(1, len(a) // SOME)] for a in problem.basis])).sum((0, 2))
    return float(np.sqrt(squares[SHARP_FROM:].sum() / max(squares.sum(), 1e-300)))


def is_textured(scene, index: int, *, seed: int) -> bool:
    """Whether the photo of an object, made of whatever, varies as of a texture."""
    rows, columns = np.nonzero(scene.regions[index] & scene.job.photo.usable)
    few = np.random.default_rng(seed).permutation(len(rows))[:SOME]
    region = np.zeros_like(scene.regions[index])
    region[rows[few], columns[few]] = True
    nothing = np.zeros_like(region)
    points = [scene.bare_points(i, region=region if i == index else nothing) for i in range(len(scene.regions))]
    return variation(with_like_pixels(Problem(scene, [], points, [], {}))) >= TEXTURED


def is_grainy(scene, index: int) -> bool:
    """Whether what the photo of an object varies by from pixel to pixel is as fine as noise is, and no texture."""
    from btfsep_engine.recognise.finest import finest  # few photos are asked
    from btfsep_engine.recognise.masked import Masked

    middle = np.median(np.nonzero(scene.regions[index]), axis=1).astype(int)
    window = tuple(slice(max(0, at - LOOKED_AT // 2), at + LOOKED_AT // 2) for at in middle)
    region, image = scene.regions[index][window], scene.job.photo.radiance[window]
    seen = Masked(region, region & scene.job.photo.usable[window] & np.isfinite(image).all(-1))
    return bool(GRAIN < finest(seen.values_of(image), seen).sharp < np.inf)


def with_like_pixels(problem: Problem) -> Problem:
    """The problem whose `around` is found."""
    scene = problem.scene
    parts = [_of_object(scene, i, points.pixels) for i, points in enumerate(problem.points)]
    return replace(problem, around=np.concatenate(parts)).without_unusable()


def variation(problem: Problem) -> float:
    """Relative difference of a pixel from the mean of those that are like it, as a rule; 0 where there are none."""
    image = problem.scene.job.photo.radiance
    some = (problem.around[..., 0] >= 0).any(1)
    if not some.any():
        return 0.0
    own, mean = (values.mean(1)[some] for values in (problem.values_of(image), problem.means_of(image)))
    return float(np.median(np.abs(own - mean) / np.maximum(mean, 1e-300)))


def _of_object(scene, index: int, pixels) -> np.ndarray:
    """(p, k, 2) int32, as `Problem.around`, of some of an object's ``pixels`` (p, 2)."""
    return kept.recalled("around", [scene.seen, index, pixels], lambda: _found(scene, index, pixels))


def _found(scene, index: int, pixels) -> np.ndarray:
    region, out = scene.regions[index], np.full((len(pixels), PAIRS, 2), -1, np.int32)
    if not len(pixels):
        return out
    height, width = region.shape
    reach = REACH * np.sqrt(region.sum())
    steps = min(round(reach), STEPS)
    side = np.arange(-steps, steps + 1) * max(1, round(reach / STEPS))
    offsets = np.stack(np.meshgrid(side, side, indexing="ij"), -1).reshape(-1, 2)
    offsets = offsets[len(offsets) // 2 + 1 :]  # of opposite ones the second
    there = pixels[:, None, None] + offsets[None, :, None] * np.array([1, -1])[:, None]  # (p, k, 2, row and column)
    inside = ((there >= 0) & (there < (height, width))).all(-1)
    there = np.where(inside[..., None], there, pixels[:, None, None])
    inside &= region[there[..., 0], there[..., 1]]
    looked_at = np.zeros_like(region)
    looked_at[there[..., 0][inside], there[..., 1][inside]] = True
    looked_at[tuple(pixels.T)] = True
    points = scene.bare_points(index, region=looked_at)  # row by row
    flat = points.pixels[:, 0].astype(np.int64) * width + points.pixels[:, 1]

    def normal_at(place):
        return points.normal[np.searchsorted(flat, place).clip(max=len(flat) - 1)]

    place = there[..., 0].astype(np.int64) * width + there[..., 1]
    own = normal_at(pixels[:, 0].astype(np.int64) * width + pixels[:, 1])
    alike = inside & ((normal_at(place) * own[:, None, None]).sum(-1) > SAME)
    out[:, : len(offsets)] = np.where(alike.all(-1)[..., None], place, -1)  # of a small object there are fewer
    return out


def like_pixels_words(problems) -> str | None:
    """That means stand for pixels, and why; None where they do not."""
    textured = [p for p in problems if p.around is not None]
    if not textured:
        return None
    share = 100 * np.mean([variation(p) for p in textured])
    return (
        f"the photo varies by {share:.0f} % from pixel to pixel, more than shape and light make it: each pixel of the "
        f"fit is the mean of up to {1 + 2 * PAIRS} around it that show the same"
    )
