# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether lamps stand near: where what is left over looks like what nearness would make of bright parts of the light.

What may be lamps is put at the best of a few distances, and its places go from there where the photo asks for it
(`near_places`). They are believed where they explain the photo clearly better than lamps far away. What is stated of
the light, of lamps above all, is then of the objects' middle. A lamp whose direction is given is taken to be far away.
"""

from dataclasses import replace

import numpy as np

from btfsep_engine import sh
from btfsep_engine.conventions import fibonacci_sphere
from btfsep_engine.fit.diagnose import effect
from btfsep_engine.fit.near_lamp import MOUND
from btfsep_engine.fit.stated import Fit
from btfsep_engine.light.sun import Near
from btfsep_engine.pipeline.refine.curves import curve_doubts
from btfsep_engine.pipeline.refine.near_places import FARTHEST, NEAREST, Lamp, Photographed, Placed, followed
from btfsep_engine.pipeline.refine.sharp import has_own_images
from btfsep_engine.pipeline.scene import unseen_meshes

# Of the misfit's square, left by the nearness of all lamps at the first of `RADII`, or of the brightest, as bright as
# the light has them: where softboxes stand near 0.2 to 0.92, or a ball at up to 3.5 radii 0.4 to 0.97; of 27 plates
# under light from far away it is more on all but three
SPEAKS = 0.975
# And how much that looks like it: chi^2 of one degree of freedom. Where softboxes stand near 20 and more (but once 9),
# or a ball 13 and more; where a light is explained badly for another reason, 1 to 10
LOOKS_NEAR = 12.0
# On 30 real photographs under lamps far away no place was believed with this, on two of 57 plates under natural light
# one was; a lamp at 3.5 radii that gives half of the light gains 18 to 150, where the material is right. Of depths,
# whose slopes are less sure, those of a painted owl gain 16 to 36.
CLEARLY, OF_A_DEPTH = 20.0, 40.0  # of the logarithm of the evidence
# And that of the brightest lamp alone, of gloss, which has to leave over less than light from far away: of two lamps
# near a nappa or a granite 10 and more, and 0.88 to 0.99 times as much; where three were found and none was there -12
# to 18, and 1.00 to 1.02, or 0.97 with -12
ALONE = 5.0
# Of what is left over, at most: places that only make the light plainer are none. Where light from far away gained 20
# to 90, 0.95 and more was left; where softboxes stand near, 0.1 to 0.9. Of gloss, whose highlights are left over either
# way, it may be all (0.96 to 1.01 where a ball stands near), where that looks like the nearness of the brightest lamp
LEAVES, LEAVES_WHERE_IT_SPEAKS = 0.9, 1.02
RADII = (8.0, 4.0, 2.0)  # of the objects: the distances that are tried first
MOST = 3  # lamps
# Where one lamp stands near, others hardly stand far away: of the logarithm of the evidence that they ask; of the first
# one's irradiance
FURTHER, LEAST, TRIES = 3.0, 0.1, 2
AROUND = fibonacci_sphere(2000)
METAL = 0.5  # metallic
BLUR = 0.08  # of a distance: lamps are as wide as the basis lights are, which no evidence knows


def near_lamps(model, light):
    """The refinement: how near the lamps of a light are, the brightest first."""
    if model.settings.estimator != "map" or light.near:
        return model, light, {}
    if any(problem.scene.mirrors for problem in model.problems):
        return model, light, {"near": "light is taken to come from far away: what mirrors show was put together so"}
    if has_own_images(model):
        return model, light, {"near": "light is taken to come from far away: a shadow falls on the objects"}
    things = model.problems[0].scene.job.objects
    if any(is_metal(made_of, thing.surface) for made_of, thing in zip(model.materials[0], things, strict=True)):
        why = "light is taken to come from far away: a metal shows lamps sharper than the fit has them, near or far"
        return model, light, {"near": why}
    if model.highlights:
        why = "light is taken to come from far away: what looks like lamps nearby may be highlights"
        return model, light, {"near": why}
    with model.reporter.stage("fit"):
        scene = Photographed(model, light)
        lamps = bright_lamps(scene)
        if not speak_for_nearness(scene, lamps):
            why = "light comes from far away: nothing in the photo looks like a lamp nearby"
            return model, light, {"near": why}
        if curve_doubts(model.problems, light):
            why = "light is taken to come from far away: what looks like a lamp nearby may be the photo's tone curve"
            return model, light, {"near": why}
        found = placed_lamps(scene, lamps)
    if found is None:
        why = "light is taken to come from far away: no lamp nearby explains the photo clearly better"
        return model, light, {"near": why}
    return nearer(scene, model, light, found)


def is_metal(made_of, surface) -> bool:
    """Whether an object is, by its `ObjectMaterial`, or by the Surface that its job says, if it does."""
    said = made_of.surface or surface
    return said.metallic >= METAL if said is not None else made_of.material.material_class == "metal"


def bright_lamps(scene: Photographed) -> tuple[Lamp, ...]:
    """What may be lamps nearby: the brightest that is in the light as from afar, and others that are not too dark."""
    fit, lamps = scene.light.fit, ()
    while len(lamps) < MOST:
        towards = brightest_left(fit, lamps) if lamps else scene.light.solver.brightest_direction(fit)
        more = (*lamps, Lamp(RADII[0] * towards))
        if lamps and too_dark(scene, fit, more):
            break
        lamps = more
    return lamps


def too_dark(scene: Photographed, fit: Fit, lamps) -> bool:
    """Whether the last of some lamps has too little of a light, beside the others."""
    *others, own = scene.mounds(fit, lamps)
    return bool(own.irradiance.mean() < LEAST * max(m.irradiance.mean() for m in others))


def brightest_left(fit: Fit, lamps) -> np.ndarray:
    """Where a light is brightest (3,), but for what is at one of some lamps' places."""
    light = fit.all_coefficients.mean(1)
    radiance = sh.evaluate(sh.order_of(len(light)), AROUND) @ light
    for lamp in lamps:
        radiance[AROUND @ lamp.direction > np.cos(np.radians(MOUND))] = -np.inf
    return AROUND[radiance.argmax()]


def clearly(problems) -> float:
    """How much larger the evidence has to be, its logarithm."""
    usual = OF_A_DEPTH if any(unseen_meshes(problem.scene.job) for problem in problems) else CLEARLY
    return usual / _counts_less(problems)


def _counts_less(problems) -> float:
    """How many times less pixels count, and so the evidence."""
    return max(problem.coarsening for problem in problems)


def speak_for_nearness(scene: Photographed, lamps) -> bool:
    """Whether the light's misfit looks like the nearness of all that may be lamps, or of the brightest, and has it."""
    each = scene.nearness_of(lamps, scene.mounds(scene.light.fit, lamps))
    return any(looks_near(scene, one) > LOOKS_NEAR and rest(scene, one) < SPEAKS for one in (sum(each), each[0]))


def rest(scene: Photographed, nearness) -> float:
    """What is left of the misfit's square, of the light as from afar, without so much of a ``nearness`` (p, 3)."""
    solver, left = scene.light.solver, scene.residual(scene.light.fit, 0.0)
    without = left - solver.smoother(scene.light.fit)(nearness) / solver.basis.response
    count = np.ones_like(left) if scene.weights is None else scene.weights
    return float((count * np.square(without)).sum() / max(float((count * np.square(left)).sum()), 1e-300))


def looks_near(scene: Photographed, nearness) -> float:
    """chi^2 of how much the misfit of the light as from afar looks like a ``nearness`` (p, 3); 0: like the opposite."""
    solver = scene.light.solver
    column = solver.smoother(scene.light.fit)(nearness) / solver.basis.response
    found = effect(scene.residual(scene.light.fit, 0.0), column[None], scene.blocks)
    return found.chi2 if found.size[0] > 0 else 0.0


def placed_lamps(scene: Photographed, lamps) -> Placed | None:
    """The lamps that stand near, of those that may, as `bright_lamps` has them, or None: from all of them on, or from
    the brightest, about which the light as from afar may have the others where none is.

    Where means of gloss are fitted (`pipeline.like_pixels`), several imitate what is wrong with highlights: there the
    brightest alone has to explain the photo better, too.
    """
    afar = scene.light.fit
    (brightest,) = scene.nearness_of(lamps[:1], scene.mounds(afar, lamps[:1]))
    most = afar.residual * (LEAVES_WHERE_IT_SPEAKS if looks_near(scene, brightest) > LOOKS_NEAR else LEAVES)
    starts = [lamps, lamps[:1]] if len(lamps) > 1 else [lamps]
    found = search(scene, starts, afar)
    if found.evidence < afar.election.evidence_of_photo + clearly(scene.problems) or found.fit.residual >= most:
        return None
    if _counts_less(scene.problems) > 1 and len(found.lamps) > 1:
        alone = search(scene, starts[-1:], afar)
        gains = alone.evidence > afar.election.evidence_of_photo + ALONE
        if not gains or alone.fit.residual >= afar.residual:
            return None
    # lamps that stood in for nearness are gone from a light that is elected anew
    found = followed(scene, scene.placed(found.lamps, scene.solve(found.correction, None)))
    found = without_idle(scene, with_further(scene, found))
    return found if found.fit.residual < most else None


def with_further(scene: Photographed, found: Placed) -> Placed:
    """The same with further lamps of its light, as long as they explain the photo better."""
    passed = ()
    while len(found.lamps) < MOST and len(passed) < TRIES:
        lamp = Lamp(found.lamps[0].radii * brightest_left(found.fit, (*found.lamps, *passed)))
        if too_dark(scene, found.fit, (*found.lamps, lamp)):
            break
        more = followed(scene, scene.placed((*found.lamps, lamp), found.fit))
        if more.evidence < found.evidence + FURTHER:
            passed = (*passed, lamp)
        else:
            found = followed(scene, scene.placed(more.lamps, scene.solve(more.correction, None)))
    return found


def without_idle(scene: Photographed, found: Placed) -> Placed:
    """The same without lamps that explain no more than if they stood far away."""
    for lamp in found.lamps:
        rest = tuple(other for other in found.lamps if other is not lamp)
        if not rest:
            break
        less = followed(scene, scene.placed(rest, found.fit))
        if less.evidence > found.evidence - FURTHER:
            return without_idle(scene, less)
    return found


def search(scene: Photographed, starts, afar: Fit) -> Placed:
    """The most probable places of lamps, from the best of a few distances on, if one is better than afar.

    ``starts`` : of lamps that may stand near, of which those are moved that explain most
    """
    tried = []
    for lamps in starts:
        fit, last = afar, -np.inf
        for radii in RADII:
            at = scene.placed(tuple(Lamp(radii * lamp.direction) for lamp in lamps), fit, turns=1)
            tried.append(at)
            if at.evidence < last:
                break
            fit, last = at.fit, at.evidence
    best = max(tried, key=lambda p: p.evidence)
    # where a lamp is believed, the best of these explains the photo clearly better already
    if best.evidence < afar.election.evidence_of_photo:
        return best
    return followed(scene, scene.placed(best.lamps, best.fit))


def nearer(scene: Photographed, model, light, found: Placed):
    """The model whose photos are less what lamps at their places make of them, its light, and what is said of it."""
    spread, lamps = np.sqrt(np.diag(scene.next_step(found)[1])).reshape(-1, 3)[:, 2], []
    for lamp, sigma in zip(found.lamps, np.hypot(spread, BLUR), strict=True):
        logarithm = min(1.96 * sigma, np.log(FARTHEST / NEAREST))  # one that nothing tells of is anywhere between
        between = np.clip(lamp.radii * np.exp(logarithm * np.array([-1, 1])), NEAREST, FARTHEST)
        distance, (low, high) = scene.radius * lamp.radii, scene.radius * between
        lamps.append((lamp.direction, Near(scene.centre, distance, float(low), float(high))))
    fit = max(scene.solve(found.correction, None), found.fit, key=lambda f: f.evidence)
    parts = np.split(found.correction, np.cumsum([len(p.pixels) for p in model.problems])[:-1])
    parts = [part * e for part, e in zip(parts, light.exposures, strict=True)]
    model = model.changed(lambda p, part: replace(p, correction=part), parts)
    metres = model.problems[0].scene.job.metres_per_unit
    each = [f"{metres * n.distance:.2g} m ({metres * n.low:.2g} to {metres * n.high:.2g} m)" for _, n in lamps]
    what = f"{'a lamp stands' if len(each) == 1 else f'{len(each)} lamps stand'} {' and '.join(each)}"
    why = f"{what} from the objects' middle, for which the light is stated (by evidence)"
    return model, replace(light, fit=fit, near=tuple(lamps)), {"near": why}
