# SPDX-License-Identifier: GPL-3.0-or-later
"""Files are written whole or not at all. No bpy in this file."""

import os
from contextlib import contextmanager
from pathlib import Path

from .errors import InputError


@contextmanager
def replacing(path):
    """Yields a scratch path beside ``path`` (same suffix); on success it takes the place of ``path``.

    On any error the scratch file is removed and an older ``path`` is left as it was.

    Raises InputError when it cannot be written; Blender's own RuntimeError counts as that.
    """
    path = Path(path)
    scratch = path.with_name(f".writing-{path.name}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield scratch
        os.replace(scratch, path)
    except (OSError, RuntimeError) as error:
        raise InputError(f"cannot write {path}", error, "free space, or choose a folder that can be written") from error
    finally:
        scratch.unlink(missing_ok=True)


def check_place(path) -> None:
    """Raises InputError where no file ``path`` could be written, whose folder need not exist yet: before long work."""
    folder = Path(path).absolute().parent
    while not os.path.exists(folder) and folder != folder.parent:
        folder = folder.parent
    if not folder.is_dir() or not os.access(folder, os.W_OK | os.X_OK):
        got = f"{folder} may not be written" if folder.is_dir() else f"{folder} is no folder"
        raise InputError(f"cannot write {path}", got, "choose a folder that can be written")


def write_bytes(path, data: bytes) -> None:
    """Writes ``data`` to ``path`` whole or not at all. Raises InputError."""
    with replacing(path) as scratch:
        scratch.write_bytes(data)
