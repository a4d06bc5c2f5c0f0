# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether the BTF is fitted with its texture: where that could line up, and explains the photo better.

A texture tells of the light where it is relief: each of its slopes faces another part of the light. Paint is the same
under all lights, and means of like pixels (`pipeline.like_pixels`) are rid of it. So a texture is tried only where
enough of its variation changes with the light (`relief`).

The richer model is taken only where it predicts the photo better by more than one standard error, which is counted over
blocks of neighbouring pixels (misfit is structured, pixels are no independent witnesses).
"""

from dataclasses import replace

import numpy as np

from btfsep_engine.conventions import fibonacci_sphere
from btfsep_engine.pipeline.settings import TransportSettings
from btfsep_engine.pipeline.together import fit_together, stacked
from btfsep_engine.storage import kept

VISIBLE_CONTRAST = 0.05  # of the texture as the camera resolves it: less is not worth a second transport
# Share of it that is no paint. Of the library's 14 only denim has less (0.23; the next are 0.42 and 0.51): photos of it
# err 1.1 times as much with the texture, those of the others less in the mean (`scripts/study aligned`)
RELIEF = 1 / 3
SOME_TEXELS, EVERY_VIEW = 128, 6  # of which it is found,
LOBES, SHARP = 128, 30  # under lights as broad as the fit's finest (powers of cosines about directions of the sphere)
SLANTED = 0.35  # cosine to the eye of the views


def textures(model, light):
    """The refinement: the textured BTFs in place of their mean ABRDFs."""
    if model.untried is not None:
        return model, light, {}
    with_texture = replace(model, appearance="textured")
    other = fit_together(with_texture.problems, replace(model.settings, order=light.order), beside=light.fit)
    # of the same values: a mean of pixels is explained better than they are
    left = light.left_over([p.of_single_pixels() for p in model.problems]), other.left_over(with_texture.problems)
    name, why = appearance_choice(*left, stacked(model.problems)[1])
    return (with_texture, other, {"appearance": why}) if name == "textured" else (model, light, {"appearance": why})


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
    if (texels := texels_seen(material, footprint_mm)) is None:
        return 0.0
    seen = texels @ material.angular.mean((0, 1, 2)).astype(np.float64)
    return float(seen.std() / max(abs(seen.mean()), 1e-30))


def texels_seen(material, footprint_mm: float) -> np.ndarray | None:
    """(h, w, k) float64, a material's texels averaged over pixels of a footprint; None where one pixel has them all."""
    size = max(1, round(footprint_mm / material.texel_mm))
    if size >= max(material.texels.shape[:2]):
        return None
    from scipy.ndimage import uniform_filter  # slow to import, and many objects have no texture

    return uniform_filter(material.texels.astype(np.float64), (size, size, 0), mode="wrap")


def relief(material, footprint_mm: float) -> float:
    """The share of a texture's variation that changes with the light, as pixels of a footprint see it; 0 without one.

    What texel and view make of each light, less what the mean ABRDF makes of it times the texel's own factor, over what
    it differs from the mean ABRDF by: norms, over lights that are broad enough to average the noise of single paths.
    """
    if not material.has_texture or (texels := texels_seen(material, footprint_mm)) is None:
        return 0.0
    some = np.random.default_rng(0).permutation(texels[..., 0].size)[:SOME_TEXELS]
    texels = texels.reshape(-1, texels.shape[-1])[some]
    towards = fibonacci_sphere(LOBES)
    towards = towards[towards[:, 2] > 0]
    lobes = np.maximum(material.lights @ towards.T, 0) ** SHARP * np.maximum(material.lights[:, 2:], 0)
    views = np.flatnonzero(material.views[:, 2] > SLANTED)[::EVERY_VIEW]
    under = np.einsum("vlck,lg->vgck", material.angular[views].astype(np.float64), lobes / lobes.sum(0))
    under *= towards[:, 2, None, None]
    each = np.einsum("vgck,tk->tvgc", under, texels)
    mean = (under @ material.mean_texel.astype(np.float64))[None]
    factor = (each * mean).sum(2, keepdims=True) / np.maximum(np.square(mean).sum(2, keepdims=True), 1e-300)
    beside_paint, all_of_it = (np.linalg.norm(part) for part in (each - factor * mean, each - mean))
    return float(beside_paint / max(all_of_it, 1e-300))


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
    share = kept.recalled("relief", [material, float(footprint_mm)], lambda: relief(material, footprint_mm))
    if share < RELIEF:
        why = "it is paint more than relief, and tells less of the light than means of pixels without it"
        return False, f"{why} ({100 * share:.0f} % of it changes with the light)"
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
