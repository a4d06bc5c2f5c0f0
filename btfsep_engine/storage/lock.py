# SPDX-License-Identifier: GPL-3.0-or-later
"""One writer of a folder at a time, whatever the process. The lock goes with its process, however that ends."""

import errno
import os
import time
from contextlib import contextmanager
from pathlib import Path

from btfsep_engine.errors import InputError

FILE = ".lock"
PATIENCE = 60.0  # seconds
HELD = (errno.EAGAIN, errno.EWOULDBLOCK, errno.EACCES, errno.EDEADLK, errno.EINTR)  # what a lock of another's gives
if os.name == "nt":
    import msvcrt

    def _take(handle) -> None:
        msvcrt.locking(handle.fileno(), msvcrt.LK_NBLCK, 1)

    def _release(handle) -> None:
        msvcrt.locking(handle.fileno(), msvcrt.LK_UNLCK, 1)

else:
    import fcntl

    def _take(handle) -> None:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)

    def _release(handle) -> None:
        fcntl.flock(handle, fcntl.LOCK_UN)


@contextmanager
def locked(folder, patience: float = PATIENCE, *, name: str = "library"):
    """Holds the lock of ``folder`` (made if it is not there) during the block; ``name``: what an error calls it.

    Raises InputError: the folder cannot be written, or another process holds the lock for longer than ``patience``
    seconds.
    """
    folder = Path(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        handle = (folder / FILE).open("a+b")
    except OSError as error:
        raise InputError(f"cannot write to {folder}", error, "choose a folder that can be written") from error
    with handle:
        end = time.monotonic() + patience
        while True:
            try:
                handle.seek(0)
                _take(handle)
                break
            except OSError as error:
                if error.errno not in HELD:
                    raise InputError(
                        f"{name} {folder}", f"its {FILE} cannot be locked: {error.strerror}", "use another disk"
                    ) from error
                if time.monotonic() >= end:
                    raise InputError(
                        f"{name} {folder}", "another program has been writing to it for long", "try again later"
                    ) from error
                time.sleep(0.05)
        try:
            yield
        finally:
            handle.seek(0)
            _release(handle)
