# SPDX-License-Identifier: GPL-3.0-or-later
"""How much each of several photographs of one light counts: as much as the light explains it.

A fit leaves three times as much over of a plaster cat that is stained as it leaves over of a plain ball under the same
lamps, and nearly all of it is the cat's own: if pixels of both counted alike, the cat would spoil what the ball tells.
So each photograph has a noise of its own, what is left over in it, found by turns with the light; and what its model
misses may be as many times larger, too (`fit.products`, ``departing``). Asked once, before things in a photograph that
go by the place are: with pieces of a stained cat free, hardly anything would be left over, and it would count as much.
"""

from dataclasses import replace

import numpy as np

from btfsep_engine.fit.search import FLOOR
from btfsep_engine.pipeline.together import all_weights, counts, fit_together, of_photographs

TURNS = 4
SETTLED = 0.1  # of the logarithm of what a photograph counts


def each_photo_by_itself(model, light):
    """The refinement: photographs count by what the light leaves over in each."""
    if light.solver is None or len(model.problems) == 1:
        return model, light, {}
    with model.reporter.stage("fit"):
        for _ in range(TURNS):
            before, now = np.array([p.counts for p in model.problems]), precisions(model.problems, light)
            if np.abs(np.log(now / before)).max() < SETTLED:
                break
            model = model.changed(lambda problem, counts: problem.counting(float(counts)), now)
            light = fit_together(model.problems, replace(model.settings, order=light.order))
    each = ", ".join(f"{p.counts:.2g}" for p in model.problems)
    return model, light, {"photographs": f"each counts by what the light leaves over in it: {each} of the mean"}


def precisions(problems, light) -> np.ndarray:
    """(photographs,), 1 over the variance of what a light leaves over in each, of mean 1 over all pixels."""
    photo, found = light.fit.election.photo, light.fit.election.solution
    relative = np.square(photo.left_over(found.x, found.v, found.discrepancy)) / photo.mean_square
    number, weights = of_photographs(problems), all_weights(problems)
    own = 1.0 / counts(problems)[:, None] * (np.ones_like(relative) if weights is None else weights)
    count = np.bincount(number, own.sum(1))
    variance = np.maximum(np.bincount(number, (own * relative).sum(1)) / np.maximum(count, 1e-300), FLOOR**2)
    return count.sum() / (count / variance).sum() / variance
