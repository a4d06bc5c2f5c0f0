# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether lights have strong colours, as filters and LEDs give them on a stage.

Natural lights and usual lamps are nearly white: what of a photo's tint is more than that, is the object's as a rule
(`fit.colour`). An object has one colour, wherever its light comes from. Where lights from several directions have
colours of their own, it is theirs, and the photo shows it: light whose colours may be strong explains it by far better
(`light.log_field.VIVID`), although it is seldom met.
"""

from dataclasses import replace

import numpy as np

from btfsep_engine.fit.colour import LIGHT, tint_of
from btfsep_engine.pipeline.together import fit_together

TINTED, COLOURED = 3.0, 2.0  # deviations of a usual tint, of all light; of a usual colour, of any unknown of it
CLEARLY = 5.0  # of the logarithm of the evidence: 15 to 106 on eleven photographs by Cycles under coloured lamps
LITTLE = 0.2  # of the photo: where more is left over, it is no light. An object of several colours that is said to
# have one shows other ones from each side, too: of five such plates that gain 12 to 54, 0.28 and more is left, of those
# under coloured lamps 0.01 to 0.19
FOUND = "lights of strong colours: the photo shows other ones from each side (by evidence)"


def vivid_light(model, light):
    """The refinement: lights of colours that natural light has not."""
    if light.solver is None or not looks_coloured(light.fit):
        return model, light, {}
    with model.reporter.stage("fit"):
        free = model.changed(lambda p: replace(p, vivid=True))
        answer = fit_together(free.problems, replace(model.settings, order=light.order), beside=light.fit)
    if answer.fit.evidence < light.fit.evidence + CLEARLY or answer.fit.residual > LITTLE:
        return model, light, {}
    return free, answer, {"colours": FOUND}


def looks_coloured(fit) -> bool:
    """Whether a light, or a part of it, has a colour that is seldom met."""
    solution = fit.election.solution
    of_field, of_lamps = solution.model.parts(solution.white)
    parts = [of_field[part] for part in solution.model.field.chroma_parts]
    chroma = np.concatenate([*parts, of_lamps[:, 3:].ravel()])
    tint = tint_of(fit.election.photo.level)
    return bool(np.abs(chroma).max() > COLOURED or (np.abs(tint) > TINTED * LIGHT).any())
