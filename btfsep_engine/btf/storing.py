# SPDX-License-Identifier: GPL-3.0-or-later
"""Putting a material into a library folder, and taking one out, so that a stop at any moment loses nothing."""

import contextlib
import os
import tempfile
from pathlib import Path

from btfsep_engine import atomic
from btfsep_engine.btf.formats.writing import write
from btfsep_engine.btf.library import Entry, changing, entries_of, file_sha256, open_library
from btfsep_engine.btf.model import Tabulated
from btfsep_engine.errors import InputError


def add(
    folder,
    material: Tabulated,
    *,
    height_mm=None,
    setup: str = "",
    layout: str = "fmf",
    source: str = "",
    relative_error: float | None = None,
    made_by: str = "",
    overwrite: bool = False,
) -> Entry:
    """Adds a material to a library folder (made if it is not there): file first, then index, under a lock.

    Parameters
    ----------
    material : Tabulated; its name is "class/name"
    height_mm, setup, layout : as in :func:`write`
    source, relative_error, made_by : for the index
    overwrite : whether a material of this name is replaced

    Raises InputError: a name that is taken; values that a file cannot hold; a folder that cannot be written.
    """
    folder = Path(folder)
    name_is_free(folder, material.name, overwrite)  # before the work; again under the lock
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for pattern in (".adding-*.btf", ".writing-*"):
            atomic.sweep(folder, pattern)
        handle, scratch = tempfile.mkstemp(prefix=".adding-", suffix=".btf", dir=folder)
        os.close(handle)
    except OSError as error:
        raise InputError(f"cannot write to {folder}", error, "choose a folder that can be written") from error
    scratch = Path(scratch)
    try:
        try:
            write(scratch, material, height_mm=height_mm, setup=setup, layout=layout)
        except InputError as error:  # the scratch file's name tells nobody anything
            what = f"cannot write to {folder}" if scratch.name in error.what else error.what
            raise InputError(what, error.got, error.do) from error
        digest, size = file_sha256(scratch), scratch.stat().st_size
        with changing(folder) as entries:
            old = entries.get(material.name)
            if old is not None and not overwrite:
                raise _taken(material.name)
            file = material.name.replace("/", "_") + ".btf"
            if file.lower() in {e.file.lower() for e in entries.values()}:  # readers of the old index still find it
                file = material.name.replace("/", "_") + f"-{digest[:8]}.btf"
            entries[material.name] = entry = Entry(
                name=material.name,
                **{"class": material.material_class},
                file=file,
                texel_mm=material.texel_mm,
                texels=material.texels.shape[:2],
                components=material.texels.shape[2],
                sha256=digest,
                size=size,
                relative_error=None if relative_error is None else round(float(relative_error), 4),
                source=source.encode(errors="replace").decode()[:300],  # names of files are not always text
                made_by=made_by,
            )
            os.replace(scratch, folder / file)
        if old is not None and old.file != file:
            with contextlib.suppress(OSError):
                (folder / old.file).unlink()
    finally:
        with contextlib.suppress(OSError):
            scratch.unlink()
    return entry


def remove(folder, name: str) -> None:
    """Takes a material out of a library folder: index first, then file.

    Raises InputError: no such material in the folder; a folder that cannot be written.
    """
    folder = Path(folder)
    _entry(open_library(folder).entries, name, folder)  # before the lock, which makes the folder
    with changing(folder) as entries:
        entry = _entry(entries, name, folder)
        del entries[name]
    with contextlib.suppress(OSError):
        (folder / entry.file).unlink()


def _entry(entries: dict, name: str, folder: Path) -> Entry:
    if name in entries:
        return entries[name]
    if not entries:
        raise InputError(f"material '{name}'", f"it is not in {folder}, which is empty", "give another library")
    some = ", ".join(list(entries)[:5])
    raise InputError(f"material '{name}'", f"it is not in {folder}", f"give one of its names ({some} …)")


def name_is_free(folder: Path, name: str, overwrite: bool) -> None:
    """Raises InputError where a library folder has a material of this name and may not lose it."""
    if not overwrite and name in entries_of(folder):
        raise _taken(name)


def _taken(name: str) -> InputError:
    return InputError(f"material '{name}'", "the library has one of this name", "use another name, or --replace")
