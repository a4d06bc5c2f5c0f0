# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether surfaces are painted or stained: lighter here and darker there, in pieces that are larger than pixels.

Of a plaster cat that is stained, or an owl that is painted, one knows a mean colour. Pieces that are darker look like
shade, lighter ones like light, and the brightest lamp is moved to where they are. But light goes by the normals, and
pieces go by the place: the light is fitted anew, by its own model, with a brightness free that goes by the place in the
picture (`fit.products`, ``slopes``), each piece and each channel by a part of what the light makes it. It is kept where
that explains the photo clearly better.

Asked only where whole parts of the objects are brighter or darker than the light makes them (`refine.misshapen`), by as
much as that is doubted for. What is stated of the light stays as wide as that asks for: it may be their shape.
"""

from dataclasses import replace

import numpy as np

from btfsep_engine.pipeline.refine.misshapen import MUCH, PATCHES, patch_misfit
from btfsep_engine.pipeline.together import followed

AMOUNTS = (0.15, 0.3)  # of the brightness: deviations of a piece that are tried
CLEARLY = 20.0  # of the logarithm of the evidence: of a stained cat and a painted owl it is 34 to 79
FEWEST = 3  # pixels of a piece
FOUND = "the objects are lighter here and darker there than was told, in pieces, which is reckoned with (by evidence)"


def painted_surfaces(model, light):
    """The refinement: a brightness that goes by the place."""
    if light.solver is None or patch_misfit(model.problems, light) < MUCH:
        return model, light, {}
    with model.reporter.stage("fit"):
        seen = [pieces(p)[:, :, None] * p.predicted(light.fit.shown)[:, None] for p in model.problems]
        settings = replace(model.settings, order=light.order)
        painted, fit = model, light.fit
        for amount in AMOUNTS:
            trial = model.changed(lambda p, s, a=amount: replace(p.beside(a * s), painted=True), seen)
            answer = followed(trial.problems, light, settings)
            if answer.evidence < fit.evidence:  # where a little paint explains nothing, more does not
                break
            painted, fit = trial, answer
    if fit.evidence < light.fit.evidence + CLEARLY:
        return model, light, {}
    return painted, replace(light, fit=fit), {"paint": FOUND}


def pieces(problem) -> np.ndarray:
    """(p, k): how much each pixel belongs to each piece of its object, of which `PATCHES` lie along its longer side.

    They pass into each other as tents do; pieces of hardly a pixel are left out.
    """
    out = [np.zeros((len(problem.pixels), 0))]
    for i, points in enumerate(problem.points):
        if not len(points):
            continue
        at = (points.pixels - points.pixels.min(0)).astype(np.float64)
        cells = at * (PATCHES / max(float(at.max()), 1.0))
        tents = np.maximum(0, 1 - np.abs(cells[:, :, None] - np.arange(PATCHES + 1)))
        share = np.einsum("pa,pb->pab", tents[:, 0], tents[:, 1]).reshape(len(points), -1)
        own = share[:, share.sum(0) > FEWEST]
        others = [np.zeros((len(p), own.shape[1])) for p in problem.points]
        out.append(np.concatenate([*others[:i], own, *others[i + 1 :]]))
    return np.concatenate(out, 1)
