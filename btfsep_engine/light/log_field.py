# SPDX-License-Identifier: GPL-3.0-or-later
"""Natural light as the exponential of a Gaussian field: positive, black where nothing speaks for light, heavy-tailed.

The logarithm of natural radiance is nearly normal (Dror, Willsky and Adelson 2004), skies and rooms alike. With l the
mean of the channels' logarithms, and c1 = log R - log B, c2 = log G - (log R + log B) / 2 the chroma,

    log L_k(d) = l(d) + V[k, 1] c1(d) + V[k, 2] c2(d),    each field a sum of spherical harmonics, f = sum a_lm Y_lm,
    a_lm ~ N(mean of the zonal ones, s_l^2),

because the eigenfunctions of a stationary covariance on the sphere are spherical harmonics: the covariance is one
variance for each degree, and white numbers w = (a - mean) / s are the unknowns of the fit. The variances are learned
from the shipped training lights (`learn`; the table is ``data/natural_log_light.json``, written by
``scripts/study learn-natural-light``): a power law over the degrees, because seven maps teach no more. The level,
degree 0, is as good as unknown.

The light's coefficients up to the fit's order are sums over directions of equal solid angle, x = T exp(u).
"""

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import pairwise
from pathlib import Path

import numpy as np

from btfsep_engine import sh
from btfsep_engine.conventions import fibonacci_sphere
from btfsep_engine.light.hidden_light import hidden_share, usual_brightness
from btfsep_engine.linear_algebra import product

TABLE = Path(__file__).resolve().parents[1] / "data" / "natural_log_light.json"
CHROMA = np.array([[1, 1 / 2, -1 / 3], [1, 0, 2 / 3], [1, -1 / 2, -1 / 3]])  # V: channels over (l, c1, c2)
DIRECTIONS = 400  # 10 degrees apart: the fit's order 9 has 20
FIELD_ORDER = 12  # of l: finer than the fit's order can tell
CHROMA_ORDER = 6
LARGEST_ORDER = 9  # of the light's coefficients that a fit can have
AMPLITUDE = 1.4  # of l over the maps' own: seven maps hold no room with one lamp
LEVEL = 3.0  # standard deviation of the level's logarithm: unknown
VIVID = np.array([1.0, 5.0, 8.0])  # times the deviations of l, c1 and c2, of light on a stage: a red filter's c1 is 4,
# a green or magenta one's c2 up to 3, where natural lights scatter by 0.35 and 0.2, from place to place by 0.8 and 0.3
LARGEST_LOG = 14.0  # exponentials stay finite on the way of a search
DRAWS = 400  # lights that say what the field varies
ZONAL = 2  # the zonal terms of so many degrees have a mean (light from above)


@dataclass(frozen=True, eq=False)
class LogField:
    """The prior, and what leads from its white unknowns to the light.

    Attributes
    ----------
    order, chroma_order : degrees of the fields l, and c1 and c2
    deviation : (k,) float64, s of every unknown: those of l, then those of c1, then those of c2
    mean : (k,) float64
    terms : of the light's coefficients
    count : of the directions
    beside : what else is asked of a light beside its coefficients: directions (…, 3) -> what a beam of irradiance 1
        from there gives, (…, k); None: nothing
    hidden : (m,) bool, from which of `fibonacci_sphere(m)` no light reaches what is photographed; None: from none.
        Basis images of a low order are not 0 there, and a light of which nothing else is known would be bright enough
        to explain by that what the photo has beside the other light
    vivid : whether lights may have the colours that they have on a stage
    """

    order: int
    chroma_order: int
    deviation: np.ndarray
    mean: np.ndarray
    terms: int = sh.term_count(LARGEST_ORDER)
    count: int = DIRECTIONS
    beside: Callable | None = None
    hidden: np.ndarray | None = None
    vivid: bool = False

    @property
    def unknowns(self) -> int:
        """k, the number of white unknowns."""
        return len(self.deviation)

    @cached_property
    def directions(self) -> np.ndarray:
        """(n, 3) float64, unit, each for the solid angle 4 pi / n; one, where all are alike."""
        return fibonacci_sphere(self.count if max(self.order, self.chroma_order) else 1)

    @cached_property
    def to_coefficients(self) -> np.ndarray:
        """T, (terms, n): radiance in the directions to coefficients."""
        y = sh.evaluate(sh.order_of(self.terms), self.directions)
        if len(y) == 1:
            y[:, 1:] = 0
        if self.beside is not None:
            places = self.directions if len(y) > 1 else fibonacci_sphere(self.count)
            more = self.beside(places)
            y = np.concatenate([y, more if len(y) > 1 else more.mean(0, keepdims=True)], 1)
        return y.T * (4 * np.pi / len(y))

    def of_beam(self, directions) -> np.ndarray:
        """Coefficients (…, terms) of light of irradiance 1 from one direction each (…, 3)."""
        y = sh.evaluate(sh.order_of(self.terms), directions)
        return y if self.beside is None else np.concatenate([y, self.beside(directions)], -1)

    @cached_property
    def _to_coefficients(self) -> dict:
        """T in double and in single precision."""
        return {np.dtype(kind): self.to_coefficients.astype(kind) for kind in (np.float64, np.float32)}

    @cached_property
    def _to_shown(self) -> dict:
        """T of light that reaches what is photographed, likewise: 0 for directions that are hidden."""
        if self.hidden is None:
            return self._to_coefficients
        return {kind: np.where(self.reaching, t, kind.type(0)) for kind, t in self._to_coefficients.items()}

    @cached_property
    def reaching(self) -> np.ndarray:
        """(n,) bool, the directions that are not hidden; all that is even is shown as it is."""
        if self.hidden is None or len(self.directions) == 1:
            return np.ones(len(self.directions), bool)
        return ~self.hidden[(self.directions @ fibonacci_sphere(len(self.hidden)).T).argmax(1)]

    @cached_property
    def _hidden_parts(self) -> tuple[np.ndarray, float]:
        """T of the light from hidden directions, (n, terms), and how many of all are hidden."""
        places = self.directions if len(self.directions) > 1 else fibonacci_sphere(self.count)
        share = hidden_share(self.hidden, places)
        if len(self.directions) > 1:
            return self.to_coefficients.T * share[:, None], share.mean()
        y = sh.evaluate(sh.order_of(self.terms), places) * (4 * np.pi / len(places))
        return np.pad(share @ y, (0, len(self.to_coefficients) - self.terms))[None], share.mean()

    def hidden_light(self, radiance, all_light, off=0.0) -> tuple:
        """What hidden light is to be multiplied by, (…), and its coefficients as the field has them, (…, 3, terms).

        Then its mean is to that of all other light as `usual_brightness` says.

        Parameters
        ----------
        radiance : (…, 3, n), the field's; all_light : (…, 3, terms), with its coefficients, and lamps beside it
        off : (…), standard deviations by which hidden light is brighter than it usually is
        """
        to_hidden, share = self._hidden_parts
        found = radiance @ to_hidden.astype(radiance.dtype)
        mean, stddev = usual_brightness(self.hidden)
        there, everywhere = found[..., 0].sum(-1), all_light[..., 0].sum(-1)
        usual = np.exp(mean + stddev * off) * (everywhere - there) * share / (1 - share)
        return usual / np.maximum(there, 1e-30), found

    @cached_property
    def _parts(self) -> list:
        ends = np.cumsum([0, sh.term_count(self.order), *[sh.term_count(self.chroma_order)] * 2])
        return [slice(a, b) for a, b in pairwise(ends)]

    @property
    def chroma_parts(self) -> list:
        """Which of the unknowns are those of c1, and of c2."""
        return self._parts[1:]

    @cached_property
    def _mean_logarithm(self) -> np.ndarray:
        """(3, n)."""
        y = self._harmonics[self.mean.dtype]
        return CHROMA @ np.stack([y[:, : part.stop - part.start] @ self.mean[part] for part in self._parts])

    def logarithm(self, white) -> np.ndarray:
        """u = log L, (…, 3, n), of white unknowns (…, k), in their precision."""
        kind = white.dtype
        a, y = white * self.deviation.astype(kind), self._series[kind]
        fields = np.array([product(a[..., part], own) for part, own in zip(self._parts, y, strict=True)])
        out = CHROMA.astype(kind) @ fields.reshape(3, -1)  # a channel's numbers side by side, however many lights
        out = _channels_last_but_one(out.reshape(fields.shape))
        out += self._mean_logarithm.astype(kind)
        return np.minimum(out, kind.type(LARGEST_LOG), out=out)

    def radiance(self, white) -> np.ndarray:
        """L, (…, 3, n), of white unknowns (…, k)."""
        logarithm = self.logarithm(white)
        return np.exp(logarithm, out=logarithm)

    def coefficients(self, radiance) -> np.ndarray:
        """T L: (…, 3, terms) of the radiance (…, 3, n), in its precision."""
        return self._times(radiance, self._to_coefficients)

    def shown(self, radiance) -> np.ndarray:
        """The same of the light that reaches what is photographed."""
        return self._times(radiance, self._to_shown)

    def _times(self, radiance, by_precision) -> np.ndarray:
        to = by_precision[radiance.dtype].T
        if radiance.ndim == 2:
            return product(radiance, to)
        by_channel = np.moveaxis(radiance, -2, 0)
        out = product(by_channel.reshape(-1, radiance.shape[-1]), to)
        return _channels_last_but_one(out.reshape(*by_channel.shape[:-1], -1))

    @cached_property
    def _harmonics(self) -> dict:
        """In double and in single precision: (n, terms of the largest field)."""
        y = sh.evaluate(max(self.order, self.chroma_order), self.directions)
        return {np.dtype(kind): y.astype(kind) for kind in (np.float64, np.float32)}

    @cached_property
    def _series(self) -> dict:
        """The same of each part of the unknowns: (terms, n)."""
        sizes = [part.stop - part.start for part in self._parts]
        return {kind: [np.ascontiguousarray(y[:, :size].T) for size in sizes] for kind, y in self._harmonics.items()}

    def by_direction(self, rows, kind=np.float64) -> list:
        """R_c T, (r_c, n), for each channel's rows R_c (r_c, terms), of what is `shown`: for `jacobian`."""
        t = self._to_shown[np.dtype(kind)]
        return [product(r.astype(kind, copy=False), t) for r in rows]

    def jacobian(self, by_direction, radiance, *, beside: int = 0) -> np.ndarray:
        """The derivatives of R_c x_c by the white unknowns: (all rows, k), in the precision of what it is given.

        Parameters
        ----------
        by_direction : R_c T of each channel; radiance : (3, n), L
        beside : so many columns more, for others to fill
        """
        kind = by_direction[0].dtype
        out, start = np.empty((sum(map(len, by_direction)), self.unknowns + beside), kind), 0
        for r, light, chroma in zip(by_direction, radiance.astype(kind), CHROMA, strict=True):
            by_term = product(r * light, self._harmonics[kind])  # all fields are series of the same harmonics
            rows = slice(start, start := start + len(r))
            for part, share in zip(self._parts, chroma, strict=True):
                size = (share * self.deviation[part]).astype(kind)
                np.multiply(by_term[:, : part.stop - part.start], size, out=out[rows, part])
        return out

    def gradient(self, by_direction, radiance, residual) -> np.ndarray:
        """J^T r, (k,), of `jacobian`'s J without making it; ``residual`` : r of each channel, in the same precision."""
        kind = by_direction[0].dtype
        each = np.stack([light * product(r, of) for of, light, r in zip(by_direction, radiance, residual, strict=True)])
        by_term = product((CHROMA.T @ each).astype(kind), self._harmonics[kind])
        own = [of_field[: part.stop - part.start] for of_field, part in zip(by_term, self._parts, strict=True)]
        return np.concatenate(own) * self.deviation

    def jacobians(self, by_direction, radiance) -> np.ndarray:
        """`jacobian` of many lights at once, of as many rows each: (m, all rows, k).

        ``by_direction`` : R_c T, (m, 3, r, n); ``radiance`` : (m, 3, n)
        """
        kind, (count, channels, r, n) = by_direction.dtype, by_direction.shape
        shown = by_direction * radiance.astype(kind)[:, :, None]
        by_term = product(shown.reshape(-1, n), self._harmonics[kind]).reshape(count, channels, r, -1)
        out = np.empty((count, channels, r, self.unknowns), kind)
        for part, shares in zip(self._parts, CHROMA.T, strict=True):
            size = (shares[:, None, None] * self.deviation[part]).astype(kind)
            np.multiply(by_term[..., : part.stop - part.start], size, out=out[..., part])
        return out.reshape(count, -1, self.unknowns)

    def gradients(self, by_direction, radiance, residual) -> np.ndarray:
        """`gradient` of many lights at once, (m, k); ``residual`` : (m, 3, r), all else as in `jacobians`."""
        kind = by_direction.dtype
        each = CHROMA.T.astype(kind) @ (radiance.astype(kind) * (residual[:, :, None] @ by_direction)[:, :, 0])
        by_term = product(each.reshape(-1, each.shape[-1]), self._harmonics[kind]).reshape(*each.shape[:2], -1)
        own = [by_term[:, i, : part.stop - part.start] for i, part in enumerate(self._parts)]
        return np.concatenate(own, 1) * self.deviation

    def at(self, white, directions) -> np.ndarray:
        """L in other directions (m, 3): (m, 3)."""
        a = self.mean + self.deviation * white
        terms = sh.term_count(max(self.order, self.chroma_order))
        of_fields = np.stack([np.pad(a[part], (0, terms - part.stop + part.start)) for part in self._parts], 1)
        return np.exp(np.minimum(sh.series(of_fields, directions) @ CHROMA.T, LARGEST_LOG))


def _channels_last_but_one(each) -> np.ndarray:
    """(3, …, n) as (…, 3, n); of a single light as it is, since what NumPy does for it is what a small step costs."""
    return each if each.ndim == 2 else np.moveaxis(each, 0, -2)


def build(table: dict, *, order: int = FIELD_ORDER, chroma_order: int = CHROMA_ORDER) -> LogField:
    """The prior of a table of `learn`."""
    sizes = (order, chroma_order, chroma_order)
    deviation, mean = [], []
    for name, largest in zip(("luminance", "red_blue", "green"), sizes, strict=True):
        l = sh.degrees(largest)
        s = table[name]["at_degree_1"] * np.maximum(l, 1.0) ** -table[name]["decline"]
        s[0] = table[name]["level"]
        m = np.zeros(len(l))
        if name == "luminance":
            s *= AMPLITUDE
            s[0] = LEVEL * np.sqrt(4 * np.pi)
            for degree, value in enumerate(table["zonal_mean"][:largest], 1):
                m[degree * degree + degree] = value
        deviation.append(s)
        mean.append(m)
    return LogField(order, chroma_order, np.concatenate(deviation), np.concatenate(mean))


@lru_cache(maxsize=1)
def natural_field() -> LogField:
    """The field that the shipped table describes."""
    return build(json.loads(TABLE.read_text()))


def as_vivid(field: LogField) -> LogField:
    """The same prior of light that may have strong colours, other ones from each direction."""
    wider = np.concatenate([np.full(p.stop - p.start, w) for p, w in zip(field._parts, VIVID, strict=True)])
    return replace(field, deviation=field.deviation * wider, vivid=True)


@lru_cache(maxsize=1)
def coarse_field(order: int, chroma_order: int, terms: int, count: int) -> LogField:
    """The same prior of coarser light, where what is asked of it is coarse: see `LogField`."""
    field = build(json.loads(TABLE.read_text()), order=order, chroma_order=chroma_order)
    return replace(field, terms=terms, count=count)


@lru_cache(maxsize=1)
def natural_spread() -> np.ndarray:
    """What the field varies each coefficient of the light by, over the first: (terms,), alike for a degree's.

    Half of the range that holds 68 %: of `DRAWS` lights, which know it to a few per cent.
    """
    field = natural_field()
    x = field.coefficients(field.radiance(np.random.default_rng(0).standard_normal((DRAWS, field.unknowns))))
    low, high = np.percentile(x / x[..., :1], (16, 84), axis=(0, 1))
    degree = sh.degrees(sh.order_of(field.terms))
    return (np.bincount(degree, (high - low) / 2) / np.bincount(degree))[degree]


@lru_cache(maxsize=1)
def even_field() -> LogField:
    """Light that is the same from everywhere, of any level and colour: what stands beside lamps in the plain model."""
    full = natural_field()
    first = [part.start for part in full._parts]
    return LogField(0, 0, full.deviation[first], np.zeros(3))
