# SPDX-License-Identifier: GPL-3.0-or-later
"""Dictionaries of visual words and the VLAD vector (Jegou et al. 2010; the paper's eq. 2).

    v_j = sum over the x_i whose nearest word is c_j of (x_i - c_j),   v = [v_1, ..., v_k]

A region's vector joins the VLAD of each kind of descriptor (`Encoding.kinds`), its colour patches and its SIFT, each
normalised on its own so that neither outweighs the other.
"""

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from scipy.sparse import csr_matrix

from btfsep_engine.linear_algebra import eigh, product

WORDS = Path(__file__).resolve().parents[1] / "data" / "words.npz"
COLOUR_WORDS = 150
SIFT_WORDS = 250


@dataclass(frozen=True)
class Encoding:
    """How VLAD vectors are normalised and how many words there are. Stored with every recogniser.

    Attributes
    ----------
    colour_words, sift_words : sizes of the dictionaries
    root_sift : whether square roots of SIFT are taken (`root_sift`); raw SIFT otherwise
    sift_components : SIFT is projected to this many principal components first; 0 keeps all 128
    power : the signed power each entry is raised to before the L2 normalisation; 1 is plain VLAD. The default,
        1/2, keeps words that repeat ("bursty" texture) from outweighing the rest (Perronnin et al. 2010)
    colour_weight : share, 0 to 1, of the colour part in the squared length of the joined vector
    windows : local regions (windows) that an object is divided into, a power of two
    """

    colour_words: int = COLOUR_WORDS
    sift_words: int = SIFT_WORDS
    root_sift: bool = True
    sift_components: int = 40
    power: float = 0.5
    colour_weight: float = 0.5
    windows: int = 4

    @property
    def kinds(self) -> dict:
        """Kind of descriptor -> (words, principal components, share of the squared length) of its part of a vector.

        The components are 0 where all are kept, and None where the points are taken as they are, their mean too.
        """
        return {
            "colour": (self.colour_words, None, self.colour_weight),
            "sift": (self.sift_words, self.sift_components, 1 - self.colour_weight),
        }


DEFAULT = Encoding()
PAPER = Encoding(root_sift=False, sift_components=0, power=1.0)
SIFT_UNIT = 512.0  # OpenCV's length of a SIFT vector


def learn_words(points, count, *, seed=0) -> np.ndarray:
    """A dictionary by k-means.

    Parameters
    ----------
    points : (n, d) float
    count : words wanted; where there are no more points than that, each is a word and the rest lie out of reach

    Returns
    -------
    (count, d) float32
    """
    points = np.ascontiguousarray(points, np.float32)
    if len(points) <= count:
        words = np.full((count, points.shape[1]), 1e6, np.float32)
        words[: len(points)] = points
        return words
    from sklearn.cluster import KMeans  # takes long, and only training needs it

    means = KMeans(count, init="random", n_init=1, max_iter=25, tol=1e-3, random_state=seed).fit(points)
    return means.cluster_centers_.astype(np.float32)


def nearest_word(points, words) -> np.ndarray:
    """(n,) int, the index of the nearest of ``words : (k, d)`` for each of ``points : (n, d)``, by L2."""
    return ((words * words).sum(1) - 2 * product(points, words.T)).argmin(1)


def aggregate(points, words, groups, group_count: int) -> np.ndarray:
    """Plain VLAD sums (eq. 2), one row per group.

    Parameters
    ----------
    points : (n, d) float32
    words : (k, d) float32
    groups : (n,) int in [0, group_count)

    Returns
    -------
    (group_count, k, d) float32
    """
    k, d = words.shape
    word = nearest_word(points, words)
    cells = np.asarray(groups, np.int64) * k + word
    ones = np.ones(len(points), np.float32)
    choose = csr_matrix((ones, (cells, np.arange(len(points)))), shape=(group_count * k, len(points)))
    return np.asarray(choose @ (points - words[word]), np.float32).reshape(group_count, k, d)


def normalise(vectors, power: float) -> np.ndarray:
    """Signed power, then unit L2 length: (m, ...) to (m, d) float32; a zero vector stays zero."""
    flat = vectors.reshape(len(vectors), -1)
    flat = np.sign(flat) * np.abs(flat) ** power
    return flat / np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-12)


def split_windows(xy, count: int) -> np.ndarray:
    """Divides an object into local regions holding about the same number of descriptors each.

    The positions are halved at the median of their longer side again and again, so that windows follow the
    object's shape and none is empty.

    Parameters
    ----------
    xy : (n, 2) float
    count : a power of two

    Returns
    -------
    (n,) int, the window of each
    """
    window = np.zeros(len(xy), np.int64)
    parts = [np.arange(len(xy))]
    while len(parts) < count:
        halves = []
        for part in parts:
            axis = int(np.ptp(xy[part], axis=0).argmax()) if len(part) else 0
            order = part[np.argsort(xy[part, axis], kind="stable")]
            halves += [order[: len(order) // 2], order[len(order) // 2 :]]
        parts = halves
    for number, part in enumerate(parts):
        window[part] = number
    return window


@dataclass(frozen=True)
class Dictionary:
    """The words of one kind of descriptor, in the space that its points are projected to.

    Attributes
    ----------
    words : (k, c) float32
    mean : (d,) float32; axes : (d, c) float32
    """

    words: np.ndarray
    mean: np.ndarray
    axes: np.ndarray

    def projected(self, points) -> np.ndarray:
        """(n, c) float32, of points (n, d)."""
        return product(points - self.mean, self.axes)


@dataclass(frozen=True)
class Encoder:
    """From descriptors to unit vectors.

    Attributes
    ----------
    dictionaries : kind of descriptor -> Dictionary, as in ``encoding.kinds``
    half_contrast : log2 units, see ``descriptors.Settings.contrast``
    """

    dictionaries: dict
    half_contrast: float
    encoding: Encoding

    def projected(self, descriptors) -> dict:
        """Kind -> the points (n, c) float32 of descriptors, in the space of the words."""
        points = points_of(descriptors, self.half_contrast, root=self.encoding.root_sift)
        return {kind: dictionary.projected(points[kind]) for kind, dictionary in self.dictionaries.items()}

    def encode(self, descriptors):
        """The VLAD vectors of an object: one per window, then that of the whole object.

        Returns
        -------
        (windows + 1, length) float32, unit; the last row is the whole object
        """
        words = {kind: dictionary.words for kind, dictionary in self.dictionaries.items()}
        return self.joined(descriptors, lambda kind, points, *groups: aggregate(points, words[kind], *groups))

    def joined(self, descriptors, sums_of) -> np.ndarray:
        """As `encode`, of other sums: ``sums_of`` takes a kind and what `aggregate` takes but for the words."""
        count, parts = self.encoding.windows, []
        window, points = split_windows(descriptors.xy, count), self.projected(descriptors)
        for kind, (_, _, weight) in self.encoding.kinds.items():
            sums = sums_of(kind, points[kind], window, count)
            sums = np.concatenate([sums, sums.sum(0, keepdims=True)])
            parts.append(np.sqrt(weight) * normalise(sums, self.encoding.power))
        return np.concatenate(parts, 1).astype(np.float32)


def points_of(descriptors, half_contrast: float, *, root: bool) -> dict:
    """Kind of descriptor -> (n, d) float32, the points of which words are learnt; ``root`` : as of `weighted_sift`."""
    return {
        "colour": np.asarray(descriptors.colour, np.float32),
        "sift": weighted_sift(descriptors.sift, descriptors.contrast, half_contrast, root=root),
    }


def weighted_sift(sift, contrast, half_contrast: float, *, root: bool = True) -> np.ndarray:
    """SIFT, or square roots of L1-normalised SIFT (Arandjelovic and Zisserman 2012), weighted by contrast.

    Parameters
    ----------
    sift : (n, 128) uint8; contrast : (n,) float; half_contrast : >= 0, that halves the weight
    root : whether roots are taken

    Returns
    -------
    (n, 128) float32, of length contrast / (contrast + half_contrast); about that length without roots
    """
    x = np.asarray(sift, np.float32)
    c = np.asarray(contrast, np.float32)
    scale = c / np.maximum(c + half_contrast, 1e-12)
    points = np.sqrt(x / np.maximum(x.sum(1, keepdims=True), 1e-12)) if root else x / SIFT_UNIT
    return points * scale[:, None]


def learn_dictionary(points, count: int, components: int | None, *, seed=0) -> Dictionary:
    """``count`` words of points (n, d) float32; ``components`` : as of `Encoding.kinds`."""
    d = points.shape[1]
    mean, axes = np.zeros(d, np.float32) if components is None else points.mean(0), np.eye(d, dtype=np.float32)
    if components:
        centred = points - mean
        _, vectors = eigh(product(centred.T.astype(np.float64), centred))
        axes = np.ascontiguousarray(vectors[:, ::-1][:, :components], np.float32)
    return Dictionary(learn_words(product(points - mean, axes), count, seed=seed), mean.astype(np.float32), axes)


@lru_cache(maxsize=1)
def ready_encoder() -> Encoder:
    """The shipped dictionaries, of `DEFAULT` and half a contrast of 0.05.

    They are learned from three objects in all shipped materials under the training lights
    (``scripts/study learn-words``): words of patches, of which no object and no material has its own.
    """
    with np.load(WORDS, allow_pickle=False) as found:
        learnt = {
            kind: Dictionary(*(found[f"{kind}.{n}"] for n in ("words", "mean", "axes"))) for kind in DEFAULT.kinds
        }
        return Encoder(learnt, float(found["half_contrast"]), DEFAULT)


def learn_encoder(sample, *, half_contrast, encoding=DEFAULT, seed=0) -> Encoder:
    """The dictionaries of all kinds from a ``sample`` of `descriptors.Descriptors`."""
    points = points_of(sample, half_contrast, root=encoding.root_sift)
    learnt = {
        kind: learn_dictionary(points[kind], count, components, seed=seed)
        for kind, (count, components, _) in encoding.kinds.items()
    }
    return Encoder(learnt, float(half_contrast), encoding)
