# SPDX-License-Identifier: GPL-3.0-or-later
"""What is stated of the light where the job says that there is more to a material than its numbers."""

from dataclasses import replace

from btfsep_engine.btf.surfaces import GIVEN
from btfsep_engine.fit.stated import widened

WIDER = 2.0


def left_out(model, light):
    """The refinement: wider ranges where a surface leaves something out; no fit can tell that from light."""
    words = {}
    for problem, materials in zip(model.problems, model.materials, strict=True):
        for thing, material in zip(problem.scene.job.objects, materials, strict=True):
            if material.name == GIVEN and thing.surface.left_out:
                words[f"'{thing.name}': {', '.join(thing.surface.left_out)}"] = None
    if not words:
        return model, light, {}
    said = (
        f"left out of what the objects are made of is, of {'; of '.join(words)}; "
        f"what is known of the light is stated {WIDER:g} times as wide"
    )
    model.reporter.warn(said)
    return model, light if light.fit.samples is None else replace(light, fit=widened(light.fit, WIDER)), {}
