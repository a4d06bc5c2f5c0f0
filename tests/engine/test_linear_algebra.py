# SPDX-License-Identifier: GPL-3.0-or-later
"""Products and factors by SciPy against NumPy's."""

import subprocess
import sys
from itertools import product as pairs

import numpy as np
import pytest

from btfsep_engine.linear_algebra import cholesky, lower_gram, product

LAYOUTS = {
    "rows": np.ascontiguousarray,
    "columns": np.asfortranarray,
    "a part": lambda m: np.pad(m, [(1, 2)] * m.ndim)[(slice(1, -2),) * m.ndim],
    "backwards": lambda m: np.ascontiguousarray(m[::-1])[::-1],
}
SHAPES = (((5, 7), (7, 3)), ((5, 7), (7,)), ((7,), (7, 3)), ((1, 7), (7, 1)), ((5, 1), (1, 3)))


@pytest.mark.parametrize("kinds", list(pairs((np.float32, np.float64), repeat=2)))
@pytest.mark.parametrize("shapes", SHAPES)
def test_a_product_is_numpys(rng, kinds, shapes):
    for layouts in pairs(LAYOUTS, repeat=2):
        a, b = (
            LAYOUTS[layout](rng.standard_normal(shape).astype(kind))
            for kind, layout, shape in zip(kinds, layouts, shapes, strict=True)
        )
        found, expected = product(a, b), a @ b
        assert found.shape == expected.shape and found.dtype == expected.dtype, layouts
        assert np.allclose(found, expected, rtol=1e-5, atol=1e-5), layouts
        assert found.ndim == 1 or found.flags.c_contiguous, layouts


@pytest.mark.parametrize("kind", (np.float32, np.float64))
@pytest.mark.parametrize("shape", ((5, 7), (7, 5), (6, 6), (1, 3)))
def test_a_gram_matrix_is_the_smaller_products_lower_triangle(rng, kind, shape):
    for layout in LAYOUTS.values():
        a = layout(rng.standard_normal(shape).astype(kind))
        found, expected = lower_gram(a), a @ a.T if len(a) < a.shape[1] else a.T @ a
        assert found.dtype == kind and found.flags.f_contiguous
        assert np.allclose(np.tril(found), np.tril(expected), rtol=1e-5, atol=1e-5)
    assert lower_gram(np.zeros((0, 3), kind)).shape == (0, 0)


def test_what_has_no_numbers_or_is_whole_or_a_stack_is_multiplied_too(rng):
    assert product(np.zeros((3, 0)), np.zeros((0, 2))).tolist() == [[0, 0]] * 3
    assert product(np.zeros((0, 3)), np.zeros((3, 2))).shape == (0, 2)
    a, stack = rng.standard_normal((4, 5)), rng.standard_normal((3, 5, 2))
    assert np.array_equal(product(a, stack), a @ stack)
    assert product(np.eye(2, dtype=int), np.array([[1, 2], [3, 4]])).tolist() == [[1, 2], [3, 4]]


def test_a_product_is_put_where_it_is_wanted(rng):
    a, b = rng.standard_normal((40, 9)).astype(np.float32), rng.standard_normal((9, 6)).astype(np.float32)
    out = np.full((2, 50, 6), np.nan, np.float32)
    product(a, b, out=out[1, 5:45])
    assert np.allclose(out[1, 5:45], a @ b, atol=1e-5)
    assert np.isnan(out[0]).all() and np.isnan(out[1, :5]).all() and np.isnan(out[1, 45:]).all()


def test_a_factor_is_numpys_and_what_has_none_is_said(rng):
    half = rng.standard_normal((30, 40))
    assert np.allclose(cholesky(half @ half.T), np.linalg.cholesky(half @ half.T))
    with pytest.raises(np.linalg.LinAlgError):
        cholesky(-np.eye(3))


@pytest.mark.skipif(sys.platform == "darwin", reason="SciPy's BLAS is the system's there")
def test_scipys_threads_are_limited_too_wherever_it_is_loaded(all_cores):
    """In a process that had not loaded it; a farm's slot has one core."""
    asked = """if True:
        from btfsep_engine import threads
        threads.at_most(1)
        from threadpoolctl import threadpool_info
        libraries = [i for i in threadpool_info() if i["user_api"] == "blas"]
        assert any("scipy" in i["filepath"] for i in libraries), libraries
        assert all(i["num_threads"] == 1 for i in libraries), libraries
    """
    subprocess.run([sys.executable, "-c", asked], check=True)
