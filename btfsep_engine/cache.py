# SPDX-License-Identifier: GPL-3.0-or-later
"""Where everything that can be made again is kept: one folder, one rule."""

import os
from pathlib import Path

from platformdirs import user_cache_dir

ENVIRONMENT = "BTFSEP_CACHE"  # names another folder


def cache_folder() -> Path:
    """$BTFSEP_CACHE, or the user's cache folder of this platform. It need not exist yet."""
    named = os.environ.get(ENVIRONMENT)
    return Path(named).expanduser() if named else Path(user_cache_dir("btfsep", appauthor=False))
