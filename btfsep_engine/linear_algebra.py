# SPDX-License-Identifier: GPL-3.0-or-later
"""Large products, and factors, by SciPy's BLAS and LAPACK, whatever NumPy was built with.

The NumPy inside Blender is built from its source, with the reference BLAS or none: there ``@`` of matrices takes
seventy times as long. One that has an old OpenBLAS takes four times as long on a processor that this does not know.
SciPy's wheels bring their own.
"""

import numpy as np
from scipy import linalg
from scipy.linalg import LinAlgError, blas, lapack

OF_MATRICES = {np.dtype(np.float32): blas.sgemm, np.dtype(np.float64): blas.dgemm}
OF_A_VECTOR = {np.dtype(np.float32): blas.sgemv, np.dtype(np.float64): blas.dgemv}
OF_ITSELF = {np.dtype(np.float32): blas.ssyrk, np.dtype(np.float64): blas.dsyrk}


def product(a, b, out=None) -> np.ndarray:
    """``a @ b``, its rows one after the other in memory.

    Parameters
    ----------
    a, b : arrays (n, k) and (k, m), or a vector (k,) for one of them; of another precision than the other's one is
        turned into the higher one. Stacks of matrices are NumPy's matter
    out : (n, m) of that precision, its rows one after the other, to hold the product; of matrices only
    """
    kind = a.dtype
    if kind != b.dtype:
        kind = np.result_type(a, b)
        a, b = a.astype(kind, copy=False), b.astype(kind, copy=False)
    if kind not in OF_MATRICES or not a.size or not b.size or max(a.ndim, b.ndim) > 2:
        return np.matmul(a, b, out=out)
    if b.ndim == 1:
        own, turned = _by_columns(a)
        return OF_A_VECTOR[kind](1.0, own, b, trans=not turned)
    if a.ndim == 1:
        own, turned = _by_columns(b)
        return OF_A_VECTOR[kind](1.0, own, a, trans=turned)
    # BLAS has matrices column by column: to it, ours are b^T and a^T, and what is asked for is b^T a^T
    (left, turn_left), (right, turn_right) = _by_columns(b), _by_columns(a)
    how = {} if out is None else {"c": out.T, "overwrite_c": 1}
    return OF_MATRICES[kind](1.0, left, right, trans_a=turn_left, trans_b=turn_right, **how).T


def _by_columns(matrix) -> tuple[np.ndarray, bool]:
    """A matrix transposed, as BLAS takes it without a copy, and whether BLAS has to turn it for that."""
    return (matrix.T, False) if matrix.flags.c_contiguous else (matrix, True)


def lower_gram(a) -> np.ndarray:
    """The smaller one of ``a a^T`` and ``a^T a``, of ``a`` (n, k), column by column, in the lower triangle alone.

    Two thirds of the time of `product`, and the same digits.
    """
    if not a.size:
        return np.zeros((min(a.shape),) * 2, a.dtype, order="F")
    own, turned = _by_columns(a)  # a^T, to BLAS
    return OF_ITSELF[a.dtype](1.0, own, trans=(len(a) < a.shape[1]) != turned, lower=1)


def cholesky(matrix) -> np.ndarray:
    """The lower factor (n, n) of a symmetric positive definite matrix of double precision.

    Raises LinAlgError where it is none.
    """
    lower, failed = lapack.dpotrf(matrix, lower=1)
    if failed:
        raise LinAlgError("the matrix is not positive definite")
    return lower


def eigh(matrix) -> tuple[np.ndarray, np.ndarray]:
    """Eigenvalues (n,), rising, and eigenvectors (n, n), its columns, of a symmetric matrix of finite numbers."""
    return linalg.eigh(matrix, driver="evd", check_finite=False)
