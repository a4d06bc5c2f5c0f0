# SPDX-License-Identifier: GPL-3.0-or-later
"""The light where recognition leaves several materials: one fit for each of them, and their mixture.

What is stated of the light is the mixture's: its mean, and the spread and ranges of samples that are drawn from each
fit as often as its material is probable. A photograph that fits two materials fits two lights, and no single one of
the fits knows that. Where lamps are told apart from the sky, the coefficients stay those of the likeliest: a lamp here
and one there are no lamp between.
"""

from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from btfsep_engine.fit.stated import Fit, restated
from btfsep_engine.pipeline.light_account import sky_radiance
from btfsep_engine.pipeline.model import Model, stand_ins
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
        out.append(Alternative(names, probability, fit_together(problems, settings)))
    return out


def mixture(found: list[Alternative]) -> Fit:
    """What all alternatives together say of the light: the first one's fit, restated."""
    first = found[0].light.fit
    fits, shares = [a.light.fit for a in found], [a.probability for a in found]
    counts = np.round(np.diff(np.append(0, np.cumsum(shares))) * len(first.samples)).astype(int)
    samples = np.concatenate([fit.samples[: max(1, n)] for fit, n in zip(fits, counts, strict=True)])
    if not found[0].light.suns:
        mean = np.average([fit.all_coefficients for fit in fits], axis=0, weights=shares)
        first = replace(first, all_coefficients=mean)
    return restated(first, samples)


def mixed_radiance(found: list[Alternative], lighting):
    """The sky of all alternatives together, directions (m, 3) -> (m, 3), as of `light_account.sky_radiance`."""
    several = found[:1] if found[0].light.suns else found
    parts = [(a.probability, sky_radiance(a.light.fit, lighting)) for a in several]
    total = sum(p for p, _ in parts)
    return lambda directions: sum(p / total * radiance(directions) for p, radiance in parts)


def mixture_words(found: list[Alternative]) -> str:
    """Between which materials the photo leaves the choice, and what that made of the light."""
    each = [f"{', '.join(a.names)} ({100 * a.probability:.0f} %)" for a in found]
    return f"{' or '.join(each)}: the light is fitted with each, and its ranges cover them all"
