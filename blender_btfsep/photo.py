# SPDX-License-Identifier: GPL-3.0-or-later
"""The photograph of a job: the file as it is where the engine can read it, else saved as a linear EXR."""

import shutil
from pathlib import Path

import bpy

from .errors import InputError

READABLE = {".exr", ".hdr", ".png", ".jpg", ".jpeg", ".tif", ".tiff", ".webp"}
CODED = {"sRGB"}
LINEAR = {"Linear Rec.709", "Linear", "Non-Color", "Raw"}


def put(source, folder) -> tuple[str, str, tuple[int, int]]:
    """Puts the photo into ``folder``.

    Parameters
    ----------
    source : a path, or a bpy.types.Image (also packed, painted or a render result)
    folder : Path that exists

    Returns
    -------
    name of the file in ``folder``; "auto" or "linear" for the job's ``image_colorspace``; (width, height)

    Raises
    ------
    InputError
        When there is no picture.
    """
    if isinstance(source, bpy.types.Image):
        return _put_image(source, Path(folder))
    path = Path(bpy.path.abspath(str(source)))
    if not path.is_file():
        raise InputError(f"the photo {path.name}", "there is no such file", "choose the photo again")
    try:
        image = bpy.data.images.load(str(path), check_existing=False)
    except RuntimeError as error:
        raise InputError(f"the photo {path.name}", str(error), "choose an EXR, HDR, PNG, JPEG, TIFF or WebP") from None
    try:
        size = _size(image)
        if path.suffix.lower() in READABLE:
            return _copy(path, Path(folder)), "auto", size
        return _save(image, Path(folder)), "linear", size
    finally:
        bpy.data.images.remove(image)


def _put_image(image, folder: Path):
    space = image.colorspace_settings.name
    path = Path(bpy.path.abspath(image.filepath_raw, library=image.library)) if image.filepath_raw else None
    as_is = image.source == "FILE" and not image.is_dirty and path is not None and path.suffix.lower() in READABLE
    float_file = as_is and path.suffix.lower() in {".exr", ".hdr"}
    as_is = as_is and (space in LINEAR or (space in CODED and not float_file))
    size = _size(image)
    if as_is and (image.packed_file or path.is_file()):
        name = _copy(image.packed_file.data if image.packed_file else path, folder, suffix=path.suffix.lower())
        return name, "linear" if space in LINEAR else "auto", size
    return _save(image, folder), "linear", size


def _size(image) -> tuple[int, int]:
    width, height = image.size
    if not (width and height):
        raise InputError(f"the photo {image.name}", "it has no pixels", "choose the photo again")
    return width, height


def _copy(source, folder: Path, suffix: str | None = None) -> str:
    name = "photo" + (suffix or source.suffix.lower())
    try:
        if isinstance(source, bytes):
            (folder / name).write_bytes(source)
        elif source.resolve() != (folder / name).resolve():
            shutil.copyfile(source, folder / name)
    except OSError as error:
        raise InputError(f"cannot write {folder / name}", error.strerror or str(error), "free space") from error
    return name


def _save(image, folder: Path) -> str:
    """Saves what Blender shows of ``image``, in scene-linear colours, through a scene of its own settings."""
    scene = bpy.data.scenes.new("BTFsep photo")
    try:
        settings = scene.render.image_settings
        settings.file_format, settings.color_depth, settings.color_mode = "OPEN_EXR", "32", "RGB"
        image.save_render(str(folder / "photo.exr"), scene=scene)
    except RuntimeError as error:
        raise InputError(f"the photo {image.name}", str(error), "save it as a file and choose that") from error
    finally:
        bpy.data.scenes.remove(scene)
    return "photo.exr"
