# SPDX-License-Identifier: GPL-3.0-or-later
"""The files of an image sequence and the frames that they stand for. No bpy in this file."""

import glob
import itertools
import re
from pathlib import Path

from ..basics.errors import InputError

SUFFIXES = (".exr", ".hdr", ".png", ".jpg", ".jpeg", ".tif", ".tiff", ".webp")
"""What the engine reads; other files that a pattern matches are passed over, as the engine does."""
_DIGITS = re.compile(r"([0-9]+)")
_NUMBERED = re.compile(r"(.*?)([0-9]+)([^0-9]*)", re.DOTALL)


def split(name: str) -> tuple[str, int, str] | None:
    """Text, number and text of a file's name, as Blender finds the frame: the last digits before the suffix."""
    path = Path(name)
    found = _NUMBERED.fullmatch(path.stem)
    return None if found is None else (found[1], int(found[2]), found[3] + path.suffix)


def family(path) -> list[Path]:
    """The files of the sequence that ``path`` is one of, in the order of their numbers.

    Raises InputError when its name has no number, or it is not there.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"the sequence {path.name}", "there is no such file", "choose the photos again")
    own = split(path.name)
    if own is None:
        raise InputError(f"the sequence {path.name}", "its name has no number", "number the files, as photo_0001.exr")
    found = {}
    for other in sorted(path.parent.iterdir()):
        parts = split(other.name)
        if parts is not None and (parts[0], parts[2]) == (own[0], own[2]) and other.is_file():
            if parts[1] in found:
                raise InputError(f"the sequence {path.name}", f"two files have number {parts[1]}", "remove one of them")
            found[parts[1]] = other
    return [found[number] for number in sorted(found)]


def matching(pattern, option: str = "--images") -> list[Path]:
    """The files of a pattern like ``frames/*.exr``, or of a folder, in the engine's order: by their names and numbers.

    ``option`` : by which it was given.
    Raises InputError when there are none.
    """
    path = Path(pattern)
    folder, name = (path, "*") if path.is_dir() else (path.parent, path.name)
    found = [p for p in folder.glob(name) if p.is_file() and p.suffix.lower() in SUFFIXES] if folder.is_dir() else []
    if not found:
        raise InputError(f"{option} '{pattern}'", "no image matches", "give a pattern in quotes, like 'frames/*.exr'")
    return sorted(found, key=lambda p: [int(x) if i % 2 else x for i, x in enumerate(_DIGITS.split(p.name))])


def pattern_of(files) -> str:
    """A pattern for the engine that matches the files of a `family`, and as little else as a pattern can."""
    before, _, after = split(files[0].name)
    lengths = {len(p.name) for p in files}
    digits = "[0-9]" * (len(files[0].name) - len(before) - len(after)) if len(lengths) == 1 else "[0-9]*"
    return str(files[0].parent / (glob.escape(before) + digits + glob.escape(after)))


def numbers(names, *, start: int | None = None) -> list[int]:
    """The frames of files: the numbers in their names, else counted from 1.

    Parameters
    ----------
    names : list of str, in order
    start : if given, the frame of the first file; the others keep their distance
    """
    parts = [split(name) for name in names]
    found = [p[1] for p in parts if p is not None]
    if len(found) < len(names) or any(a >= b for a, b in itertools.pairwise(found)):
        found = list(range(1, len(names) + 1))
    shift = 0 if start is None else start - found[0]
    return [number + shift for number in found]
