# SPDX-License-Identifier: GPL-3.0-or-later
"""Shadows of what no job knows: a branch, a wall or a hand that keeps the sun from a part of the objects.

The objects' own shadows are in the basis images. One from elsewhere is not, and its edges leave much over, which light
from all over then imitates. Of beams from all over it is asked which one leaves least over beside smooth light, and
which pixels see it (`fit.two_kinds`). Its own image, as far as it is seen, takes the place of what the basis images
have of it (`fit.sharp_lamp`); the light, how much of the lamp each pixel sees, and where it stands are then found by
turns. In half-shade pixels count for less.
"""

from dataclasses import dataclass, replace

import numpy as np

from btfsep_engine.conventions import across, fibonacci_sphere
from btfsep_engine.fit.sharp_lamp import SharpLight
from btfsep_engine.fit.two_kinds import HOPEFUL, edges_of, in_between, share_of
from btfsep_engine.light.sun import cap_around
from btfsep_engine.pipeline.own_image import OwnImage, image_from_afar
from btfsep_engine.pipeline.refine.sharp import OwnImages, asked_move, model_beside, with_its_lamp
from btfsep_engine.pipeline.together import fit_together
from btfsep_engine.render.beams import beam_radiance

BEAMS = 400  # directions, 10 degrees apart
FIRST, FOLLOWED = 3, 60  # turns of which pixels see all of them, and those that are then followed to the end
LEAST = 0.03  # of the brightest beam's: one that lights less is none that casts a shadow
BEST, ASIDE, FINER = 5, np.radians(24), 24  # of them; farther apart from each other than that; beams about each,
AROUND = np.radians(6)  # so far away
ROUNDS, MORE, WORTH = 3, 8, 0.99  # of all of them; of the best; of what is left over: another round leaves less
RINGS = np.radians([15, 30])  # about the best of them: where else the lamp may stand,
HELD, CLIMBS = 2, 3  # turns of which pixels see it there; rings about one that is better
PROMISING = 1.5  # of what the best leaves over after the first rounds: others that leave more are given up
AS_WELL, SAME = 1.25, np.radians(5)  # of what the best leaves over: others leave no more; nearer, two lamps are one
# How far from seeing all of the lamp or nothing pixels may be away from edges: in shadows 0.01 to 0.06, of grey stains
# without edges 0.08 to 0.13.
HALF_SEEN = 0.07
SHADOW = "shadow"  # its name among what is chosen
FOUND = (
    "something that the job does not know casts a shadow on the objects: {} % of what faces the lamp does not see it "
    "(by evidence); the light goes by that, and is known better if what casts it is in the scene"
)


@dataclass(frozen=True)
class Shaded:
    """A lamp that some pixels see.

    Attributes
    ----------
    own : OwnImage of it where all see it; seen : (p,), how much of it each does
    found : OwnImages of it as it is seen; light : SharpLight of it and of a free sky
    rest : (p, 3), what these leave over of the photo; left : the same, relative
    """

    own: OwnImage
    seen: np.ndarray
    found: OwnImages
    light: SharpLight
    rest: np.ndarray
    left: float


def in_shadow(lamp: OwnImage, seen, unsure) -> OwnImage:
    """A lamp's image where ``seen`` (p,), 0 to 1, of it is seen, which is known to ``unsure`` (p,)."""
    part = seen[:, None]
    spread = np.hypot(part * lamp.spread, unsure[:, None] * lamp.image)
    excess = lamp.excess - (1 - part) * lamp.image
    return OwnImage(lamp.direction, part * lamp.image, part * lamp.slopes, spread, excess)


def _close(one: Shaded, other: Shaded) -> bool:
    return bool(one.own.direction @ other.own.direction > np.cos(SAME))


def rings_about(direction) -> np.ndarray:
    """(n, 3), unit directions in `RINGS` about one (3,)."""
    turns = np.pi / 3 * (np.arange(6) + np.arange(len(RINGS))[:, None] / 2)
    aside = np.stack([np.cos(turns), np.sin(turns)], -1) @ across(direction)
    return (np.cos(RINGS)[:, None, None] * direction + np.sin(RINGS)[:, None, None] * aside).reshape(-1, 3)


def beams_of(problems, directions, some) -> np.ndarray:
    """Images of beams (n, 3) on ``some`` (p,) bool of all photographs' pixels: (some, n, 3)."""
    ends, out = np.cumsum([len(p.pixels) for p in problems])[:-1], []
    for problem, used in zip(problems, np.split(some, ends), strict=True):
        part, unit = problem.subset(used), problem.scene.millimetres_per_unit
        for points, material in zip(part.points, part.materials, strict=True):
            own = beam_radiance(problem.scene.tracer, points, material, directions, millimetres_per_unit=unit)
            out.append(own)
    return np.concatenate(out)


class Shadows:
    """The search for a lamp that some pixels do not see; ``pixels`` : `pixels.Pixels`."""

    def __init__(self, pixels):
        self.pixels, self.solver = pixels, pixels.light.solver

    def found(self) -> list[Shaded]:
        """The likeliest lamps, the best first; none where no lamp has any light."""
        tried = [one for one in map(self._settled, self._likely()) if one is not None]
        least = PROMISING * min((one.left for one in tried), default=np.inf)
        each = sorted((self._onward(one, MORE) for one in tried if one.left <= least), key=lambda one: one.left)
        each = self._beside(each) if each and each[0].left < HOPEFUL * self.pixels.light.fit.residual else each
        kept: list[Shaded] = []
        for one in each:
            known = one.left < AS_WELL * each[0].left and not any(_close(one, other) for other in kept)
            if known and len(kept) < BEST and self._half_seen(one) < HALF_SEEN:
                kept.append(one)
        return kept

    def _beside(self, each: list[Shaded]) -> list[Shaded]:
        """The lamps, sorted, and those around the best: as long as one of these leaves less over, that is the best.

        Which pixels see a lamp is free, and makes up for much of where it stands: what a move asks for ends early.
        """
        for _ in range(CLIMBS):
            best = each[0]
            aside = [self._seen_from(best, direction) for direction in rings_about(best.own.direction)]
            least = min(aside, key=lambda one: one.left)
            each = sorted([*each, *aside], key=lambda one: one.left)
            if least.left > WORTH * best.left:
                break
            each = sorted([self._onward(least, MORE), *each], key=lambda one: one.left)
        return each

    def _seen_from(self, at: Shaded, direction) -> Shaded:
        """The lamp elsewhere, and what sees it then."""
        own = image_from_afar(self.pixels.problems, direction)
        for _ in range(HELD):
            at = self._seen_anew(at, own, at.found.irradiances[0] * own.image)
        return at

    def _seen_anew(self, at: Shaded, own: OwnImage, image) -> Shaded:
        """A lamp of which what sees it is found by its ``image`` (p, 3), with the light; ``own`` : of the lamp."""
        (irradiance,) = at.found.irradiances
        rest = self.pixels.b - self.solver.basis.predicted(at.light.x)
        of_lamp = rest + irradiance * (at.own.image - at.own.excess)
        scale = 1 / self.solver.basis.response**2
        seen = share_of(of_lamp, image, self.pixels.known * scale, self.pixels.around)
        return self._solved(own, seen, irradiance, at.light)

    def _likely(self):
        """Directions (3,) and which pixels (p,) see a lamp there, of those lamps that leave least over."""
        pixels, kinds = self.pixels, self.pixels.kinds
        directions = fibonacci_sphere(BEAMS)
        images = beams_of(pixels.problems, directions, pixels.some)
        bright = images.mean((0, 2))
        there = bright > LEAST * bright.max()
        directions, images = directions[there], images[:, there]
        lit, left = kinds.lit(images, kinds.brighter, FIRST)
        likely = np.argsort(left)[:FOLLOWED]
        directions, images = directions[likely], images[:, likely]
        lit, left = kinds.lit(images, lit[:, likely])
        for _ in range(BEST):
            if not left.min(initial=np.inf) < HOPEFUL * kinds.left:
                break
            i = int(left.argmin())
            finer = cap_around(directions[i], AROUND, FINER)
            seen, rest = kinds.lit(beams_of(pixels.problems, finer, pixels.some), lit[:, i])
            k = int(rest.argmin())
            yield finer[k], pixels.of_all(seen[:, k])
            left = np.where(directions @ directions[i] > np.cos(ASIDE), np.inf, left)

    def _settled(self, one) -> Shaded | None:
        direction, seen = one
        own = image_from_afar(self.pixels.problems, direction)
        image = seen[:, None] * own.image
        power = (self.pixels.known * image**2).sum(0)
        half = 0.5 * (self.pixels.known * image * self.pixels.b).sum(0) / np.maximum(power, 1e-300)
        first = self._solved(own, seen, np.maximum(half, 0), None)
        return self._onward(first, ROUNDS - 1) if first.found.irradiances.any() else None

    def _solved(self, own, seen, irradiance, start) -> Shaded:
        pixels = self.pixels
        found = OwnImages((in_shadow(own, seen, edges_of(seen, pixels.around)),)).at(
            irradiance[None], pixels.rms, pixels.known
        )
        how = {"weights": found.weights, "start": start}
        excess = found.lamps[0].excess[:, None]
        light = self.solver.sharp_lamps(pixels.b, pixels.light.fit, own.direction[None], excess, **how)
        found = replace(found, irradiances=light.irradiances)
        rest = pixels.b - self.solver.basis.predicted(light.x) - found.excess
        return Shaded(own, seen, found, light, rest, pixels.share(rest, pixels.known))

    def _half_seen(self, one: Shaded) -> float:
        image = one.found.irradiances[0] * one.own.image
        weights = self.pixels.known / self.solver.basis.response**2
        return in_between(one.rest + one.seen[:, None] * image, image, weights, self.pixels.around)

    def _onward(self, at: Shaded, rounds: int) -> Shaded:
        """A lamp moved to where it is asked to, and seen anew, as long as that leaves less over."""
        scale = 1 / self.solver.basis.response**2
        for _ in range(rounds):
            (irradiance,), (lamp,) = at.found.irradiances, at.found.lamps
            left = self.pixels.b - self.solver.basis.predicted(at.light.x) - irradiance * lamp.excess
            move = asked_move(left, irradiance * lamp.slopes, at.found.weights * scale)
            own = image_from_afar(self.pixels.problems, lamp.direction + move @ across(lamp.direction))
            now = self._seen_anew(at, own, irradiance * (at.own.image + np.einsum("a,apc->pc", move, at.own.slopes)))
            if now.left > WORTH * at.left:
                break
            at = now
        return at

    def lights(self, model, shaded: Shaded):
        """The model whose photos are less what the lamp makes of them, and its light."""
        free = model_beside(model, self.pixels.light, shaded.found)
        settings = replace(model.settings, order=self.pixels.light.order)
        answer = fit_together(free.problems, settings, beside=self.pixels.light.fit)
        return free, with_its_lamp(answer, shaded.own.direction)


def shadow_words(shaded: Shaded) -> str:
    """How much of what faces the lamp is in the shadow."""
    facing = shaded.own.image.sum(1) > 0
    return FOUND.format(round(100 * float(1 - shaded.seen[facing].mean())))
