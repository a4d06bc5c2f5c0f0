# SPDX-License-Identifier: GPL-3.0-or-later
"""UBO2014 ``.btf`` files, opened: the full-matrix-factorised layouts ``!FMF…`` and ``!DFMF…``.

An opened file is mapped into memory. Its factors are views into it; only what is asked for is read and decoded.
All layouts become one: for each stored channel c, an angular factor with a row per pair of directions and a spatial
factor with a row per texel,

    stored(x, pair)[c] = spatial[c][x] . angular[c][pair],      pair = view * lights + light,  x = row * width + column,

and the colour model (or the dynamic range reduction) makes linear RGB of the three stored channels.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from btfsep_engine.btf.formats.colour import LOG_RGB, MODELS, Colour
from btfsep_engine.btf.formats.header import Header, read_common
from btfsep_engine.btf.formats.mapped import EXPORT, Cursor, map_file, sha256
from btfsep_engine.errors import InputError
from btfsep_engine.linear_algebra import product

LARGEST = 1e12  # 1/sr; far beyond any material, far within float32
SCALARS = {2: np.dtype("<f2"), 4: np.dtype("<f4"), 8: np.dtype("<f8")}


@dataclass(frozen=True)
class BtfFile:
    """An opened ``.btf`` file.

    Attributes
    ----------
    path : Path
    header : Header
    angular : three arrays (pairs, K of the channel), float16, float32 or float64, in the file
    spatial : three arrays (texels, K of the channel), likewise
    colour : Colour; dynamic range reduction counts as the model LOG_RGB
    data : the mapped bytes
    """

    path: Path
    header: Header
    angular: tuple
    spatial: tuple
    colour: Colour
    data: object

    @property
    def components(self) -> tuple:
        """K of each channel."""
        return tuple(a.shape[1] for a in self.angular)

    @property
    def linear(self) -> bool:
        """Whether the factors can be used as they are."""
        return self.colour.linear

    @cached_property
    def shared_spatial(self) -> bool:
        """Whether the three channels have one spatial factor in common, also where a file repeats it for each."""
        return all(_alike(self.spatial[0], other) for other in self.spatial[1:])

    @property
    def texels(self) -> int:
        """How many texels there are."""
        return self.header.width * self.header.height

    @property
    def pairs(self) -> int:
        """How many pairs of view and light there are."""
        return len(self.header.views) * len(self.header.lights)

    def sha256(self) -> str:
        """Hash of the whole file."""
        return sha256(self.data)

    def truncated(self, components: int) -> "BtfFile":
        """The coarser model of the first ``components`` (>= 1) of each channel; they are sorted in the file."""
        k = max(int(components), 1)
        one = self.spatial[0][:, :k]
        spatial = (one, one, one) if self.shared_spatial else tuple(s[:, :k] for s in self.spatial)
        return replace(self, angular=tuple(a[:, :k] for a in self.angular), spatial=spatial)

    def decode(self, texels, pairs) -> np.ndarray:
        """Values as they are in the file, the cosine in them or not.

        Parameters
        ----------
        texels, pairs : indices (n,) int, or slices

        Returns
        -------
        (texels, pairs, 3) float32, linear RGB

        Raises InputError: some of these values are not finite.
        """
        planes, spatial = [], None
        with np.errstate(over="ignore", invalid="ignore"):
            for c in range(3):
                if spatial is None or not self.shared_spatial:
                    spatial = np.asarray(self.spatial[c][texels], np.float32)
                planes.append(product(spatial, np.asarray(self.angular[c][pairs], np.float32).T))
            values = self.colour.decode(np.stack(planes, -1))
        if values.size and not (values.max() < LARGEST and values.min() > -LARGEST):  # NaN fails both
            raise InputError(str(self.path), f"it holds NaN or infinite values, or some beyond {LARGEST:.0e}", EXPORT)
        return values


def _alike(a, b) -> bool:
    """Whether two factors are the same; of different ones, which is the rule, little is read."""
    if a is b:
        return True
    return a.shape == b.shape and np.array_equal(a[:16], b[:16]) and np.array_equal(a, b)


def open_btf(path, data=None) -> BtfFile:
    """Opens a ``.btf`` file: checks everything but the values, decodes nothing.

    Parameters
    ----------
    path : path of the file
    data : its bytes, where they are mapped already

    Raises InputError: no such file, another kind, cut short, or one whose parts do not fit.
    """
    path = Path(path)
    cursor = Cursor(map_file(path) if data is None else data, path)
    header = read_common(cursor)
    if header.signature.startswith("!FMF"):
        return _open_fmf(cursor, header)
    return _open_dfmf(cursor, header)


def _open_fmf(cursor: Cursor, header: Header) -> BtfFile:
    reduced = False
    if header.signature.startswith("!FMF12"):
        version = cursor.unpack("B", "the extra header")
        if version > 2:
            raise cursor.fail(f"the extra header has version {version}; 0 to 2 are known", EXPORT)
        if version >= 1:
            method = cursor.unpack("I", "the extra header")
            if method > 1:
                raise cursor.fail(f"dynamic range reduction {method}; 0 and 1 are known", EXPORT)
            reduced = method == 1
        if version >= 2:
            width, height = cursor.unpack("II", "the height map")
            if width > 0 and height > 0:
                stored = cursor.array("<f2", (height, width), "the height map")
                header = replace(header, height_mm=stored.astype(np.float32))
    cursor.unpack("I", "the component count")
    u, sxv = _factor_pair(cursor)
    pairs, texels, k = len(header.views) * len(header.lights), header.width * header.height, u.shape[1]
    if len(u) == pairs * 3 and len(sxv) == texels:
        angular = tuple(u.reshape(pairs, 3, k)[:, c] for c in range(3))
        spatial = (sxv, sxv, sxv)
    elif len(u) == texels * 3 and len(sxv) == pairs:  # the transposed layout
        angular = (sxv, sxv, sxv)
        spatial = tuple(u.reshape(texels, 3, k)[:, c] for c in range(3))
    else:
        raise cursor.fail(f"factors of {len(u)} and {len(sxv)} rows do not fit the directions and texels")
    colour = Colour(LOG_RGB) if reduced else Colour()
    return BtfFile(cursor.path, header, angular, spatial, colour, cursor.data)


def _open_dfmf(cursor: Cursor, header: Header) -> BtfFile:
    _, model = cursor.unpack("Ii", "the colour model")
    transform = cursor.array("<f4", (12,), "the colour transform").astype(np.float32)
    if model not in MODELS:
        known = ", ".join(map(str, MODELS))
        raise cursor.fail(f"colour model {model} is not supported; known are {known}", "convert it to one of these")
    colour = Colour(model, transform[3:].reshape(3, 3), transform[:3])
    if colour.linear and not all(np.isfinite(part).all() for part in colour.affine()):
        raise cursor.fail("its colour transform is not finite")
    pairs, texels = len(header.views) * len(header.lights), header.width * header.height
    angular, spatial = [], []
    for _ in range(3):
        u, sxv = _factor_pair(cursor)
        if len(u) == texels and len(sxv) == pairs and len(u) != len(sxv):
            u, sxv = sxv, u  # the transposed layout
        if len(u) != pairs or len(sxv) != texels:
            raise cursor.fail(f"factors of {len(u)} and {len(sxv)} rows do not fit the directions and texels")
        angular.append(u)
        spatial.append(sxv)
    return BtfFile(cursor.path, header, tuple(angular), tuple(spatial), colour, cursor.data)


def _factor_pair(cursor: Cursor):
    """One block of scalar size, K, rows, cols, S, U, SxV: U (rows, K) and SxV (cols, K), both in the file."""
    scalar, k, rows, cols = cursor.unpack("BIII", "the factors")
    if scalar not in SCALARS:
        raise cursor.fail(f"its scalars have {scalar} bytes; 2, 4 and 8 are known")
    if k < 1:
        raise cursor.fail("its factors have no components")
    cursor.skip(k * scalar, "the singular values")
    u = cursor.array(SCALARS[scalar], (rows, k), "the angular factor")
    return u, cursor.array(SCALARS[scalar], (cols, k), "the spatial factor")
