# SPDX-License-Identifier: GPL-3.0-or-later
"""The three-spheres protocol: how publications measure estimated lighting.

StyleLight (Wang et al., ECCV 2022) made it; DiffusionLight (Phongthawee et al., CVPR 2024) and others follow it. What
its programs do (github.com/DiffusionLight/DiffusionLight-evaluation, folder ``stylelight``):

1. The estimate is averaged down to 256 x 128 pixels (plainly, not by solid angle). The truth is not: the mirror of
   their example shows its map of 4096 x 2048 in full.
2. Both are tone-mapped: the power 1 / 2.4, then one factor that takes the median of the values above zero, of all
   pixels (plainly again) and channels, to 0.5. Nothing is clipped.
3. A mirror, a matte silver and a diffuse sphere are rendered under what the tone map made (`blender_spheres`).
4. The pictures are compared where there is sphere. A squared error is summed over the channels, then averaged over
   the pixels: a figure is sqrt(3) times what a mean over all values would be.

They render with 5 samples a pixel and denoise; here there is no noise.
"""

import numpy as np

from btfsep_engine.fit.blender_spheres import averaged, blender_spheres

GAMMA, MIDDLE = 2.4, 0.5
ROWS = 128
PERCENTILES = (0.01, 99.9)


def three_spheres(estimate, truth) -> dict:
    """The figures of the three-spheres protocol.

    Parameters
    ----------
    estimate, truth : (h, w, 3) float, environment maps, linear Rec.709, each in any scale and of any size, w = 2 h.
        Radiance below zero counts as 0; the protocol has none.

    Returns
    -------
    {"mirror", "matte_silver", "diffuse": as `picture_figures`}
    """
    if len(estimate) > ROWS:
        estimate = averaged(estimate, ROWS, 2 * ROWS)
    pictures, seen = blender_spheres(tone_mapped(estimate), tone_mapped(truth))
    return {kind: picture_figures(*pair, seen) for kind, pair in pictures.items()}


def tone_mapped(radiance) -> np.ndarray:
    """The power 1 / 2.4 of a map, scaled so that the median of what is above zero is 0.5; black stays black."""
    a = np.maximum(radiance, 0) ** (1 / GAMMA)
    return a * (MIDDLE / np.median(a[a > 0])) if (a > 0).any() else a


def picture_figures(estimate, truth, seen) -> dict:
    """The figures of one sphere.

    Parameters
    ----------
    estimate, truth : (h, w, 3) float, >= 0, whole pictures, 0 off the sphere
    seen : (h, w) bool, where there is sphere

    Returns
    -------
    dict, JSON-ready, None where one of the pictures is black::

        rmse              root of the squared error, as above
        si_rmse           the smallest that one factor on ``estimate``, for all channels and pixels, makes of it
        angular_degrees   mean angle between the RGB vectors of a pixel, 0 where one is black
        normalised_rmse   rmse after each picture, background included, is stretched from its percentiles 0.01 and
                          99.9 to 0 and 1
    """
    ranges = [np.percentile(a, PERCENTILES) for a in (estimate, truth)]
    if any(high <= low for low, high in ranges):
        return dict.fromkeys(("rmse", "si_rmse", "angular_degrees", "normalised_rmse"))
    p, q = ((a - low) / (high - low) for a, (low, high) in zip((estimate, truth), ranges, strict=True))
    a, b = estimate[seen], truth[seen]
    lengths = np.linalg.norm(a, axis=-1) * np.linalg.norm(b, axis=-1)
    cosine = np.divide((a * b).sum(-1), lengths, out=np.ones_like(lengths), where=lengths > 0)
    return {
        "rmse": _rmse(a, b),
        "si_rmse": _rmse((a * b).sum() / (a * a).sum() * a, b),
        "angular_degrees": float(np.degrees(np.arccos(np.clip(cosine, 0, 1)).mean())),
        "normalised_rmse": _rmse(p[seen], q[seen]),
    }


def _rmse(a, b) -> float:
    return float(np.sqrt(((a - b) ** 2).sum(-1).mean()))
