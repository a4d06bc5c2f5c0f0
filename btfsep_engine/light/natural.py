# SPDX-License-Identifier: GPL-3.0-or-later
"""What natural light is like in spherical harmonics, learned from the shipped training lights.

Light x of the level s (the mean of its channels' first coefficients) is taken to be

    x[0, c]  = s + s colour e           e ~ N(0, 1) per channel, s unknown
    x[lm, c] = s (mean[l] [m = 0] + scale amplitude[l] z[lm, c]),    z[lm] ~ N(0, C)

with C = (1 - r) I + r 1 1^T: the channels vary together. Every m of an order has the same variance, so the prior
does not change when light is turned about the vertical; only zonal terms can have a mean (light from above).
Seven maps teach no more than a few numbers, and these are they: amplitude[l] = strength l^-decline, r, colour and how
much the maps' common scale varies (its logarithm; an overcast sky and a sun differ by more than any two coefficients
of one of them). How many orders have a mean was decided by the likelihood of each map under what the others teach
(`held_out`): none but the level. That light comes from above is true of all seven, but their scales differ so much
that one mean serves none of them.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from btfsep_engine import sh
from btfsep_engine.light.maps import training_lights

MEAN_ORDER = 0  # the best by `held_out`: -7 for one zonal mean, -19 for two
LARGEST_ORDER = 9
# Variance of colour against the maps' own: a material's colours are not exact either, and the light has to bear it.
COLOUR_ALLOWANCE = 2.0
LEVEL_SPREAD = 5.0  # of the level, relative to a first guess: as good as unknown


@dataclass(frozen=True, eq=False)
class NaturalPrior:
    """Natural light relative to its level.

    Attributes
    ----------
    order : L
    mean : (terms,) float64, the first is 1
    deviation : (terms,) float64, standard deviation about the mean at scale 1; the first: of the level's colour
    correlation : between two channels of a coefficient, 0 to 1
    log_scale_spread : standard deviation of the logarithm of the scale
    """

    order: int
    mean: np.ndarray
    deviation: np.ndarray
    correlation: float
    log_scale_spread: float

    def covariance(self) -> np.ndarray:
        """(3 terms, 3 terms) float64 about zero, channel by channel; the level's own (wide) spread is in it."""
        terms = len(self.mean)
        channels = np.full((3, 3), self.correlation) + (1 - self.correlation) * np.eye(3)
        out = np.einsum("cd,ij->cidj", channels, np.diag(self.deviation**2))
        out[:, 0, :, 0] = self.deviation[0] ** 2 * np.eye(3)
        out += LEVEL_SPREAD**2 * np.outer(self.mean, self.mean)[None, :, None, :]
        return out.reshape(3 * terms, 3 * terms)


def relative_coefficients(order: int = LARGEST_ORDER) -> np.ndarray:
    """The training lights, each as it was taken, over their levels: (maps, terms, 3) float64."""
    x = training_lights(rotations=1).coefficients(order)
    return x / x[:, 0].mean(-1)[:, None, None]


def learn(relative, *, mean_order: int = MEAN_ORDER) -> NaturalPrior:
    """The prior that maps teach.

    Parameters
    ----------
    relative : (maps, terms, 3), coefficients over the level; orders 2 and more
    mean_order : the zonal terms up to this order have a mean
    """
    relative = np.asarray(relative, np.float64)
    order = sh.order_of(relative.shape[1])
    per_term = np.repeat(np.arange(order + 1), 2 * np.arange(order + 1) + 1)
    zonal = [l * l + l for l in range(mean_order + 1)]
    mean = np.zeros(len(per_term))
    mean[zonal] = relative[:, zonal].mean((0, 2))
    centred = relative - mean[:, None]
    common = centred.mean(-1, keepdims=True)
    colour = centred - common
    orders = np.arange(1, order + 1)
    # the mean of logarithms, not of squares: two maps with a sun would else speak for all
    logs = np.log([[np.sqrt((m[per_term == l] ** 2).mean()) for m in common] for l in orders])
    slope, offset = np.polyfit(np.log(orders), logs.mean(1), 1)
    deviation = np.ones(len(per_term))
    deviation[1:] = np.exp(offset) * per_term[1:] ** slope
    deviation[0] = np.sqrt(COLOUR_ALLOWANCE * (colour[:, 0] ** 2).mean() * 1.5)  # 1.5: three channels, their mean known
    share = COLOUR_ALLOWANCE * 1.5 * (colour[:, 1:] ** 2).mean() / (common[:, 1:] ** 2).mean()
    # variance per channel 1 + share of the common one's; the common one keeps the learned amplitude
    deviation[1:] *= np.sqrt(1 + share * 2 / 3)
    return NaturalPrior(order, mean, deviation, float(1 / (1 + share)), float(logs.mean(0).std(ddof=1)))


@lru_cache(maxsize=10)
def natural_prior(order: int = LARGEST_ORDER) -> NaturalPrior:
    """The prior up to ``order``, learned from all training lights at their largest order."""
    full = learn(relative_coefficients())
    terms = sh.term_count(order)
    return NaturalPrior(order, full.mean[:terms], full.deviation[:terms], full.correlation, full.log_scale_spread)


def held_out(relative, *, mean_order: int) -> float:
    """Sum over the maps of the log-likelihood of each (its colourless part) under what the others teach."""
    relative = np.asarray(relative, np.float64)
    scales = np.linspace(-3, 3, 121)
    total = 0.0
    for k, left_out in enumerate(relative):
        prior = learn(np.delete(relative, k, 0), mean_order=mean_order)
        z = (left_out.mean(-1) - prior.mean)[1:] / prior.deviation[1:]
        log = (
            -0.5 * (z @ z) * np.exp(-2 * scales)
            - len(z) * scales
            - np.log(prior.deviation[1:]).sum()
            - 0.5 * (scales / prior.log_scale_spread) ** 2
            - np.log(prior.log_scale_spread)
        )
        total += np.logaddexp.reduce(log)
    return float(total)


@lru_cache(maxsize=10)
def natural_amplitude(order: int) -> np.ndarray:
    """Typical size of each coefficient of natural light, relative to the first.

    The root mean square over the shipped training lights, all channels and each band's terms; a band's terms
    share one value, as if light could be turned about any axis.

    Returns
    -------
    ((order + 1)^2,) float64, the first is 1
    """
    x = np.moveaxis(training_lights().coefficients(order), 1, 0)
    relative = x / x[0].mean(-1, keepdims=True)
    out = np.ones(sh.term_count(order))
    for l in range(1, order + 1):
        band = slice(l * l, (l + 1) ** 2)
        out[band] = np.sqrt((relative[band] ** 2).mean())
    return out
