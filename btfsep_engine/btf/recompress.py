# SPDX-License-Identifier: GPL-3.0-or-later
"""Factors in the linear domain for data that can be decoded anywhere, but whose own factors are logarithms.

M (texels x columns; a column is a pair of directions and a colour) is never held. It is decoded in three sweeps:

1. a sample of texels, all columns: a random sketch of the sampled rows (Halko, Martinsson, Tropp 2011);
2. the same again: the leading angular patterns A, from the rows' projection onto the sketch;
3. all texels, a sample of columns: the texels' coordinates in A, least squares.

The sweeps go through the directions view by view, and through the texels block by block; memory is bounded by BUDGET
whatever the file. Columns count relative to their mean, as in :mod:`btfsep_engine.btf.factorise`: otherwise the few
columns with a highlight would be all that the patterns explain.
"""

from dataclasses import dataclass

import numpy as np

from btfsep_engine.linear_algebra import product
from btfsep_engine.progress import Reporter

SAMPLED_TEXELS = 2048
SAMPLED_PAIRS = 768  # at least; 12 for each component
PROBES = 256  # texels and pairs by which the error is measured; they are not those of the fit
FLOOR = 0.5  # of the mean of all columns: below this a column's mean is not made 1
BUDGET = 4 << 20  # decoded values at once (16 MB of float32)
OVERSAMPLING = 12
STAGE = "decode"


@dataclass(frozen=True)
class LinearFactors:
    """M ~ spatial @ angular.T

    Attributes
    ----------
    spatial : (texels, k) float32, each column of mean square 1, sorted by weight
    angular : (pairs, 3, k) float32
    relative_error : Frobenius, each column divided by its mean (plus a little), on texels and pairs not fitted
    """

    spatial: np.ndarray
    angular: np.ndarray
    relative_error: float


def recompress(decode, texels: int, pairs: int, *, components: int, reporter: Reporter | None = None) -> LinearFactors:
    """Factorises what ``decode`` gives.

    Parameters
    ----------
    decode : function of (texel indices, pair indices) -> (texels, pairs, 3) float32
    texels, pairs : how many there are
    components : k at most
    reporter : told the progress as stage "decode"
    """
    reporter, rng = reporter or Reporter(), np.random.default_rng([0, 0xB7F])
    chosen = _stratified(texels, SAMPLED_TEXELS, rng)
    step = max(1, BUDGET // (3 * len(chosen)))
    sweeps = [np.arange(start, min(start + step, pairs)) for start in range(0, pairs, step)]
    total, done = 2 * len(chosen) * pairs + texels * min(pairs, max(SAMPLED_PAIRS, 12 * components)), 0

    def tell(amount):
        nonlocal done
        done += amount
        reporter.progress(STAGE, min(done / total, 1.0))

    # sweep 1: the columns' scale and the sketch of the sampled rows
    rank = min(2 * components + OVERSAMPLING, len(chosen), 3 * pairs)
    first = np.abs(decode(chosen, _stratified(pairs, max(1, BUDGET // (3 * len(chosen))), rng)).mean(0))
    floor = FLOOR * max(float(first.mean()), 1e-6)
    scale, sketch = np.empty((pairs, 3), np.float32), np.zeros((len(chosen), rank))
    for part in sweeps:
        block = decode(chosen, part)
        scale[part] = 1 / (np.abs(block.mean(0)) + floor)
        block = (block * scale[part]).reshape(len(chosen), -1)
        sketch += product(block, rng.standard_normal((block.shape[1], rank)).astype(np.float32))
        tell(block.size // 3)
    basis = np.linalg.qr(sketch)[0].astype(np.float32)

    # sweep 2: M ~ basis @ projected.T on the sampled rows
    projected, gram = np.empty((pairs, 3, rank), np.float32), np.zeros((rank, rank))
    for part in sweeps:
        block = decode(chosen, part) * scale[part]
        projected[part] = np.einsum("tnc,tr->ncr", block, basis, optimize=True)
        flat = projected[part].reshape(-1, rank).astype(np.float64)
        gram += product(flat.T, flat)
        tell(block.size // 3)
    values, vectors = np.linalg.eigh(gram)
    k = max(1, min(components, int((values > values.max() * 1e-12).sum())))
    leading = vectors[:, ::-1][:, :k].astype(np.float32)
    angular = np.empty((pairs, 3, k), np.float32)
    for part in sweeps:
        angular[part] = projected[part] @ leading
    del projected

    # sweep 3: every texel's coordinates, by the sampled columns
    some = _stratified(pairs, max(SAMPLED_PAIRS, 12 * components), rng)
    solve = np.linalg.pinv(angular[some].reshape(-1, k).astype(np.float64), rcond=1e-6).astype(np.float32)
    spatial = np.empty((texels, k), np.float32)
    rows = max(1, BUDGET // (3 * len(some)))
    for start in range(0, texels, rows):
        part = slice(start, min(start + rows, texels))
        block = (decode(part, some) * scale[some]).reshape(-1, 3 * len(some))
        spatial[part] = product(block, solve.T)
        tell(len(block) * len(some))
    size = np.maximum(np.sqrt(np.einsum("tk,tk->k", spatial, spatial, dtype=np.float64) / texels), 1e-30)
    spatial /= size.astype(np.float32)
    angular *= size.astype(np.float32)
    error = _error(decode, texels, pairs, spatial, angular, scale, rng)
    angular /= scale[..., None]
    return LinearFactors(spatial, angular, error)


def _error(decode, texels, pairs, spatial, angular, scale, rng) -> float:
    """Relative error on probes; ``angular`` still multiplied by ``scale``."""
    t, p = (np.sort(rng.choice(n, min(n, PROBES), replace=False)) for n in (texels, pairs))
    truth = decode(t, p) * scale[p]
    found = np.einsum("tk,nck->tnc", spatial[t], angular[p], optimize=True)
    return float(np.linalg.norm(truth - found) / max(np.linalg.norm(truth), 1e-30))


def _stratified(count: int, wanted: int, rng) -> np.ndarray:
    """``wanted`` of ``count`` indices, ascending, one at random from each of equal strata; all if there are fewer."""
    if count <= wanted:
        return np.arange(count)
    edges = np.linspace(0, count, wanted + 1).astype(np.int64)
    return edges[:-1] + (rng.random(wanted) * np.diff(edges)).astype(np.int64)
