# SPDX-License-Identifier: GPL-3.0-or-later
"""Parts of a long run, kept until it is over, so that a run that was stopped goes on where it was.

A folder of the cache is named by a digest of everything that the run depends on; each entry in it is a part. Parts
follow each other; what is damaged, and all that comes after it, is made again.
"""

import shutil
import time
from pathlib import Path

from btfsep_engine.errors import InputError
from btfsep_engine.progress import Reporter
from btfsep_engine.storage import cache

EVERY = 8  # calls of :meth:`Checkpoints.due` from one part to the next
FORGOTTEN = 30 * 86400.0  # seconds after which the parts of a run that never ended are removed


class Checkpoints:
    """The kept parts of one run.

    Parameters
    ----------
    kind : of run, a folder's name
    key : digest of all that the run depends on
    every : steps from one part to the next
    reporter : told when nothing can be kept; the run goes on
    """

    def __init__(self, kind: str, key: str, *, every: int = EVERY, reporter: Reporter | None = None):
        self.folder = cache.cache_folder() / kind / key
        self.every, self.reporter = every, reporter or Reporter()
        self._count = self._steps = 0
        self._can_write = True
        _forget(self.folder.parent)

    def load(self):
        """Yields the parts that are whole, in order: dicts of arrays."""
        while (part := cache.read(self._path(self._count))) is not None:
            self._count += 1
            yield part

    def due(self, *, last: bool = False) -> bool:
        """Called once a step: whether what was done since the last part is to be saved now (not after the last)."""
        self._steps += 1
        return self._can_write and not last and self._steps % self.every == 0

    def save(self, part: dict) -> None:
        """Keeps the next part; where that cannot be done it is said once, and the run goes on."""
        try:
            cache.write(self._path(self._count), part)
        except InputError as error:
            self._can_write = False
            self.reporter.warn(f"{error}; if this run is stopped, it will have to start anew")
            return
        self._count += 1

    def remove(self) -> None:
        """The run is over: nothing of it is needed."""
        shutil.rmtree(self.folder, ignore_errors=True)

    def _path(self, number: int) -> Path:
        return self.folder / f"{number:04d}.part"


def _forget(parent: Path) -> None:
    """Removes what runs left behind that were never taken up again."""
    try:
        old = [f for f in parent.iterdir() if f.is_dir() and time.time() - f.stat().st_mtime > FORGOTTEN]
    except OSError:
        return
    for folder in old:
        shutil.rmtree(folder, ignore_errors=True)
