# SPDX-License-Identifier: GPL-3.0-or-later
"""Is the misfit what a known mistake would leave? One test for each mistake, from the residual alone.

Every hypothesis is a column (or three) that the photo would have besides A x. What the light can imitate of a column
is taken out, with the same smoother as the photo's own misfit, c' = c - A x(c); then the residual r is regressed on
what is left,

    g = (C'^T C')^-1 C'^T r,     chi^2 = (C'^T r)^T V^-1 (C'^T r),

with V from the scores of blocks of neighbouring pixels (a sandwich estimate: misfit is structured, pixels are no
independent witnesses). g says how large the mistake is, chi^2 whether it is there.

- ``near``: the prediction times the place in the scene, three columns. Light from far away does not depend on place;
  a lamp at the distance d of an object of radius R brightens its near side by the factor 1 + 2 R / d.
- ``blocked``: light in places that see less of the sky than a flat one does. Positive where reflections are missing.
- ``diffuse``: what a matte surface would show under the estimated light. A material with a wrong balance of matte and
  gloss leaves it over. Not asked of things of a few flat faces: whatever is wrong on these looks like shading.
"""

from dataclasses import dataclass

import numpy as np

from btfsep_engine import sh
from btfsep_engine.linear_algebra import product

FEW_FACES, APART = 30, 8.0  # of smooth things hundreds are seen; 1 over the difference of their normals


@dataclass(frozen=True)
class Effect:
    """What the residual holds of a hypothesis.

    Attributes
    ----------
    size : (k,) g; chi2 : float, k degrees of freedom where nothing is wrong
    """

    size: np.ndarray
    chi2: float


def effect(residual, columns, blocks) -> Effect:
    """The test above.

    Parameters
    ----------
    residual : (p, 3), r
    columns : (k, p, 3), C', what the light cannot imitate
    blocks : (p,) int
    """
    _, labels = np.unique(blocks, return_inverse=True)
    labels = labels.reshape(-1)
    k = len(columns)
    flat, r = columns.reshape(k, -1), np.ravel(residual)
    gram, score = product(flat, flat.T), product(flat, r)
    if not np.trace(gram) > 0 or not r.any():
        return Effect(np.zeros(k), 0.0)
    size = np.linalg.solve(gram + 1e-9 * np.trace(gram) / k * np.eye(k), score)
    rest = (r - size @ flat).reshape(residual.shape)
    each = np.stack([np.bincount(labels, (c * rest).sum(1)) for c in columns])
    spread = each @ each.T
    spread += 1e-12 * max(float(np.trace(spread)), 1e-300) * np.eye(k)
    return Effect(size, float(score @ np.linalg.solve(spread, score)))


def hypotheses(predicted, x, *, position, normal, open_share) -> dict[str, np.ndarray]:
    """The columns of every mistake.

    Parameters
    ----------
    predicted : (p, 3), A x; x : (terms, 3), the light of all orders of the fit
    position : (p, 3) world, normal : (p, 3) unit
    open_share : (p,) how much of what lies above the surface is sky, 0 to 1

    Returns
    -------
    name -> (k, p, 3)
    """
    centred = position - position.mean(0)
    radius = np.sqrt(np.square(centred).sum(1).max())
    at = centred / max(radius, 1e-300)
    terms = min(len(x), 9)
    return {
        "near": predicted[None] * at.T[:, :, None],
        "blocked": (predicted.mean(0) * (1 - open_share)[:, None])[None],
        "diffuse": sh.irradiance(x[:terms], normal)[None],
    }


def has_few_faces(normal) -> bool:
    """Whether points with normals (p, 3) look in a few directions alone, as those of boxes do."""
    return len(np.unique(np.round(np.asarray(normal) * APART).astype(int), axis=0)) < FEW_FACES


def diagnose(solver, fit, radiance, *, blocks, position, normal, open_share) -> dict[str, Effect]:
    """The effect of every hypothesis on one photograph's fit.

    Parameters
    ----------
    solver : log_normal.LightSolver
    fit : its Fit of ``radiance : (p, 3)``
    blocks, position, normal, open_share : of the p points
    """
    left_of = solver.smoother(fit)
    predicted = solver.basis.predicted(fit.shown)  # the smoother is the fit's derivative, not the fit
    left, weight = radiance - predicted, 1 / solver.basis.response
    columns = hypotheses(predicted, fit.shown, position=position, normal=normal, open_share=open_share)
    effects = {
        name: effect(left * weight, np.stack([left_of(c) * weight for c in each]), blocks)
        for name, each in columns.items()
    }
    return effects | ({"diffuse": Effect(np.zeros(1), 0.0)} if has_few_faces(normal) else {})
