# SPDX-License-Identifier: GPL-3.0-or-later
"""How much each of several objects counts, of one photograph or of more: as much as the light explains it.

A fit leaves three times as much over of a plaster cat that is stained as it leaves over of a plain ball under the same
lamps, and nearly all of it is the cat's own: if pixels of both counted alike, the cat would spoil what the ball tells.
So each object has a noise of its own, what is left over in it, found by turns with the light; and what its model misses
may be as many times larger, too (`fit.products`, ``departing``). Asked once, before things that go by the place are:
with pieces of a stained cat free, hardly anything would be left over, and it would count as much.
"""

from dataclasses import replace

import numpy as np

from btfsep_engine.fit.search import FLOOR
from btfsep_engine.pipeline.together import all_weights, counts, fit_together, parts_of

TURNS = 4
SETTLED = 0.1  # of the logarithm of what an object counts
# Of the root mean square: an object of which more is left over counts no less. Of 24 photographs by Cycles, without
# this end two counted for a thousandth of the other, and erred 0.2 more than with 0.2 for it; with that, real ball, cat
# and owl together err as if all counted alike.
MOST = 0.3


def each_object_by_itself(model, light):
    """The refinement: objects count by what the light leaves over in each."""
    if light.solver is None or parts_of(model.problems) is None:
        return model, light, {}
    with model.reporter.stage("fit"):
        for _ in range(TURNS):
            before, now = [p.counts_of_each for p in model.problems], precisions(model.problems, light)
            if max(np.abs(np.log(a / b)).max() for a, b in zip(now, before, strict=True)) < SETTLED:
                break
            model = model.changed(lambda problem, own: problem.counting(own), now)
            light = fit_together(model.problems, replace(model.settings, order=light.order))
    of_photos = [
        ", ".join(f"'{o.name}' {count:.2g}" for o, count in zip(p.scene.job.objects, p.counts_of_each, strict=True))
        for p in model.problems
    ]
    said = f"each object counts by what the light leaves over in it: {' | '.join(of_photos)} of the mean"
    return model, light, {"counts": said}


def precisions(problems, light) -> list[np.ndarray]:
    """Of each photograph (objects,), 1 over the variance of what a light leaves over, of mean 1 over all pixels.

    1 of an object of which no pixel is used.
    """
    photo, found = light.fit.election.photo, light.fit.election.solution
    relative = np.square(photo.left_over(found.x, found.v, found.discrepancy)) / photo.mean_square
    number, weights = parts_of(problems), all_weights(problems)
    own = (np.ones_like(relative) if weights is None else weights) / counts(problems)[:, None]
    count = np.bincount(number, own.sum(1))
    variance = np.bincount(number, (own * relative).sum(1)) / np.maximum(count, 1e-300)
    variance = np.clip(variance, FLOOR**2, MOST**2)
    each, out = iter(count.sum() / (count / variance).sum() / variance), []
    for problem in problems:
        out.append(np.array([next(each) if len(points) else 1.0 for points in problem.points]))
    return out
