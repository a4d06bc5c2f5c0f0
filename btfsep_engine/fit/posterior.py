# SPDX-License-Identifier: GPL-3.0-or-later
"""Lights as probable as the posterior has them: samples about the most probable one, and of what no pixel shows."""

import numpy as np
from scipy.linalg import solve_triangular

from btfsep_engine import sh
from btfsep_engine.fit.light_model import BRIGHTNESS
from btfsep_engine.fit.products import Basis
from btfsep_engine.fit.search import LONGEST, Solution
from btfsep_engine.light.log_field import natural_field
from btfsep_engine.linear_algebra import product

WIDER = 1.4  # than Laplace's: one model was elected, and real materials misfit in more ways than it has
HIDDEN = 0.04  # of the largest mean response of the pixels: a lamp that the photo could not know of
HIDDEN_LAMPS = 0.5  # expected number of them over a whole sphere of such directions
CENTRINGS = 8  # steps by which samples are moved to what the photo says
CENTRED = 0.5  # of chi^2: less is not worth a further step


def posterior_samples(best: Solution, count: int, random, *, model=None) -> tuple[np.ndarray, np.ndarray]:
    """Unknowns (count, unknowns) and lights (count, all terms, 3), as probable as the posterior has them.

    Laplace's samples theta + delta, moved until what they predict of the photo is what the linear model says they
    should, r + J delta, and no further than it takes: an exponential is brighter in the mean than at its middle, and
    the photo knows how bright it is (randomise, then optimise: Bardsley and others 2014, with the derivative at the
    maximum for all). ``model`` : whose lights they are, where it is not the solution's own.
    """
    model, root = model or best.model, [r.astype(np.float32) for r in best.rows.root]
    jacobian, inverse = best.jacobian.astype(np.float32), best.inverse
    by_direction = model.field.by_direction(root, np.float32)
    delta = WIDER * solve_triangular(best.factor.T, random.standard_normal((len(best.white), count)), lower=False).T
    asked = (best.white + delta).astype(np.float32)
    # of the photo's own values y nothing is left but what they differ by from R x: small numbers, as single ones want
    shown = np.concatenate([product(r, x) for r, x in zip(best.rows.root, best.x, strict=True)])
    wanted = (shown + product(delta, best.jacobian.T)).astype(np.float32)
    whites, left, moving = asked.copy(), model.seen(asked, root, by_direction) - wanted, np.arange(count)
    for _ in range(CENTRINGS):
        slope = product(left[moving], jacobian) + whites[moving] - asked[moving]
        step = product(slope, inverse)
        worth = np.einsum("ij,ij->i", slope, step) > CENTRED  # what a whole step would gain of linear images
        moving, step = moving[worth], step[worth]
        if not len(moving):
            break
        trial = whites[moving] - step * (LONGEST / np.maximum(np.abs(step).max(1, keepdims=True), LONGEST))
        left_there = model.seen(trial, root, by_direction) - wanted[moving]
        here = np.square(left[moving]).sum(1) + np.square(whites[moving] - asked[moving]).sum(1)
        gain = here - np.square(left_there).sum(1) - np.square(trial - asked[moving]).sum(1)
        better = gain > 0
        whites[moving[better]], left[moving[better]] = trial[better], left_there[better]
        moving = moving[gain > CENTRED]
    off = 0.0 if model.field.hidden is None else random.standard_normal(count)
    return whites, model.whole(whites, off).transpose(0, 2, 1)


def hidden_lamps(basis: Basis, count: int, random, *, lamps: int, field=None, shadowed=None) -> np.ndarray:
    """Lamps in the directions from which hardly a pixel is lit: (count, terms, 3), most of them none.

    A field's logarithm is Gaussian, and has no lamps; those that the photo shows, ``lamps`` of them, have been found.
    Of others, behind the object as a rule, nothing is known but that lamps are, and that they come in company: their
    density is that of the known ones where they could be seen, under a Gamma prior of `HIDDEN_LAMPS` in one sphere.
    ``field`` : whose directions; of hidden ones natural lights say how bright they are, lamps and all.
    ``shadowed`` : as of `products.Photograph`: what else than a pixel that is lit would show a lamp.
    Each is as bright as `fit.light_model` takes lamps to be, or half of its spread from it.
    """
    field = field or natural_field()
    response = basis.mean_response @ field.to_coefficients
    places = field.directions[(response < HIDDEN * response.max()) & field.reaching]
    if shadowed is not None:
        places = places[~shadowed(places)]
    out = np.zeros((count, basis.terms, 3))
    share = len(places) / len(field.directions)
    lit = random.random(count) < -np.expm1(-share * (HIDDEN_LAMPS + lamps) / (2 - share))
    if lit.any():
        d = places[random.integers(len(places), size=lit.sum())]
        irradiance = 2 * np.pi * np.exp(BRIGHTNESS / 2 * random.standard_normal(len(d)))
        out[lit] = (sh.evaluate(sh.order_of(basis.terms), d) * irradiance[:, None])[..., None]
    return out
