# SPDX-License-Identifier: GPL-3.0-or-later
"""Dr.Jit and Mitsuba for the files of this room, NumPy's arrays on their device, and look-ups there.

``from btfsep_engine.render.arrays import dr, mi`` imports nothing yet: both begin with the first use, in the variant
that :mod:`btfsep_engine.render.backend` chooses, or in the one that a program which uses the plugin has set.
"""

import sys

import numpy as np

from btfsep_engine.btf.directions import GRID, interpolator
from btfsep_engine.render.backend import import_mitsuba

ALIGNMENT = 64  # bytes, of memory that Dr.Jit works on


class _AtFirstUse:
    """The module ``name``: importing it before the backend is chosen would end the process where that fails."""

    def __init__(self, name: str):
        self._name = name

    def __getattr__(self, attribute):
        mitsuba = sys.modules.get("mitsuba")
        if mitsuba is None or mitsuba.variant() is None:
            import_mitsuba()
        return getattr(sys.modules[self._name], attribute)


dr, mi = _AtFirstUse("drjit"), _AtFirstUse("mitsuba")


def aligned(shape, kind) -> np.ndarray:
    """An array yet to be filled, at an address that is a multiple of `ALIGNMENT`.

    Dr.Jit borrows NumPy's memory, and compiles other kernels for memory that is not aligned: without this, chance would
    decide whether a kernel is found in the cache.
    """
    size = int(np.prod(shape)) * np.dtype(kind).itemsize
    room = np.empty(size + ALIGNMENT, np.uint8)
    start = -room.ctypes.data % ALIGNMENT
    return room[start : start + size].view(kind).reshape(shape)


def _copied(values, kind) -> np.ndarray:
    """A flat aligned copy."""
    values = np.asarray(values)
    out = aligned(values.shape, kind)
    out[...] = values
    return out.ravel()


def floats(values):
    """An array of any shape to a flat Mitsuba Float."""
    return mi.Float(_copied(values, np.float32))


def integers(values):
    """An array of any shape, of numbers >= 0, to a flat Mitsuba UInt32."""
    return mi.UInt32(_copied(values, np.uint32))


def vector(values):
    """(n, 3) array to a Mitsuba vector of n lanes."""
    return mi.Vector3f(*(floats(column) for column in np.asarray(values, np.float32).T))


def packets(values):
    """(n, 3) array to a Mitsuba Float whose lanes are gathered four at a time, the fourth 0."""
    padded = np.zeros((len(values), 4), np.float32)
    padded[:, :3] = values
    return floats(padded)


def divided(lane, divisor: int):
    """``lane // divisor`` for a divisor that may change from call to call without a new kernel.

    Processors have no fast division of whole numbers: the high half of a product, at most one too large.
    """
    if divisor == 1:  # 2^32 is no UInt32
        return lane
    quotient = dr.mul_hi(lane, dr.opaque(mi.UInt32, -(-(2**32) // divisor)))
    over = quotient * dr.opaque(mi.UInt32, divisor) > lane
    return quotient - dr.select(over, mi.UInt32(1), mi.UInt32(0))


class DirectionTaps:
    """`btf.directions.Interpolator` on the device: which three directions of a list a direction lies between.

    ``directions`` : (n, 3) float, unit, upper hemisphere
    """

    def __init__(self, directions):
        taps = interpolator(directions)
        self._grid = integers(taps.grid)
        # a corner of a triangle in one packet: its row of the affine map, and which direction it is
        self._corners = floats(np.concatenate([taps.affine, taps.triangles[..., None]], -1))

    def __call__(self, direction, active=True):
        """Three (number in the list, weight >= 0) of a local direction in the upper hemisphere; they sum to about 1."""
        horizon = 1 + dr.maximum(direction.z, 0)
        u, v = direction.x / horizon, direction.y / horizon  # the parabolic map
        column, row = (mi.UInt32(dr.clip((c + 1) * (GRID / 2), 0, GRID - 1)) for c in (u, v))
        triangle = dr.gather(mi.UInt32, self._grid, row * GRID + column, active)
        found = []
        for corner in range(3):
            affine = dr.gather(mi.Vector4f, self._corners, triangle * 3 + corner, active)
            found.append((mi.UInt32(affine.w), dr.maximum(affine.x * u + affine.y * v + affine.z, 0)))
        return found

    def normalised(self, direction, active=True):
        """The same as three numbers and three weights of sum 1."""
        numbers, weights = zip(*self(direction, active), strict=True)
        total = weights[0] + weights[1] + weights[2]
        scale = dr.select(total > 0, 1 / total, 0)
        return numbers, [w * scale for w in weights]
