# SPDX-License-Identifier: GPL-3.0-or-later
"""Libraries are loaded without a look for garbage: they leave none, and to look takes a quarter of their time."""

import gc
import sys
from contextlib import contextmanager


@contextmanager
def loading():
    """A context in which libraries are imported; what they bring is never looked through, at the very end either."""
    loaded = len(sys.modules)
    gc.disable()
    try:
        yield
    finally:
        if len(sys.modules) > loaded:  # else it would keep what a resident process has not let go of yet
            gc.freeze()
        gc.enable()
