# SPDX-License-Identifier: GPL-3.0-or-later
"""Writing UBO2014 ``.btf`` files, both layouts: linear, half floats, whole or not at all."""

import struct

import numpy as np

from btfsep_engine.btf.formats.header import DFMF_SIGNATURES, FMF_SIGNATURES
from btfsep_engine.btf.model import Tabulated
from btfsep_engine.errors import InputError
from btfsep_engine.storage.atomic import replacing


def write(
    path, material: Tabulated, *, height_mm=None, setup: str = "", layout: str = "fmf", cosine: bool = True
) -> None:
    """Writes a linear, half-float ``.btf`` file, whole or not at all.

    Parameters
    ----------
    path : path of the file
    material : Tabulated, without cos(theta_i); three channels
    height_mm : (h, w) float, mm, or None; held by the "fmf" layout only
    setup : free text for the header, at most 79 bytes
    layout : "fmf" (``!FMF12FCER``, one spatial factor) or "dfmf" (``!DFMF08FCR``, one a channel)
    cosine : multiply cos(theta_i) in, and set the flag (as the public data are)

    Raises InputError: values that are not finite or beyond half floats; a folder that cannot be written.
    """
    angular = np.asarray(material.angular, np.float32)
    n_views, n_lights, channels, k = angular.shape
    h, w, k_texels = material.texels.shape
    if channels != 3 or k != k_texels or (n_views, n_lights) != (len(material.views), len(material.lights)):
        raise ValueError("the factors of the material do not fit each other")
    if cosine:
        angular = angular * np.asarray(material.lights, np.float32)[None, :, 2, None, None]
    with np.errstate(over="ignore"):
        u, sxv = angular.astype("<f2"), np.asarray(material.texels).reshape(h * w, k).astype("<f2")
    if not (np.isfinite(u).all() and np.isfinite(sxv).all()):
        raise InputError(material.name, "values that half floats cannot hold", "check the material's measurement")
    singular = np.zeros(k, "<f2")
    with replacing(path) as scratch, open(scratch, "wb") as out:
        out.write(FMF_SIGNATURES[0] if layout == "fmf" else DFMF_SIGNATURES[0])
        text = b"".join(s.encode()[:79].ljust(80, b"\0") for s in (setup, "BTFsep", "directional"))
        names = b"".join(struct.pack("<I", 1) + c for c in (b"R", b"G", b"B"))
        body = text + struct.pack("<4fIII", 1 / material.texel_mm, 1, 1, 1, int(cosine), 0, 3) + names
        out.write(struct.pack("<II", len(body) + 8, 4) + body)
        out.write(_direction_block(material.views, material.lights))
        out.write(struct.pack("<III", w, h, 0))
        if layout == "fmf":
            height = None if height_mm is None else np.asarray(height_mm).astype("<f2")
            shape = (0, 0) if height is None else height.shape
            out.write(struct.pack("<BIII", 2, 0, shape[1], shape[0]))
            out.write(b"" if height is None else height.tobytes())
            out.write(struct.pack("<IBIII", k, 2, k, n_views * n_lights * 3, h * w))
            out.write(singular.tobytes() + u.tobytes() + sxv.tobytes())
        elif layout == "dfmf":
            out.write(struct.pack("<Ii12f", k, 0, 0, 0, 0, *np.eye(3).ravel()))
            for channel in range(3):
                out.write(struct.pack("<BIII", 2, k, n_views * n_lights, h * w) + singular.tobytes())
                out.write(np.ascontiguousarray(u[:, :, channel]).tobytes() + sxv.tobytes())
        else:
            raise ValueError(f"no layout {layout!r}")


def _direction_block(views, lights) -> bytes:
    def angles(directions):
        d = np.asarray(directions, np.float64)
        theta = np.arctan2(np.hypot(d[:, 0], d[:, 1]), d[:, 2])
        return np.stack([theta, np.arctan2(d[:, 1], d[:, 0])], 1).astype("<f4")

    light_block = struct.pack("<I", len(lights)) + angles(lights).tobytes()
    return struct.pack("<I", len(views)) + b"".join(v.tobytes() + light_block for v in angles(views))
