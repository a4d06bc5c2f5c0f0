# SPDX-License-Identifier: GPL-3.0-or-later
"""How many threads the linear algebra uses: one, so that their number changes no digit of what is found."""

import importlib
from contextlib import contextmanager
from functools import lru_cache

from threadpoolctl import ThreadpoolController


@lru_cache(maxsize=1)
def _controller() -> ThreadpoolController:
    """Of all libraries that are loaded, that of large products (`linear_algebra`) among them."""
    importlib.import_module("scipy.linalg")
    return ThreadpoolController()


def at_most(count: int) -> None:
    """From now on a matrix product takes at most ``count`` threads."""
    _controller().limit(limits=count)


@contextmanager
def one_thread():
    """A context, or a decorator ``@one_thread()``, in which a matrix product takes one thread.

    How many share a product decides in which order it is summed: basis images that differ in the last digit move a
    stated deviation by some thousandths, and what is decided by evidence near a tie. Products of a few hundred rows
    gain nothing from several, and lose much where others run; those of the transport are small beside its rays.
    """
    with _controller().limit(limits=1, user_api="blas"):
        yield
