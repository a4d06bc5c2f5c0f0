# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether the photo shows the objects a little beside where the geometry does, as the shading tells.

To first order a photo that is moved by (u, v) pixels differs by u dI/dx + v dI/dy from what it would be, and likewise
one that is turned or magnified a little. Where what the light leaves over away from outlines looks like that, the
same light is fitted anew with these differences free (`fit.products`, ``slopes``): it need not imitate them. They are
kept where that explains the photo clearly better. Near outlines a misfit says nothing of the camera: where lamps
stand behind an object its rim is bright, and what materials reflect at grazing angles is not known so well. Nothing
is moved: steps of a pixel or two are what a slope can say. (Lucas and Kanade 1981.)

Where the photo's own edges say where the camera is (`pipeline.alignment`), the shading is not asked: what it says then
is mostly of other things. Of 32 photographs with four cameras each that were off and stayed, 32 of 128 looked so, and
erred 1.5 times as much without these differences; of 128 plates whose cameras edges had been asked about, 13, and 0.9
times.
"""

from dataclasses import replace

import numpy as np

from btfsep_engine.fit.diagnose import effect
from btfsep_engine.pipeline.together import all_weights, fit_together, stacked

USUAL = 0.5  # pixels, at the middle of an object's extent: a deviation of each difference
SPEAKS = 6.0  # chi^2 of two degrees of freedom, away from outlines: on 8 photos of gloss that are in place and lit from
# behind it is 0 to 4, and what all pixels would say of them is an evidence of up to 103; on 20 that are off 0 to 3,000
INNER = 4  # rings of `render.outlines`: so far from an outline what is left over is of the shading
CLEARLY = 5.0
FOUND = "the shading is a little beside where the geometry has it, which is reckoned with (by evidence)"
REACH, BLUR = 2, 1.0  # cells about a pixel of which its slope is; pixels of a Gaussian


def shifted(model, light):
    """The refinement: differences that a camera makes which is a little off."""
    known = any(problem.slopes is not None or problem.scene.in_place for problem in model.problems)
    if light.solver is None or known:
        return model, light, {}
    with model.reporter.stage("fit"):
        slopes = [p.as_measured(differences(p)) / e for p, e in zip(model.problems, light.exposures, strict=True)]
        if max(_moved(model.problems, slopes, light)) < SPEAKS:
            return model, light, {}
        free = model.changed(lambda p, s: replace(p, slopes=USUAL * s), slopes)
        answer = fit_together(free.problems, replace(model.settings, order=light.order), beside=light.fit)
    if answer.fit.evidence < light.fit.evidence + CLEARLY:
        return model, light, {}
    return free, answer, {"shift": FOUND}


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
    same &= outlines.rings_at(inside.reshape(-1, 2)).reshape(same.shape) > 0
    photo = problem.scene.job.photo
    image = photo.radiance[inside[..., 0], inside[..., 1]].astype(np.float64)
    same &= np.isfinite(image).all(-1)
    image[~same] = 0
    weight = same * np.exp(-0.5 * np.square(offsets / BLUR).sum(-1))
    columns = np.concatenate([np.ones((len(offsets), 1)), offsets], 1)
    gram = np.einsum("po,oi,oj->pij", weight, columns, columns) + np.diag([1e-9, 1e-3, 1e-3])
    _, down, right = np.moveaxis(np.linalg.solve(gram, np.einsum("po,oi,poc->pic", weight, columns, image)), 1, 0)
    y, x = (problem.pixels - problem.pixels.mean(0)).T
    far = max(np.sqrt(np.mean(x * x + y * y)), 1e-9)
    x, y = (x / far)[:, None], (y / far)[:, None]
    return np.stack([right, down, x * right + y * down, x * down - y * right], 1) / outlines.edge


def _moved(problems, slopes, light) -> list[float]:
    """Of each photograph how much what is left over away from outlines looks like a move to a side: chi^2."""
    weights, project = all_weights(problems), light.solver.smoother(light.fit)
    inner = np.concatenate([p.rings > INNER for p in problems])[:, None]
    unit = inner * (1.0 if weights is None else np.sqrt(weights)) / light.solver.basis.response
    left, blocks, start, out = light.left_over(problems) * unit, stacked(problems)[1], 0, []
    for each in slopes:
        columns = np.zeros((2, *left.shape))
        columns[:, start : start + len(each)] = np.moveaxis(each[:, :2], 1, 0)
        start += len(each)
        out.append(effect(left, np.stack([project(c * inner) * unit for c in columns]), blocks).chi2)
    return out
