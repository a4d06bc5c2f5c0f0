# SPDX-License-Identifier: GPL-3.0-or-later
"""How rough an object of given numbers is: its job has what a user saw by eye, or never looked at.

A surface's colour is seen, and its metal known; its roughness is guessed, or what Blender begins with. Light imitates
the difference: a matte thing that is said to have a gloss has all that a gloss would show taken out of its light. But
the photo tells: of 32 plates that were said to have a roughness of 0.5, those that have another explain it better by
19 to 277 of the logarithm of the evidence, and of those that have it none by more than 4. So rougher and smoother
surfaces are tried, step by step as long as the photo is explained better, on a few of the pixels under a field alone,
and the best on all of them. Objects are looked at one by one, the largest first. A gloss of 0.2 passes for one of 0.35:
its tables are no sharper. So only a roughness that is far from what is said is a doubt (`pipeline.checks`).

The evidence is not enough: under light that is nearly even (an overcast sky, a tent) a rougher surface lets the light
be plainer by more than it costs, though less of the photo is explained. So what is left over may not grow. And a gloss
shows the edges of a light, as a horizon, sharper than basis images of the order 9 have it: of a photo that is explained
but for that, a rougher surface takes some of it. There a gloss is no rougher than it is said to be.

On a few pixels light between surfaces stays what it was: it goes by the albedo, which a roughness hardly changes.
"""

from dataclasses import replace

import numpy as np

from btfsep_engine.pipeline.refine.given import asked_of, gains_on_a_few, on_all

TURNS = 3
STEP, LEAST = 0.15, 0.1  # of a roughness; smoother ones are sharper than tables are
USUAL = 0.2  # by how much who says a roughness may be off: a standard deviation
# Of the logarithm of the evidence, the prior counted: of a few pixels, of all; and the same where what is said is given
# up already. Where 21 objects were taken for rougher or smoother, a few pixels gain 6 and more; of ten that were asked
# of all pixels in vain, eight gain less than 2. Further steps are of the size of what a few pixels can tell.
HOPEFUL, CLEARLY = 2.0, 10.0
STILL_HOPEFUL, FURTHER = -4.0, 3.0
GROWN = 1.01  # of what is left over; of 40 plates whose light gained a tenth it shrank, or grew by 0.1 %
GLOSS, EXPLAINED = 0.35, 0.1  # a roughness; the share of the photo that is left over
ROUGHNESS, OTHERWISE = (
    "roughness",
    "said_roughness",
)  # its name among what is chosen: near what is said, and far from it


def as_rough_as_seen(model, light):
    """The refinement: the roughness that explains the photo best, of objects whose surface is given by numbers."""
    words, name_of_all, first = [], ROUGHNESS, model.problems[0]
    with model.reporter.stage("reflectance"):
        for i in asked_of(model, light):
            said = rough = first.scene.job.objects[i].surface.roughness
            for _ in range(TURNS):
                trial = _rougher_or_smoother(model, light, i, rough)
                if trial is None:
                    break
                model, light, rough = trial
            if rough != said:
                if abs(rough - said) > USUAL:
                    name_of_all = OTHERWISE
                name = first.scene.job.objects[i].name
                words.append(
                    f"object '{name}' was taken to have a roughness of {rough:.2f}, where its surface says {said:.2f} "
                    "(by evidence); check its 'surface'"
                )
    return model, light, {name_of_all: "; ".join(words)} if words else {}


def _rougher_or_smoother(model, light, i: int, rough: float):
    """Model, light and roughness of an object that explain the photo clearly better than ``rough`` does, or None."""
    said = model.problems[0].scene.job.objects[i].surface
    better = _hopeful(model, light, i, rough)
    if better is None:
        return None
    trial, answer = on_all(model, light, i, replace(said, roughness=better))
    prior = _log_prior(better, said) - _log_prior(rough, said)
    needed = CLEARLY if rough == said.roughness else FURTHER
    if answer.fit.evidence + prior < light.fit.evidence + needed:
        return None
    is_as_good = answer.share_left(trial.problems) < GROWN * light.share_left(model.problems)
    if model.problems[0].flash is not None:  # its highlight is most of that, and known as well as normals are
        is_as_good &= answer.fit.residual < GROWN * light.fit.residual
    return (trial, answer, better) if is_as_good else None


def _log_prior(rough: float, said) -> float:
    return -0.5 * ((rough - said.roughness) / USUAL) ** 2


def _hopeful(model, light, i: int, rough: float) -> float | None:
    """The roughness that explains a few of the pixels best, its prior counted, beside ``rough``; None: none promises.

    Steps go on as long as each is better than the one before.
    """
    said = model.problems[0].scene.job.objects[i].surface
    gained = gains_on_a_few(model, light, i)

    def gain(other: float) -> float:
        return gained(replace(said, roughness=other)) + _log_prior(other, said) - _log_prior(rough, said)

    best, most = None, HOPEFUL if rough == said.roughness else STILL_HOPEFUL
    is_gloss = rough < GLOSS and light.share_left(model.problems) < EXPLAINED
    for way in (-STEP,) if is_gloss else (STEP, -STEP):
        before, other = rough, _clipped(rough + way)
        while other != before and (found := gain(other)) > most:
            best, most = other, found
            before, other = other, _clipped(other + way)
    return best


def _clipped(rough: float) -> float:
    return float(np.clip(rough, LEAST, 1.0))
