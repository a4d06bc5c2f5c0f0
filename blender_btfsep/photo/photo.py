# SPDX-License-Identifier: GPL-3.0-or-later
"""The pictures of a job: the photo (the file itself where the engine can read it, else its codes, or a linear EXR),
masks, depth.
"""

import re
import shutil
from pathlib import Path
from typing import NamedTuple

import bpy
import numpy as np

from ..basics import pixels
from ..basics.atomic import replacing, write_bytes
from ..basics.errors import InputError
from ..basics.scratch import save_exr, scratch
from .frames import SUFFIXES, split
from .photo_file import FileFacts, facts_of, holds_floats, unread

FLOAT = {".exr", ".hdr"}
CODED = {"sRGB": "auto", "Display P3": "display-p3", "sRGB Encoded P3-D65": "display-p3"}
"""Blender's colour spaces that have sRGB's curve, and their primaries for the engine (auto: what the file says)."""
MOVIE = "save it as an image sequence, or the frame as an image, and open that"
SINGLE = "open the photo as a single image"
RENDERED = "is a render that is in no file: save it (Image > Save As) and open that"
LINEAR = {"Linear Rec.709", "Linear", "Non-Color", "Raw"}
_last = None, FileFacts()
_read: dict = {}  # (session number, path) of an image -> of its file, as `stamp_of`, when it was first looked at


class JobPhoto(NamedTuple):
    """A picture in a job: its file's name, the job's ``image_colorspace``, (width, height), ``image_primaries``."""

    name: str
    colorspace: str
    size: tuple[int, int]
    primaries: str = "auto"


def put_into_job(source, folder, *, file=None) -> JobPhoto:
    """Puts the photo into ``folder``.

    Parameters
    ----------
    source : a path, or a bpy.types.Image (also packed, painted or a render result)
    folder : Path that exists
    file : of a sequence the one of its files that is meant (of :func:`file_at`); None for the one that was opened

    Gives a JobPhoto; its colour space is "auto" or "linear". Raises InputError when there is no picture.
    """
    if isinstance(source, bpy.types.Image):
        if source.source == "SEQUENCE":
            return _put_one_of(source, Path(folder), file or file_of(source))
        return _put_image(source, Path(folder))
    path = Path(bpy.path.abspath(str(source)))
    if not path.is_file():
        raise InputError(f"the photo {path.name}", "there is no such file", "choose the photo again")
    with scratch() as own:
        try:
            image = own(bpy.data.images.load(str(path), check_existing=False))
        except RuntimeError as error:
            raise InputError(f"the photo {path.name}", error, "choose an EXR, HDR, PNG, JPEG, TIFF or WebP") from None
        if path.suffix.lower() in SUFFIXES:
            _only_one(image)
            return JobPhoto(_copy(path, Path(folder)), "auto", _size(image))
        return _put_image(image, Path(folder))


def file_of(image) -> Path | None:
    """The file of ``image``, of a sequence the one that was opened; None where it has none."""
    return Path(bpy.path.abspath(image.filepath_raw, library=image.library)) if image.filepath_raw else None


def file_at(image, camera, frame: int) -> Path | None:
    """The file of ``image``; of a sequence that is the background of ``camera``, the one that is shown at ``frame``."""
    path, user = file_of(image), None
    if image.source == "SEQUENCE" and camera is not None and camera.type == "CAMERA":
        behind = (b for b in camera.data.background_images if b.source == "IMAGE" and b.image == image)
        user = next((background.image_user for background in behind), None)
    parts = split(path.name) if user is not None and path is not None else None
    if parts is None:
        return path
    before, _, after = parts
    place, last = frame - user.frame_start, max(user.frame_duration, 1)
    place = place % last if user.use_cyclic else min(max(place, 0), last - 1)
    digits = len(path.name) - len(before) - len(after)
    return path.with_name(f"{before}{place + 1 + user.frame_offset:0{digits}d}{after}")


def size_of(image) -> tuple[int, int]:
    """Width and height of ``image``, of a sequence those of the photo that was opened; (0, 0) without pixels."""
    path = file_of(image)
    if image.source != "SEQUENCE" or all(image.size) or path is None or not path.is_file():
        return tuple(image.size)
    one = bpy.data.images.load(str(path), check_existing=False)
    try:
        return tuple(one.size)
    finally:
        bpy.data.images.remove(one)


def stamp_of(image) -> tuple | None:
    """When the file of ``image`` was written, and its bytes; None where the image is no file's, or that is gone."""
    if image.source != "FILE" or image.is_dirty or image.packed_file or not image.filepath_raw:
        return None
    try:
        stat = file_of(image).stat()
    except OSError:
        return None
    stamp = stat.st_mtime_ns, stat.st_size
    _read.setdefault(_key(image), stamp)
    return stamp


def _key(image) -> tuple:
    return image.session_uid, str(file_of(image))


def read_anew(image) -> None:
    """Has Blender read ``image`` anew where its file was written since it was first looked at.

    Blender keeps the pixels that it read; a job has the file, which may have another size by now.
    """
    stamp = stamp_of(image)
    if stamp is not None and _read[_key(image)] != stamp:
        _read[_key(image)] = stamp
        image.reload()


def facts_of_image(image) -> FileFacts:
    """What the file of ``image`` says of it; nothing where the image is no file's. For a panel: it is read once."""
    global _last
    if image is None or image.source != "FILE" or image.is_dirty:
        return FileFacts()
    path, packed = file_of(image), image.packed_file
    stamp = packed.size if packed else stamp_of(image)
    if stamp is None:
        return FileFacts()
    key = *_key(image), bool(packed), stamp
    if key != _last[0]:
        _last = key, facts_of(packed.data if packed else path)
    return _last[1]


def taken_as_is(image, path: Path) -> bool:
    """Whether the engine takes the colours of the file ``path`` of ``image`` for what Blender takes them for."""
    space = image.colorspace_settings.name
    return path.suffix.lower() in SUFFIXES and space in (LINEAR if path.suffix.lower() in FLOAT else CODED)


def is_linear(path: Path) -> bool:
    """Whether the engine takes the file ``path`` for linear light, whatever curve others have."""
    return path.suffix.lower() in FLOAT or holds_floats(path)


def named(image, sentences) -> list:
    """The engine's sentences with the photo's own name: in the job it is photo.png, or whatever it is.

    ``image`` : the photo, or None
    """
    return [re.sub(r"^photo\.\w+(?=: )", lambda _: image.name, each) if image else each for each in sentences]


def of_floats(image) -> bool:
    """Whether the photo ``image`` is linear light, whatever its curve; `is_float` are 16 bits, too."""
    path = file_of(image)
    if path is not None and is_linear(path):
        return True
    coded = path is not None and image.source != "GENERATED" and not image.is_dirty and taken_as_is(image, path)
    return image.is_float and not coded


def lacks_pixels(image) -> str:
    """Why ``image``, which has no pixels, has none, and what to do, in two parts with a colon."""
    if image.type == "MULTILAYER":
        return "is an EXR of many layers: save the one with the photo as an EXR of its own"
    if image.type == "RENDER_RESULT":
        return RENDERED
    return unread(file_of(image)) or "has no pixels: choose it again"


def _only_one(image) -> None:
    if image.source == "MOVIE":
        raise InputError(f"the photo {image.name}", "it is a movie", MOVIE)
    if image.source == "TILED":
        raise InputError(f"the photo {image.name}", "it is made of tiles (UDIM)", SINGLE)


def _put_image(image, folder: Path, stem: str = "photo"):
    _only_one(image)
    space = image.colorspace_settings.name
    path = file_of(image)
    as_is = image.source == "FILE" and not image.is_dirty and path is not None and path.suffix.lower() in SUFFIXES
    float_file = as_is and path.suffix.lower() in FLOAT
    as_is = as_is and (space in LINEAR or (space in CODED and not float_file))
    size = _size(image)
    coding = "linear" if space in LINEAR else "auto"
    if as_is and (image.packed_file or path.is_file()):
        source = image.packed_file.data if image.packed_file else path
        name = _copy(source, folder, suffix=path.suffix.lower(), stem=stem)
        return JobPhoto(name, coding, size, CODED.get(space, "auto"))
    if not image.is_float and (space in LINEAR or space in CODED):
        return JobPhoto(_save_codes(image, folder, stem), coding, size, CODED.get(space, "auto"))
    return JobPhoto(_save(image, folder, stem), "linear", size)


def put_texture(image, folder, stem: str) -> str:
    """Puts a texture's image into ``folder``, linear or as the engine reads its file; gives its name, from ``stem``."""
    return _put_image(image, Path(folder), stem).name


def put_numbers(values, folder, stem: str) -> str:
    """Writes numbers (h, w, 3) as they are, the lowest row first, as an EXR into ``folder``; gives its name."""
    name = f"{stem}.exr"
    with scratch() as own, replacing(Path(folder) / name) as file:
        save_exr(own(pixels.new(stem, values)), file, raw=True)
    return name


def _put_one_of(sequence, folder: Path, path: Path | None):
    """One photo, by its file: a sequence has pixels only at the frames where the scene has them."""
    if path is None or not path.is_file():
        name = sequence.name if path is None else path.name
        raise InputError(f"the photo {name}", "there is no such file", "choose the photos again, or another frame")
    with scratch() as own:
        image = own(bpy.data.images.load(str(path), check_existing=False))
        image.colorspace_settings.name = sequence.colorspace_settings.name
        return _put_image(image, folder)


def put_mask(image, folder, name: str, size) -> str:
    """Writes where ``image`` is not black (nor, if it has alpha, transparent) as ``name`` into ``folder``.

    ``size`` : (width, height) of the photo. Gives ``name``. Raises InputError.
    """
    width, height = _size(image)
    if (width, height) != tuple(size):
        raise InputError(
            f"the mask '{image.name}'",
            f"it has {width} x {height} pixels, the photo {size[0]} x {size[1]}",
            "make the mask from the photo, at its size",
        )
    shown = pixels.read(image)
    inside = (shown[..., :3] != 0).any(-1) & (shown[..., 3:] != 0).all(-1)
    if not inside.any():
        raise InputError(f"the mask '{image.name}'", "it is black everywhere", "paint it white where the object is")
    with scratch() as own:
        return _save_png(own(pixels.new("BTFsep mask", inside, floats=False)), Path(folder) / name)


def put_depth(image, folder) -> str:
    """Copies the EXR of ``image``, or of a path, into ``folder``: the engine reads its channel. Raises InputError."""
    named = f"the depth '{getattr(image, 'name', Path(str(image)).name)}'"
    packed = None
    if isinstance(image, bpy.types.Image):
        path, packed = file_of(image), image.packed_file
        if image.source != "FILE" or path is None or (image.is_dirty and not packed):
            raise InputError(named, "it is no file", "save the z-depth as an EXR and open that")
    else:
        path = Path(bpy.path.abspath(str(image)))
    if path.suffix.lower() != ".exr":
        raise InputError(named, f"it is a {path.suffix or 'nameless'} file", "save the z-depth as an EXR and open that")
    if packed is None and not path.is_file():
        raise InputError(named, "there is no such file", "choose it again")
    return _copy(packed.data if packed else path, Path(folder), suffix=".exr", stem="depth")


def _size(image) -> tuple[int, int]:
    width, height = image.size
    if not (width and height):
        raise InputError(f"the photo {image.name}", *f"it {lacks_pixels(image)}".split(": "))
    return width, height


def _copy(source, folder: Path, suffix: str | None = None, stem: str = "photo") -> str:
    name = stem + (suffix or source.suffix.lower())
    if isinstance(source, bytes):
        write_bytes(folder / name, source)
    elif source.resolve() != (folder / name).resolve():
        with replacing(folder / name) as file:
            shutil.copyfile(source, file)
    return name


def _save_codes(image, folder: Path, stem: str) -> str:
    """Saves the codes of an image of bytes, whose brightest are then known to be bounds."""
    stored = np.empty(4 * image.size[0] * image.size[1], np.float32)
    image.pixels.foreach_get(stored)
    with scratch() as own:
        copy = own(bpy.data.images.new("BTFsep photo", *image.size, alpha=True))
        copy.pixels.foreach_set(stored)
        return _save_png(copy, folder / f"{stem}.png")


def _save_png(image, path: Path) -> str:
    """Saves an image's own codes; gives the file's name."""
    with replacing(path) as file:
        image.filepath_raw, image.file_format = str(file), "PNG"
        image.save()
    return path.name


def _save(image, folder: Path, stem: str = "photo") -> str:
    """Saves what Blender shows of ``image``, in scene-linear colours."""
    with replacing(folder / f"{stem}.exr") as file:
        save_exr(image, file)
    return f"{stem}.exr"
