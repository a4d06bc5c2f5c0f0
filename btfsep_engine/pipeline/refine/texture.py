# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether the BTF is fitted with its texture: where that could line up, and explains the photo better.

A texture tells of the light by its slopes: each faces another part of it. Where it is not taken, means of like pixels
(`pipeline.like_pixels`) stand for it.

The richer model is taken only where it predicts the photo better by more than one standard error, which is counted over
blocks of neighbouring pixels (misfit is structured, pixels are no independent witnesses), and, by what is stated, tells
as much of the light: a weave explains most of a photo, even of another piece, and little of what its yarns make of it.
"""

from dataclasses import replace

import numpy as np

from btfsep_engine.fit.stated import expected_error
from btfsep_engine.pipeline.settings import TransportSettings
from btfsep_engine.pipeline.together import fit_together, stacked

# With a texture errors are 0.62 of what is stated, with means of pixels 0.70 (84 photos of `scripts/study aligned`)
WIDER = 1.15
VISIBLE_CONTRAST = 0.05  # of the texture as the camera resolves it: less is not worth a second transport


def textures(model, light):
    """The refinement: the textured BTFs in place of their mean ABRDFs."""
    if model.untried is not None:
        return model, light, {}
    with_texture = replace(model, appearance="textured")
    other = fit_together(with_texture.problems, replace(model.settings, order=light.order), beside=light.fit)
    # of the same values: a mean of pixels is explained better than they are
    left = light.left_over([p.of_single_pixels() for p in model.problems]), other.left_over(with_texture.problems)
    name, why = appearance_choice(*left, stacked(model.problems)[1])
    if name == "textured":
        without, expected = map(stated_error, (light.fit, other.fit))
        if expected <= WIDER * without:
            return with_texture, other, {"appearance": why}
        why += f"; but it tells less of the light (errors of {expected:.2f}) than means of pixels do ({without:.2f})"
    return model, light, {"appearance": why}


def stated_error(fit) -> float:
    """The error that a light expects of itself, up to order 2 where it has that; 0 where it states none."""
    stated = {} if fit.samples is None else expected_error(fit.coefficients, fit.samples)
    return [0.0, *(error["median"] for error in stated.values())][-1]


def reason_against(scenes, materials, settings: TransportSettings) -> str | None:
    """Why textures are not worth trying for any object of any photograph; None where they are."""
    if settings.appearance != "auto":
        return "as asked for"
    answers = []
    for scene, each in zip(scenes, materials, strict=True):
        for i, m in enumerate(each):
            footprint = scene.footprint(i) * scene.millimetres_per_unit
            answers.append(texture_may_help(scene.job.objects[i], m.material, footprint))
    return None if any(worth for worth, _ in answers) else "; ".join(dict.fromkeys(why for _, why in answers))


def texture_contrast(material, footprint_mm: float) -> float:
    """Relative standard deviation of a material's brightness from place to place, seen by pixels of a footprint.

    0 for a material without texture.
    """
    if not material.has_texture:
        return 0.0
    brightness = material.texels @ material.angular.mean((0, 1, 2))
    size = max(1, round(footprint_mm / material.texel_mm))
    if size >= max(brightness.shape):
        return 0.0
    from scipy.ndimage import uniform_filter  # slow to import, and many objects have no texture

    seen = uniform_filter(brightness.astype(np.float64), size, mode="wrap")
    return float(seen.std() / max(abs(seen.mean()), 1e-30))


def texture_may_help(obj, material, footprint_mm: float) -> tuple[bool, str]:
    """Whether fitting the BTF with its texture is worth trying for an object, and why not."""
    if not material.has_texture:
        return False, f"{material.name} has no texture"
    if material.lines_up:
        return False, "an image in the mesh's own UVs lines up and is used"
    if obj.uv != "mesh":
        return False, "computed charts cannot line up with the photo's texture"
    contrast = texture_contrast(material, footprint_mm)
    if contrast < VISIBLE_CONTRAST:
        return False, f"the camera does not resolve it (contrast {100 * contrast:.0f} %)"
    return True, f"the camera resolves it (contrast {100 * contrast:.0f} %)"


def better_by_blocks(by_mean, by_texture, blocks) -> tuple[float, float]:
    """How much less squared misfit the richer model leaves: the mean over blocks, and its standard error.

    Parameters
    ----------
    by_mean, by_texture : (p, 3), what each leaves over of the photo
    blocks : (p,) int
    """
    _, labels, counts = np.unique(blocks, return_inverse=True, return_counts=True)
    gain = (np.square(by_mean) - np.square(by_texture)).sum(1)
    each = np.bincount(labels.reshape(-1), gain) / counts
    if len(each) < 2:
        return float(each.mean()), np.inf
    mean = np.average(each, weights=counts)
    spread = np.sqrt(np.average((each - mean) ** 2, weights=counts) / (len(each) - 1))
    return float(mean), float(spread)


def appearance_choice(by_mean, by_texture, blocks) -> tuple[str, str]:
    """ "mean" or "textured", and the reason, from what both leave over (see `better_by_blocks`)."""
    mean, error = better_by_blocks(by_mean, by_texture, blocks)
    total = float(np.square(by_mean).sum() / max(len(by_mean), 1))
    share = 100 * mean / max(total, 1e-300)
    if mean > error:
        return "textured", f"the texture explains {share:.0f} % of what the mean ABRDF leaves over"
    return "mean", (
        f"with its texture the fit is not better by more than one standard error ({share:+.0f} % of the misfit)"
    )
