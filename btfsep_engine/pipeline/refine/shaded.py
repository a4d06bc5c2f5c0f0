# SPDX-License-Identifier: GPL-3.0-or-later
"""Shadows of what no job knows: a branch, a wall or a hand that keeps the sun from a part of the objects.

The objects' own shadows are in the basis images. One from elsewhere is not, and its edges leave much over, which light
from all over then imitates. Where whole parts of the objects are not explained, it is asked whether a lamp is kept from
some of the pixels (`fit.cast_shadows`): of beams from all over, which one leaves least over beside smooth light, and
which pixels see it. Its own image, as far as it is seen, takes the place of what the basis images have of it
(`fit.sharp_lamp`); the light, how much of the lamp each pixel sees, and where it stands are then found by turns. In
half-shade pixels count for less. It is kept where that explains the photo far better than a lamp that lights all.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from btfsep_engine.conventions import across, fibonacci_sphere
from btfsep_engine.fit.cast_shadows import FINE, FINEST, ShadowSearch, neighbours, seen_of_lamp
from btfsep_engine.light.sun import cap_around
from btfsep_engine.pipeline.refine.misshapen import patch_misfit
from btfsep_engine.pipeline.refine.sharp import OwnImage, OwnImages, asked_move, model_beside, with_its_lamp
from btfsep_engine.pipeline.together import APART, all_weights, fit_together
from btfsep_engine.render.beams import beam_radiance

MUCH, POOR = 0.05, 0.08  # misfit of patches, and of all that is left over, with which it is asked
BEAMS, PIXELS = 400, 700  # directions, 10 degrees apart, and how many of all pixels are asked about all of them
LEAST = 0.03  # of the brightest beam's: one that lights less is none that casts a shadow
BEST, ASIDE, FINER = 3, np.radians(12), 24  # of them; apart from each other; beams about each
ROUNDS = 5  # of the light, of what pixels see of the lamp, and of where it stands
CLEARLY, FALLS = 50.0, 0.7  # of the logarithm of the evidence; of what is left over
FOUND = "something that the job does not know casts a shadow on the objects: {} % of what faces the lamp does not see it"


@dataclass(frozen=True)
class Shaded:
    """A lamp that some pixels see: its direction (3,), how much of it each sees (p,), 0 to 1, what is left over."""

    direction: np.ndarray
    seen: np.ndarray
    left: float


def in_shadow(lamp: OwnImage, seen) -> OwnImage:
    """A lamp's image where ``seen`` (p,), 0 to 1, of it is seen; how much is, is not known where it is a part."""
    out, part = object.__new__(OwnImage), seen[:, None]
    out.direction, out.image, out.slopes = lamp.direction, part * lamp.image, part * lamp.slopes
    out.spread = np.hypot(part * lamp.spread, np.sqrt(part * (1 - part)) * lamp.image)
    out.excess = lamp.excess - (1 - part) * lamp.image
    return out


class Shadows:
    """The search for what casts shadows, in all photographs' pixels."""

    def __init__(self, model, light):
        self.problems, self.light, self.solver = model.problems, light, light.solver
        self.b, own = light.radiance(self.problems), all_weights(self.problems)
        clipped = np.concatenate([p.clipped for p in self.problems])
        self.known = np.where(clipped, 0.0, 1.0 if own is None else own)
        self.rms = np.sqrt((self.known * self.b**2).sum(0) / np.maximum(self.known.sum(0), 1.0))
        self.pixels = np.concatenate([p.pixels + [i * APART, 0] for i, p in enumerate(self.problems)])
        self.around = neighbours(self.pixels, deviation=FINE, farthest=FINEST)

    def beams(self, directions, some) -> np.ndarray:
        """Images of beams (n, 3) on ``some`` (p,) bool of the pixels: (some, n, 3)."""
        ends, out = np.cumsum([len(p.pixels) for p in self.problems])[:-1], []
        for problem, used in zip(self.problems, np.split(some, ends), strict=True):
            part = problem.subset(used)
            for points, material in zip(part.points, part.materials, strict=True):
                unit = problem.scene.millimetres_per_unit
                how = {"millimetres_per_unit": unit}
                out.append(beam_radiance(problem.scene.tracer, points, material, directions, **how))
        return np.concatenate(out)

    def likely(self) -> list[Shaded]:
        """The lamps that leave least over, the best first, no two of them close together."""
        step = -(-len(self.b) // PIXELS)
        some = np.arange(len(self.b)) % step == 0
        basis = np.concatenate([p.all_basis for p in self.problems])[some]
        around = neighbours(self.pixels[some])
        search = ShadowSearch(basis, self.b[some], self.known[some], around)
        directions = fibonacci_sphere(BEAMS)
        images = self.beams(directions, some)
        bright = images.mean((0, 2))
        there = bright > LEAST * bright.max()
        directions, images = directions[there], images[:, there]
        lit, _, left = search.lit(images)
        out = []
        while len(out) < BEST and np.isfinite(left).any():
            i = int(left.argmin())
            finer = cap_around(directions[i], ASIDE / 2, FINER)
            seen, _, rest = search.lit(self.beams(finer, some), lit[:, i])
            k = int(rest.argmin())
            # each pixel as the nearest of those that were asked
            out.append(Shaded(finer[k], self._of_all(seen[:, k], some), float(rest[k])))
            left = np.where(directions @ directions[i] > np.cos(2 * ASIDE), np.inf, left)
        return out

    def _of_all(self, values, some) -> np.ndarray:
        nearest = cKDTree(self.pixels[some]).query(self.pixels)[1]
        return values[nearest].astype(np.float64)

    def settled(self, first: Shaded):
        """A lamp, what is seen of it and the light, found by turns: (OwnImages, evidence, seen) of the best."""
        direction, seen, best, last = first.direction, first.seen, None, None
        own = OwnImage(self.problems, direction)
        irradiance = self._irradiance(own, seen)
        for _ in range(ROUNDS):
            found = OwnImages((in_shadow(own, seen),)).at(irradiance[None], self.rms, self.known)
            how = {"weights": found.weights, "start": last}
            excess = found.lamps[0].excess[:, None]
            last = self.solver.sharp_lamps(self.b, self.light.fit, direction[None], excess, **how)
            irradiance = last.irradiances[0]
            found = replace(found, irradiances=last.irradiances)
            predicted = self.solver.basis.predicted(last.x)
            left = self.b - predicted - found.excess
            if best is None or last.evidence > best[1]:
                best = found, last.evidence, seen
            if not irradiance.any():
                break
            scale = 1 / self.solver.basis.response**2
            move = asked_move(left, irradiance * found.lamps[0].slopes, found.weights * scale)
            turned = own.direction + move @ across(own.direction)
            of_lamp = self.b - predicted + irradiance * (own.image - own.excess)
            seen = seen_of_lamp(of_lamp, irradiance * own.image, self.known * scale, self.around)
            own = OwnImage(self.problems, turned)
            direction = own.direction
        return best

    def _irradiance(self, own, seen):
        image = seen[:, None] * own.image
        power = (self.known * image**2).sum(0)
        return np.maximum(0.5 * (self.known * image * self.b).sum(0) / np.maximum(power, 1e-300), 0)


def cast_shadows(model, light):
    """The refinement: a lamp that something keeps from a part of the objects."""
    if light.solver is None or light.solver.given or light.fit.residual < POOR:
        return model, light, {}
    if patch_misfit(model.problems, light) < MUCH:
        return model, light, {}
    with model.reporter.stage("fit"):
        shadows = Shadows(model, light)
        tried = [shadows.settled(one) for one in shadows.likely()]
        found, _, seen = max(tried, key=lambda each: each[1])
        if not found.irradiances.any():
            return model, light, {}
        free = model_beside(model, light, found)
        answer = fit_together(free.problems, replace(model.settings, order=light.order), beside=light.fit)
        answer = with_its_lamp(answer, found.lamps[0].direction)
    if DEBUG: DEBUG.append(dict(tried=tried, before=light.fit, after=answer.fit, seen=seen, found=found, shadows=shadows))
    if answer.fit.evidence < light.fit.evidence + CLEARLY or answer.fit.residual > FALLS * light.fit.residual:
        return model, light, {}
    facing = found.lamps[0].image.sum(1) > 0
    return free, answer, {"shadow": FOUND.format(round(100 * float(1 - seen[facing].mean())))}

DEBUG = []
