# SPDX-License-Identifier: GPL-3.0-or-later
"""Reading a material of a database, whatever its format, into a library folder."""

import re
import stat
import zipfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from btfsep_engine.btf import linear
from btfsep_engine.btf.formats.image_set import import_images
from btfsep_engine.btf.formats.ubo2014 import open_btf
from btfsep_engine.btf.library import NAME
from btfsep_engine.btf.model import Tabulated
from btfsep_engine.btf.storing import add, name_is_free
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

    Raises InputError: whatever is wrong with the source, or a size that is neither in it nor given.
    """
    source, reporter = Path(source), reporter or Reporter()
    if cosine not in linear.COSINE:
        raise InputError(f"cosine '{cosine}'", "it is not one of the rules", "use " + ", ".join(linear.COSINE))
    if components is not None and not 1 <= components <= 1024:
        raise InputError(f"{components} components", "that many cannot be kept", "use 1 to 1024")
    if _is_btf(source):
        if gamma is not None or scale != 1:
            raise InputError("gamma and scale", ".btf files hold linear values", "leave them out")
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
        if texel_mm is None and size_mm is None and (source.is_dir() or zipfile.is_zipfile(source)):
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
        raise InputError(f"cannot read {source}", error, "check the path") from error


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

    Raises InputError: names that an index cannot hold, or of a class that is the engine's own.
    """
    full = name if name.startswith(material_class + "/") else f"{material_class}/{name}"
    if not re.fullmatch(NAME, full) or len(full) > 100:
        raise InputError(
            f"the name '{full}'",
            "it is not class/name",
            "use letters, digits, _, and after the first of them also - and dots; a-z and digits for classes",
        )
    if full.startswith(("reference/", "surface/")):
        raise InputError(
            f"the name '{full}'", f"the class {full.split('/')[0]} is the engine's own", "use another class"
        )
    return full


def import_material(folder, source, *, name: str, material_class: str, replace_old: bool = False, **options) -> dict:
    """Reads a source and adds it to a library folder; ``options`` as in :func:`read_source`.

    Gives a dict: name, file, size, kind, cosine, reciprocity, texels, texel_mm, components, directions, albedo,
    relative_error.

    Raises InputError as :func:`read_source` and :func:`add`.
    """
    full = full_name(name, material_class)
    name_is_free(Path(folder), full, replace_old)
    read = read_source(source, name=full, material_class=material_class, **options)
    reporter = options.get("reporter") or Reporter()
    material = read.material
    albedo = material.directional_albedo().max(1)
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
