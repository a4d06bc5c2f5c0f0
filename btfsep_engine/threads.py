# SPDX-License-Identifier: GPL-3.0-or-later
"""How many threads the linear algebra uses: one, so that their number changes no digit of what is found."""

from contextlib import contextmanager
from functools import lru_cache

from threadpoolctl import ThreadpoolController

_controller = lru_cache(maxsize=1)(ThreadpoolController)


@contextmanager
def one_thread():
    """A context, or a decorator ``@one_thread()``, in which a matrix product takes one thread.

    How many share a product decides in which order it is summed: basis images that differ in the last digit move a
    stated deviation by some thousandths, and what is decided by evidence near a tie. Products of a few hundred rows
    gain nothing from several, and lose much where others run; those of the transport are small beside its rays.
    """
    with _controller().limit(limits=1, user_api="blas"):
        yield
