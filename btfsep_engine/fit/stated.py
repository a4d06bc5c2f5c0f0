# SPDX-License-Identifier: GPL-3.0-or-later
"""What is stated of a light: its coefficients, how well they are known, which the photo determines, the expected error.

An error of a light x^ is |s x^ - x| / |x| with the best factor s >= 0 (one free scale), over the coefficients up to an
order. The truth x is any of the posterior's samples, so the error has a distribution; its median and the range that
holds 68 % of it are the expected error: what was knowable, beside what was found.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import lapack

from btfsep_engine import sh
from btfsep_engine.conventions import fibonacci_sphere
from btfsep_engine.light.log_field import natural_spread

DETERMINED = 0.5  # of what a coefficient could be: known to better than that
REFLECTANCE = 0.1  # of all light: a material's reflectance differs from piece to piece
RANGE = (2.5, 97.5)  # percentiles of what is stated as the range
MIDDLE = (15.9, 84.1)  # of a standard deviation: tails of an exponential would make the mean square say anything
LEAST_SCALE = 1e-3  # of a sample: one that has nothing in common with the estimate has no scale
ERROR_RANGE = (16, 50, 84)  # percentiles of the expected error
ERROR_ORDERS = (1, 2)


@dataclass(frozen=True)
class Lamp:
    """A lamp or sun of the light.

    Attributes
    ----------
    direction : (3,) unit, to the lamp; irradiance : (3,) on a surface that faces it; stddev : (3,) of it
    degrees : standard deviation of the direction
    share, share_stddev : of the light's mean radiance
    given : whether its direction was
    """

    direction: np.ndarray
    irradiance: np.ndarray
    stddev: np.ndarray
    degrees: float
    share: float
    share_stddev: float
    given: bool = False


@dataclass(frozen=True)
class Stated:
    """How well a light is known, of all orders of its fit.

    Attributes
    ----------
    stddev : (terms, 3) float64; determined : (terms,) bool
    interval : (2, terms, 3), the ends of the range that holds 95 % of the samples; None without a prior
    samples : (n, terms, 3), lights as probable as the posterior has them; None without a prior
    lamps : Lamp, the brightest first
    pattern : (4, terms, 3), `pattern_ranges`; None without a prior
    """

    stddev: np.ndarray
    determined: np.ndarray
    interval: np.ndarray | None = None
    samples: np.ndarray | None = None
    lamps: tuple = ()
    pattern: np.ndarray | None = None


@dataclass(frozen=True, kw_only=True)
class Fit:
    """A fitted lighting. What is called "all" has all orders of the fit; the same without it, those up to ``order``.

    Attributes
    ----------
    order : that is reported
    all_coefficients : (terms, 3) float64
    state : gives its Stated, reckoned when it is first asked for: most fits of a search are compared, and no more
    residual : relative root mean square of b - A x, over all pixels and channels
    residual_per_channel : (3,)
    condition : 2-norm condition number of A up to ``order`` (the worst channel)
    effective_degrees_of_freedom : of a channel's unknowns, how many the photo decides (all, without a prior)
    noise : a pixel's own misfit over the photo's root mean square; None without a prior
    tint : colour.Tint, what of the light's colour was taken to be the object's; None without a prior
    election : elected.Election, which models stood and what they were given; None without a prior
    seen : (terms, 3), `shown` without the light that does not reach what is photographed; None: all of it does
    """

    order: int
    all_coefficients: np.ndarray
    state: Callable[[], Stated]
    residual: float
    residual_per_channel: np.ndarray
    condition: float
    effective_degrees_of_freedom: float
    noise: float | None = None
    tint: object | None = None
    election: object | None = None
    seen: np.ndarray | None = None

    @property
    def all_determined(self) -> np.ndarray:
        """(terms,) bool."""
        return self.state().determined

    @property
    def samples(self) -> np.ndarray | None:
        """`Stated.samples`."""
        return self.state().samples

    @property
    def lamps(self) -> tuple:
        """`Stated.lamps`."""
        return self.state().lamps

    @property
    def terms(self) -> int:
        """How many coefficients are reported."""
        return sh.term_count(self.order)

    @property
    def coefficients(self) -> np.ndarray:
        """(terms, 3), those that are reported."""
        return self.all_coefficients[: self.terms]

    @property
    def stddev(self) -> np.ndarray:
        """(terms, 3)."""
        return self.state().stddev[: self.terms]

    @property
    def determined(self) -> np.ndarray:
        """(terms,) bool."""
        return self.state().determined[: self.terms]

    @property
    def interval(self) -> np.ndarray | None:
        """(2, terms, 3)."""
        interval = self.state().interval
        return None if interval is None else interval[:, : self.terms]

    @property
    def pattern(self) -> np.ndarray | None:
        """(4, terms, 3), `pattern_ranges`."""
        pattern = self.state().pattern
        return None if pattern is None else pattern[:, : self.terms]

    @property
    def shown(self) -> np.ndarray:
        """All coefficients whose A x is the photo: in the colour that the object gives them."""
        if self.seen is not None:
            return self.seen
        return self.all_coefficients if self.tint is None else self.all_coefficients / self.tint.gain

    @property
    def hidden(self) -> np.ndarray | None:
        """From where no light reaches what is photographed, as `log_field.LogField` has it; None: from nowhere."""
        return None if self.election is None else self.election.photo.fields[0].hidden

    @property
    def evidence(self) -> float | None:
        """Logarithm of how probable the photo is under the model, comparable for the same photo alone."""
        return None if self.election is None else self.election.solution.evidence


def determined(coefficients, stddev) -> np.ndarray:
    """Which coefficients the photo determines: those it knows to better than half of what they could be.

    What a coefficient could be is what natural light varies it by (`light.log_field.natural_spread`), or its own size,
    where that is larger: no nature varies the high orders as a lamp does.

    (terms, 3), (terms, 3) -> (terms,) bool
    """
    x = np.asarray(coefficients)
    nature = natural_spread()[: len(x)] * np.abs(x[0]).mean()
    size = np.sqrt(np.square(x).mean(1))
    return np.sqrt(np.square(stddev).mean(1)) < DETERMINED * np.maximum(nature, size)


def stated_by(coefficients, samples, lamps=()) -> Stated:
    """What ``samples`` (n, terms, 3) of the posterior about ``coefficients`` (terms, 3) say.

    The reflectance's scale, which all coefficients share, is in the spread, and leaves none of them undetermined.
    """
    x = coefficients
    low, below, above, high = _percentiles(samples, (RANGE[0], *MIDDLE, RANGE[1]))
    spread = np.maximum(np.maximum(above - x, x - below), 0)
    pattern = np.sqrt(np.maximum(spread**2 - (REFLECTANCE * x) ** 2, 0))
    return Stated(spread, determined(x, pattern), np.stack([low, high]), samples, lamps, pattern_ranges(x, samples))


def pattern_ranges(coefficients, samples) -> np.ndarray:
    """What the coefficients may be where only a light's pattern counts, whatever its scale, as of one free scale.

    Each sample is brought to the scale in which ``coefficients`` (terms, 3) are nearest to it, up to the order of the
    usual error. The scale of a photo's exposure and of a surface's reflectance is in none of it.

    Gives (4, terms, 3), ascending: the ends of the range that holds 95 %, and within it of that which holds 68 %.
    """
    x, few = coefficients, sh.term_count(max(ERROR_ORDERS))
    scale = np.einsum("ntc,tc->n", samples[:, :few], x[:few]) / max(float(np.square(x[:few]).sum()), 1e-300)
    own = samples / np.maximum(scale, LEAST_SCALE)[:, None, None]
    return _percentiles(own, (RANGE[0], *MIDDLE, RANGE[1]))


def _percentiles(samples, percentages) -> np.ndarray:
    """`np.percentile` over the first axis, of numbers sorted side by side: it takes several times as long."""
    n = len(samples)
    by_number = np.sort(samples.reshape(n, -1).T.copy(), axis=1)
    at = np.asarray(percentages) / 100 * (n - 1)
    below = np.minimum(at.astype(int), max(n - 2, 0))
    first, second = by_number[:, below], by_number[:, np.minimum(below + 1, n - 1)]
    return (first + (at - below) * (second - first)).T.reshape(-1, *samples.shape[1:])


def reaching_part(hidden, order: int) -> np.ndarray:
    """What is left of coefficients of an order without light from ``hidden`` directions: (terms, terms)."""
    y = sh.evaluate(order, fibonacci_sphere(len(hidden))[~hidden])
    return (y.T @ y) * (4 * np.pi / len(hidden))


def of_reaching(fit: Fit) -> tuple[np.ndarray, np.ndarray]:
    """All coefficients and the samples of a fit, as of its light without that which does not reach the photo."""
    to_reaching = reaching_part(fit.hidden, sh.order_of(len(fit.all_coefficients)))
    return to_reaching @ fit.all_coefficients, to_reaching @ fit.samples


def shown_error(fit: Fit) -> dict | None:
    """`expected_error` of the light that reaches the photo; None where all light does, or without a prior."""
    return None if fit.hidden is None or fit.samples is None else expected_error(*of_reaching(fit))


def restated(fit: Fit, samples) -> Fit:
    """The fit with what other samples (n, terms, 3) say."""
    stated = stated_by(fit.all_coefficients, samples, fit.lamps)
    return replace(fit, state=lambda: stated)


def mixed(fit: Fit, others) -> Fit:
    """The fit with samples of others among its own, each in the fit's own scale.

    ``others`` : (Fit, its share of the samples) of each; what is left of them are the fit's own
    """
    samples, x = [], fit.all_coefficients
    for other, share in others:
        count = int(share * len(fit.samples))
        if count:
            y = other.all_coefficients
            samples.append(float((y * x).sum() / max(np.square(y).sum(), 1e-300)) * other.samples[:count])
    if not samples:
        return fit
    own = len(fit.samples) - sum(map(len, samples))
    return restated(fit, np.concatenate([fit.samples[:own], *samples]))


def widened(fit: Fit, factor: float, *, odds_even: bool = False) -> Fit:
    """The fit with all that its samples depart from it by made ``factor`` times as large.

    ``odds_even`` : of half of them, where what was found may as well be as right as the fit says
    """
    x, count = fit.all_coefficients, len(fit.samples)
    factors = np.full((count, 1, 1), factor)
    if odds_even:  # drawn by chance: samples may stand in an order, as by whose colour a tint is
        factors[np.random.default_rng(0).permutation(count)[: count // 2]] = 1
    return restated(fit, x + factors * (fit.samples - x))


def decided_unknowns(factor) -> float:
    """Of a channel's unknowns of variance 1, how many the photo decides; ``factor``: of I + J^T J, lower Cholesky.

    To six decimals: the last digits of a long sum hang on where its numbers lie in memory.
    """
    inverse, _ = lapack.dtrtri(factor.T, lower=0)
    return round((len(factor) - float(np.square(inverse).sum())) / 3, 6)


def expected_error(coefficients, samples) -> dict:
    """The expected relative error up to each of `ERROR_ORDERS` that the terms reach, with one free scale.

    Parameters
    ----------
    coefficients : (terms, 3), the estimate
    samples : (n, at least so many terms, 3), lights as probable as the posterior has them

    Returns
    -------
    {"order_1": {"median", "low", "high"}, …}, relative errors with one free scale
    """
    x, out = np.asarray(coefficients, np.float64), {}
    for order in ERROR_ORDERS:
        n = sh.term_count(order)
        if n > len(x):
            continue
        a, b = x[:n].ravel(), np.asarray(samples)[:, :n].reshape(len(samples), -1)
        scale = np.maximum(b @ a / max(a @ a, 1e-300), 0)
        error = np.linalg.norm(scale[:, None] * a - b, axis=1) / np.maximum(np.linalg.norm(b, axis=1), 1e-300)
        low, median, high = np.percentile(error, ERROR_RANGE)
        out[f"order_{order}"] = {"median": float(median), "low": float(low), "high": float(high)}
    return out
