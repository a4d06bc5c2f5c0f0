# SPDX-License-Identifier: GPL-3.0-or-later
"""A file mapped into memory, and a cursor that reads packed little-endian values from it, never past its end."""

import hashlib
import mmap
import struct
from pathlib import Path

import numpy as np

from btfsep_engine.errors import InputError

MAX_FILE_BYTES = 4 << 30
EXPORT = "export or download the file again"


def map_file(path) -> memoryview | mmap.mmap:
    """The bytes of ``path``, mapped; only what is read is loaded.

    Raises InputError: the file cannot be read, or is larger than any ``.btf`` file.
    """
    path = Path(path)
    try:
        size = path.stat().st_size
        if size > MAX_FILE_BYTES:
            raise InputError(str(path), f"{size} bytes are more than a .btf file can have", EXPORT)
        if size == 0:
            return memoryview(b"")  # an empty file cannot be mapped
        with path.open("rb") as handle:
            return mmap.mmap(handle.fileno(), 0, access=mmap.ACCESS_READ)
    except OSError as error:
        raise InputError(f"cannot read {path}", error, "check the path") from error


def sha256(data) -> str:
    """Hexadecimal SHA-256 of ``data``, bytes or mapped."""
    return hashlib.sha256(data).hexdigest()


class Cursor:
    """Walks through mapped bytes. Every count is checked against what is left before anything is made of it."""

    def __init__(self, data, path: Path):
        self.data, self.path, self.at = data, path, 0

    def fail(self, got: str, do: str = EXPORT) -> InputError:
        """The error that says what is wrong with this file."""
        return InputError(str(self.path), got, do)

    def skip(self, count: int, what: str) -> int:
        """Steps over ``count`` bytes; returns where they begin."""
        left = len(self.data) - self.at
        if count > left:
            raise self.fail(f"the file is cut short: {what} needs {count} bytes, {left} are left")
        self.at += count
        return self.at - count

    def unpack(self, layout: str, what: str):
        """The value, or the tuple of values, of a :mod:`struct` layout (little-endian, packed)."""
        begin = self.skip(struct.calcsize("<" + layout), what)
        values = struct.unpack_from("<" + layout, self.data, begin)
        return values if len(values) > 1 else values[0]

    def text(self, count: int, what: str) -> str:
        """``count`` bytes of NUL-padded text."""
        begin = self.skip(count, what)
        return bytes(self.data[begin : begin + count]).split(b"\0")[0].decode("utf-8", "replace").strip()

    def array(self, dtype, shape: tuple, what: str) -> np.ndarray:
        """An array that still lies in the file (read-only, maybe unaligned)."""
        dtype, count = np.dtype(dtype), 1
        for extent in shape:
            count *= int(extent)  # Python's integers: no overflow
        begin = self.skip(count * dtype.itemsize, what)
        if not count:
            return np.zeros(shape, dtype)
        return np.frombuffer(self.data, dtype, count, begin).reshape(shape)
