# SPDX-License-Identifier: GPL-3.0-or-later
"""Free red, green and blue scales of objects whose reflectance is not known for sure, fixed by those that are known.

A photograph's exposure and white balance multiply the light, which has no other measure: with one object, or where no
object is better known than another, the light is in the photo's own scale. With several objects, those whose material
is given hold the scale, and a recognised one, whose dye may be another, gets factors s of its own:

    b_k = s_k A_k x,    s_k = (b_k . A_k x + r) / (A_k x . A_k x + r),   one for each channel,

by turns with the fit of x. r pulls towards 1 with as much force as natural spread of reflectance asks for:
log s ~ N(0, `SPREAD`^2), against a noise that a block of neighbouring pixels shares.
"""

import numpy as np

from btfsep_engine import sh
from btfsep_engine.fit.log_normal import LightSolver

SPREAD = 0.5  # of the logarithm of a material's reflectance, from piece to piece of a class
LIMITS = (0.1, 10.0)
TURNS = 25
SETTLED = 1e-3  # relative change of a scale


def free_scales(basis, radiance, *, normals, blocks, free) -> np.ndarray:
    """The scale of each object's reflectance over the material's in the library.

    Parameters
    ----------
    basis : list of (p, terms, 3) float, A of each object; radiance : list of (p, 3) float, b
    blocks : list of (p,) int, no number in two objects
    normals : list of (p, 3)
    free : bool of each object: those that may differ; at least one may not

    Returns
    -------
    (objects, 3) float64, 1 where an object is not free

    Raises
    ------
    ValueError
        Where all are free: nothing would hold the scale.
    """
    if all(free):
        raise ValueError("one object has to hold the scale")
    scales = np.ones((len(basis), 3))
    if not any(free):
        return scales
    order = sh.order_of(basis[0].shape[1])
    solver = LightSolver(np.concatenate(basis), normals=np.concatenate(normals), order=order)
    held = [i for i, each in enumerate(free) if not each]
    # the light that the known objects see is the first guess: all together would begin with a compromise
    first = LightSolver(
        np.concatenate([basis[i] for i in held]), normals=np.concatenate([normals[i] for i in held]), order=order
    )
    x, fit = first.solve(np.concatenate([radiance[i] for i in held])).shown, None
    for _ in range(TURNS):
        before = scales.copy()
        for i in np.flatnonzero(free):
            scales[i] = _scale(basis[i], radiance[i], blocks[i], x)
        if np.abs(scales / before - 1).max() < SETTLED:
            break
        fit = solver.solve(np.concatenate([b / s for b, s in zip(radiance, scales, strict=True)]), start=fit)
        x = fit.shown
    return scales


def _scale(basis, radiance, blocks, x) -> np.ndarray:
    """(3,) the most probable scale of one object under a light x (terms, 3)."""
    b = np.asarray(radiance, np.float64)
    predicted = np.stack([basis[:, :, c] @ x[:, c].astype(basis.dtype) for c in range(3)], 1).astype(np.float64)
    energy = np.maximum(np.square(predicted).sum(0), 1e-300)
    plain = (predicted * b).sum(0) / energy
    misfit = np.square(b - plain * predicted).mean(0)
    together = len(b) / len(np.unique(blocks))  # pixels that make one piece of evidence
    pull = misfit * together / SPREAD**2
    return np.clip((plain * energy + pull) / (energy + pull), *LIMITS)
