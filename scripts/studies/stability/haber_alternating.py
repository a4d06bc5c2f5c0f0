# SPDX-License-Identifier: GPL-3.0-or-later
"""Reflectance and light in turns, after Haber et al. 2009, "Relighting objects from image collections" (CVPR).

What is theirs: reflectance is a combination of basis BRDFs with weights >= 0, light is a combination of Haar wavelets;
with one held fixed the other is linear least squares, and the two are solved in turns until it stalls.

What is simpler here: one photograph instead of a collection, so the weights are one set for the whole object (a single
view cannot tell them apart pixel by pixel); the wavelets are of one fine grid of cells of equal area instead of being
refined where they are needed, and finer ones cost more (a ridge instead of their refinement); light stays >= 0. The
scale and the colour that reflectance and light can hand to each other are settled by a light whose mean is grey.
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize, nnls
from threadpoolctl import threadpool_limits

from scripts.studies.stability.lobes import COLUMNS, ROWS

ALPHAS = (0.12, 0.25, 0.45)  # of the glossy basis BRDFs, beside a Lambertian one
RIDGE = 1e-3  # of the coarsest wavelets, relative to the system; every level costs four times as much
STEPS = 25  # downhill in a turn: it starts from the light of the turn before
TURNS = 150
STALLED = 3e-4  # of the residual, in a turn


@dataclass(frozen=True)
class Alternated:
    """light : (cells, 3); weights : (lobes, 3); residual : relative, after every turn."""

    light: np.ndarray
    weights: np.ndarray
    residual: list


def haar_levels() -> tuple[np.ndarray, np.ndarray]:
    """The orthonormal Haar basis of the grid of cells.

    Gives (cells, cells) float64, one wavelet a row, and (cells,) int its level: 0 is the mean, 1 the coarsest.
    """
    rows, row_level = _haar(ROWS)
    columns, column_level = _haar(COLUMNS)
    return np.kron(rows, columns), np.maximum(row_level[:, None], column_level[None, :]).ravel()


def _haar(n: int):
    basis = np.ones((1, 1))
    while len(basis) < n:
        basis = np.concatenate([np.kron(basis, [1, 1]), np.kron(np.eye(len(basis)), [1, -1])])
    return basis / np.linalg.norm(basis, axis=1, keepdims=True), np.ceil(np.log2(np.arange(n) + 1)).astype(int)


@threadpool_limits.wrap(limits=1, user_api="blas")  # small products: more threads wait for each other
def fit(matrices, radiance) -> Alternated:
    """Solves in turns.

    Parameters
    ----------
    matrices : list of (p, cells), one for each basis BRDF (`lobes.Seen`)
    radiance : (p, 3)
    """
    matrices = [np.asarray(m, np.float64) for m in matrices]
    b = np.asarray(radiance, np.float64)
    grams = [[None] * len(matrices) for _ in matrices]
    for j, first in enumerate(matrices):
        for k in range(j + 1):
            product = first.T @ matrices[k]
            grams[j][k] = product + product.T if k < j else product  # (j, k) and (k, j) at once
    basis, level = haar_levels()
    cost = basis.T @ (np.where(level, 4.0 ** (level - 1), 0.0)[:, None] * basis)
    light = np.ones((ROWS * COLUMNS, 3))
    norm, history = np.linalg.norm(b), []
    weights = _reflectance(matrices, b, light)
    for _ in range(TURNS):
        light = np.stack([_light(matrices, grams, b[:, c], weights[:, c], cost, light[:, c]) for c in range(3)], 1)
        mean = light.mean(0)
        light = light / np.maximum(mean, 1e-12)
        weights = _reflectance(matrices, b, light)
        shading = np.stack([m @ light for m in matrices])
        history.append(float(np.linalg.norm(np.einsum("jpc,jc->pc", shading, weights) - b) / norm))
        if len(history) > 1 and history[-2] - history[-1] < STALLED * history[-2]:
            break
    return Alternated(light, weights, history)


def _reflectance(matrices, b, light) -> np.ndarray:
    """Weights (lobes, 3) >= 0 under a known light."""
    return np.stack([nnls(np.stack([m @ light[:, c] for m in matrices], 1), b[:, c])[0] for c in range(3)], 1)


def _light(matrices, grams, b, weights, cost, start) -> np.ndarray:
    """One channel of the light >= 0 (cells,) for known weights."""
    gram = sum(weights[j] * weights[k] * grams[j][k] for j in range(len(matrices)) for k in range(j + 1))
    gram = gram + RIDGE * np.trace(gram) / len(gram) * cost
    target = sum(w * (m.T @ b) for w, m in zip(weights, matrices, strict=True))
    scale = max(float(np.trace(gram)), 1e-300)

    def energy(x):
        product = gram @ x
        return (0.5 * x @ product - target @ x) / scale, (product - target) / scale

    options = {"maxiter": STEPS, "ftol": 1e-13, "gtol": 1e-12, "maxcor": 20}
    return minimize(energy, start, jac=True, method="L-BFGS-B", bounds=[(0, None)] * len(start), options=options).x
