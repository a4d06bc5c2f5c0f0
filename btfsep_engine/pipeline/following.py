# SPDX-License-Identifier: GPL-3.0-or-later
"""A further photograph of the same things: its light under the model that an estimate chose.

What an estimate finds out about things rather than light, it need not find out again: materials and how they depart
from the library's, appearance, light between surfaces, colours of surroundings, the camera and its tone curve. All else
is done as for a photo alone where the light moves: it is elected anew, and where a photo alone would have chosen the
same model, it is the same in every digit. A light that stands still (`stands_still`) is found from the last one on, in
a part of the time; of the same view, all that was settled of the last photo stays (`Problem.again`), be it of its
light: a lamp's own image, or what the photo may be moved by. Where a photo may tell more of the model than the one that
it was chosen by (`tells_more`), or the model hangs on that one's light (`hangs_on_light`), it is chosen anew.
"""

import copy
from dataclasses import dataclass, replace

import numpy as np

from btfsep_engine.fit.stated import Fit
from btfsep_engine.job.model import Photo
from btfsep_engine.pipeline.alternatives import alternatives
from btfsep_engine.pipeline.black_and_white import SAID, without_colours
from btfsep_engine.pipeline.estimation import REFINEMENTS, Estimate, light_of, refinements_of
from btfsep_engine.pipeline.mirrors import with_picture
from btfsep_engine.pipeline.model import Model, first_model
from btfsep_engine.pipeline.phone import with_tones_undone
from btfsep_engine.pipeline.refine import refined
from btfsep_engine.pipeline.refine.interreflection import light_between_surfaces, with_reflections
from btfsep_engine.pipeline.refine.key_lights import key_lights
from btfsep_engine.pipeline.refine.reflectance import nearer_materials
from btfsep_engine.pipeline.refine.said_surface import as_the_photo_shows
from btfsep_engine.pipeline.refine.seen_colour import with_colours
from btfsep_engine.pipeline.scene import PreparedScene
from btfsep_engine.pipeline.together import SolvedLight, fit_together, light_solver
from btfsep_engine.pipeline.tone import Curves, codes_of, read_by
from btfsep_engine.threads import one_thread

WORSE = 1.2  # of the residual of the photo that the model was chosen by
STILL = 0.1  # of what is stated of a light (root mean square): one that moves by less stands still
AS_WELL = 0.03  # of the residual: by as much that of a light that stands still may change
OF_LIGHT = tuple(r for r in REFINEMENTS if r not in (as_the_photo_shows, light_between_surfaces, nearer_materials))
CHOSEN, ELECTED, FOLLOWED = "model chosen", "light elected", "light followed"


@dataclass(frozen=True)
class FollowedEstimate:
    """An Estimate, and what of it was found for its own photo: `CHOSEN`, `ELECTED` or `FOLLOWED`.

    ``as_before`` : whether the photo is that of the last other one but for noise, and what was said of that holds
    """

    estimate: Estimate
    how: str
    as_before: bool = False


class Follower:
    """Estimates of further photographs; ``first`` : the Estimate that chose the model; ``library`` : of materials."""

    def __init__(self, first: Estimate, library):
        self.chosen = self._elected = self._last = first
        self.library = library.without_colours() if library and not first.scene.has_colours else library
        self._curves, self._tones = first.scene.curves, first.scene.tones

    def scene_of(self, scene: PreparedScene, photo: Photo, reporter) -> PreparedScene:
        """A scene with another photo, read by the curve, and with a phone's tones undone as far, as was chosen."""
        out, known = copy.copy(scene), self._curves
        out.job, out.curves = replace(scene.job, photo=photo), None
        out = with_tones_undone(out if self.chosen.scene.has_colours else without_colours(out), self._tones)
        if known is not None and photo.bits is not None:
            out = read_by(out, Curves(codes_of(out.job), known.curves, known.shares))
        out = with_picture(out, out.job.photo)
        out.reporter, out.greys = reporter, None
        if not out.has_colours:
            reporter.warn(SAID)
        return out

    def estimate(self, scene: PreparedScene) -> FollowedEstimate:
        """The light of a scene with objects like those of the first, named and numbered as these."""
        found = self._estimate(scene)
        self._last = found.estimate
        if found.how != FOLLOWED:
            self._elected = found.estimate
        if found.how == CHOSEN:
            self.chosen = found.estimate
        return found

    @one_thread()
    def _estimate(self, scene: PreparedScene) -> FollowedEstimate:
        there = scene.seen == self._elected.scene.seen
        if there and (again := self._again(scene)):
            return FollowedEstimate(again, FOLLOWED, as_before=True)
        with scene.reporter.stage("transport"):
            simplest = first_model([scene], self.chosen.model.materials[:1], self.chosen.model.settings)
        if not hangs_on_light(self.chosen.model):
            with scene.reporter.stage("transport"):
                model = as_chosen(simplest, self.chosen.model)
            beside = None
            if model.looks is not simplest.looks or model.appearance != simplest.appearance:
                solver, (problem,) = light_solver(simplest.problems, model.settings), simplest.problems
                beside = solver.first_look(problem.radiance(), weights=problem.weights)
            light = None if there else self._followed(model, beside)
            if light is not None:
                return FollowedEstimate(self._completed(model, light), FOLLOWED)
            with scene.reporter.stage("fit"):
                light = fit_together(model.problems, model.settings, beside=beside)
            found = self._completed(model, light)
            if not tells_more(found, self.chosen):
                return FollowedEstimate(found, ELECTED)
        return FollowedEstimate(light_of(simplest, self.library), CHOSEN)

    def _again(self, scene: PreparedScene) -> Estimate | None:
        """The Estimate of a photo of the view that was elected last, all as it was settled there but for the light.

        None where it does not stand still, or a ground is evidence of it.
        """
        elected = self._elected
        (problem,), light = elected.model.problems, elected.light
        seen = copy.copy(problem.scene)
        seen.job, seen.reporter, seen.curves = scene.job, scene.reporter, scene.curves
        seen.mirror_lights = scene.mirror_lights
        if light.alone or (problem := problem.again(seen)) is None:
            return None
        with scene.reporter.stage("fit"):
            stated = replace(light.fit, state=elected.fit.state)  # of all materials that things may be made of
            fit = light.solver.again(problem.radiance(), stated, self._last.light.fit)
            if not stands_still(fit, stated):
                return None
        model = replace(elected.model, looks={elected.model.appearance: [problem]}, otherwise=())  # the fit has them
        model, light, _ = key_lights(model, replace(light, fit=fit))
        return Estimate(model, light, elected.choice)

    def _followed(self, model: Model, beside: Fit | None) -> SolvedLight | None:
        """The light of a model from the last one on, of another view; None where it does not stand still.

        Nor is a lamp or a paint followed that was settled in the other view, or a light that a ground is evidence of.
        ``beside`` : as of `fit_together`
        """
        (problem,), solver = model.problems, light_solver(model.problems, model.settings)
        last = self._last.model.problems[0]
        if any(one is not None for one in (last.correction, last.flash, last.paint)) or self._last.light.alone:
            return None
        with model.reporter.stage("fit"):
            before, b = self._last.light.fit, problem.radiance()
            left = np.linalg.norm(b - problem.predicted(before.shown)) / max(np.linalg.norm(b), 1e-300)
            if left > (1 + 2 * AS_WELL) * self._elected.light.fit.residual:  # why search
                return None
            fit = solver.follow(b, before, weights=problem.weights, beside=beside)
        return SolvedLight(fit, solver, [1.0]) if stands_still(fit, self._elected.light.fit) else None

    def _completed(self, model: Model, light: SolvedLight) -> Estimate:
        """The Estimate of a model that is as it was chosen, and of its light."""
        model, light, choice = refined(model, light, {}, refinements_of(model.settings, OF_LIGHT))
        with model.reporter.stage("alternatives"):
            others = tuple(alternatives(model, light, self.library))
        return Estimate(model, light, choice, others)


def stands_still(fit: Fit, elected: Fit) -> bool:
    """Whether a light that was followed is the last that was elected, which explains its photo as well."""
    change = fit.residual / max(elected.residual, 1e-300) - 1
    moved = (fit.coefficients - elected.coefficients) / np.maximum(elected.stddev, 1e-300)
    return abs(change) < AS_WELL and np.sqrt(np.square(moved).mean()) < STILL


def tells_more(estimate: Estimate, chosen: Estimate) -> bool:
    """Whether a photo may ask for another model than the one that was chosen.

    It explains it much worse; or there are lamps and were none: only under these a departure is believed.
    """
    worse = estimate.light.fit.residual > WORSE * chosen.light.fit.residual
    return worse or bool(estimate.fit.lamps and not chosen.fit.lamps)


def hangs_on_light(model: Model) -> bool:
    """Whether greys of things around the objects were chosen by the photo: what is stated has others' light in it."""
    return any(problem.scene.greys is not None for problem in model.problems)


def as_chosen(simplest: Model, chosen: Model) -> Model:
    """The simplest model of a photo with light between surfaces, colours and departures that were chosen of another."""
    model = replace(simplest, appearance=chosen.appearance)
    if colours := chosen.problems[0].scene.colours:
        model = with_colours(model, [colours])
    if chosen.bounces != model.bounces:
        model = replace(with_reflections(model), appearance=chosen.appearance)
    if chosen.departed:

        def near(problem):
            each = [chosen.departed.get(i, m) for i, m in enumerate(problem.materials)]
            return problem.of_materials(each, model.modelled)

        look = chosen.appearance  # no other was tried with them
        model = replace(model, looks={look: [near(p) for p in model.looks[look]]}, departed=chosen.departed)
    return model
