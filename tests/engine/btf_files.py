# SPDX-License-Identifier: GPL-3.0-or-later
"""A writer and a decoder of ``.btf`` files of their own, straight from the format's facts, for the tests.

Nothing here comes from the engine: values are decoded one by one, with the math module.
"""

import math
import struct

import numpy as np

EPSILON = 1e-5


def header(signature, *, views, lights, width, height, cosine=1, version=4, ppmm=4.0, xml=b""):
    """Everything before the payload. ``views, lights : (n, 2)`` theta and phi in radians."""
    texts = b"".join(t.ljust(80, b"\0") for t in (b"test setup", b"test sensor", b"test light"))
    body = texts + struct.pack("<f3f", ppmm, 1, 2, 3)
    if version > 1:
        body += struct.pack("<I", cosine)
    if version > 2:
        body += struct.pack("<I", len(xml)) + xml
    if version > 3:
        body += struct.pack("<I", 3) + b"".join(struct.pack("<I", 1) + c for c in (b"R", b"G", b"B"))
    out = signature + struct.pack("<II", len(body) + 8, version) + body + struct.pack("<I", len(views))
    for theta, phi in views:
        out += struct.pack("<2fI", theta, phi, len(lights))
        out += b"".join(struct.pack("<2f", *light) for light in lights)
    out += struct.pack("<II", width, height)
    return out + (struct.pack("<I", 0) if signature.endswith(b"R") else b"")


def block(u, sxv, dtype):
    """Scalar size, K, rows, cols, S (inf, as in real files), U, SxV."""
    u, sxv = np.asarray(u, dtype), np.asarray(sxv, dtype)
    start = struct.pack("<BIII", u.dtype.itemsize, u.shape[1], len(u), len(sxv))
    return start + np.full(u.shape[1], np.inf, dtype).tobytes() + u.tobytes() + sxv.tobytes()


def dfmf(u, sxv, *, model=0, mean=(0, 0, 0), matrix=None, dtype="<f2", transposed=False, **common):
    """``u, sxv``: three arrays each, (pairs, K) and (texels, K)."""
    matrix = np.eye(3) if matrix is None else np.asarray(matrix)
    out = header(b"!DFMF08FCR", **common) + struct.pack("<Ii", max(a.shape[1] for a in u), model)
    out += struct.pack("<12f", *mean, *matrix.ravel())
    return out + b"".join(block(b, a, dtype) if transposed else block(a, b, dtype) for a, b in zip(u, sxv, strict=True))


def fmf(u, sxv, *, reduced=0, dtype="<f2", signature=b"!FMF12FCER", height_map=None, **common):
    """``u : (pairs * 3, K), sxv : (texels, K)``, or the transposed (texels * 3, K) and (pairs, K)."""
    out = header(signature, **common)
    if signature == b"!FMF12FCER":
        shape = (0, 0) if height_map is None else np.shape(height_map)
        out += struct.pack("<BIII", 2, reduced, shape[1], shape[0])
        out += b"" if height_map is None else np.asarray(height_map, "<f2").tobytes()
    return out + struct.pack("<I", np.shape(u)[1]) + block(u, sxv, dtype)


def rgb(model, stored, mean=(0, 0, 0), matrix=None):
    """One stored triple as linear RGB, by the formulas of the format."""
    a, b, c = (float(v) for v in stored)
    if model == 0:
        return a, b, c
    if model == 3:
        return tuple(sum(v * float(matrix[i][j]) for i, v in enumerate((a, b, c))) + mean[j] for j in range(3))
    if model == 4:
        return a + b - c, a + c, a - b - c
    if model == 12:
        return tuple(math.exp(v) - EPSILON for v in (a, b, c))
    y, u, v = a, b, c
    if model in (9, 10, 11):
        y = math.exp(a) - EPSILON
    if model == 10:
        u, v = (math.copysign(math.exp(abs(s) + math.log(EPSILON)), s) for s in (b, c))
    if model == 11:
        u, v = b * (y + EPSILON), c * (y + EPSILON)
    return y + 1.13983 * v, y - 0.39465 * u - 0.5806 * v, y + 2.03211 * u
