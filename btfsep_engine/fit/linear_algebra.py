# SPDX-License-Identifier: GPL-3.0-or-later
"""Linear algebra of matrices of some hundred rows."""

from functools import lru_cache

import numpy as np
from scipy.linalg import lapack
from threadpoolctl import ThreadpoolController

SMALL = 40  # rows: from here on down LAPACK inverts as fast as halves


def one_thread():
    """A context in which a product takes one thread.

    Matrices of 300 rows gain nothing from several, and lose much where others run.
    """
    return _controller().limit(limits=1, user_api="blas")


@lru_cache(maxsize=1)
def _controller() -> ThreadpoolController:
    return ThreadpoolController()


def triangular_inverse(lower) -> np.ndarray:
    """The inverse of a lower triangular matrix (n, n), by halves:

        ((A, 0), (B, C))^-1 = ((A^-1, 0), (-C^-1 B A^-1, C^-1)),

    almost all of it products of full matrices, which LAPACK's dtrtri does not make.
    """
    out = np.zeros(lower.shape)
    _invert(np.asarray(lower), out)
    return out


def _invert(lower, out):
    n, half = len(lower), len(lower) // 2
    if n <= SMALL:
        out[:] = lapack.dtrtri(lower, lower=1)[0]
        return
    _invert(lower[:half, :half], out[:half, :half])
    _invert(lower[half:, half:], out[half:, half:])
    out[half:, :half] = -out[half:, half:] @ (lower[half:, :half] @ out[:half, :half])
