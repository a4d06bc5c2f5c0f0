# SPDX-License-Identifier: GPL-3.0-or-later
"""What phones do to tones place by place, before a camera's curve, and its inverse.

A phone brightens shadows by what lies around them, not pixel by pixel, so that both sky and ground are seen: exposures
are fused, or a coarse picture of the logarithm of the light is pressed together and its details are kept (Durand and
Dorsey 2002; Hasinoff et al. 2016). Of linear values y that it displays,

    log r = log y + a (B - B_max),

B the mean of log y about each pixel, but for edges (guided filter, He et al. 2010),

is close to the light of the scene: a = 0 where nothing was moved, and contrasts between parts were pressed together to
1 / (1 + a) of what they were. What each maker does is not published, and a differs from photo to photo.
"""

import cv2
import numpy as np

from btfsep_engine.conventions import REC709_LUMINANCE

RADIUS = 0.08  # of the longer side: how far about a pixel its surroundings reach
EDGE = 0.5  # variance of the binary logarithm, above which something is an edge
BRIGHTEST = 99.0  # percentile of B: B_max
DARKEST = 1e-3  # of the brightest pixels' luminance: less is noise
SIDE = 512  # pixels, of a picture whose means are taken: of a larger one they are interpolated
MAKERS = (
    "apple", "google", "samsung", "xiaomi", "redmi", "poco", "huawei", "honor", "oneplus", "oppo", "realme", "vivo",
    "motorola", "hmd", "nokia", "nothing", "fairphone", "lge", "lg electronics", "htc", "zte", "tecno", "infinix",
)  # fmt: skip
CAMERAS = "SAMSUNG "  # in capitals: those that are no phones


def is_phone(camera: str) -> bool:
    """Whether a maker and model (`images.Image.camera`) are a phone's."""
    return camera.casefold().startswith(tuple(f"{maker} " for maker in MAKERS)) and not camera.startswith(CAMERAS)


def undone(displayed, strength: float) -> np.ndarray:
    """The light of a scene, of what a phone displays of it.

    Parameters
    ----------
    displayed : (h, w, 3) float, linear Rec.709, >= 0 but for noise
    strength : a >= 0; 0: as it is

    Returns
    -------
    (h, w, 3) float32, as bright as before where the picture is brightest
    """
    displayed = np.asarray(displayed, np.float32)
    if not strength or not displayed.size:
        return displayed
    luminance = displayed @ REC709_LUMINANCE.astype(np.float32)
    side = max(luminance.shape)
    scale, some = min(1.0, SIDE / side), (slice(None, None, max(side // SIDE, 1)),) * 2
    brightest = float(np.percentile(luminance[some], BRIGHTEST))
    if not brightest > 0:
        return displayed
    log = np.log2(np.maximum(luminance / brightest, DARKEST)).astype(np.float32)
    radius = max(round(RADIUS * side), 1)
    about = cv2.ximgproc.guidedFilter(log, log, radius, EDGE, scale=scale)
    gain = np.exp2(strength * (about - np.percentile(about[some], BRIGHTEST)))
    return displayed * gain[..., None].astype(np.float32)
