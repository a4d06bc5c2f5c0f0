# SPDX-License-Identifier: GPL-3.0-or-later
"""A table or floor that the photo shows is evidence of the light: its shadows.

What the objects say stands: the ground's shadows are fitted beside them (`fit.ground`), light between surfaces counted,
and the answer is taken unless it explains the objects far worse. It may be matte, satin, or as rough as the job says:
that under which objects and ground are the most probable. Nobody has said that it is of one colour: where the light
does not explain all that it shows, it counts for less, the further what is left over goes together from place to place.
Where its light lies farther from the objects' own than was to be expected, one of them is wrong, and that is stated.
"""

from dataclasses import replace

import numpy as np

from btfsep_engine.btf.surfaces import Surface
from btfsep_engine.fit.ground import Ground
from btfsep_engine.fit.stated import expected_error, shown_error, widened
from btfsep_engine.pipeline.ground_places import places_of, shadows_on, tried_as_evidence, used_as_evidence
from btfsep_engine.pipeline.together import all_weights

WORSE = 1.3  # of the objects' residual: a ground that asks for so much more speaks of something else than their light
TOO_BRIGHT = 3.0  # times the light of the objects alone: lamps that reach next to nothing may be of any strength
# Of the ground's root mean square, not explained: what is of one colour leaves 2 to 5 %, light between surfaces is
# known to 2. Where more is left over, places beside each other go together in it, and count for less. Of 37 plates on
# tables of one colour, at which this was chosen, 20 leave less: they err 0.73 times as much, two by a tenth more.
SURELY = 0.035
PATTERN = 0.15  # from so much on a ground has a pattern; of less, others' shadows are as likely
FAINTEST = 0.5  # of its square, times the places that count as one: more says nothing of the light
WORTH, WIDEST = 1.1, 4.0  # times what is stated, of a light that a ground which was not used speaks against
# A ground's light that lies so far from the objects' own is a surprise: times what was stated of that; of all light.
SURPRISING, FAR = 2.0, 0.1
MATTE, SATIN = 1.0, 0.5  # roughnesses that are tried beside its own; the second is that of a new Blender material


def looks_of(scene, k: int) -> dict:
    """What an occluder may be like: {roughness: Surface}, None for a matte one, whatever the job says.

    Nobody has looked at the roughness of most tables: where it is wrong, lamps explain what gloss does.
    """
    surface = scene.job.occluders[k].surface
    if surface is None or k in scene.colours:
        colour = scene.occluder_albedos[k]
    else:
        colour = surface.base_color if surface.image is None else surface.image.mean((0, 1))
    base = tuple(float(c) for c in np.clip(colour, 0, 1))
    out = {MATTE: None, SATIN: Surface(base, SATIN)}
    own = surface and replace(surface, base_color=base, image=None)
    if own and own.plain and own.specular:
        out.setdefault(own.roughness, own)
    return out


def grounds_of(problems, exposures, settings, chosen) -> list[Ground]:
    """What the photos show of the ground, in the first one's exposure, by each of `looks_of`; [] if it is too little.

    ``chosen`` : for each photo, the numbers of its occluders that are ground
    """
    seen = [
        (problem, k, *places, exposure)
        for problem, exposure, numbers in zip(problems, exposures, chosen, strict=True)
        for k in numbers
        if (places := places_of(problem.scene, k)) is not None
    ]
    looks = [looks_of(problem.scene, k) for problem, k, *_ in seen]
    return [_ground_like(look, seen, looks, settings) for look in dict.fromkeys(r for each in looks for r in each)]


def _ground_like(look, seen, looks, settings) -> Ground:
    """The Ground where all that may be of a roughness ``look`` is; the others are matte."""
    parts: list = []
    for (problem, _, points, radiance, exposure), known in zip(seen, looks, strict=True):
        off = (points.position - points.position.mean(0)) / problem.scene.tracer.radius
        at = off @ np.linalg.svd(off, full_matrices=False)[2][:2].T
        shadows = shadows_on(problem.scene, problem.materials, points, settings)
        response = shadows.response(points, known.get(look))
        parts.append((response, radiance / exposure, np.full(len(points), len(parts)), at))
    return Ground(*(np.concatenate(each) for each in zip(*parts, strict=True)))


def ground(model, light):
    """The refinement: the light that objects and ground explain together."""
    problems, settings = model.problems, model.modelled
    chosen = [used_as_evidence(p.scene.job, model.settings) for p in problems]
    asked = any(chosen)
    if not asked:
        chosen = [tried_as_evidence(p.scene, model.settings) for p in problems]
    if not any(chosen):
        return model, light, {}
    if settings.estimator != "map" or settings.transport != "kernel":
        why = "not used as evidence: that needs --estimator map and --transport kernel"
        return model, light, {"ground": why} if asked else {}
    if light.near:
        return model, light, {"ground": "not used as evidence: a lamp stands near"} if asked else {}
    with model.reporter.stage("ground"):
        found, why = _beside(model, light, chosen, asked)
    return model, found, {"ground": why}


def _beside(model, light, chosen, asked: bool) -> tuple:
    """The SolvedLight beside the ``chosen`` occluders of each photograph, and what is said of that."""
    problems = model.problems
    looks = grounds_of(problems, light.exposures, model.modelled, chosen)
    if not looks:
        return light, "not used as evidence: the photo shows too little of it"
    photo, how = (light.radiance(problems), light.fit), {"weights": all_weights(problems)}
    shown = max(looks, key=lambda one: light.solver.ground_evidence(*photo, one, **how))
    fit = whole = light.solver.beside_ground(*photo, shown, **how)
    noise, alike = unexplained(fit), 1.0
    if noise > SURELY:
        alike = fit.election.photo.alike(fit.election.solution)
        if noise**2 * alike > FAINTEST:
            why = f"it is not of one colour, or not matte ({100 * noise:.0f} % is not explained)"
            return light, f"not used as evidence: {why}"
        fit = light.solver.beside_ground(*photo, shown, alike=alike, **how)
    brighter = float(fit.all_coefficients[0].mean() / light.fit.all_coefficients[0].mean())
    if not brighter < TOO_BRIGHT:  # nor what is no number
        return light, f"not used as evidence: its light would be {brighter:.0f} times the objects'"
    if fit.residual > WORSE * light.fit.residual:
        if asked:
            model.reporter.warn(
                "what is seen of the ground does not go with the objects: the light that explains its shadows explains "
                "them far worse, so it was left out; it may not be matte, lie elsewhere, or show other things' shadows"
            )
        light, words = _disagreed(light, fit)
        return light, f"not used as evidence: it speaks against the objects{words}"
    why = f"used as evidence: the light explains what is seen of it but for {100 * unexplained(fit):.0f} %"
    used, words = replace(light, fit=fit, alone=light.fit), ""
    if 1 < alike and noise < PATTERN:
        used, words = _disagreed(used, whole)
    apart = _apart(light.fit, fit)
    if not words and apart > FAR and apart > SURPRISING * _stated(light.fit):
        used, words = _disagreed(used, light.fit)
    if alike == 1:
        return used, f"{why} (its colour is free){words}"
    return used, f"{why}, a pattern or others' shadows, of which {alike:.0f} places count as one{words}"


def unexplained(fit) -> float:
    """How much of what is seen of a ground the light of a Fit beside it leaves over, relative."""
    return float(np.sqrt(np.mean(fit.election.solution.v[3:] / fit.election.photo.energy)))


def _disagreed(light, fit) -> tuple:
    """A light of which is stated that it errs as much as it differs from ``fit``, the one that was not taken.

    Gives the SolvedLight, and words to add.
    """
    if light.fit.samples is None:
        return light, ""
    apart = _apart(light.fit, fit)
    factor = min(apart / max(_stated(light.fit), 1e-9), WIDEST)
    if factor < WORTH:
        return light, ""
    words = f"; its light differs by {100 * apart:.0f} %, what is known of light is stated {factor:.1f} times as wide"
    return replace(light, fit=widened(light.fit, factor)), words


def _apart(fit, other) -> float:
    """The error up to order 2 of one Fit's light, were the ``other``'s the true one."""
    return expected_error(other.shown, fit.shown[None])["order_2"]["median"]


def _stated(fit) -> float:
    """The error up to order 2 that is stated of a Fit's light; infinite where nothing is."""
    if fit.samples is None:
        return np.inf
    stated = shown_error(fit) or expected_error(fit.all_coefficients, fit.samples)
    return stated["order_2"]["median"]
