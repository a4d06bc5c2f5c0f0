# SPDX-License-Identifier: GPL-3.0-or-later
"""A phone's picture: how far tones that it moved place by place are undone, by evidence.

Undone too little, light comes out too even, and sure of it; and what the light may make as well as a phone, a fit in
which the tones are free takes from the light. So whole estimates stand for election, each of the photo with its tones
undone so far (`imaging.local_tones`), by what they leave over. The evidence of a fit does not decide: where dark parts
come out darker, its noise, which is the same everywhere, is a larger part of them. What is stated has the others' light
in it, as often as they are probable.
"""

import copy
from dataclasses import replace

import numpy as np
from scipy.special import softmax

from btfsep_engine.imaging.local_tones import is_phone, undone
from btfsep_engine.pipeline.scene import PreparedScene
from btfsep_engine.pipeline.settings import Settings

USUAL = 0.3
STRENGTHS = {USUAL: 0.4, 0.0: 0.3, 0.6: 0.3}  # how probable each is before any light is known
DECIDES = 3.0  # times the logarithm of what is left over: that of an estimate's probability
LEAST = 0.01  # of the photo: what is less says nothing more


def moves_tones(job) -> bool:
    """Whether a job's photo is a phone's own picture, as the job says, or the file."""
    stated, photo = job.image_colorspace, job.photo
    if photo.bits is None or (stated == "auto" and photo.profile is not None and photo.profile.linear):
        return False
    return stated == "phone" or (stated == "auto" and is_phone(photo.camera))


def strengths(scenes: list[PreparedScene], settings: Settings) -> tuple:
    """How far tones of photographs are undone, each to be tried, the usual first; (None,) where no phone moved any.

    The usual alone where nothing elects, or where all that takes long is left out, as of drafts that follow a user.
    """
    if not any(moves_tones(scene.job) for scene in scenes):
        return (None,)
    return (USUAL,) if settings.refine == "least" or settings.estimator != "map" else tuple(STRENGTHS)


def with_tones_undone(scene: PreparedScene, strength: float | None) -> PreparedScene:
    """The scene with what a phone did to its photo undone so far; itself where no phone took it, or at None."""
    if strength is None or not moves_tones(scene.job):
        return scene
    out = copy.copy(scene)
    photo = scene.job.photo
    out.job = replace(scene.job, photo=replace(photo, radiance=undone(photo.radiance, strength)))
    out.tones = strength
    return out


def probabilities(residuals: dict) -> dict:
    """How probable each strength is, by what its estimate leaves over of the photo, {strength: relative residual}."""
    logs = [np.log(STRENGTHS[each]) - DECIDES * np.log(max(left, LEAST)) for each, left in residuals.items()]
    return dict(zip(residuals, softmax(logs).tolist(), strict=True))


def tones_words(shares: dict) -> str:
    """What was elected, and what may be as well; of none, that it is the usual."""
    if not shares:
        return f"tones that a phone moves place by place: undone by {USUAL:g}, which is usual"
    best, *others = sorted(shares, key=shares.get, reverse=True)

    def said(strength) -> str:
        what = f"undone by {strength:g}" if strength else "left as they are"
        return f"{what} (probability {shares[strength]:.2f})"

    also = [said(each) for each in others if shares[each] > 0.05]
    return f"tones that a phone moves place by place: {said(best)}" + (f"; also: {', '.join(also)}" if also else "")
