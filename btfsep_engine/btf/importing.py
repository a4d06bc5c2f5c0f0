# SPDX-License-Identifier: GPL-3.0-or-later
"""Bringing a material of a database into a library folder, and taking one out of it."""

import contextlib
import os
import re
import stat
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from btfsep_engine import atomic
from btfsep_engine.btf import linear
from btfsep_engine.btf.formats.image_set import import_images
from btfsep_engine.btf.formats.ubo2014 import open_btf
from btfsep_engine.btf.formats.writing import write
from btfsep_engine.btf.library import NAME, Entry, changing, entries_of, file_sha256, open_library
from btfsep_engine.btf.model import REFERENCE, Tabulated
from btfsep_engine.errors import InputError
from btfsep_engine.progress import Reporter


@dataclass(frozen=True)
class Source:
    """A material as it comes from its files.

    Attributes
    ----------
    material : Tabulated, without the cosine
    height_mm : (h, w) float32 or None
    relative_error : of factors that were made on the way
    cosine : "included" or "excluded", what was taken to be in the data
    reciprocity : Reciprocity of the data as stored
    kind : words for what was read
    """

    material: Tabulated
    height_mm: np.ndarray | None
    relative_error: float
    cosine: str
    reciprocity: object
    kind: str


def read_source(
    source,
    *,
    name: str,
    material_class: str,
    texel_mm: float | None = None,
    size_mm: float | None = None,
    cosine: str = "auto",
    components: int | None = None,
    gamma: float | None = None,
    scale: float = 1.0,
    flip_v: bool = False,
    reporter: Reporter | None = None,
) -> Source:
    """Reads a ``.btf`` file, or 81 x 81 images in a folder or zip.

    Parameters
    ----------
    source : path
    name, material_class : as the material is to be called
    texel_mm, size_mm : edge of a texel, or width of the patch; None: as the file says
    cosine : "auto", "included", "excluded" or "header"; images have no header: "auto" then falls back to "included"
    components : K at most; None: the file's own where they are linear and shared by the channels, else 32
    gamma, scale, flip_v : as in :func:`import_images`; scale is for images only
    reporter : told the progress

    Raises
    ------
    InputError
        Whatever is wrong with the source, or a size that is neither in it nor given.
    """
    source, reporter = Path(source), reporter or Reporter()
    if cosine not in linear.COSINE:
        raise InputError(f"cosine '{cosine}'", "it is not one of the rules", "use " + ", ".join(linear.COSINE))
    if components is not None and not 1 <= components <= 1024:
        raise InputError(f"{components} components", "that many cannot be kept", "use 1 to 1024")
    if _is_btf(source):
        if gamma is not None or scale != 1:
            raise InputError("gamma and scale", ".btf files hold linear values", "leave them away")
        file = open_btf(source)
        size = _texel_mm(file.header.width, texel_mm, size_mm, file.header.pixels_per_mm)
        included = linear.cosine_included(file, cosine, reporter=reporter)
        if components is None and not (file.linear and file.shared_spatial):
            components = linear.COMPONENTS  # three factors side by side would be three times the work for ever
        material, error = linear.to_material_and_error(
            file,
            name=name,
            material_class=material_class,
            cosine="included" if included else "excluded",
            components=components,
            flip_v=flip_v,
            reporter=reporter,
        )
        found, height = linear.check_reciprocity(file), file.header.height_mm
        kind, material = f"{file.header.signature[1:]} file", replace(material, texel_mm=size)
    else:
        if texel_mm is None and size_mm is None:
            _texel_mm(1, None, None, 0)
        images = import_images(
            source,
            components=components or linear.COMPONENTS,
            gamma=gamma,
            scale=scale,
            flip_v=flip_v,
            reporter=reporter,
        )
        found, error, height, kind = images.reciprocity, images.relative_error, None, "81 x 81 images"
        included = cosine == "included" or (cosine in ("auto", "header") and found.verdict != "excluded")
        angular = images.angular
        if included:
            angular = angular / images.directions[:, 2].astype(np.float32)[None, :, None, None]
        size = _texel_mm(images.texels.shape[1], texel_mm, size_mm, 0)
        material = Tabulated(name, material_class, images.texels, angular, images.directions, images.directions, size)
    return Source(material, height, error, "included" if included else "excluded", found, kind)


def _is_btf(source: Path) -> bool:
    try:
        if source.is_dir():
            return False
        if not stat.S_ISREG(source.stat().st_mode):  # reading a pipe would wait for ever
            raise InputError(str(source), "it is neither a file nor a folder", "give a .btf file, a folder or a zip")
        with source.open("rb") as handle:
            return handle.read(1) == b"!" or source.suffix.lower() == ".btf"
    except OSError as error:
        raise InputError(f"cannot read {source}", error.strerror or str(error), "check the path") from error


def _texel_mm(width: int, texel_mm, size_mm, pixels_per_mm) -> float:
    if texel_mm is not None and size_mm is not None:
        raise InputError("--texel-mm and --size-mm", "both are given", "give one of them")
    size = texel_mm if texel_mm is not None else size_mm / width if size_mm is not None else None
    if size is None and pixels_per_mm > 0:
        size = 1 / pixels_per_mm
    if size is None:
        raise InputError("the size of the patch", "the source does not say it", "give --size-mm or --texel-mm")
    if not 1e-4 < size < 1000:
        raise InputError("the size of the patch", f"a texel would be {size:g} mm", "give the size in millimetres")
    return float(size)


def full_name(name: str, material_class: str) -> str:
    """ "class/name", checked.

    Raises
    ------
    InputError
        Names that an index cannot hold, or that are a reference material's.
    """
    full = name if name.startswith(material_class + "/") else f"{material_class}/{name}"
    if not re.fullmatch(NAME, full) or len(full) > 100:
        raise InputError(
            f"the name '{full}'",
            "it is not class/name",
            "use letters, digits, _, and after the first of them also - and dots; a-z and digits for classes",
        )
    if full in REFERENCE or full.startswith("reference/"):
        raise InputError(f"the name '{full}'", "it is a reference material's", "use another class")
    return full


def add(
    folder,
    material: Tabulated,
    *,
    height_mm=None,
    setup: str = "",
    layout: str = "fmf",
    source: str = "",
    relative_error: float | None = None,
    made_by: str = "",
    overwrite: bool = False,
) -> Entry:
    """Adds a material to a library folder (made if it is not there): file first, then index, under a lock.

    Parameters
    ----------
    material : Tabulated; its name is "class/name"
    height_mm, setup, layout : as in :func:`write`
    source, relative_error, made_by : for the index
    overwrite : whether a material of this name is replaced

    Raises
    ------
    InputError
        A name that is taken; values that a file cannot hold; a folder that cannot be written.
    """
    folder = Path(folder)
    _name_is_free(folder, material.name, overwrite)  # before the work; again under the lock
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for pattern in (".adding-*.btf", ".writing-*"):
            atomic.sweep(folder, pattern)
        handle, scratch = tempfile.mkstemp(prefix=".adding-", suffix=".btf", dir=folder)
        os.close(handle)
    except OSError as error:
        raise InputError(
            f"cannot write to {folder}", error.strerror or str(error), "choose a folder that can be written"
        ) from error
    scratch = Path(scratch)
    try:
        try:
            write(scratch, material, height_mm=height_mm, setup=setup, layout=layout)
        except InputError as error:  # the scratch file's name tells nobody anything
            what = f"cannot write to {folder}" if scratch.name in error.what else error.what
            raise InputError(what, error.got, error.do) from error
        digest, size = file_sha256(scratch), scratch.stat().st_size
        with changing(folder) as entries:
            old = entries.get(material.name)
            if old is not None and not overwrite:
                raise _taken(material.name)
            file = material.name.replace("/", "_") + ".btf"
            if file.lower() in {e.file.lower() for e in entries.values()}:  # readers of the old index still find it
                file = material.name.replace("/", "_") + f"-{digest[:8]}.btf"
            entries[material.name] = entry = Entry(
                name=material.name,
                **{"class": material.material_class},
                file=file,
                texel_mm=material.texel_mm,
                texels=material.texels.shape[:2],
                components=material.texels.shape[2],
                sha256=digest,
                size=size,
                relative_error=None if relative_error is None else round(float(relative_error), 4),
                source=source.encode(errors="replace").decode()[:300],  # names of files are not always text
                made_by=made_by,
            )
            os.replace(scratch, folder / file)
        if old is not None and old.file != file:
            with contextlib.suppress(OSError):
                (folder / old.file).unlink()
    finally:
        with contextlib.suppress(OSError):
            scratch.unlink()
    return entry


def remove(folder, name: str) -> None:
    """Takes a material out of a library folder: index first, then file.

    Raises
    ------
    InputError
        No such material in the folder; a folder that cannot be written.
    """
    folder = Path(folder)
    _entry(open_library(folder).entries, name, folder)  # before the lock, which makes the folder
    with changing(folder) as entries:
        entry = _entry(entries, name, folder)
        del entries[name]
    with contextlib.suppress(OSError):
        (folder / entry.file).unlink()


def _entry(entries: dict, name: str, folder: Path) -> Entry:
    if name in entries:
        return entries[name]
    if not entries:
        raise InputError(f"material '{name}'", f"it is not in {folder}, which is empty", "give another library")
    some = ", ".join(list(entries)[:5])
    raise InputError(f"material '{name}'", f"it is not in {folder}", f"give one of its names ({some} …)")


def _name_is_free(folder: Path, name: str, overwrite: bool) -> None:
    if not overwrite and name in entries_of(folder):
        raise _taken(name)


def _taken(name: str) -> InputError:
    return InputError(f"material '{name}'", "the library has one of this name", "use another name, or --replace")


def import_material(folder, source, *, name: str, material_class: str, replace_old: bool = False, **options) -> dict:
    """Reads a source and adds it to a library folder; ``options`` as in :func:`read_source`.

    Returns
    -------
    dict : name, file, size, kind, cosine, reciprocity, texels, texel_mm, components, directions, albedo,
        relative_error

    Raises
    ------
    InputError
        As :func:`read_source` and :func:`add`.
    """
    full = full_name(name, material_class)
    _name_is_free(Path(folder), full, replace_old)
    read = read_source(source, name=full, material_class=material_class, **options)
    reporter = options.get("reporter") or Reporter()
    material = read.material
    albedo = material.albedo().max(1)
    if albedo.max() >= 1:
        reporter.warn(
            f"{full}: it would reflect {albedo.max():.0%} of the light from some views; "
            "check the cosine rule, or the scale of images (--scale)"
        )
    entry = add(
        folder,
        material,
        height_mm=read.height_mm,
        setup="imported",
        source=f"{Path(source).name} ({read.kind})",
        relative_error=read.relative_error,
        overwrite=replace_old,
    )
    return {
        "name": full,
        "file": entry.file,
        "size": entry.size,
        "kind": read.kind,
        "cosine": read.cosine,
        "reciprocity": {
            "as_stored": round(read.reciprocity.as_stored, 4),
            "divided": round(read.reciprocity.divided, 4),
            "verdict": read.reciprocity.verdict,
        },
        "texels": list(entry.texels),
        "texel_mm": entry.texel_mm,
        "components": entry.components,
        "directions": [len(material.views), len(material.lights)],
        "albedo": [round(float(albedo.min()), 4), round(float(albedo.max()), 4)],
        "relative_error": entry.relative_error,
    }
