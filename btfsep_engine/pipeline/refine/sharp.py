# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether the light has a sun: a lamp that is sharper than the fit's harmonics, 20 degrees wide, can be.

On gloss a sun leaves a highlight a few degrees wide, on anything the edges of shadows. Basis images of order 9 have
neither: what they make of a sun is bright where the photo is dark, and a fit of them takes the sun to be weaker and
wider than it is, the more so where the highlight itself is clipped. Here the brightest lamp has an image of its own
(`fit.sharp_lamp`), which is tried where what the light leaves over looks like it. Where that image is steep, at the
highlight's edge, it is only as good as the geometry's normals are, and counts for less there; a clipped highlight says
nothing. Whether the lamp is sharp, the evidence decides, of the same pixels with the same weights. What its own image
has beside the basis images is then taken off the photo, and what is left is one of light of order 9.
"""

from dataclasses import replace

import numpy as np

from btfsep_engine import sh
from btfsep_engine.conventions import across
from btfsep_engine.fit.diagnose import effect
from btfsep_engine.light.lightings import SHLighting
from btfsep_engine.pipeline.basis import USUAL
from btfsep_engine.pipeline.together import all_weights, fit_together, stacked
from btfsep_engine.render.beams import beam_radiance

CAP, LEAST = np.radians(25), 0.2  # about the brightest direction, and how much of the light has to come from there
# On 30 real photographs under lamps it is found on none, on 128 by Cycles on 8: the light of 5 errs less than without,
# of 2 as much, of one more. On one of lacquered wood that gains 20 it errs twice as much.
LOOKS, PART = 12.0, 0.3  # chi^2 of one degree of freedom, and how much of it: of what is left over looking like that
# image. On 12 photographs by Cycles under training lights they are 3 to 430 and 0.27 to 0.91; of the five whose first
# place gains more than 5, at least 32 and 0.54.
SPEAKS, CLEARLY = 5.0, 25.0  # of the logarithm of the evidence: where so little is gained at first, no place is sought
SETTLED = 1.0  # of it: a place that gains less than that over the last one is the last
SAME, CHEAP = np.radians(15), 10.0  # between a lamp and another fit's; of the logarithm of the evidence
FAINTEST = 0.1  # of the light: a fainter lamp gains by chance
RING, AROUND = np.radians(1.5), 6  # directions about the lamp's, between which its image is the mean
UNSURE = 3.0  # times what the image changes by from one to the next: as if normals were known to some 4 degrees
NOISE = 0.1  # of the photo's root mean square: what that is laid against
BRIGHTER, ASIDE = 0.2, np.radians(1)  # standard deviations of how bright it is and where it stands, once it is found
FARTHEST = np.radians(6)  # of one move of the lamp
TRIALS = 6  # of places, and of how bright the lamp is and what counts for less then
FOUND = "the brightest lamp is sharper than the harmonics are: it has an image of its own (by evidence)"


class OwnImage:
    """A lamp's image by itself, of all photographs' pixels, for an irradiance of 1.

    Attributes
    ----------
    direction : (3,), to the lamp
    image : (p, 3), the mean over a ring about it; slopes : (2, p, 3), by the angles `across` it, radians
    spread : (p, 3), standard deviation over the ring
    excess : (p, 3), the image less what the basis images have of it
    """

    def __init__(self, problems, direction):
        self.direction = direction / np.linalg.norm(direction)
        turns = 2 * np.pi / AROUND * np.arange(AROUND)
        aside = np.tan(RING) * np.stack([np.cos(turns), np.sin(turns)], 1)  # (AROUND, 2)
        beams = self.direction + np.concatenate([np.zeros((1, 3)), aside @ across(self.direction)])
        beams /= np.linalg.norm(beams, axis=1, keepdims=True)
        parts = [beam_images(problem, beams) for problem in problems]
        each = np.concatenate([images for images, _ in parts])  # (p, beams, 3)
        self.image, self.spread = each.mean(1), each.std(1)
        self.slopes = np.einsum("ka,pkc->apc", aside * 2 / (AROUND * np.tan(RING) ** 2), each[:, 1:])
        self.excess = self.image - np.concatenate([smooth for _, smooth in parts])

    def weights(self, irradiance, rms, known) -> np.ndarray:
        """(p, 3): how much the pixels count, of which ``known`` (p, 3) have been, beside a lamp of an irradiance."""
        return known / (1 + np.square(UNSURE * irradiance * self.spread / (NOISE * rms)))


def beam_images(problem, beams) -> tuple[np.ndarray, np.ndarray]:
    """Of beams (n, 3) of irradiance 1 what comes straight from them, (p, n, 3); of the first by order 9, (p, 3)."""
    scene, exact, smooth = problem.scene, [], []
    directions = problem.transport.get("directions", USUAL)  # the basis images' own, so that errors are theirs, too
    order = sh.order_of(problem.basis[0].shape[1])
    towards = np.repeat(sh.evaluate(order, beams[0])[:, None], 3, 1)
    straight = problem.transport["bounces"] == 1 and problem.transport["by"] == "kernel"
    for points, material, basis in zip(problem.points, problem.materials, problem.basis, strict=True):
        unit = scene.millimetres_per_unit
        own = beam_radiance(scene.tracer, points, material, beams, millimetres_per_unit=unit)
        if material.mirror_reflectance is not None:  # it shows nothing of light without extent
            by_order = own[:, 0]
        elif straight:
            by_order = np.einsum("ptc,tc->pc", basis, towards)
        else:
            by_order = scene.radiance(points, material, SHLighting(towards), directions=directions)[:, 0]
        exact.append(own.astype(np.float64))
        smooth.append(by_order.astype(np.float64))
    return np.concatenate(exact), np.concatenate(smooth)


def sharp_lamps(model, light):
    """The refinement: the brightest lamp with an image of its own; where lamps are given or near, none is sought."""
    if light.solver is None or light.solver.given or light.near:
        return model, light, {}
    with model.reporter.stage("fit"):
        direction = light.solver.brightest_direction(light.fit)
        irradiance = irradiance_around(light.fit, direction)
        if irradiance.sum() < LEAST * np.sqrt(4 * np.pi) * light.fit.all_coefficients[0].sum():
            return model, light, {}
        found = sharp_lamp(model, light, direction, irradiance)
        if found is None:
            return model, light, {}
        free = model_beside(model, light, *found)
        answer = fit_together(free.problems, replace(model.settings, order=light.order), beside=light.fit)
        return free, with_its_lamp(answer, found[0].direction), {"sharp": FOUND}


def with_its_lamp(light, direction):
    """The light with a lamp towards a direction, in place of a free sky that is as bright there, if it costs little."""
    if any(lamp.direction @ direction > np.cos(SAME) for lamp in light.fit.lamps):
        return light
    fit = light.solver.with_lamp(light.fit)
    stands = any(lamp.direction @ direction > np.cos(SAME) for lamp in fit.lamps)
    return replace(light, fit=fit) if stands and fit.evidence > light.fit.evidence - CHEAP else light


def model_beside(model, light, lamp, irradiance, weights):
    """The model whose photos are less what a sharp lamp makes of them, as well as that is known."""
    departures = [BRIGHTER * lamp.excess, *(ASIDE * lamp.slopes)]
    departures = irradiance * np.stack(departures, 1)  # (p, 3, 3)
    changes, start = [], 0
    for problem, exposure in zip(model.problems, light.exposures, strict=True):
        part = slice(start, start := start + len(problem.pixels))
        own = [] if problem.slopes is None else [problem.slopes]
        changes.append(
            {
                "correction": exposure * irradiance * lamp.excess[part],
                "weights": weights[part],
                "slopes": np.concatenate([*own, departures[part]], 1),
            }
        )
    return model.changed(lambda p, change: replace(p, **change), changes)


def irradiance_around(fit, direction) -> np.ndarray:
    """(3,), of all of a fit's light within `CAP` of a direction, in the colour that the object gives it."""
    election, field = fit.election, fit.election.solution.model.field
    inside = field.directions @ direction > np.cos(CAP)
    share = 4 * np.pi / len(field.directions) if len(field.directions) > 1 else 2 * np.pi * (1 - np.cos(CAP))
    of_field = election.solution.radiance[:, inside if inside.size > 1 else slice(None)].sum(1) * share
    lamps = [e for d, e in election.lamps if d @ direction > np.cos(CAP)]
    return of_field * election.photo.level + sum(lamps, np.zeros(3))


def sharp_lamp(model, light, direction, irradiance):
    """An OwnImage of the brightest lamp, its irradiance (3,), and the pixels' weights (p, 3); None: it is not sharp."""
    problems, solver, b = model.problems, light.solver, light.radiance(model.problems)
    own, clipped = all_weights(problems), np.concatenate([p.clipped for p in problems])
    known = np.where(clipped, 0.0, 1.0 if own is None else own)
    rms = np.sqrt((known * b**2).sum(0) / np.maximum(known.sum(0), 1.0))
    best, most = None, -np.inf
    for _ in range(TRIALS):
        lamp = OwnImage(problems, direction)
        weights = lamp.weights(irradiance, rms, known)
        if not weights.sum(0).all():
            break
        if best is None and not looks_sharp(light, problems, irradiance * lamp.excess, weights):
            return None
        irradiance, x, gain = solver.sharp_lamp(b, light.fit, lamp.direction, lamp.excess, weights=weights)
        if gain < max(most, SPEAKS) or irradiance.sum() < FAINTEST * np.sqrt(4 * np.pi) * x[0].sum():
            break
        grew, best, most = gain - most, (lamp, irradiance, weights), gain
        if grew < SETTLED:
            break
        left = b - irradiance * lamp.excess - solver.basis.predicted(x)
        move = asked_move(left, irradiance * lamp.slopes, weights / solver.basis.response**2)
        direction = lamp.direction + move @ across(lamp.direction)
    return best if most > CLEARLY else None


def looks_sharp(light, problems, excess, weights) -> bool:
    """Whether what a light leaves over looks like what a lamp's own image has beside the basis images, (p, 3)."""
    unit = np.sqrt(weights) / light.solver.basis.response
    column = light.solver.smoother(light.fit)(excess) * unit
    found = effect(light.left_over(problems) * unit, column[None], stacked(problems)[1])
    return found.chi2 > LOOKS and found.size[0] > PART


def asked_move(left, slopes, weights) -> np.ndarray:
    """The angles (2,) by which a lamp's misfit (p, 3) asks it to move, no more than `FARTHEST`."""
    gram = np.einsum("apc,bpc,pc->ab", slopes, slopes, weights)
    step = np.linalg.solve(gram + 1e-9 * np.trace(gram) * np.eye(2), np.einsum("apc,pc,pc->a", slopes, left, weights))
    return step * min(1.0, FARTHEST / max(float(np.linalg.norm(step)), 1e-12))
