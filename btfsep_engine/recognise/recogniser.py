# SPDX-License-Identifier: GPL-3.0-or-later
"""A trained recogniser and its answer."""

from dataclasses import dataclass, replace

import numpy as np

from btfsep_engine.recognise import descriptors as dense
from btfsep_engine.recognise.classifier import Nearest, Svm, scores
from btfsep_engine.recognise.vlad import Encoder


@dataclass(frozen=True)
class Recognition:
    """What an object was recognised as.

    Attributes
    ----------
    material : the best candidate's name
    candidates : (name, score in [0, 1]) of every known material and plain surface, best first; the scores sum to 1
    unknown : whether the object looks like none of the library's materials; ``material`` is then only the nearest
    unknown_score : above 1 is unknown. By `judgement`, how strange the photo is of the library's likeliest material,
        over the strangeness at which it is ruled out; by the classifier alone, how far the winning vote falls short of
        1, over the shortfall that 99 % of the library's own materials stay below under lights that were held out
    likely : the materials that are not ruled out, the likeliest first: the right one is among them 95 times of 100;
        where ``unknown``, plain surfaces at most. None: not stated (by the classifier alone)
    stand_in : the likeliest plain surface where ``unknown``, if any was looked at
    """

    material: str
    candidates: tuple[tuple[str, float], ...]
    unknown: bool
    unknown_score: float
    likely: tuple[str, ...] | None = None
    stand_in: str | None = None


@dataclass(frozen=True)
class Recogniser:
    """Everything needed to recognise.

    Attributes
    ----------
    settings : how images are described
    encoder : dictionaries
    model : the classifier
    contents : what each of the materials is made of, a text; empty where nothing of it can be used again
    """

    settings: dense.Settings
    encoder: Encoder
    model: Svm | Nearest
    contents: tuple[str, ...] = ()

    @property
    def materials(self) -> tuple[str, ...]:
        """The names it can answer with."""
        return self.model.classes

    def known_vectors(self, contents: dict) -> dict:
        """Material -> its training vectors (M, windows + 1, length) float16, of those whose content is the same.

        ``contents`` : material -> text
        """
        # a training whose materials have contents has the rows of one after the other
        count, windows = len(self.materials), self.encoder.encoding.windows + 1
        vectors = self.model.vectors.reshape(count, -1, windows, self.model.vectors.shape[1]) if self.contents else ()
        each = zip(self.materials, self.contents, vectors, strict=True) if self.contents else ()
        return {name: own for name, content, own in each if contents.get(name) == content}

    def describe(self, radiance, mask, *, what: str = "the region to recognise"):
        """The VLAD vectors of the masked region of a photo, see `vlad.Encoder.encode`.

        Parameters
        ----------
        radiance : (h, w, 3) float, linear Rec.709, any exposure; NaN where a pixel is unusable (saturated)
        mask : (h, w) bool
        what : names the region in errors, as in "object 'bunny'"

        Raises
        ------
        InputError
            Where the region is too small, black or without finite pixels.
        """
        return self.encoder.encode(dense.extract(radiance, mask, settings=self.settings, what=what))

    def without(self, name: str) -> "Recogniser":
        """The same without a material: the classifier as if it had not been there, the dictionaries as they are."""
        return replace(self, model=self.model.without(name))

    def judged(self, vectors) -> Recognition:
        """The material of what `describe` gave, by the classifier alone."""
        votes = self.model.votes(vectors)
        pooled = scores(votes.mean(0), self.model.sharpness)
        order = np.argsort(-pooled, kind="stable")
        names = self.model.classes
        # how far the winning vote falls short, against the most that is usual for known materials
        ratio = float(1 - votes.mean(0).max()) / max(1 - self.model.known_vote, 1e-9)
        return Recognition(names[order[0]], tuple((names[i], float(pooled[i])) for i in order), ratio > 1, ratio)
