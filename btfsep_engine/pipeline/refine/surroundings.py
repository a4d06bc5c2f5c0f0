# SPDX-License-Identifier: GPL-3.0-or-later
"""What stands around the objects: what it reflects where the job does not say it, and words on it.

Where the light that occluders send is modelled and the job says of one of them no surface, it has the colour that the
photo shows of it (`refine.seen_colour`). Of what the photo does not show, or shows as what nothing agrees with, a few
greys stand for all. What a table sends comes from nearby, has the object's shadow in it, and goes with the light from
above: the photo tells greys apart, by evidence. Not exactly, so that what is stated is a mixture over those that are
nearly as probable.
"""

from dataclasses import dataclass, replace

import numpy as np

from btfsep_engine.fit.stated import restated
from btfsep_engine.pipeline.refine.seen_colour import by_own_pixels
from btfsep_engine.pipeline.scene import BRIGHTEST, GREY
from btfsep_engine.pipeline.together import fit_together

DARKEST, WHITE = 0.05, 0.95
TEMPER = 20.0  # of the logarithm of the evidence: it takes misfits of a few per cent for what they are not
PLAUSIBLE = 0.05  # probability of a grey whose light is among what is stated
APART = 0.04  # greys: nearer ones are not both tried
FINER = 2  # more greys, at most
UNSURE = 1.0  # of the logarithm of the evidence, by which a colour that is not sure has to be better than greys
TOO_BRIGHT = 3.0  # times the light of the darkest answer: light that hardly reaches the objects may be of any strength


@dataclass(frozen=True)
class Greys:
    """Greys that were tried, the most probable first, their probabilities (n,), and the samples of each one's light."""

    albedos: tuple
    shares: np.ndarray
    samples: tuple


def by_photo(direct, model, light, with_reflections):
    """A model with light between surfaces, what is not known in it as the photo has it; and its light.

    Parameters
    ----------
    direct, model : Model without and with light between surfaces; light : SolvedLight of the second
    with_reflections : Model -> the same with light between surfaces
    """

    def with_greys(direct, model, light):
        def of_grey(grey):
            return with_reflections(direct.changed(lambda p: replace(p, scene=p.scene.with_grey(grey))))

        return by_grey(model, light, of_grey)

    read = by_own_pixels(direct, model, light, with_reflections)
    if read is None:
        return with_greys(direct, model, light)
    coloured = with_greys(read.direct, read.model, read.light)
    if read.sure:
        return coloured
    greys = with_greys(direct, model, light)
    return coloured if coloured[1].fit.evidence > greys[1].fit.evidence + UNSURE else greys


def by_grey(model, light, of_grey):
    """A model with light between surfaces, what is not known in it of the most probable grey; and its light.

    Parameters
    ----------
    model, light : Model and SolvedLight, those of unknown surfaces of the grey `GREY`
    of_grey : grey -> the same Model with all that is not known of that grey
    """
    if light.fit.evidence is None or not any(p.scene.has_unknown for p in model.problems):
        return model, light
    trials = {GREY: (model, light)}

    def look_at(grey):
        trial = replace(of_grey(grey), appearance=model.appearance)
        settings = replace(model.settings, order=light.order)
        trials[grey] = trial, fit_together(trial.problems, settings, beside=light.fit)

    for grey in (DARKEST, BRIGHTEST):
        look_at(grey)
    for _ in range(FINER):
        between = _highest(believed(trials))
        if between is None:
            break
        look_at(between)
    fits = believed(trials)
    order = sorted(fits, key=lambda g: -fits[g].evidence)
    shares = np.exp([(fits[g].evidence - fits[order[0]].evidence) / TEMPER for g in order])
    greys = Greys(tuple(order), shares / shares.sum(), tuple(fits[g].samples for g in order))
    best, light = trials[order[0]]
    for problem in best.problems:
        problem.scene.greys = greys
    return best, light


def believed(trials) -> dict:
    """grey -> Fit, of those that were tried without such as hide a light of any strength behind an occluder."""
    fits = {grey: light.fit for grey, (_, light) in trials.items()}
    level = {grey: float(fit.all_coefficients[0].mean()) for grey, fit in fits.items()}
    return {grey: fit for grey, fit in fits.items() if level[grey] < TOO_BRIGHT * min(level.values())}


def _highest(fits) -> float | None:
    """Where a parabola through the best and its neighbours is highest, of the evidence's logarithm; None: tried."""
    greys = np.array(sorted(fits))
    logs = np.array([fits[g].evidence for g in greys])
    first = int(np.clip(logs.argmax() - 1, 0, max(len(greys) - 3, 0)))
    near, logs = greys[first : first + 3], logs[first : first + 3]
    if len(near) < 3:
        top = near.mean()
    else:
        a, b, _ = np.polyfit(near, logs, 2)
        top = -b / (2 * a) if a < 0 else near[logs.argmax()]
    top = round(float(np.clip(top, DARKEST, WHITE)), 3)
    return None if np.abs(greys - top).min() < APART else top


def surroundings(model, light):
    """The refinement: samples of the light in proportion to the greys' probabilities, and words on what was taken."""
    if not any(p.scene.job.occluders for p in model.problems):
        return model, light, {}
    light = replace(light, fit=with_other_greys(model.problems, light.fit))
    return model, light, {"surroundings": surroundings_words(model.problems)}


def with_other_greys(problems, fit):
    """The fit with samples of its light in proportion to the probabilities of the greys."""
    greys = problems[0].scene.greys
    if greys is None:
        return fit
    kept = greys.shares * (greys.shares > PLAUSIBLE)
    counts = np.floor(kept / kept.sum() * len(fit.samples)).astype(int)
    others = [s[len(s) - n :] for s, n in zip(greys.samples[1:], counts[1:], strict=True) if n]
    own = fit.samples[: len(fit.samples) - counts[1:].sum()]
    return restated(fit, np.concatenate([own, *others])) if others else fit


def surroundings_words(problems) -> str:
    """What the occluders were taken to reflect, and why."""
    said = []
    for scene in (p.scene for p in problems):
        count, seen = len(scene.job.occluders), scene.colours.values()
        given = sum(o.surface is not None and k not in scene.colours for k, o in enumerate(scene.job.occluders))
        unknown = count - given
        if given:
            said.append(f"the surface of {given} of {count} occluders is given")
        if seen:
            each = ", ".join("({:.2f}, {:.2f}, {:.2f})".format(*colour) for colour in seen)
            said.append(f"of {len(seen)} of {count} occluders the photo shows the colour: red, green, blue {each}")
            unknown -= len(seen)
        if not unknown:
            continue
        what = f"of {unknown} of {count} occluders it is not known what they reflect"
        if scene.greys is None:
            said.append(f"{what}: a grey of {scene.grey:.2f}, where it is modelled")
            continue
        each = [
            f"{grey:.2f} (probability {share:.2f})"
            for grey, share in zip(scene.greys.albedos, scene.greys.shares, strict=True)
            if share > PLAUSIBLE
        ]
        others = f"; also possible: {', '.join(each[1:])}" if each[1:] else ""
        said.append(f"{what}: by evidence a grey of {each[0]}{others}; give their 'surface', if you know it")
    return "; ".join(dict.fromkeys(said))
