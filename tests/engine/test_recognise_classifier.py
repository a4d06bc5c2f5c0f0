# SPDX-License-Identifier: GPL-3.0-or-later
"""The classifiers: folds by light, decisions against scikit-learn's own, pooling."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sklearn.svm import SVC

from btfsep_engine.recognise import classifier


@given(st.lists(st.integers(0, 8), min_size=1, max_size=60), st.integers(2, 5), st.integers(0, 99))
def test_a_light_is_never_in_two_folds(lights, folds, seed):
    fold = classifier.grouped_folds([f"light {i}" for i in lights], folds, seed=seed)
    for light in set(lights):
        assert len({f for f, one in zip(fold, lights, strict=True) if one == light}) == 1
    assert set(fold) == set(range(min(folds, len(set(lights)))))


def clusters(rng, classes=4, lights=6, windows=3, dims=12, spread=0.25):
    centre = rng.normal(size=(classes, dims))
    labels = np.repeat(np.arange(classes), lights * windows)
    light = np.tile(np.repeat(np.arange(lights), windows), classes)
    objects = np.repeat(np.arange(classes * lights), windows)
    x = centre[labels] + spread * rng.normal(size=(len(labels), dims))
    return (x / np.linalg.norm(x, axis=1, keepdims=True)).astype(np.float32), labels, light, objects


@pytest.mark.parametrize("classes", [2, 5])
def test_svm_decides_as_scikit_learn_does(rng, classes):
    x, labels, light, objects = clusters(rng, classes, spread=0.8)
    names = [f"m{i}" for i in range(classes)]
    model = classifier.train_svm(x, labels, light, objects, names, seed=3)
    reference = SVC(C=model.c, gamma=model.gamma, decision_function_shape="ovo").fit(x, labels)
    query = rng.normal(size=(40, x.shape[1])).astype(np.float32)
    query /= np.linalg.norm(query, axis=1, keepdims=True)
    expected = reference.decision_function(query)
    if not model.bias.any():
        expected = expected - reference.intercept_
    if classes == 2:
        expected = -expected[:, None]  # there positive says the second class
    np.testing.assert_allclose(model.votes(query), classifier.pair_votes(expected, classes), atol=5e-3)


@pytest.mark.parametrize("seed", [0, 1])
def test_the_grid_search_takes_the_best_of_its_grid(seed):
    """Each cell, made again by scikit-learn alone: two clusters a class, so that a wide kernel is not enough."""
    rng = np.random.default_rng(seed)
    a, *_ = clusters(rng, classes=6, lights=9, windows=2, dims=6, spread=0.45)
    labels, light, objects = (np.tile(np.repeat(np.arange(n), k), m) for n, k, m in ((3, 36, 1), (9, 2, 6), (54, 2, 1)))
    model = classifier.train_svm(a, labels, light, objects, list("abc"), seed=seed)
    unit = 1 / np.median(classifier.squared_distances(a, a)[~np.eye(len(a), dtype=bool)])
    fold, quality = classifier.grouped_folds(light, seed=seed), {}
    for c in classifier.C_GRID:
        for g in classifier.GAMMA_GRID:
            decision, offset = np.zeros((2, len(a), 3))
            for f in range(fold.max() + 1):
                svc = SVC(C=c, gamma=g * unit, decision_function_shape="ovo").fit(a[fold != f], labels[fold != f])
                decision[fold == f], offset[fold == f] = svc.decision_function(a[fold == f]), svc.intercept_
            for with_offset in (True, False):
                votes = classifier.pair_votes(decision - (0 if with_offset else offset), 3)
                own, others = votes[np.arange(len(a)), labels], votes.copy()
                others[np.arange(len(a)), labels] = -np.inf
                margin = own - others.max(1)
                quality[c, g, with_offset] = (margin > 0).mean(), margin.mean()
    best = max(quality, key=quality.get)
    assert (model.c, round(model.gamma / unit, 3), bool(model.bias.any())) == best
    assert model.held_out_accuracy == pytest.approx(quality[best][0])
    assert best != (10.0, 1.0, True) and min(quality.values()) < (quality[best][0] - 0.05,)  # the choice matters


def test_offsets_only_where_they_are_tried(rng):
    x, labels, light, objects = clusters(rng, 3)
    for offsets in (True,), (False,):
        assert classifier.train_svm(x, labels, light, objects, list("abc"), offsets=offsets).bias.any() == offsets[0]


def test_a_class_missing_from_training_half_does_not_shift_the_others(rng):
    x, labels, *_ = clusters(rng, 4)
    some = labels != 1
    kernel = np.exp(-classifier.squared_distances(x, x))
    weights, bias = classifier._fit_pairs(kernel[np.ix_(some, some)], labels[some], 10.0, 4)
    votes = classifier.pair_votes(kernel[:, some] @ weights + bias, 4)
    assert (votes[some].argmax(1) == labels[some]).mean() > 0.95


@pytest.mark.parametrize("train", [classifier.train_svm, classifier.train_nearest])
def test_learns_and_scores(rng, train):
    x, labels, light, objects = clusters(rng)
    model = train(x, labels, light, objects, list("abcd"), seed=0)
    votes = model.votes(x)
    assert (votes.argmax(1) == labels).all() and np.abs(votes).max() <= 1
    p = classifier.scores(votes, model.sharpness)
    np.testing.assert_allclose(p.sum(1), 1)
    assert model.held_out_accuracy > 0.9


def test_held_out_accuracy_is_not_flattered_by_the_light(rng):
    """Vectors that show the light only: with a light's windows in both halves a classifier would look perfect."""
    lights, windows = 12, 6
    light = np.repeat(np.arange(lights), windows)
    labels = rng.permutation(np.repeat([0, 1], lights // 2))[light]
    own = rng.normal(size=(lights, 40))
    x = (own[light] + 0.01 * rng.normal(size=(len(light), 40))).astype(np.float32)
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    model = classifier.train_svm(x, labels, light, light, ["a", "b"], seed=0)
    assert model.held_out_accuracy < 0.95


def test_one_class_and_one_light(rng):
    x, labels, light, objects = clusters(rng, classes=1)
    for train in (classifier.train_svm, classifier.train_nearest):
        model = train(x, labels, light, objects, ["only"])
        np.testing.assert_allclose(classifier.scores(model.votes(x), model.sharpness), 1)
    x, labels, light, objects = clusters(rng, lights=1)
    model = classifier.train_svm(x, labels, light, objects, list("abcd"))
    assert np.isnan(model.held_out_accuracy) and (model.votes(x).argmax(1) == labels).mean() > 0.9


def test_pooling_is_by_object():
    votes = np.array([[1.0, 0], [0, 1], [0, 0.5]])
    pooled, truth = classifier.pool_objects(votes, np.array([0, 1, 0]), np.array([7, 3, 7]))
    np.testing.assert_allclose(pooled, [[0, 1], [0.5, 0.25]])
    assert truth.tolist() == [1, 0]


@pytest.mark.parametrize("train", [classifier.train_svm, classifier.train_nearest])
def test_a_class_left_out_leaves_the_decisions_between_the_others(rng, train):
    """Against a model of the others' own training vectors: the same kernel, the same pairs."""
    x, labels, light, objects = clusters(rng, 4, spread=0.8)
    model = train(x, labels, light, objects, list("abcd"))
    other = model.without("b")
    assert other.classes == ("a", "c", "d")
    if model.kind == "svm":
        some = labels != 1
        kernel = np.exp(-model.gamma * classifier.squared_distances(x, x))
        weights, bias = classifier._fit_pairs(
            kernel[np.ix_(some, some)], np.unique(labels[some], return_inverse=True)[1], model.c, 3
        )
        expected = classifier.pair_votes(kernel[:, some] @ weights + bias * model.bias.any(), 3)
        np.testing.assert_allclose(other.votes(x), expected, atol=5e-3)
    else:
        np.testing.assert_allclose(other.votes(x), model.votes(x)[:, [0, 2, 3]], atol=1e-6)
