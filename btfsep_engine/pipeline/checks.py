# SPDX-License-Identifier: GPL-3.0-or-later
"""Everything that speaks against an estimate, in words."""

from dataclasses import replace

import numpy as np

from btfsep_engine.fit.diagnose import diagnose
from btfsep_engine.fit.misalignment import silhouette_shift
from btfsep_engine.fit.search import BESIDE, LAMP_COST
from btfsep_engine.fit.stated import expected_error, of_reaching, stated_by
from btfsep_engine.pipeline.delighting import DE_LIT
from btfsep_engine.pipeline.doubts import (
    THRESHOLDS,
    alignment_doubt,
    clamped_share,
    given_lamp_doubts,
    structure_doubts,
)
from btfsep_engine.pipeline.light_account import colour_doubts
from btfsep_engine.pipeline.refine.curves import curve_doubts
from btfsep_engine.pipeline.refine.dusty import DUSTY
from btfsep_engine.pipeline.refine.in_front import OTHER_SHAPE
from btfsep_engine.pipeline.refine.interreflection import open_share
from btfsep_engine.pipeline.refine.layers import LAYERED
from btfsep_engine.pipeline.refine.look_alike import LOOK_ALIKE
from btfsep_engine.pipeline.refine.misshapen import UNEXPLAINED
from btfsep_engine.pipeline.refine.roughness import OTHERWISE as ROUGH_OTHERWISE
from btfsep_engine.pipeline.refine.said_surface import OTHERWISE, UNLIKE
from btfsep_engine.pipeline.refine.shaded import SHADOW
from btfsep_engine.pipeline.refine.sharp import has_own_images
from btfsep_engine.pipeline.scene import unseen_meshes
from btfsep_engine.pipeline.standing import STANDS
from btfsep_engine.pipeline.together import all_weights, stacked
from btfsep_engine.storage import kept

IN_ITS_PLACE = 45.0  # degrees between a lamp whose direction is given and the one that a photo has in its place
TONES_MATTER = 1.3  # times as wide as without other readings of a phone's picture


def all_doubts(estimate) -> list[str]:
    """What is to be said of an `estimation.Estimate`."""
    out = [doubt for problem in estimate.model.problems if (doubt := shift_doubt(problem.scene))]
    if not out and estimate.light.solver is not None:
        out += misfit_doubts(estimate)
    for photo, materials in zip(estimate.photos, estimate.model.materials, strict=True):
        for obj, m, residual in zip(photo.scene.job.objects, materials, photo.residuals, strict=True):
            if residual > THRESHOLDS.residual:
                out.append(
                    f"the light explains object '{obj.name}' poorly (relative residual {residual:.2f}): the material "
                    f"({m.name}), the geometry or the camera may be wrong"
                )
    out += known_lamp_doubts(estimate) + colour_doubts(estimate.fit) + uncertainty_doubts(estimate)
    out += shape_and_colour_doubts(estimate) + in_front_doubts(estimate) + gloss_doubts(estimate)
    out += veil_doubts(estimate)
    return out + curve_doubts(estimate.model.problems, estimate.light) + tones_doubts(estimate)


def tones_doubts(estimate) -> list[str]:
    """That a photo does not tell how far a phone has moved its tones (`pipeline.phone`), where that matters."""
    if not estimate.otherwise:
        return []
    known, alone = (
        expected_error(fit.all_coefficients, fit.samples)["order_2"]["median"]
        for fit in (estimate.fit, replace(estimate, otherwise=()).fit)
    )
    wider = known / max(alone, 1e-9)
    if wider < TONES_MATTER:
        return []
    return [
        "a phone moved the photo's tones from place to place, and the photo does not tell how far: what is known of "
        f"the light is stated {wider:.1f} times as wide; a picture that was taken as raw, or in a Pro mode, tells more"
    ]


def shape_and_colour_doubts(estimate) -> list[str]:
    """What was said on the way of a ground (`standing`), light in textures (`delighting`), shadows (`refine.shaded`),
    shapes (`refine.misshapen`, `refine.in_front`), surroundings (`refine.said_surface`), and of what the objects are
    made of."""
    of_surfaces = UNLIKE, ROUGH_OTHERWISE, LAYERED, DUSTY, LOOK_ALIKE
    keys = STANDS, DE_LIT, SHADOW, UNEXPLAINED, OTHER_SHAPE, OTHERWISE, *of_surfaces
    return [estimate.choice[key] for key in keys if key in estimate.choice]


def in_front_doubts(estimate) -> list[str]:
    """That pixels were left out which nobody asked to leave out (`refine.in_front`)."""
    problems = estimate.model.problems
    lost, left = sum(p.left_out or 0 for p in problems), sum(len(p.pixels) for p in problems)
    if estimate.settings.robust or not lost:
        return []
    return [
        f"{lost} of {lost + left} pixels show something else than the light explains: things in front of the objects, "
        "or what is behind them where a mesh reaches too far; they were left out; a mask that leaves them out is surer"
    ]


def gloss_doubts(estimate) -> list[str]:
    """That the photo shows highlights which no lamp explains either (`refine.in_front`)."""
    if not estimate.model.highlights or has_own_images(estimate.model):
        return []
    named = " or ".join(dict.fromkeys(m.material.name for each in estimate.model.materials for m in each))
    return [f"the photo shows highlights that are not those of {named}: the object has more gloss, or a coat"]


def veil_doubts(estimate) -> list[str]:
    """That something lies over a photo (`refine.veil`)."""
    out = []
    for problem in (p for p in estimate.model.problems if p.veil is not None):
        share = problem.veil.mean() / max(float((problem.veil + problem.radiance()).mean()), 1e-300)
        out.append(
            f"about {100 * share:.0f} % of the objects' brightness lies over the photo and never met them (haze, a "
            "pane, stray light; or a tone curve or things nearby that are not told of); it was taken off"
        )
    return out


def shift_doubt(scene) -> str | None:
    """That the photo's outline does not lie where the geometry says.

    The objects' alone: a table's edge runs across the picture, and shifted along it lies on itself.
    """
    frayed, photo, seen = bool(unseen_meshes(scene.job)), scene.job.photo.radiance, scene.shows_objects
    shift = kept.recalled("shift", [photo, seen, frayed], lambda: silhouette_shift(photo, seen, frayed=frayed))
    return alignment_doubt(shift)


def misfit_doubts(estimate) -> list[str]:
    """What the structure of the residual speaks for."""
    problems, light = estimate.model.problems, estimate.light
    points = [p for problem in problems for p in problem.points]
    effects = diagnose(
        light.solver,
        light.fit,
        light.radiance(problems),
        blocks=stacked(problems)[1],
        position=np.concatenate([p.position for p in points]),
        normal=np.concatenate([p.normal for p in points]),
        open_share=np.concatenate([open_share(q.scene, p) for q in problems for p in q.points]),
    )
    names = [m.name for materials in estimate.model.materials for m in materials]
    mirrored = any(p.scene.mirrors for p in problems)
    return structure_doubts(effects, residual=light.fit.residual, names=names, mirrored=mirrored)


def known_lamp_doubts(estimate) -> list[str]:
    """What the photo says of the lamps whose direction is given: it is fitted again without each of them.

    A lamp that is then found in its place is not counted as one more: that there is a lamp, is given.
    """
    problems, light, out = estimate.model.problems, estimate.light, []
    if light.solver is None and any(p.scene.job.known_lamps for p in problems):
        return ["lamps whose direction is given are left out: that needs --estimator map"]
    lamps = [lamp for lamp in light.fit.lamps if lamp.given]
    for lamp in lamps:
        number = next(i for i, (d, _) in enumerate(light.solver.given) if np.allclose(d, lamp.direction))
        free = light.solver.without_given(number).solve(
            light.radiance(problems), weights=all_weights(problems), beside=light.fit
        )
        there = [free.election.lamps[i][0] for i in free.election.found]
        instead = max(there, key=lambda d: d @ lamp.direction, default=None)
        if instead is not None and instead @ lamp.direction < np.cos(np.radians(IN_ITS_PLACE)):
            instead = None
        gain = free.evidence - light.fit.evidence + LAMP_COST * (instead is not None)
        shown = bool(light.solver.shows(lamp.direction))
        near = np.cos(np.radians(BESIDE))
        beside = any(not other.given and other.direction @ lamp.direction > near for other in light.fit.lamps)
        out += given_lamp_doubts(lamp, gain=gain, instead=instead, shown=shown, beside=beside)
    return out


def uncertainty_doubts(estimate) -> list[str]:
    """What the photo cannot tell."""
    out, lighting, estimator = [], estimate.lighting, estimate.settings.estimator
    count, terms = int(lighting.determined.sum()), len(lighting.determined)
    if estimator == "least-squares" and estimate.fit.condition > THRESHOLDS.condition:
        out.append(
            f"the fit is badly conditioned (condition number {estimate.fit.condition:.0f}): {count} of {terms} "
            "coefficients are determined by the photo; --estimator map or a lower --order is steadier"
        )
    if estimator == "map":
        known, of_what = lighting.determined, ""
        if estimate.fit.hidden is not None:  # of light from below a table nothing is known, and nothing needs it
            known, of_what = stated_by(*of_reaching(estimate.fit)).determined[:terms], " of the light that reaches it"
        if not known[: min(terms, 4)].all():
            out.append(
                f"the photo determines {int(known.sum())} of {terms} coefficients{of_what}, and not all of the first "
                "four, which hold the main direction of the light: the others are natural light's average; see stddev "
                "in lighting.json"
            )
    # the log-normal light is positive itself: what its series lacks is in lighting.exr
    clamped = 0.0 if estimator == "map" else clamped_share(lighting.sky)
    if clamped > THRESHOLDS.clamped:
        out.append(
            f"the estimated light is negative in some directions ({100 * clamped:.0f} % of its power), as a series of "
            f"order {lighting.order} can be; the World shows it dark there"
        )
    return out
