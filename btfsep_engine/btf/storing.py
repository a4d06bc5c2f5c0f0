# SPDX-License-Identifier: GPL-3.0-or-later
"""Putting a material into a library folder, and taking one out, so that a stop at any moment loses nothing."""

import contextlib
from itertools import count
from pathlib import Path

from btfsep_engine.btf.formats.writing import write
from btfsep_engine.btf.library import Entry, changing, entries_of, open_library
from btfsep_engine.btf.model import Tabulated
from btfsep_engine.errors import InputError
from btfsep_engine.storage import atomic


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
    atomic.sweep(folder)
    with changing(folder) as entries:
        old = entries.get(material.name)
        if old is not None and not overwrite:
            raise _taken(material.name)
        path = folder / _free_file(material.name, entries)
        write(path, material, height_mm=height_mm, setup=setup, layout=layout)
        entries[material.name] = entry = Entry(
            name=material.name,
            **{"class": material.material_class},
            file=path.name,
            texel_mm=material.texel_mm,
            texels=material.texels.shape[:2],
            components=material.texels.shape[2],
            sha256=atomic.digest(path),
            size=path.stat().st_size,
            relative_error=None if relative_error is None else round(float(relative_error), 4),
            source=source.encode(errors="replace").decode()[:300],  # names of files are not always text
            made_by=made_by,
        )
    if old is not None:
        with contextlib.suppress(OSError):
            (folder / old.file).unlink()
    return entry


def _free_file(name: str, entries: dict) -> str:
    """A file's name that no entry has: what readers of the old index find stays until the new one is there."""
    taken = {entry.file.lower() for entry in entries.values()}
    stem = name.replace("/", "_")
    return next(file for n in count() if (file := f"{stem}-{n}.btf" if n else f"{stem}.btf").lower() not in taken)


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
