# SPDX-License-Identifier: GPL-3.0-or-later
"""The photograph of a job: read, of the camera's size, with what is left out of it in words."""

from pathlib import Path

import numpy as np

from btfsep_engine.errors import InputError
from btfsep_engine.imaging import images
from btfsep_engine.job.camera import Camera
from btfsep_engine.job.model import Photo

SAME_ASPECT = 0.02  # relative, up to which the pixels of photo and camera have one shape


def no_photo(camera: Camera) -> Photo:
    """A black photograph of the camera's size, in the place of one that is not read."""
    shape = camera.height, camera.width
    return Photo(np.zeros((*shape, 3), np.float32), np.ones(shape, bool), 0)


def read_photo(
    path, camera: Camera, *, colorspace: str = "auto", primaries: str = "auto", notes: list | None = None
) -> Photo:
    """A photograph that ``camera`` took, which no job names; ``notes`` : takes, in words, what of it is left out.

    Raises InputError when it cannot be read, or is not of the camera's size.
    """
    return read(path, Path(path).name, (colorspace, primaries), camera, [] if notes is None else notes)


def read(path, name: str, coding, camera: Camera, notes: list) -> Photo:
    """The photograph at ``path``, as `read_photo`.

    Parameters
    ----------
    name : what to call it in sentences
    coding : the job's colour space and primaries
    """
    colorspace, primaries = coding
    fits(images.declared_size(path), name, camera, path)  # before it is decoded: a small file can claim gigabytes
    first = {"unknown": "auto", "blender": "srgb", "phone": "camera"}.get(colorspace, colorspace)
    image = images.read_linear(path, colorspace=first, primaries=primaries, by_camera=True)
    height, width = image.pixels.shape[:2]
    fits((width, height), name, camera, path)
    if image.orientation != 1:
        notes.append(
            f"{name}: it says that it is to be turned (EXIF orientation {image.orientation}), which was not done: the "
            "camera has to be of the pixels as they are stored"
        )
    if len(layers := images.layers(path)) > 1:
        notes.append(
            f"{name}: of {len(layers)} layers that could be the picture '{layers[0]}' was read, the first; the next is "
            f"'{layers[1]}' (save the picture alone)"
        )
    aspect, own = images.pixel_aspect(path), camera.fy / camera.fx
    if aspect != 1 and abs(aspect / own - 1) > SAME_ASPECT:
        notes.append(
            f"{name}: it says that its pixels are {aspect:.3g} times as wide as high, and those of the camera are "
            f"{own:.3g} times (fy / fx); the camera's were taken"
        )
    if image.profile is not None and not image.profile.followed:
        notes.append(f"{name}: {image.profile.name} could not be followed; its colours were taken for those of sRGB")
    finite = np.isfinite(image.pixels).all(-1)
    if not finite.all():
        rows, columns = np.nonzero(~finite)
        got = f"{len(rows)} pixels are NaN or infinite, first x {columns[0]}, y {rows[0]}"
        raise InputError(name, got, "render or export the photo again")
    if not image.usable.any():
        cure = "give one that is opaque, with a shorter exposure"
        raise InputError(name, "every pixel is saturated or transparent", cure)
    saturated = int(image.saturated.sum())
    if saturated:
        notes.append(f"{name}: {saturated} of {width * height} pixels are saturated")
    hidden = int((~image.usable & ~image.saturated).sum())
    if hidden:
        notes.append(f"{name}: {hidden} of {width * height} pixels are transparent and left out")
    clipped = image.clipped if saturated else None
    said = image.bits, image.coarse_chroma, image.camera, image.profile, image.is_render, image.is_jpeg, image.flash
    return Photo(image.pixels, image.usable, saturated, clipped, *said)


def fits(size, name: str, camera: Camera, photo=None) -> None:
    """InputError unless an image's (width, height) is the camera's; None: not known yet.

    ``photo`` : its path where it may say why it is of another size.
    """
    own = camera.width, camera.height
    if size not in (None, own):
        got = f"it has {size[0]} x {size[1]} pixels and the camera {own[0]} x {own[1]}"
        do = "export it at the camera's size"
        if photo is not None and images.data_size(photo) == own:
            got += ", the size of its data window"
            do = "save it with a data window that is its display window"
        elif photo is not None and size == own[::-1] and images.orientation(photo) > 4:
            got += ", as it is to be turned (EXIF orientation) and its pixels are not"
            do = "turn it in an image editor and save it, or give the camera as the photo is stored"
        raise InputError(name, got, do)
