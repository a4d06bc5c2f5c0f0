# SPDX-License-Identifier: GPL-3.0-or-later
"""How much pixels near an outline count: less, as far as the light explains them worse than the others.

A camera that is a pixel or two off shows something else there, and nowhere as much; nor is what a material reflects at
grazing angles known as well. Noise of two kinds has two variances, and a pixel's weight is 1 over its own: that of
pixels near outlines over the others' is found from what a first fit leaves over, and once more from the
second's. In a picture that is in line nothing changes.
"""

from dataclasses import replace

import numpy as np

from btfsep_engine.pipeline.together import fit_together

NEAR = 2  # rings of `render.outlines`, beside the one that is left out
LEAST = 20  # pixels of a kind; fewer tell no variance
FLOOR = 0.02  # of the photo's root mean square: so well no pixel is known to be explained
ALIKE = 0.8  # a weight that is not worth a fit
SMALLEST = (
    0.05  # a weight: what is explained worse still is a rim that is lit from behind, rather than a camera's doing
)
ROUNDS = 2
RIM_LIT = 1.6  # of the others' root mean square radiance; on 24 plates by Cycles, lit from all sides, it is 0.2 to 1.5


def near_outlines(model, light):
    """The refinement: weights for pixels near outlines, and the light with them."""
    if light.solver is None or is_rim_lit(model.problems):
        return model, light, {}
    own, shares = [_weights(problem) for problem in model.problems], None
    with model.reporter.stage("fit"):
        for _ in range(ROUNDS):
            now = _shares(model.problems, own, light)
            if min(now) > ALIKE:
                break
            shares = now
            weights = [w * _factor(p, s) for p, w, s in zip(model.problems, own, shares, strict=True)]
            looks = {
                look: [replace(p, weights=w) for p, w in zip(problems, weights, strict=True)]
                for look, problems in model.looks.items()
            }
            model = replace(model, looks=looks)
            light = fit_together(model.problems, replace(model.settings, order=light.order), beside=light.fit)
    if shares is None:
        return model, light, {}
    each = " and ".join(f"{1 / np.sqrt(share):.1f}" for share in shares)
    why = f"pixels near outlines are explained {each} times as badly as the others or worse, and count by so much less"
    return model, light, {"outlines": f"{why}: the camera may be a little off"}


def is_rim_lit(problems) -> bool:
    """Whether what is near outlines is so bright that it alone tells of lamps, behind the objects.

    What materials reflect at grazing angles is not known so well that a misfit there would tell of the camera.
    """
    values = np.concatenate([p.radiance() for p in problems])
    near = np.concatenate([p.rings <= NEAR for p in problems])
    if near.all() or not near.any():
        return False
    return float(np.square(values[near]).mean()) > RIM_LIT**2 * float(np.square(values[~near]).mean())


def _weights(problem) -> np.ndarray:
    return np.ones((len(problem.pixels), 3)) if problem.weights is None else problem.weights


def _factor(problem, share: float) -> np.ndarray:
    return np.where(problem.rings <= NEAR, share, 1.0)[:, None]


def _shares(problems, own, light) -> list[float]:
    """Of each photo the variance of pixels that are not near outlines over that of those that are: `SMALLEST` to 1."""
    out = []
    left = np.split(light.left_over(problems), np.cumsum([len(w) for w in own])[:-1])
    for problem, weights, rest in zip(problems, own, left, strict=True):
        near = problem.rings <= NEAR
        unit = np.sqrt(np.square(problem.radiance()).mean(0))  # each channel counts alike, but for black ones
        unit = np.maximum(unit, max(1e-3 * unit.max(), 1e-300))
        square = weights * np.square(rest / unit)
        if min(near.sum(), (~near).sum()) < LEAST:
            out.append(1.0)
            continue
        others, beside = (float(square[which].sum() / max(weights[which].sum(), 1e-300)) for which in (~near, near))
        out.append(float(np.clip(max(others, FLOOR**2) / max(beside, 1e-300), SMALLEST, 1.0)))
    return out
