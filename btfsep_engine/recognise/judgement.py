# SPDX-License-Identifier: GPL-3.0-or-later
"""How probable each candidate is, how probable that it is none of them, and which are not to be ruled out.

Each candidate m has cues f_m, of which a table says the weights, learned as a multinomial logistic regression:

    p(m) = exp(w f_m) / (exp(w0) + sum over k of exp(w f_k)),     p(none) the rest.

What may be said of that is calibrated (conformal prediction; Vovk and others 2005): -log p of the right material is
compared with what it was in the table's photographs, each under a light of its own. The p-value of a candidate is

    (1 + number of those photographs that were as strange or stranger) / (1 + their number),

and the candidates above `LEVEL` are the answer: the right material is among them in at least 95 % of photographs like
those. Where none of the library's is among them, the object looks like no material that is known; the likeliest of the
surfaces that are alike all over stands in for it.

The table is ``data/recognition.json``; ``scripts/study learn-recognition`` makes it.
"""

import json
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from btfsep_engine.recognise.recogniser import Recognition

TABLE = Path(__file__).resolve().parents[1] / "data" / "recognition.json"
LEVEL = 0.05  # of the p-value: a right material is ruled out so often


@dataclass(frozen=True)
class Judgement:
    """A model of the table.

    Attributes
    ----------
    weights : {cue: weight}
    none : w0
    strangeness : (photographs,) -log p of the right material, rising
    """

    weights: dict
    none: float
    strangeness: np.ndarray

    def answer(self, names, cues: dict, *, plain=()) -> Recognition:
        """What is to be said of the candidates ``names`` with ``cues`` : {cue: (candidates,) float}.

        ``plain`` : those that are none of the library's
        """
        found = judged(utilities(self.weights, cues), self.none, self.strangeness)
        order = np.argsort(-found.probabilities, kind="stable")
        scores = found.probabilities / found.probabilities.sum()
        likely = tuple(names[i] for i in order if found.likely[i])
        candidates = tuple((names[i], float(scores[i])) for i in order)
        nearest = next(i for i in order if names[i] not in plain)
        known = bool(found.likely[nearest])
        material, stand_in = names[order[0] if known else nearest], None
        if not known:
            stand_in = next((names[i] for i in order if names[i] in plain), None)
        return Recognition(material, candidates, not known, float(found.strangeness[nearest]), likely, stand_in)


@dataclass(frozen=True)
class Judged:
    """What is said of n candidates.

    Attributes
    ----------
    probabilities : (n,), and ``none`` : float; they add up to 1
    likely : (n,) bool, those that are not ruled out, whose p value is above `LEVEL`
    strangeness : (n,), over that at which a candidate is ruled out; above 1: it is
    """

    probabilities: np.ndarray
    none: float
    likely: np.ndarray
    strangeness: np.ndarray


def utilities(weights: dict, cues: dict) -> np.ndarray:
    """w f_m of each candidate."""
    return np.sum([weight * np.asarray(cues[name], np.float64) for name, weight in weights.items()], axis=0)


def judged(utility, none: float, strangeness) -> Judged:
    """See the head of this file; ``utility`` : (candidates,), ``strangeness`` : (photographs,), rising."""
    z = np.append(utility, none)
    logs = z - z.max() - np.log(np.exp(z - z.max()).sum())
    strange = -logs[:-1]
    count = len(strangeness)
    p_values = (1 + count - np.searchsorted(strangeness, strange, side="left")) / (1 + count)
    # the largest strangeness that is not ruled out; of fewer photographs than 19 none is
    allowed = np.append(strangeness, np.inf)[count - int(np.floor(LEVEL * (1 + count)))]
    return Judged(
        np.exp(logs[:-1]),
        float(np.exp(logs[-1])),
        p_values > LEVEL,
        strange / max(allowed, 1e-9),
    )


@lru_cache(maxsize=1)
def judgements() -> dict[str, Judgement]:
    """The shipped table: {"verified": with all cues, "spoilt" and "grainy": the same of photos that are so
    (`finest.judged_as`), "explained": what is worth a rendering, "votes": by the classifier alone}.
    """
    table = json.loads(TABLE.read_text())["models"]
    return {
        name: Judgement(model["weights"], model["none"], np.sort(np.asarray(model["strangeness"], np.float64)))
        for name, model in table.items()
    }
