# SPDX-License-Identifier: GPL-3.0-or-later
"""The light where recognition leaves several materials: one fit for each of them, and ranges that cover all.

What is stated of the light, its spread and its ranges, is of samples that are drawn from each fit as often as its
material is probable: a photograph that fits two materials fits two lights, and no single one of the fits knows that.
The coefficients stay those of the likeliest: their mean over materials, of which a dark one asks for bright light, is
further off (docs/results/recognition.md).
"""

from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from btfsep_engine.fit.stated import Fit, stated_by
from btfsep_engine.pipeline.model import Model, stand_ins
from btfsep_engine.pipeline.refine import refined
from btfsep_engine.pipeline.refine.look_alike import look_alike
from btfsep_engine.pipeline.refine.misplaced import misplaced
from btfsep_engine.pipeline.together import SolvedLight, fit_together

MOST = 4  # combinations of the objects' materials
LEAST = 0.05  # of the probability of the likeliest combination: what is less changes nothing


@dataclass(frozen=True)
class Alternative:
    """A combination of materials.

    Attributes
    ----------
    names : of each object
    probability : of those that are looked at they add up to 1
    light : SolvedLight
    """

    names: tuple[str, ...]
    probability: float
    light: SolvedLight


def combinations(materials) -> list[tuple[tuple[str, ...], float]]:
    """The likeliest combinations of what objects may be made of, the chosen one first.

    Parameters
    ----------
    materials : ObjectMaterial of each object

    Returns
    -------
    (names, probability) of at most `MOST`; the probabilities add up to 1
    """
    chosen = tuple(m.name for m in materials)
    each = []
    for m in materials:
        scores = dict(m.candidates)
        each.append([(name, scores[name]) for name in m.likely] if len(m.likely or ()) > 1 else [(m.name, 1.0)])
    every = [(tuple(n for n, _ in parts), float(np.prod([p for _, p in parts]))) for parts in product(*each)]
    every.sort(key=lambda one: (one[0] != chosen, -one[1]))
    kept = [one for one in every[:MOST] if one[1] > LEAST * every[0][1]]
    total = sum(p for _, p in kept)
    return [(names, p / total) for names, p in kept]


def alternatives(model: Model, light: SolvedLight, library) -> list[Alternative]:
    """The light of every combination that is likely: none where there is only one, and without a prior of light."""
    kept, settings = combinations(model.materials[0]), replace(model.modelled, order=light.order)
    if len(kept) < 2 or settings.estimator != "map":
        return []
    chosen, out = kept[0][0], [Alternative(*kept[0], light)]
    for names, probability in kept[1:]:
        others = stand_ins([library.load(name) for name in names], model.appearance)
        problems = []
        for problem in model.problems:
            known = zip(problem.materials, others, names, chosen, strict=True)
            made = [old if name == before else new for old, new, name, before in known]
            problems.append(problem.of_materials(made, settings))
        _, fitted, _ = refined(model, fit_together(problems, settings), {}, (look_alike, misplaced))  # known as little
        out.append(Alternative(names, probability, fitted))
    return out


def mixture(choices: list[Alternative]) -> Fit:
    """The first one's fit, with the spread and the ranges of all alternatives together.

    How much the materials reflect sets the light's scale, which leaves no coefficient undetermined.
    """
    first = choices[0].light.fit
    fits, shares = [a.light.fit for a in choices], [a.probability for a in choices]
    counts = np.round(np.diff(np.append(0, np.cumsum(shares))) * len(first.samples)).astype(int)
    parts, x = [fit.samples[: max(1, n)] for fit, n in zip(fits, counts, strict=True)], first.all_coefficients
    scales = [(f.all_coefficients * x).sum() / max(np.square(f.all_coefficients).sum(), 1e-300) for f in fits]
    alike = stated_by(x, np.concatenate([scale * part for scale, part in zip(scales, parts, strict=True)]))
    stated = replace(stated_by(x, np.concatenate(parts), first.lamps), determined=alike.determined)
    return replace(first, state=lambda: stated)


def mixture_words(choices: list[Alternative]) -> str:
    """Between which materials the photo leaves the choice, and what that made of the light."""
    each = [f"{', '.join(a.names)} ({100 * a.probability:.0f} %)" for a in choices]
    return f"{' or '.join(each)}: the light is fitted with each, and its ranges cover them all"
