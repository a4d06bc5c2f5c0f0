# SPDX-License-Identifier: GPL-3.0-or-later
"""Files are written whole or not at all, and read with errors in words."""

import hashlib
import json
import math
import os
import tempfile
import time
from contextlib import contextmanager, suppress
from pathlib import Path

from btfsep_engine.errors import InputError

ABANDONED = 24 * 3600.0  # seconds after which a scratch file is nobody's


@contextmanager
def replacing(path, *, synced: bool = False):
    """Yields a scratch path beside ``path`` (same suffix); on success it takes the place of ``path``.

    On any error the scratch file is removed and an older ``path`` is left as it was. ``synced`` : the content is on the
    disk before it has the name, and the name before this returns.

    Raises InputError when the folder cannot be written or the disk is full.
    """
    path = Path(path)
    scratch = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, scratch = tempfile.mkstemp(prefix=".writing-", suffix=path.suffix, dir=path.parent)
        os.close(handle)
        yield Path(scratch)
        umask = os.umask(0)
        os.umask(umask)
        os.chmod(scratch, 0o666 & ~umask)  # mkstemp makes private files
        if synced:
            _sync(scratch, os.O_RDWR)
        os.replace(scratch, path)
        scratch = None
        if synced and os.name != "nt":  # Windows opens no folders
            _sync(path.parent, os.O_RDONLY)
    except OSError as error:
        raise InputError(f"cannot write {path}", error, "free space or choose a folder that can be written") from error
    finally:
        if scratch is not None and os.path.exists(scratch):
            os.unlink(scratch)


def check_folder(folder) -> None:
    """Looks whether files can be put into ``folder``, which need not exist yet: to be said before long work.

    Raises InputError: it or what it would lie in is a file, or may not be written.
    """
    place = Path(folder).absolute()
    while not os.path.exists(place) and place != place.parent:
        place = place.parent
    problem = "" if place.is_dir() else f"{place} is no folder"
    if not problem and not os.access(place, os.W_OK | os.X_OK):
        problem = f"{place} may not be written"
    if problem:
        raise InputError(f"cannot write into {folder}", problem, "choose a folder that can be written")


def _sync(path, flags: int) -> None:
    handle = os.open(path, flags)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def sweep(folder) -> None:
    """Takes away scratch files that killed processes have left; what is younger than a day may be in use."""
    with suppress(OSError, ValueError):  # of a name that no folder can have, since Python 3.13
        for path in Path(folder).glob(".writing-*"):
            with suppress(OSError):
                if time.time() - path.lstat().st_mtime > ABANDONED:
                    path.unlink()


def write_bytes(path, data: bytes) -> None:
    """Writes ``data`` to ``path``, whole or not at all."""
    with replacing(path) as scratch:
        scratch.write_bytes(data)


def write_text(path, text: str) -> None:
    """Writes ``text`` as UTF-8 to ``path``, whole or not at all; bytes of names that are none as \\udcXX."""
    write_bytes(path, text.encode(errors="backslashreplace"))


def plain(value):
    """NumPy's values and arrays as JSON's own; numbers that JSON cannot hold become null."""
    if hasattr(value, "tolist"):  # without NumPy: the first line of a command needs none of it
        return plain(value.tolist())
    if isinstance(value, dict):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def write_json(path, value) -> None:
    """Writes ``value`` as indented JSON, whole or not at all."""
    write_text(path, json.dumps(plain(value), indent=1, allow_nan=False) + "\n")


def remove(*paths) -> None:
    """Takes files away, where they are there. Raises InputError."""
    for path in map(Path, paths):
        try:
            path.unlink()
        except (FileNotFoundError, NotADirectoryError):  # whoever writes there says the second
            pass
        except OSError as error:
            raise InputError(f"cannot take away {path}", error, "close or move it, or choose another folder") from error


def digest(path) -> str:
    """SHA-256 of what is in a file, in hexadecimal."""
    with Path(path).open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def read_bytes(path, name: str | None = None) -> bytes:
    """What is in a file, which an error calls ``name``; None: by its own name.

    Raises InputError: it is missing, empty, or cannot be read.
    """
    path = Path(path)
    name = name or path.name
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        raise InputError(name, f"there is no such file in {path.parent}", "check the name") from None
    except OSError as error:
        reason = "it is a folder" if path.is_dir() else error.strerror or str(error)
        raise InputError(name, f"it cannot be read: {reason}", "check the file") from error
    if not data:
        raise InputError(name, "the file is empty", "export it again")
    return data
