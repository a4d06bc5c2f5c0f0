# SPDX-License-Identifier: GPL-3.0-or-later
"""Linear algebra of matrices of some hundred rows."""

from functools import lru_cache

from threadpoolctl import ThreadpoolController


def one_thread():
    """A context in which a product takes one thread.

    Matrices of 300 rows gain nothing from several, and lose much where others run.
    """
    return _controller().limit(limits=1, user_api="blas")


@lru_cache(maxsize=1)
def _controller() -> ThreadpoolController:
    return ThreadpoolController()
