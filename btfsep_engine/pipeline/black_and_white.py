# SPDX-License-Identifier: GPL-3.0-or-later
"""A black-and-white photo: it shows luminance, and so materials, surroundings and the light have no other.

Taken for a photo in colours, what is brown in one would be lit by blue light, and sure of it; and what is recognised
would be whatever is grey. How a photo was made black and white nobody knows: the luminance of Rec.709 is usual.
"""

import copy
from dataclasses import replace

import numpy as np

from btfsep_engine.btf.surfaces import COLOURED
from btfsep_engine.job.model import Job
from btfsep_engine.pipeline.scene import PreparedScene

ALIKE = 0.01  # of the brightest channel: as far apart the channels of a pixel without a colour may be
ALL = 0.98  # of the pixels: so many have none, where a file in colours rounds them by a code
COLOURLESS = "the photo is black and white: of the light's colours nothing is known, and it was taken to be grey"
SAID = (
    "the photo is black and white: everything in it is taken for grey, and so is the light, whose colours are not "
    "known (give a photo in colours, if there is one)"
)
LOOKED_AT = 100_000  # pixels at most, about


def is_black_and_white(photo) -> bool:
    """Whether a photo (job.model.Photo) has no colours anywhere; a sepia has."""
    some = (slice(None, None, 1 + int((photo.usable.size / LOOKED_AT) ** 0.5)),) * 2
    colours = photo.radiance[some][photo.usable[some]]
    colours = colours[colours.max(-1) > 0]
    if not len(colours):
        return False
    return bool((np.ptp(colours, axis=-1) <= ALIKE * colours.max(-1)).mean() >= ALL)


def as_photographed(scenes: list[PreparedScene], library, *, names=None) -> tuple:
    """The scenes and the library (btf.library.Library), without colours where no photo has any: then it is said.

    Where all that is in them is said to be grey, a photo in colours has none either, in white light: nothing is done.

    ``names`` : of each scene's objects' materials, None of those that are recognised; None: all are
    """
    if not all(is_black_and_white(scene.job.photo) for scene in scenes):
        return scenes, library
    if names and all(_is_grey(scene.job, library, own) for scene, own in zip(scenes, names, strict=True)):
        return scenes, library
    scenes[0].reporter.warn(SAID)
    return [without_colours(scene) for scene in scenes], library.without_colours()


def _is_grey(job: Job, library, names) -> bool:
    """Whether all of a job is said to have no colours."""
    surfaces = [o.surface for o, name in zip(job.objects, names, strict=True) if name is None]
    albedos = [library.load(name).diffuse_albedo() for name in names if name is not None]
    said = all(surfaces) and not any(s.coloured for s in (*surfaces, *(o.surface for o in job.occluders)) if s)
    return said and all(np.ptp(albedo) <= COLOURED for albedo in albedos)


def without_colours(scene: PreparedScene) -> PreparedScene:
    """The scene of greys alone; itself where it is so already."""
    if not scene.has_colours:
        return scene
    out = copy.copy(scene)
    out.job, out.has_colours = _job_without_colours(scene.job), False
    out.__dict__.pop("_known_albedos", None)
    return out


def _job_without_colours(job: Job) -> Job:
    objects, occluders = (
        tuple(replace(o, surface=o.surface and o.surface.without_colours()) for o in some)
        for some in (job.objects, job.occluders)
    )
    return replace(job, objects=objects, occluders=occluders)
