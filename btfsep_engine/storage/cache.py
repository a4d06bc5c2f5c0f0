# SPDX-License-Identifier: GPL-3.0-or-later
"""Where everything that can be made again is kept: one folder, and one kind of file that is whole or is not there.

An entry holds arrays by name. It is called by a :func:`digest` of all that it depends on. In front of them stands the
SHA-256 of the entry's own folder and name and of all that follows, so that a file that a disk, a crash or a person has
changed, or put in the place of another, is made again. Each kind has a folder, of `most_bytes` at most: what has been
unused for longest gives way.
"""

import dataclasses
import hashlib
import os
import shutil
from contextlib import suppress
from functools import partial
from pathlib import Path

import numpy as np
from platformdirs import user_cache_dir

from btfsep_engine.storage import atomic

ENVIRONMENT = "BTFSEP_CACHE"  # names another folder
DIGEST = 32  # bytes
MOST_BYTES = 2 << 30  # of a folder of entries: some sixty recognisers
LIMIT = "BTFSEP_CACHE_MB"  # names another limit, in megabytes
TEXT = "text"  # what an entry holds instead of numbers


def cache_folder() -> Path:
    """$BTFSEP_CACHE, or the user's cache folder of this platform. It need not exist yet, nor be one that can."""
    named = os.environ.get(ENVIRONMENT)
    if named:
        return Path(os.path.expanduser(named))
    usual = Path(user_cache_dir("btfsep", appauthor=False))
    # a user without a home would get a folder called "~", wherever a command is run
    return usual if usual.is_absolute() else Path(os.devnull, "btfsep")


def read(path, shapes: dict | None = None) -> dict | None:
    """The arrays by name of the entry ``path``; None where there is none, or none that is whole.

    ``shapes`` says what the entry has to hold to be of use: for each name `TEXT`, or the shape of its numbers, with a
    word for a length that may be any, and is the same wherever the word stands. All its numbers have to be finite then.
    """
    path = Path(path)
    try:
        if not path.is_file():  # a pipe would be waited for
            return None
        with open(path, "rb") as file:
            if file.read(DIGEST) != _digest(path, file):
                return None
            file.seek(DIGEST)
            names = np.load(file, allow_pickle=False)
            found = {str(name): np.load(file, allow_pickle=False) for name in names}
        with suppress(OSError):  # of another user, perhaps
            os.utime(path)  # the time of an entry is that of its last use
    except (OSError, ValueError, EOFError):
        return None
    return found if shapes is None or _fits(found, shapes) else None


def _fits(arrays: dict, shapes: dict) -> bool:
    """Whether the arrays are those that `read` is asked for."""
    lengths = {}
    for name, shape in shapes.items():
        array = arrays.get(name, np.array(None))
        if shape is TEXT:
            if array.dtype.kind != "U" or array.ndim:
                return False
            continue
        wanted = tuple(
            lengths.setdefault(n, got) if isinstance(n, str) else n for n, got in zip(shape, array.shape, strict=False)
        )
        if len(shape) != array.ndim or array.shape != wanted or array.dtype.kind not in "fiu":
            return False
    return all(np.isfinite(array).all() for array in arrays.values() if array.dtype.kind == "f")


def write(path, arrays: dict) -> None:
    """Puts the entry there, in the place of whatever was, and sees to it that it outlives a crash of the machine.

    Raises InputError when it cannot be written: the caller goes on without.
    """
    path = Path(path)
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    atomic.sweep(path.parent)
    with atomic.replacing(path, synced=True) as scratch, open(scratch, "w+b") as file:
        file.write(bytes(DIGEST))
        # one after the other: a zip would try again on a disk that is full
        for part in (np.array(list(arrays)), *arrays.values()):
            np.save(file, part, allow_pickle=False)
        file.seek(DIGEST)
        digest = _digest(path, file)
        file.seek(0)
        file.write(digest)
    _make_room(path)


def _make_room(kept: Path) -> None:
    """Removes the entries beside ``kept`` that were unused for longest, until the folder is no larger than allowed."""
    found = []
    for entry in kept.parent.glob("*.entry"):
        with suppress(OSError):  # another process may have removed it
            about = entry.stat()
            found.append((entry != kept, -about.st_mtime_ns, about.st_size, entry))
    total, most = 0, most_bytes()
    for removable, _, size, entry in sorted(found):
        total += size
        if removable and total > most:
            with suppress(OSError):
                entry.unlink()


def most_bytes() -> float:
    """How large a folder of entries may be."""
    try:
        return max(float(os.environ[LIMIT]), 0.0) * (1 << 20)
    except (KeyError, ValueError):
        return MOST_BYTES


def entries() -> list[Path]:
    """All that is kept: entries, and what killed processes have left of some. Nothing else that lies in the folder."""
    folder = cache_folder()
    return [path for name in ("*.entry", ".writing-*") for path in folder.rglob(name) if path.is_file()]


def clear() -> int:
    """Takes all of it away, and folders that are empty then; gives the bytes that are free now."""
    freed = 0
    for path in entries():
        with suppress(OSError):  # in use, on Windows
            size = path.stat().st_size
            path.unlink()
            freed += size
    for folder in sorted((p for p in cache_folder().rglob("*") if p.is_dir()), key=lambda p: -len(p.parts)):
        with suppress(OSError):  # it holds something
            folder.rmdir()
    return freed


def _digest(path: Path, file) -> bytes:
    """Of the entry's place in the cache and of the rest of ``file``."""
    return hashlib.file_digest(file, partial(hashlib.sha256, os.fsencode("/".join(path.parts[-2:])))).digest()


def digest(*parts) -> str:
    """A key of content: texts, numbers, dataclasses, bytes, arrays, None, and lists and tuples of these."""
    h = hashlib.sha256()

    def feed(part):
        if isinstance(part, np.ndarray):
            data = np.ascontiguousarray(part)
            h.update(f"array {data.dtype.str} {data.shape};".encode())
            h.update(data.tobytes())
        elif isinstance(part, bytes):
            h.update(f"bytes {len(part)};".encode() + part)
        elif isinstance(part, list | tuple):
            h.update(f"list {len(part)};".encode())
            for item in part:
                feed(item)
        elif part is None or isinstance(part, str | int | float | bool):
            h.update(f"{type(part).__name__} {part!r};".encode())
        elif dataclasses.is_dataclass(part):
            h.update(f"{type(part).__name__};".encode())
            feed([item for f in dataclasses.fields(part) for item in (f.name, getattr(part, f.name))])
        else:
            raise TypeError(f"no digest of a {type(part).__name__}")

    feed(list(parts))
    return h.hexdigest()
