# SPDX-License-Identifier: GPL-3.0-or-later
"""Fisher vectors, which the paper names beside VLAD: for the study of descriptors alone.

A mixture of Gaussians with diagonal covariances stands for the dictionary, and a region is described by how its
descriptors would have the means and the deviations moved (Perronnin, Sanchez and Mensink 2010, "Improving the Fisher
kernel for large-scale image classification"): of the descriptors x_i, Gaussian j with weight w, mean mu and deviation
sigma, gamma_i the share of x_i that is its own,

    G_mu    = sum over i of gamma_i (x_i - mu) / sigma / sqrt(w)
    G_sigma = sum over i of gamma_i ((x_i - mu)^2 / sigma^2 - 1) / sqrt(2 w)

Signed power and unit length, windows and the weights of colours and SIFT are those of `recognise.vlad`.
"""

import warnings
from dataclasses import dataclass

import numpy as np
from sklearn.exceptions import ConvergenceWarning
from sklearn.mixture import GaussianMixture

from btfsep_engine.recognise import vlad

ROUNDS = 30  # of expectation and maximisation
LEAST_VARIANCE = 1e-4  # over that of all points: a Gaussian on a few points alike would outweigh all others


def mixture(points, means, *, seed=0) -> GaussianMixture:
    """A mixture of Gaussians with diagonal covariances of ``points`` (n, d), begun at the words ``means`` (k, d)."""
    points = np.asarray(points, np.float64)
    word, floor = vlad.nearest_word(points, means), LEAST_VARIANCE * points.var(0).mean()
    share = np.maximum(np.bincount(word, minlength=len(means)), 1) / len(points)
    variance = np.stack([points[word == j].var(0) if (word == j).any() else points.var(0) for j in range(len(means))])
    start = {"weights_init": share / share.sum(), "means_init": means, "precisions_init": 1 / (variance + floor)}
    how = {"covariance_type": "diag", "reg_covar": floor, "max_iter": ROUNDS, "random_state": seed}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)  # as k-means, which is not run to its end either
        return GaussianMixture(len(means), **how, **start).fit(points)


def gradients(points, of: GaussianMixture, groups, group_count: int) -> np.ndarray:
    """The sums of the head of this file, one row for each group.

    Parameters
    ----------
    points : (n, d) float
    groups : (n,) int in [0, group_count)

    Returns
    -------
    (group_count, 2, k, d) float64
    """
    points, shares = np.asarray(points, np.float64), of.predict_proba(points)
    deviation, weight = np.sqrt(of.covariances_), of.weights_[:, None]
    out = np.empty((group_count, 2, *of.means_.shape))
    for g in range(group_count):
        own, x = shares[groups == g].T, points[groups == g]
        count, first, second = own.sum(1)[:, None], own @ x, own @ x**2
        moved = (first - count * of.means_) / deviation
        spread = (second - 2 * of.means_ * first + count * of.means_**2) / of.covariances_ - count
        out[g] = moved / np.sqrt(weight), spread / np.sqrt(2 * weight)
    return out


@dataclass(frozen=True)
class FisherEncoder:
    """From descriptors to unit vectors, as `vlad.Encoder`, with whose words the ``mixtures`` of each kind began."""

    words: vlad.Encoder
    mixtures: dict

    def encode(self, descriptors) -> np.ndarray:
        """(windows + 1, 2 k d of colours and of SIFT) float32, unit; the last row is the whole object."""
        return self.words.joined(
            descriptors, lambda kind, points, *groups: gradients(points, self.mixtures[kind], *groups)
        )


def learn_encoder(sample, *, seed=0, **how) -> FisherEncoder:
    """The mixtures from a sample of descriptors; as `vlad.learn_encoder`."""
    words = vlad.learn_encoder(sample, seed=seed, **how)
    points = words.projected(sample).items()
    return FisherEncoder(words, {k: mixture(p, words.dictionaries[k].words, seed=seed) for k, p in points})
