# SPDX-License-Identifier: GPL-3.0-or-later
"""Which material a VLAD vector shows: an RBF-SVM with grid search, or the nearest training vector.

Both answer with one number per class in [-1, 1] for every vector. The numbers of an object's windows and of the
whole object are averaged, and a softmax turns the mean into scores; its sharpness is fitted on lights that were
held out. All squared distances between training vectors are computed once (one matrix product), so that a
whole grid search works on small matrices.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations

import numpy as np
from scipy.linalg.blas import ssyrk
from scipy.optimize import minimize_scalar
from scipy.special import softmax

from btfsep_engine.linear_algebra import product

C_GRID = (1.0, 10.0, 100.0)
GAMMA_GRID = (0.25, 0.5, 1.0, 2.0, 4.0)  # in units of 1 / median squared distance
GRID = tuple((c, gamma) for gamma in GAMMA_GRID for c in C_GRID)
FOLDS = 3
KNOWN_SHARE = 0.99  # of known materials under new lights that are to be judged known
SVM_CACHE_MB = 500


def squared_distances(a, b) -> np.ndarray:
    """(n, m) float32, squared L2 distances between the rows of a : (n, d) and b : (m, d), never below 0."""
    a, b = np.asarray(a, np.float32), np.asarray(b, np.float32)
    return np.maximum((a * a).sum(1)[:, None] + (b * b).sum(1) - 2 * product(a, b.T), 0)


def mutual_distances(vectors) -> np.ndarray:
    """(n, n) float32, squared L2 distances between the rows of (n, d): half the products of `squared_distances`."""
    products = ssyrk(1.0, np.asarray(vectors, np.float32).T, trans=1, lower=1)  # the lower triangle; 0 above
    products += np.tril(products, -1).T
    size = products.diagonal().copy()
    products *= -2
    products += size
    products += size[:, None]
    return np.maximum(products, 0, out=products)


def grouped_folds(groups, folds=FOLDS, *, seed=0) -> np.ndarray:
    """The fold of each sample, such that all samples of a group (a light) share one fold.

    Parameters
    ----------
    groups : (n,) of any hashable, the light of each sample

    Returns
    -------
    (n,) int in [0, min(folds, number of groups))
    """
    names, number = np.unique(np.asarray(groups), return_inverse=True)
    order = np.random.default_rng(seed).permutation(len(names))
    return (order % min(folds, len(names)))[number]


@dataclass(frozen=True)
class Svm:
    """A trained one-against-one RBF-SVM as plain arrays.

    Attributes
    ----------
    classes : names, in order
    vectors : (m, d) float16, all training vectors, or the support vectors alone
    weights : (m, pairs) float32; decision of pair (i, j), i < j: positive says i
    bias : (pairs,) float32; 0 where cross-validation did better without
    gamma, c : kernel and regularisation parameters
    sharpness : of the softmax over pooled votes
    held_out_accuracy : share of single vectors (windows) right on lights that were held out
    known_vote : the open-set limit: the winning vote, pooled over an object, that 99 % of the held-out training
        images reach; an object whose winner has less is judged unknown. -1 (never) where no light could be held out
    """

    classes: tuple[str, ...]
    vectors: np.ndarray
    weights: np.ndarray
    bias: np.ndarray
    gamma: float
    c: float
    sharpness: float = 10.0
    held_out_accuracy: float = float("nan")
    known_vote: float = -1.0
    kind = "svm"

    @cached_property
    def _support(self) -> tuple:
        """The support vectors as they are multiplied, half floats widened once, their squared lengths and weights."""
        used = np.abs(self.weights).sum(1) > 0
        vectors = self.vectors[used].astype(np.float32)
        return vectors, np.square(vectors).sum(1), self.weights[used]

    def votes(self, vectors) -> np.ndarray:
        """(n, classes) in [-1, 1] for ``vectors : (n, d)``."""
        support, squares, weights = self._support
        vectors = np.asarray(vectors, np.float32)
        squared = np.square(vectors).sum(1)[:, None] + squares - 2 * product(vectors, support.T)
        return pair_votes(product(np.exp(-self.gamma * np.maximum(squared, 0)), weights) + self.bias, len(self.classes))

    def without(self, name: str) -> "Svm":
        """The same with a class left out: its pairs' decisions are not asked for."""
        out = self.classes.index(name)
        kept = [out not in pair for pair in combinations(range(len(self.classes)), 2)]
        classes = tuple(c for c in self.classes if c != name)
        return replace(self, classes=classes, weights=self.weights[:, kept], bias=self.bias[kept])


@dataclass(frozen=True)
class Nearest:
    """Nearest neighbour by L2 distance: the classes, all training vectors (m, d) float16 and their labels (m,).

    The other attributes are as of :class:`Svm`.
    """

    classes: tuple[str, ...]
    vectors: np.ndarray
    labels: np.ndarray
    sharpness: float = 10.0
    held_out_accuracy: float = float("nan")
    known_vote: float = -1.0
    kind = "nearest"

    def votes(self, vectors) -> np.ndarray:
        """(n, classes) in [-1, 1] for ``vectors : (n, d)``: 1 minus the squared distance to the class's nearest."""
        return nearest_votes(squared_distances(vectors, self.vectors), self.labels, len(self.classes))

    def without(self, name: str) -> "Nearest":
        """The same with a class left out."""
        out = self.classes.index(name)
        kept, classes = self.labels != out, tuple(c for c in self.classes if c != name)
        labels = self.labels[kept] - (self.labels[kept] > out)
        return replace(self, classes=classes, vectors=self.vectors[kept], labels=labels)


def pair_votes(decisions, class_count: int) -> np.ndarray:
    """From decisions of pairs (n, pairs) to votes (n, classes): the mean, over the rivals, of the clipped decision."""
    votes = np.zeros((len(decisions), class_count))
    for column, (i, j) in enumerate(combinations(range(class_count), 2)):
        clipped = np.clip(decisions[:, column], -1, 1)
        votes[:, i] += clipped
        votes[:, j] -= clipped
    return votes / max(class_count - 1, 1)


def nearest_votes(squared, labels, class_count: int) -> np.ndarray:
    """Votes of the nearest neighbour; unit vectors lie at most 2 apart, so 1 - d^2 / 2 lies in [-1, 1]."""
    votes = np.full((len(squared), class_count), -1.0)
    for c in range(class_count):
        if (own := labels == c).any():
            votes[:, c] = 1 - squared[:, own].min(1) / 2
    return votes


def scores(votes, sharpness: float) -> np.ndarray:
    """Softmax of ``sharpness * votes`` over the last axis; sums to 1."""
    return softmax(sharpness * np.asarray(votes, np.float64), axis=-1)


def _fit_pairs(kernel, labels, c, class_count):
    """Trains on a kernel matrix; gives dense weights (n, pairs) and the bias (pairs,), in libsvm's pair order."""
    pairs = class_count * (class_count - 1) // 2
    weights = np.zeros((len(labels), pairs), np.float32)
    bias = np.zeros(pairs, np.float32)
    present = np.unique(labels)
    if len(present) < 2:
        return weights, bias
    from sklearn.svm import SVC  # most of a second, and an estimate with a given material needs none

    machine = SVC(C=c, kernel="precomputed", cache_size=SVM_CACHE_MB).fit(kernel, labels)
    # libsvm keeps for a support vector of class i the coefficient against class j in row j - (j > i)
    column_of = {pair: number for number, pair in enumerate(combinations(range(class_count), 2))}
    support, dual = machine.support_, machine.dual_coef_
    own = np.searchsorted(present, labels[support])
    sign = -1.0 if len(present) == 2 else 1.0  # scikit-learn turns the sign of the two-class case
    for number, (a, b) in enumerate(combinations(range(len(present)), 2)):
        column = column_of[present[a], present[b]]
        first, second = own == a, own == b
        weights[support[first], column] = sign * dual[b - 1, first]
        weights[support[second], column] = sign * dual[a, second]
        bias[column] = sign * machine.intercept_[number]
    return weights, bias


def _best_sharpness(votes, labels, objects):
    """The softmax sharpness with the best held-out likelihood of whole objects."""
    pooled, truth = pool_objects(votes, labels, objects)

    def loss(log_sharpness):
        p = scores(pooled, np.exp(log_sharpness))[np.arange(len(truth)), truth]
        return -np.log(np.maximum(p, 1e-12)).mean()

    # few held-out objects, all right, would ask for certainty: a cap keeps the scores honest
    return float(np.exp(minimize_scalar(loss, bounds=np.log((1.0, 40.0)), method="bounded").x))


def _known_vote(votes, labels, objects):
    """The winning pooled vote that all but ``1 - KNOWN_SHARE`` of the held-out objects reach."""
    pooled, _ = pool_objects(votes, labels, objects)
    return float(np.clip(np.quantile(pooled.max(1), 1 - KNOWN_SHARE), -1, 1))


def pool_objects(votes, labels, objects):
    """Mean votes (objects, classes) and label (objects,) of the vectors that belong to the same object."""
    _, first, number = np.unique(objects, return_index=True, return_inverse=True)
    pooled = np.zeros((len(first), votes.shape[1]))
    np.add.at(pooled, number, votes)
    return pooled / np.bincount(number)[:, None], labels[first]


def train_svm(
    vectors,
    labels,
    lights,
    objects,
    classes,
    *,
    seed=0,
    offsets=(True, False),
    grid=GRID,
    step=lambda fraction: None,
) -> Svm:
    """An RBF-SVM; C, gamma and whether decisions have an offset by grid search, cross-validated over lights.

    Of one C and gamma, and offsets or none, there is no search: held-out lights fit the scores alone.

    New light, and a photo's noise and detail that no rendering has, lie partly at right angles to all training
    vectors and shrink all kernel values alike. What is left of a decision is then its offset, and a few classes would
    win every photo; without offsets (Steinwart et al. 2011) all votes shrink together. Small, plain sets do better
    with them.

    Parameters
    ----------
    vectors : (n, d) float32, unit
    labels : (n,) int into ``classes``
    lights : (n,), the light of each; a light is never in both halves of a split
    objects : (n,) int, the image each vector is a window of
    offsets : which are tried: decisions with an offset (True), without (False)
    grid : the pairs of C and gamma that are tried, gamma in units of 1 / median squared distance; those of a gamma
        stand together
    step : called with the fraction done
    """
    squared = mutual_distances(vectors)
    unit = 1 / max(float(np.median(squared[~np.eye(len(squared), dtype=bool)])), 1e-9) if len(squared) > 1 else 1.0
    fold = grouped_folds(lights, seed=seed)
    best, best_votes, best_parameters = (-1.0, 0.0), None, (grid[0][0], grid[0][1] * unit, offsets[0])
    grid = [(c, gamma * unit) for c, gamma in grid] if fold.max() > 0 and len(classes) > 1 else []
    kernel, of = None, None
    for done, (c, gamma) in enumerate(grid):
        if gamma != of:
            kernel, of = np.exp(-gamma * squared), gamma
        decisions = np.zeros((len(labels), len(classes) * (len(classes) - 1) // 2))
        offset = np.zeros_like(decisions)
        for f in range(fold.max() + 1):
            test, rest = fold == f, fold != f
            weights, offset[test] = _fit_pairs(kernel[np.ix_(rest, rest)], labels[rest], c, len(classes))
            decisions[test] = product(kernel[np.ix_(test, rest)], weights)
        for with_offset in offsets:
            votes = pair_votes(decisions + offset if with_offset else decisions, len(classes))
            own = votes[np.arange(len(labels)), labels]
            rival = np.where(np.arange(len(classes)) == labels[:, None], -np.inf, votes).max(1)
            quality = (float((own > rival).mean()), float((own - rival).mean()))  # ties go to the wider margin
            if quality > best:
                best, best_votes, best_parameters = quality, votes, (c, gamma, with_offset)
        step((done + 1) / (len(grid) + 1))
    c, gamma, with_offset = best_parameters
    weights, bias = _fit_pairs(np.exp(-gamma * squared), labels, c, len(classes))
    if not with_offset:
        bias = np.zeros_like(bias)
    step(1.0)
    return Svm(
        tuple(classes),
        np.asarray(vectors, np.float16),
        weights,
        bias,
        gamma,
        c,
        _best_sharpness(best_votes, labels, objects) if grid else 10.0,
        best[0] if grid else float("nan"),
        _known_vote(best_votes, labels, objects) if grid else -1.0,
    )


def train_nearest(
    vectors, labels, lights, objects, classes, *, seed=0, offsets=(), grid=(), step=lambda fraction: None
) -> Nearest:
    """Nearest neighbour; parameters as of :func:`train_svm`, but that there are no ``offsets`` and no ``grid``.

    Held-out lights fit only the sharpness of the scores.
    """
    squared = mutual_distances(vectors)
    fold = grouped_folds(lights, seed=seed)
    sharpness, accuracy, known = 10.0, float("nan"), -1.0
    if fold.max() > 0 and len(classes) > 1:
        votes = np.zeros((len(labels), len(classes)))
        for f in range(fold.max() + 1):
            test, rest = fold == f, fold != f
            votes[test] = nearest_votes(squared[np.ix_(test, rest)], labels[rest], len(classes))
        sharpness, accuracy = _best_sharpness(votes, labels, objects), float((votes.argmax(1) == labels).mean())
        known = _known_vote(votes, labels, objects)
    step(1.0)
    return Nearest(tuple(classes), np.asarray(vectors, np.float16), labels.astype(np.int32), sharpness, accuracy, known)
