# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether the BTF is fitted with its texture: where that could line up, and explains the photo better.

A texture tells of the light by its slopes: each faces another part of it. Where it is not taken, means of like pixels
(`pipeline.like_pixels`) stand for it.

Which of the two tells more of the light, neither misfit nor evidence says: a weave explains most of a photo, even of
another piece, and little of what its yarns make of it. So each light is asked what it explains of what the other one
was found by. That which leaves less over there, beside the other's own, knows what the other does, and more. In grain,
of which means have less, a texture tells no more.
"""

from dataclasses import replace

import numpy as np

from btfsep_engine.pipeline.settings import TransportSettings
from btfsep_engine.pipeline.together import all_weights, fit_together

VISIBLE_CONTRAST = 0.05  # of the texture as the camera resolves it: less is not worth a second transport


def textures(model, light):
    """The refinement: the textured BTFs in place of their mean ABRDFs."""
    if model.untried is not None:
        return model, light, {}
    with_texture = replace(model, appearance="textured")
    other = fit_together(with_texture.problems, replace(model.settings, order=light.order), beside=light.fit)
    of_means, of_texture = held_against_each_other((light, model.problems), (other, with_texture.problems))
    why = (
        f"the light that the texture tells leaves over {100 * of_means:+.0f} % of what means of pixels leave over by "
        f"theirs, and theirs {100 * of_texture:+.0f} % of what is left over of the textured photo"
    )
    if of_means < of_texture:
        return with_texture, other, {"appearance": f"with the texture: {why}"}
    return model, light, {"appearance": f"without the texture: {why}"}


def held_against_each_other(*found) -> list[float]:
    """Of two lights how much more, relative, what each was found by leaves over under the other: [of the first's, …].

    ``found`` : (SolvedLight, the Problems that it was found by) of each; squares count, each value by its weight
    """
    out = []
    for (own, problems), (other, _) in (found, found[::-1]):
        weights = all_weights(problems)
        left = [np.square(light.left_over(problems)) * (1.0 if weights is None else weights) for light in (own, other)]
        out.append(float(left[1].sum() / max(left[0].sum(), 1e-300)) - 1)
    return out


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
