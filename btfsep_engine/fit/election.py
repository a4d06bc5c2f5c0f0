# SPDX-License-Identifier: GPL-3.0-or-later
"""Which model a photograph asks for: the one of the largest evidence among a field, lamps, and a field with lamps.

With one exception: of lamps in a dark room the evidence is believed; where even light is bright beside the lamps, both
have to leave over about as little of the photo as the field. A sky or a room that is not even passes for them by up to
a hundred of the logarithm of the evidence: what is uneven for lamps, and what is left over for a material that is only
nearly right.
"""

from dataclasses import replace

import numpy as np
from scipy.linalg import solve_triangular

from btfsep_engine.fit.light_model import BRIGHTNESS, LightModel
from btfsep_engine.fit.products import Photograph
from btfsep_engine.fit.search import EXACT, EXACT_COST, FLOOR, LONGEST, ROUNDS, Solution, solve
from btfsep_engine.linear_algebra import product

MOST_LAMPS = 3
HOPELESS = 30.0  # of the logarithm of the evidence: so far below a rich model, nothing more is tried of a plain one
DARK = 0.3  # of all light: of 14 photographs by Cycles with more even light than that beside lamps, and an evidence no
# less than the field's, the field erred less on 11, by a third in the middle; of 30 real ones under lamps one has more
AS_LITTLE, LITTLE = 3.0, 0.1  # times what the field leaves over; of a channel's mean square: what leaves over more than
# either is no even light. Where the sky is even in truth (a grey World with a Sun) hardly more is left than by a field
AS_GOOD = 3.0  # of the logarithm of the evidence, by which a model may be less probable and is not out of the question:
# what is not strong evidence against it (Kass and Raftery 1995)
ROUGHLY = 6  # steps of the first fit, of which the size of the discrepancy alone is taken
FIRST_BRIGHTNESS = np.linspace(-1, 2, 31)  # of a new lamp, q3: a search begins at the best; from dimmer ones it creeps


def rough_light(photo: Photograph, **held) -> Solution:
    """A field that is roughly probable; the photo learns from it what its misfit is a part of.

    ``held`` : `LightModel.lamps` that are given, and `LightModel.given`
    """
    first = solve(photo, LightModel(photo.fields[0], **held), rounds=2, steps=ROUGHLY)
    photo.learn_from(first.x)
    return first


def natural_light(photo: Photograph, *, rounds: int = ROUNDS, start: Solution | None = None, **held) -> Solution:
    """The most probable field alone, or with lamps that are given (``held``, as of `rough_light`).

    ``start`` : that of the same photograph by another basis, from which the search goes on
    """
    first = start or rough_light(photo, **held)
    if start is not None:
        photo.learn_from(start.x)
    return solve(photo, first.model, white=first.white, v=first.v, rounds=rounds)


def from_elsewhere(photo: Photograph, model: LightModel, white, v) -> Solution:
    """The most probable light of a model, from unknowns ``white`` on that another photograph, or basis, asks for."""
    photo.learn_from(model.light(white)[0])
    return solve(photo, model, white=white, v=v)


def elect(photo: Photograph, **held) -> tuple[Solution, Solution | None]:
    """The model that the photograph asks for, at its most probable light, and its rival: see `decided`.

    ``held`` : as of `rough_light`
    """
    field = natural_light(photo, **held)
    plain = with_lamps(photo, solve(photo, LightModel(photo.fields[1], **held)), place=most_explained)
    rich = field
    if plain.model.lamps and plain.evidence > field.evidence - HOPELESS:
        model = replace(plain.model, field=photo.fields[0])
        white = np.concatenate([np.zeros(model.field.unknowns), plain.model.parts(plain.white)[1].ravel()])
        rich = max(rich, solve(photo, model, white=white, v=plain.v), key=lambda s: s.evidence)
    rich = with_lamps(photo, rich, place=brightest)
    rich = exact_if_so(photo, rich)
    if plain.evidence > rich.evidence - HOPELESS:
        plain = exact_if_so(photo, plain, place=most_explained)
    return decided(plain, rich, photo)


def decided(plain: Solution, rich: Solution, photo: Photograph) -> tuple[Solution, Solution | None]:
    """Which of the two stands, and its rival, of whose light every other sample is.

    The rival of the plain one is the rich one, always: of directions that the photo does not show, nobody knows that
    they are even. That of the rich one is the plain one, where that is about as probable; else there is none.
    """
    if stands(plain, photo, beside=rich):
        return plain, rich
    return rich, plain if plain.model.lamps and stands(plain, photo, beside=rich, by=-AS_GOOD) else None


def stands(plain: Solution, photo: Photograph, *, beside: Solution, by: float = 0.0) -> bool:
    """Whether the photograph asks for the plain model, and not for the rich one beside it, or does so ``by`` less."""
    if plain.evidence <= beside.evidence + by:
        return False
    if not plain.model.lamps or even_share(plain) < DARK:
        return True
    left, of_rich = (photo.misfit(each.x) / photo.mean_square for each in (plain, beside))
    return bool((left < np.maximum(AS_LITTLE * of_rich, FLOOR**2)).all() and left.max() < LITTLE)


def even_share(plain: Solution) -> float:
    """How much of a plain model's light is its even light."""
    return float(plain.model.sky(plain.white)[:, 0].mean() / plain.x[:, 0].mean())


def exact_if_so(photo: Photograph, best: Solution, *, place=None) -> Solution:
    """The same model where the photo says that nothing is missing but light; with more lamps, if there is a ``place``.

    A model that takes its materials for nearly right pays for what they might miss by its determinant, at most.
    """
    if best.rows.log_determinant < EXACT_COST:
        return best
    exact = solve(photo, best.model, white=best.white, v=best.v, discrepancy=EXACT)
    return max(best, with_lamps(photo, exact, place=place) if place else exact, key=lambda s: s.evidence)


def onward(photo: Photograph, before: Solution) -> Solution:
    """The light of an earlier solution's model, from its light on."""
    return solve(photo, before.model, white=before.white, v=before.v, discrepancy=before.discrepancy)


def with_lamps(photo: Photograph, best: Solution, *, place) -> Solution:
    """The solution with as many more lamps as its evidence asks for; ``place`` says where the next one may be."""
    while best.model.found < MOST_LAMPS:
        trial = one_lamp_more(photo, best, place=place)
        if trial.evidence <= best.evidence:
            break
        best = trial
    return best


def one_lamp_more(photo: Photograph, best: Solution, *, place) -> Solution:
    """The solution with one more lamp."""
    direction = place(best, photo)
    model = replace(best.model, lamps=(*best.model.lamps, direction))
    lamp = best.model.field.of_beam(direction)
    slope, curvature, answer = best.beside(np.concatenate([root @ lamp for root in best.rows.root]))
    irradiance = 2 * np.pi * np.exp(BRIGHTNESS * FIRST_BRIGHTNESS)
    i = (irradiance * (slope + 0.5 * irradiance * curvature) + 0.5 * FIRST_BRIGHTNESS**2).argmin()
    answer = answer * irradiance[i]
    answer *= LONGEST / max(np.abs(answer).max(initial=0.0), LONGEST)
    white = np.concatenate([best.white + answer, [0, 0, FIRST_BRIGHTNESS[i], 0, 0]])
    return solve(photo, model, white=white, v=best.v, discrepancy=best.discrepancy)


def next_lamp(best: Solution):
    """What says where a model's next lamp may be."""
    return most_explained if best.model.field.order == 0 else brightest


def brightest(best: Solution, photo: Photograph) -> np.ndarray:
    """The direction (3,) of the field's brightest place."""
    field = best.model.field
    return field.directions[np.where(photo.reaches(field), best.radiance.mean(0), 0).argmax()]


def most_explained(best: Solution, photo: Photograph) -> np.ndarray:
    """The direction (3,) of the lamp that explains most of what even light and the lamps that are there leave over."""
    field = photo.fields[0]
    x = best.x
    candidates = field.to_coefficients.T  # a lamp from each direction, all channels alike
    r = -best.rows.residual(x)
    ends = np.cumsum([len(y) for y in best.rows.target])[:-1]
    jacobian = np.split(best.model.jacobian(best.white, best.radiance, best.rows.root), ends)
    score, own, beside = 0.0, 0.0, 0.0
    for root, left, j in zip(best.rows.root, np.split(r, ends), jacobian, strict=True):
        seen = product(root, candidates.T)  # (rows, n)
        score = score + product(left, seen)
        own = own + np.square(seen).sum(0)
        beside = beside + product(j.T, seen)
    imitated = solve_triangular(best.factor, beside, lower=True)
    rest = np.maximum(own - np.square(imitated).sum(0), 1e-6 * own + 1e-300)
    gain = np.where(score > 0, score**2 / rest, 0.0)
    return field.directions[np.where(photo.reaches(field), gain, 0.0).argmax()]
