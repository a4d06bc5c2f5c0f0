# SPDX-License-Identifier: GPL-3.0-or-later
"""A further photograph of the same things: its light under the model that an estimate chose.

What an estimate finds out about things rather than light, it need not find out again: materials and how they depart
from the library's, appearance, light between surfaces, the camera and its tone curve. All else is done as for a photo
alone: the light is elected anew, so that where a photo alone would have chosen the same model, its light is the same in
every digit. Where a photo may tell more of the model than the one that it was chosen by (`tells_more`), or the model
hangs on that one's light (`hangs_on_light`), it is chosen anew.
"""

import copy
from dataclasses import dataclass, replace

from btfsep_engine.job.model import Photo
from btfsep_engine.pipeline.alternatives import alternatives
from btfsep_engine.pipeline.estimation import REFINEMENTS, Estimate, light_of
from btfsep_engine.pipeline.model import Model, first_model
from btfsep_engine.pipeline.refine import refined
from btfsep_engine.pipeline.refine.interreflection import light_between_surfaces, with_reflections
from btfsep_engine.pipeline.refine.reflectance import nearer_materials
from btfsep_engine.pipeline.scene import PreparedScene
from btfsep_engine.pipeline.together import all_weights, fit_together, light_solver
from btfsep_engine.pipeline.tone import Curves, codes_of, read_by
from btfsep_engine.threads import one_thread

WORSE = 1.2  # of the residual of the photo that the model was chosen by
OF_LIGHT = tuple(r for r in REFINEMENTS if r not in (light_between_surfaces, nearer_materials))


@dataclass(frozen=True)
class Found:
    """An Estimate, and whether its model was chosen by its own photo."""

    estimate: Estimate
    anew: bool


class Follower:
    """Estimates of further photographs; ``first`` : the Estimate that chose the model; ``library`` : of materials."""

    def __init__(self, first: Estimate, library):
        self.chosen, self.library = first, library
        self._curves = first.scene.curves

    def scene_of(self, scene: PreparedScene, photo: Photo, reporter) -> PreparedScene:
        """A scene with another photo, read by the curve that was chosen."""
        out = copy.copy(scene)
        out.job, out.reporter, out.greys = replace(scene.job, photo=photo), reporter, None
        out.curves, known = None, self._curves
        if known is None or photo.bits is None:
            return out
        return read_by(out, Curves(codes_of(out.job), known.curves, known.shares))

    @one_thread()
    def found(self, scene: PreparedScene) -> Found:
        """The light of a scene with objects like those of the first, named and numbered as these."""
        with scene.reporter.stage("transport"):
            simplest = first_model([scene], self.chosen.model.materials[:1], self.chosen.model.settings)
        if not hangs_on_light(self.chosen.model):
            found = self._followed(simplest)
            if not tells_more(found, self.chosen):
                return Found(found, False)
        self.chosen = light_of(simplest, self.library)
        return Found(self.chosen, True)

    def _followed(self, simplest: Model) -> Estimate:
        chosen = self.chosen.model
        with simplest.reporter.stage("transport"):
            model = replace(as_chosen(simplest, chosen), appearance=chosen.appearance)
        with simplest.reporter.stage("fit"):
            beside = None
            if model.looks is not simplest.looks or model.appearance != simplest.appearance:
                problems = simplest.problems
                solver = light_solver(problems, model.settings)
                beside = solver.first_look(problems[0].radiance(), weights=all_weights(problems))
            light = fit_together(model.problems, model.settings, beside=beside)
        model, light, choice = refined(model, light, {}, OF_LIGHT)
        with model.reporter.stage("alternatives"):
            others = tuple(alternatives(model, light, self.library))
        return Estimate(model, light, choice, others)


def tells_more(found: Estimate, chosen: Estimate) -> bool:
    """Whether a photo may ask for another model than the one that was chosen.

    It explains it much worse; or there are lamps and were none: only under these a departure is believed.
    """
    worse = found.light.fit.residual > WORSE * chosen.light.fit.residual
    return worse or bool(found.fit.lamps and not chosen.fit.lamps)


def hangs_on_light(model: Model) -> bool:
    """Whether greys of things around the objects were chosen by the photo: what is stated has others' light in it."""
    return any(problem.scene.greys is not None for problem in model.problems)


def as_chosen(simplest: Model, chosen: Model) -> Model:
    """The simplest model of a photo with the light between surfaces and the departures that were chosen of another."""
    model = simplest
    if chosen.bounces != model.bounces:
        model = with_reflections(model)
    if chosen.departed:

        def near(problem):
            each = [chosen.departed.get(i, m) for i, m in enumerate(problem.materials)]
            return problem.of_materials(each, model.modelled)

        look = chosen.appearance  # no other was tried with them
        model = replace(model, looks={look: [near(p) for p in model.looks[look]]}, departed=chosen.departed)
    return model
