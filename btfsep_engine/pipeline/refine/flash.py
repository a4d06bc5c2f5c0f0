# SPDX-License-Identifier: GPL-3.0-or-later
"""A flash on the camera: a bare lamp of which is known where it may be, beside the lens or a little above it.

Photos taken indoors often have one. It lights the near side of things more than the far one, leaves highlights on gloss
where the camera looks straight at it, and hardly a shadow that the camera sees: as light from far away, all of that
bends the light that is found. Since its place is known, its image is, too (`pipeline.own_image`): of a few places at
the lens and around it, the one stands that explains the photo best, if it does so clearly better than light from far
away, a lamp that is as sharp and as far away in the same direction included, and no lamps elsewhere stand near. It is
looked for before the materials are doubted, since a highlight that nobody expects makes a gloss rougher; materials that
are tried then have its image by themselves, and how bright it is, is asked once more when they are settled.
"""

from dataclasses import dataclass, replace

import numpy as np

from btfsep_engine.fit.sharp_lamp import SharpLight
from btfsep_engine.light.sun import Near
from btfsep_engine.pipeline.own_image import OwnImage, image_from_afar, image_from_nearby
from btfsep_engine.pipeline.problem import Flash
from btfsep_engine.pipeline.refine.near import LOOKS_NEAR, bright_lamps, looks_near, near_lamps, rest
from btfsep_engine.pipeline.refine.near_places import NEAREST, Photographed, middle_of
from btfsep_engine.pipeline.refine.sharp import (
    SAME,
    OwnImages,
    Pursuit,
    has_own_images,
    irradiance_around,
    likeness,
    model_beside,
    with_its_lamp,
)
from btfsep_engine.pipeline.together import fit_together

# From the lens, to the right and up, in the distance to the objects' middle: a telephone's is beside the lens, one that
# folds out of a camera is a hand's breadth above it, one that is put on it two; held upright, beside it
FIRST = 0.0, 0.1
OTHERS = (0.0, 0.0), (0.0, 0.2), (0.0, 0.3), (0.12, 0.0), (-0.12, 0.0)
UNSURE = 0.1  # of its distance: a standard deviation
FARTHEST = 15.0  # radii of the objects: what is farther away lights all of them alike
# How much what is left over looks like the first place's image: chi^2 of one degree of freedom. Of 64 plates under a
# flash four have less, and of 64 in other light 51
GLANCE = 12.0
# Of the logarithm of the evidence: what the first place gains, the best, and that over one as sharp and far away. Of 58
# of those 64 plates the best gains 12 and more, and 9 over one far away; in other light it gains 4 at most, but of two
# of metal, where it gains 11 and 18 and does not pass the glance
HOPEFUL, CLEARLY, NEARER = 3.0, 10.0, 8.0
LEAST = 0.05  # of the light
TURNS = 2  # of how bright it is, and of what counts beside it
# Of the misfit's square, what the nearness of lamps elsewhere would explain beside a flash, over what the flash does:
# where softboxes or two lamps stand near, of which one between them imitates some, 0.27 to 2.7; under a flash to 0.21
ELSEWHERE = 0.25
# What is left over beside a flash, with which lamps elsewhere are placed, and what these leave of that if there is no
# flash: of a lamp that stood aside, and between whose image and light from far away a flash was believed, 0.3
MUCH, LESS = 0.1, 0.7


@dataclass(frozen=True)
class Lit:
    """A flash that was tried.

    ``place`` : (3,), world; ``found`` : OwnImages with its own, as bright as the photo has it; ``light`` : the
    SharpLight of it and of a free sky; ``gain`` : by how much the logarithm of its evidence is larger than without;
    ``explained`` : how much less of the misfit's square is left over than without
    """

    place: np.ndarray
    found: OwnImages
    light: SharpLight
    gain: float
    explained: float

    @property
    def share(self) -> float:
        """Of the light, what the flash has."""
        return float(self.light.irradiances[0].mean() / max(np.sqrt(4 * np.pi) * self.light.x[0].mean(), 1e-300))


def flash(model, light):
    """The refinement: a flash on the camera, where the photo shows one."""
    if not asked(model, light):
        return model, light, {}
    with model.reporter.stage("fit"):
        centre, _ = middle_of(model.problems[0])
        best = likeliest(Pursuit(model, light), centre)
        if best is None:
            return model, light, {}
        own = Flash(best.place, centre, best.light.irradiances[0])
        free = model_beside(model, light, best.found)
        free = free.changed(lambda problem: replace(problem.under(own), correction=None))
        beside = refitted(free, light)
        if others_stand_near(free, beside, best.explained) or others_explain_more(model, light, beside):
            return model, light, {}
    return free, beside, {}


def flash_settled(model, light):
    """The refinement: how bright the flash is beside the materials that were settled, and what is said of it."""
    (problem, *_) = model.problems
    if problem.flash is None:
        return model, light, {}
    own, how = problem.flash, {"weights": problem.weights}
    with model.reporter.stage("fit"):
        b = problem.radiance() + own.irradiance * problem.of_flash
        solved = light.solver.sharp_lamps(b, light.fit, own.direction[None], problem.of_flash[:, None], **how)
        own = replace(own, irradiance=solved.irradiances[0])
        model = model.changed(lambda problem: replace(problem, flash=own))
        light = refitted(model, light)
    distance, metres = own.distance, problem.scene.job.metres_per_unit
    low, high = distance * np.exp(1.96 * UNSURE * np.array([-1, 1]))
    # of 16 things in rooms, three with a window right behind the camera pass for things under one
    what = "a flash on the camera" if problem.scene.job.photo.flash else "a light at the camera, as its flash would be,"
    why = f"{what} lights the objects from {metres * distance:.2g} m (by evidence)"
    near = ((own.direction, Near(own.centre, distance, float(low), float(high))),)
    return model, replace(light, near=near), {"flash": why}


def refitted(model, light):
    """The light of a model with a flash, which is a lamp in it."""
    answer = fit_together(model.problems, replace(model.settings, order=light.order), beside=light.fit)
    return with_its_lamp(answer, model.problems[0].flash.direction)


def asked(model, light) -> bool:
    """Whether a flash is looked for: of one photograph, by a camera near the objects and not among them, with no lamps
    given.

    Not where its file says that none fired. One that did may have been turned to the ceiling.
    """
    (problem, *others), scene = model.problems, model.problems[0].scene
    if light.solver is None or light.solver.given or others or scene.mirrors or has_own_images(model):
        return False
    if scene.job.camera.orthographic or model.settings.transport != "kernel" or scene.job.photo.flash is False:
        return False
    centre, radius = middle_of(problem)
    away = np.linalg.norm(scene.job.camera.to_world[:3, 3] - centre)
    return bool(NEAREST * radius < away < FARTHEST * radius)


def likeliest(pursuit: Pursuit, centre) -> Lit | None:
    """The flash at the best of all places; None where none is clear. ``centre`` : (3,), the middle of the objects."""
    (problem,) = pursuit.problems
    pose = problem.scene.job.camera.to_world
    away = float(np.linalg.norm(pose[:3, 3] - centre))

    places = [pose[:3, 3] + away * pose[:3, :2] @ offset for offset in (FIRST, *OTHERS)]
    first = image_from_nearby(pursuit.problems, places[0], centre)
    found = lit(pursuit, places[0], first) if promises(pursuit, first) else None
    if found is None or found.gain < HOPEFUL:
        return None
    others = [lit(pursuit, place, image_from_nearby(pursuit.problems, place, centre)) for place in places[1:]]
    best = max([found, *filter(None, others)], key=lambda one: one.gain)
    if best.gain < CLEARLY or best.share < LEAST:
        return None
    return best if best.light.evidence - as_from_afar(pursuit, best).evidence > NEARER else None


def others_stand_near(model, light, explained: float) -> bool:
    """Whether what is left over beside a flash looks like the nearness of lamps elsewhere: it stood for them.

    ``explained`` : as of `Lit`
    """
    scene = Photographed(model, light)
    (own,) = [problem.flash.direction for problem in model.problems]
    lamps = [lamp for lamp in bright_lamps(scene) if lamp.direction @ own < np.cos(SAME)]
    if not lamps:
        return False
    nearness = sum(scene.nearness_of(lamps, scene.mounds(light.fit, lamps)))
    more = (1 - rest(scene, nearness)) * (1 - explained)
    return more > ELSEWHERE * explained and looks_near(scene, nearness) > LOOKS_NEAR


def others_explain_more(model, light, beside) -> bool:
    """Whether lamps nearby elsewhere leave far less over of a photo without a flash than the light ``beside`` one does.

    Beside a flash that is none, what may be lamps elsewhere stands in places from which nothing looks near.
    """
    if beside.fit.residual < MUCH:
        return False
    placed = near_lamps(model, light)[1]
    return bool(placed.near) and placed.fit.residual < LESS * beside.fit.residual


def promises(pursuit: Pursuit, image: OwnImage) -> bool:
    """Whether what the light leaves over looks at all like a flash of an image, as bright as the light is there."""
    irradiance = irradiance_around(pursuit.light.fit, image.direction)
    one = OwnImages((image,)).at(irradiance[None], pursuit.rms, pursuit.known)
    found = likeness(pursuit.light, pursuit.problems, one.excess, one.weights)
    return found.chi2 > GLANCE and found.size[0] > 0


def lit(pursuit: Pursuit, place, image: OwnImage) -> Lit | None:
    """A flash at a place (3,), as bright as the photo has it; None where nothing counts beside its image."""
    irradiance, light = irradiance_around(pursuit.light.fit, image.direction), None
    for _ in range(TURNS):
        found = OwnImages((image,)).at(irradiance[None], pursuit.rms, pursuit.known)
        if not found.weights.sum(0).all():
            return None
        light = pursuit.solved(found, start=light)
        irradiance = light.irradiances[0]
    found = replace(found, irradiances=light.irradiances)
    left = misfit(pursuit, found.weights, found.excess, light)
    before = misfit(pursuit, found.weights, 0.0, pursuit.solved(found, ()))
    return Lit(place, found, light, pursuit.gain(found), 1 - left / max(before, 1e-300))


def misfit(pursuit: Pursuit, weights, excess, light: SharpLight) -> float:
    """The square of what a light, and ``excess`` (p, 3) of its lamps, leave over, of pixels with ``weights`` (p, 3)."""
    left = (pursuit.b - excess - pursuit.solver.basis.predicted(light.x)) / pursuit.solver.basis.response
    return float((weights * np.square(left)).sum())


def as_from_afar(pursuit: Pursuit, flash: Lit) -> SharpLight:
    """The light of a lamp in the same direction that is as sharp, and far away, by pixels that count as much."""
    (image,), weights = flash.found.lamps, flash.found.weights
    afar = image_from_afar(pursuit.problems, image.direction)
    solver, fit = pursuit.solver, pursuit.light.fit
    return solver.sharp_lamps(pursuit.b, fit, image.direction[None], afar.excess[:, None], weights=weights)
