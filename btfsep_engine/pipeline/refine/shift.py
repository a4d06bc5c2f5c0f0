# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether the photo shows the objects a little beside where the geometry does, as the shading tells.

To first order a photo that is moved by (u, v) pixels differs by u dI/dx + v dI/dy from what it would be, and likewise
one that is turned or magnified a little. Where what the light leaves over looks like that, the same light is fitted
anew with these differences free (`fit.products`, ``slopes``): it need not imitate them. They are kept where that
explains the photo clearly better. Nothing is moved: steps of a pixel or two are what a slope can say. (Lucas and
Kanade 1981.)
"""

from dataclasses import replace

import numpy as np

from btfsep_engine.fit.diagnose import effect
from btfsep_engine.pipeline.refine.outlines import is_rim_lit
from btfsep_engine.pipeline.together import all_weights, fit_together, stacked

USUAL = 0.5  # pixels, at the middle of an object's extent: a deviation of each difference
SPEAKS = 30.0  # chi^2 of two degrees of freedom
# Evidence gained: on 17 photos by Cycles of given surfaces, 1 or 2 pixels off: 5 to 118 (once -5); on 7 in place: -17
# to -2. In place on 22 others: -11 to 4 (and 94, on lacquer under lamps behind it, whose light is nearer to the truth
# with it); on 15 real ones -6 to 3.
CLEARLY = 5.0
REACH, BLUR = 2, 1.0  # cells about a pixel of which its slope is; pixels of a Gaussian


def shifted(model, light):
    """The refinement: differences that a camera makes which is a little off."""
    known = any(problem.slopes is not None for problem in model.problems)
    if light.solver is None or known or is_rim_lit(model.problems):
        return model, light, {}
    with model.reporter.stage("fit"):
        slopes = [differences(problem) for problem in model.problems]
        moves = _moves(model.problems, slopes, light)
        if not any(chi2 > SPEAKS for _, chi2 in moves):
            return model, light, {}
        looks = {
            look: [replace(p, slopes=USUAL * s) for p, s in zip(problems, slopes, strict=True)]
            for look, problems in model.looks.items()
        }
        free = replace(model, looks=looks)
        answer = fit_together(free.problems, replace(model.settings, order=light.order), beside=light.fit)
    if answer.fit.evidence < light.fit.evidence + CLEARLY:
        return model, light, {}
    return free, answer, {"shift": _words([size for size, _ in moves])}


def differences(problem) -> np.ndarray:
    """What a photo changes by, pixel by pixel (p, 4, 3): moved to the right, down, magnified, and turned.

    Each by one pixel: of the last two at the root mean square distance from the middle. The photo's slope is that of a
    plane through what is around a pixel on the same surface, so that no outline has a part in it.
    """
    outlines, view = problem.scene.outlines, problem.scene.view
    offsets = np.stack(np.meshgrid(*[np.arange(-REACH, REACH + 1)] * 2, indexing="ij"), -1).reshape(-1, 2)
    places = problem.pixels[:, None] + offsets * outlines.edge
    inside = np.clip(places, 0, np.array(view.mesh.shape) - 1)
    own = view.mesh[tuple(problem.pixels.T)]
    same = (places == inside).all(-1) & (view.mesh[inside[..., 0], inside[..., 1]] == own[:, None])
    same &= outlines.at(inside.reshape(-1, 2)).reshape(same.shape) > 0
    weight = same * np.exp(-0.5 * np.square(offsets / BLUR).sum(-1))
    image = problem.scene.job.photo.radiance[inside[..., 0], inside[..., 1]].astype(np.float64)
    columns = np.concatenate([np.ones((len(offsets), 1)), offsets], 1)
    gram = np.einsum("po,oi,oj->pij", weight, columns, columns) + 1e-3 * np.eye(3)
    _, down, right = np.moveaxis(np.linalg.solve(gram, np.einsum("po,oi,poc->pic", weight, columns, image)), 1, 0)
    y, x = (problem.pixels - problem.pixels.mean(0)).T
    far = max(np.sqrt(np.mean(x * x + y * y)), 1e-9)
    x, y = (x / far)[:, None], (y / far)[:, None]
    return np.stack([right, down, x * right + y * down, x * down - y * right], 1) / outlines.edge


def _moves(problems, slopes, light) -> list:
    """Of each photograph by how many pixels it seems to be moved, to the right and down (2,), and chi^2 of that."""
    weights, project = all_weights(problems), light.solver.smoother(light.fit)
    unit = (1.0 if weights is None else np.sqrt(weights)) / light.solver.basis.response
    left, blocks, start, out = light.left_over(problems) * unit, stacked(problems)[1], 0, []
    for each in slopes:
        columns = np.zeros((2, *left.shape))
        columns[:, start : start + len(each)] = np.moveaxis(each[:, :2], 1, 0)
        start += len(each)
        found = effect(left, np.stack([project(c) * unit for c in columns]), blocks)
        out.append((-found.size, found.chi2))  # a photo that has moved to the right shows what was to the left
    return out


def _words(moves) -> str:
    each = [
        f"{abs(r):.1f} pixels to the {'right' if r > 0 else 'left'} and {abs(d):.1f} {'down' if d > 0 else 'up'}"
        for r, d in moves
    ]
    return f"the shading is about {', '.join(each)} of where the geometry has it, which is reckoned with (by evidence)"
