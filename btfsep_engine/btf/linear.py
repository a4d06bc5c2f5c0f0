# SPDX-License-Identifier: GPL-3.0-or-later
"""From an opened ``.btf`` file to the one model in memory: linear in both factors, without the cosine.

Files whose factors are linear and shared by the channels are taken as they are. All others are decoded once,
factorised anew in the linear domain, and kept in the cache folder under the hash of the file's content.
"""

from contextlib import suppress

import numpy as np

from btfsep_engine.btf import reciprocity
from btfsep_engine.btf.formats.colour import RGB
from btfsep_engine.btf.formats.mapped import EXPORT
from btfsep_engine.btf.formats.ubo2014 import LARGEST, BtfFile, open_btf
from btfsep_engine.btf.model import Tabulated
from btfsep_engine.btf.recompress import LinearFactors, recompress
from btfsep_engine.errors import InputError
from btfsep_engine.progress import Reporter
from btfsep_engine.storage import cache

COSINE = ("header", "auto", "included", "excluded")
COMPONENTS = 32  # of a file that is factorised anew, unless told
VERSION = 2  # of the cached factors; another one when the method changes
CHECKED_TEXELS = 128
MAX_DECODED_TEXELS = 1024 * 1024  # of a file that has to be decoded
CLASSES = (
    *("carpet", "fabric", "felt", "leather", "stone", "wallpaper", "wood"),  # of UBO2014
    *("ceramic", "metal", "paint", "paper", "plaster", "plastic"),
)


def read(path, data=None, **options) -> Tabulated:
    """Reads a ``.btf`` file into memory.

    Parameters
    ----------
    path : path of the file
    data : its bytes, where they are mapped already
    options : name, material_class, cosine, components, flip_v, reporter of :func:`to_material_and_error`

    Raises InputError: not such a file, cut short, inconsistent, not finite, or of a kind that is not supported.
    """
    return to_material_and_error(open_btf(path, data), **options)[0]


def to_material_and_error(
    file: BtfFile,
    *,
    name: str | None = None,
    material_class: str | None = None,
    cosine: str = "header",
    components: int | None = None,
    flip_v: bool = False,
    reporter: Reporter | None = None,
) -> tuple[Tabulated, float]:
    """The material of an opened file, and the relative error of factors that were made anew (else 0).

    Parameters
    ----------
    file : BtfFile
    name, material_class : as the material is to be called; None: from the file's name
    cosine : whether cos(theta_i) is in the data: "included", "excluded", "header" (as the file says), or "auto"
        (as reciprocity says where it is clear, else as the file says)
    components : at most so many; None: all of linear files, COMPONENTS of others
    flip_v : turns the rows of texels over (files with row 0 at the largest v)
    reporter : told the progress, and where "auto" overrules the header

    Raises InputError: values that are not finite; more texels than can be decoded.
    """
    header, reporter = file.header, reporter or Reporter()
    included = cosine_included(file, cosine, reporter=reporter)
    with np.errstate(over="ignore", invalid="ignore"):  # looked for below
        factors = _own_factors(file, components)
    if factors is None:
        factors = converted(file, components=components or COMPONENTS, reporter=reporter)
    angular, texels = factors.angular, factors.spatial
    k = texels.shape[1]
    angular = angular.reshape(len(header.views), len(header.lights), 3, k)
    texels = texels.reshape(header.height, header.width, k)
    with np.errstate(over="ignore", invalid="ignore"):
        if included:
            angular /= np.maximum(header.lights[:, 2], 1e-3).astype(np.float32)[None, :, None, None]
        largest = [max(factor.max(), -factor.min()) for factor in (angular, texels)]  # NaN stays NaN
        possible = float(largest[0]) * float(largest[1]) * k < LARGEST
    if not possible:
        raise InputError(
            str(file.path), f"its factors hold NaN or infinite values, or some beyond {LARGEST:.0e}", EXPORT
        )
    stem = file.path.name.split(".")[0]
    if material_class is None:
        material_class = next((c for c in CLASSES if stem.lower().startswith(c)), "unknown")
    material = Tabulated(
        name=name or stem,
        material_class=material_class,
        texels=np.ascontiguousarray(texels[::-1] if flip_v else texels),
        angular=np.ascontiguousarray(angular),
        views=header.views,
        lights=header.lights,
        texel_mm=1 / header.pixels_per_mm if header.pixels_per_mm > 0 else 0.25,
    )
    return material, factors.relative_error


def _own_factors(file: BtfFile, components: int | None) -> LinearFactors | None:
    """The file's own factors where they are linear and not too many, as float32; None: to be factorised anew."""
    if not file.linear:
        return None
    file = file if components is None else file.truncated(components)
    matrix, offset = file.colour.affine()
    if file.shared_spatial and not offset.any():
        angular = np.stack([np.asarray(a, np.float32) for a in file.angular], 1)
        if file.colour.model != RGB:
            angular = matrix @ angular
        return LinearFactors(np.array(file.spatial[0], np.float32), angular, 0.0)
    total = sum(file.components) + int(offset.any())
    if components is not None and total > components:
        return None
    angular, at = np.zeros((file.pairs, 3, total), np.float32), 0
    spatial = np.ones((file.texels, total), np.float32)
    for c, k in enumerate(file.components):
        for rgb in np.flatnonzero(matrix[:, c]):
            np.multiply(file.angular[c], matrix[rgb, c], out=angular[:, rgb, at : at + k], casting="same_kind")
        spatial[:, at : at + k] = file.spatial[c]
        at += k
    if at < total:
        angular[:, :, at] = offset
    return LinearFactors(spatial, angular, 0.0)


def converted(file: BtfFile, *, components: int, reporter: Reporter | None = None) -> LinearFactors:
    """The file's values factorised anew, linear RGB, the cosine in them as stored: from the cache, or made now.

    A damaged or older cache file is replaced. Two processes may do it at once: both may decode, each file appears
    whole, the last one stays. A cache that cannot be written is no error. Raises InputError where the file has too many
    texels to decode.
    """
    if file.texels > MAX_DECODED_TEXELS:
        raise InputError(str(file.path), f"{file.texels} texels are too many to decode", "give a smaller resampling")
    components = max(1, min(components, 2 * sum(file.components) + 2))
    key = cache.digest(VERSION, file.sha256(), components, file.components)
    stored = cache.cache_folder() / "materials" / f"{key[:32]}.entry"
    shapes = {"spatial": (file.texels, "k"), "angular": (file.pairs, 3, "k"), "relative_error": ()}
    kept = cache.read(stored, shapes)
    if kept is not None:
        return LinearFactors(kept["spatial"], kept["angular"], float(kept["relative_error"]))
    factors = recompress(file.decode, file.texels, file.pairs, components=components, reporter=reporter)
    with suppress(InputError):  # only costs the decoding next time
        cache.write(stored, vars(factors))
    return factors


def mean_abrdf_as_stored(file: BtfFile) -> np.ndarray:
    """(views, lights, 3) float32, the mean over a sample of texels, the cosine in it as in the file."""
    some = np.unique(np.linspace(0, file.texels - 1, CHECKED_TEXELS).astype(np.int64))
    step = max(1, (2 << 20) // len(some))
    parts = [
        file.decode(some, slice(start, min(start + step, file.pairs))).mean(0) for start in range(0, file.pairs, step)
    ]
    return np.concatenate(parts).reshape(len(file.header.views), len(file.header.lights), 3)


def check_reciprocity(file: BtfFile) -> reciprocity.Reciprocity:
    """How reciprocal the file's mean ABRDF is as stored and divided by the cosine."""
    return reciprocity.check(mean_abrdf_as_stored(file), file.header.views, file.header.lights)


def cosine_included(file: BtfFile, cosine: str = "header", *, reporter: Reporter | None = None) -> bool:
    """Whether cos(theta_i) is taken to be in the data; ``cosine`` as in :func:`to_material_and_error`.

    Raises InputError where that is none of `COSINE`.
    """
    if cosine not in COSINE:
        raise InputError(f"cosine '{cosine}'", "it is not one of the rules", "use " + ", ".join(COSINE))
    if cosine in ("included", "excluded"):
        return cosine == "included"
    said = file.header.cosine_in_data
    if cosine == "auto":
        found = check_reciprocity(file)
        if found.verdict != "unclear" and (found.verdict == "included") != said:
            if reporter is not None:
                reporter.warn(
                    f"{file.path.name}: its header says that the cosine is {'in' if said else 'not in'} the data; "
                    f"reciprocity says the opposite (error {found.as_stored:.2f} as stored, {found.divided:.2f} "
                    "divided by it), and is believed"
                )
            return not said
    return said
