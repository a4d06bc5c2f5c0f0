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
