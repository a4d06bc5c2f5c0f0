# SPDX-License-Identifier: GPL-3.0-or-later
"""How long a run takes on this machine, learnt from the last one of its kind: a bar that is true, and seconds to tell.

The engine says which share of a run is over by a rough guide that is the same for all machines. What is kept of a run
is when it said so. No run of its kind yet: the engine's guide as it is, and no seconds.
"""

import itertools
import json
import time
from functools import lru_cache
from pathlib import Path

import bpy

from ..basics import atomic
from ..basics.errors import InputError

FILE = "durations.json"
MOST = 200  # points of a curve


def _file() -> Path:
    """In the extension's own folder, which goes when it is uninstalled; else where Blender cleans up when it quits."""
    try:
        folder = bpy.utils.extension_path_user(__package__.rpartition(".")[0], create=True)
    except (ValueError, OSError, AttributeError):  # not installed as an extension, or a home that cannot be written
        folder = bpy.app.tempdir
    return Path(folder) / FILE


def _all() -> dict:
    try:
        about = _file().stat()
    except OSError:
        return {}
    return _read(_file(), about.st_mtime_ns, about.st_size)


@lru_cache(maxsize=1)
def _read(path: Path, *_as_it_is) -> dict:
    """What is in the file; it is read once, though a panel asks with every drawing."""
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return found if isinstance(found, dict) else {}


def curve_of(kind: str) -> list:
    """[share by the engine's guide, seconds] of the last run of ``kind``, both rising; empty where there was none."""
    curve = _all().get(kind)
    try:
        points = [(min(max(float(whole), 0.0), 1.0), float(seconds)) for whole, seconds in curve]
    except (TypeError, ValueError):
        return []
    rising = all(a[0] <= b[0] and a[1] <= b[1] for a, b in itertools.pairwise(points))
    return points if points and rising and points[-1][1] > 0 else []


def expected(kind: str) -> float | None:
    """Seconds of the last run of ``kind``; None where there was none."""
    curve = curve_of(kind)
    return curve[-1][1] if curve else None


def in_words(kind: str) -> str:
    """ "About 24 s, as the last one", or nothing."""
    seconds = expected(kind)
    return "" if seconds is None else f"About {rounded(seconds)}, as the last one"


def rounded(seconds: float) -> str:
    """Seconds for people: "4 s", "50 s", "3 min"."""
    return f"{max(round(seconds), 1)} s" if seconds < 90 else f"{round(seconds / 60)} min"


class Clock:
    """One run: told how far the engine says it is, it says how far that is in time."""

    def __init__(self, kind: str, now=time.monotonic):
        self.kind, self._now, self._start = kind, now, now()
        self._before = curve_of(kind)
        self._heard = [(0.0, 0.0)]
        self._shown = 0.0

    def heard(self, whole: float) -> None:
        """The engine says that ``whole`` (0 to 1) is over."""
        if whole > self._heard[-1][0] and len(self._heard) < MOST:
            self._heard.append((whole, self._now() - self._start))

    def fraction(self) -> float:
        """Share of the time that is over, 0 to 1; it never falls, and grows while the engine is at one thing."""
        whole, since = self._heard[-1]
        share = whole
        if self._before:
            total = self._before[-1][1]
            at = max((seconds for w, seconds in self._before if w <= whole), default=0.0)
            until = min((seconds for w, seconds in self._before if w > whole), default=total)
            share = min(at + (self._now() - self._start - since), until) / total
        self._shown = max(self._shown, min(share, 1.0))
        return self._shown

    def left(self) -> float | None:
        """Seconds that are left, by the last run; None where there was none."""
        return (1 - self.fraction()) * self._before[-1][1] if self._before else None

    def keep(self) -> None:
        """Remembers this run, which went well."""
        curve = [*self._heard, (1.0, self._now() - self._start)]
        try:
            atomic.write_bytes(_file(), json.dumps(_all() | {self.kind: curve}).encode())
        except InputError:
            pass  # a bar that is less true the next time
