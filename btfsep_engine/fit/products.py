# SPDX-License-Identifier: GPL-3.0-or-later
"""All that a fit needs to know of basis images and a photograph: their products, under one noise model.

Channel by channel, at unit response, a photograph is taken to be

    b = A x + F a + n,    n ~ N(0, h v I),    a ~ N(0, I),    F = D (A x') (o) Y

F is what a model that is nearly right misses: reflectance, tone and shape that are off by a part D, smoothly over the
normals (Y: harmonics of the normal up to `SMOOTH_ORDER`, each pixel's size as a first fit x' predicts it), and where
it is told so what the photo changes by if the camera is a little off (`slopes`). Light can imitate such a misfit;
under this model it need not. Of several objects, of one photograph or more, each has a misfit of its own, and that of
one which is explained worse than others is as many times larger (`departing`). How right the model is, D, is for the
evidence to say (`fit.log_normal`). a is integrated out, so that the inverse covariance is, with W = 1 / (h v),

    N^-1 = W - W F (I + F^T W F)^-1 F^T W

and the light enters by A^T N^-1 A and A^T N^-1 b alone, of which R (r, terms) and y (r,) are a square root:

    (b - A x)^T N^-1 (b - A x) = |R x - y|^2 + rest.

At v other than 1 the products are those at 1, scaled along the axes of F^T F at D and of A^T A; the square root is a
pivoted Cholesky factor, so that directions in which the photo says next to nothing cost nothing.

h > 1 is a coarsened posterior (Miller and Dunson 2019: a model that is nearly right is not trusted more the more pixels
there are): n pixels in channels whose misfits go together as `effective` independent ones count as at most
`EVIDENCE` * effective numbers.
"""

import copy
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import lapack

from btfsep_engine import sh
from btfsep_engine.errors import InputError
from btfsep_engine.light.log_field import LogField, as_vivid, even_field, natural_field
from btfsep_engine.linear_algebra import eigh, product

CHANNELS = ("red", "green", "blue")
EVIDENCE = 500  # pixels: alpha of the coarsened posterior
SMOOTH_ORDER = 4
NEARLY_RIGHT = 0.08  # D, root mean square over the normals, of a material that is taken for another's
NEGLIGIBLE = 1e-2  # an eigenvalue of A^T N^-1 A, where the prior of the light has variances of some 1
SEEN = 0.15  # of the largest mean response of the pixels: a lamp that hardly reaches them has any strength it likes
MOST_APART = 8  # parts with a misfit of their own; of more, neighbours share one
CHUNK = 1 << 13  # pixels: the basis images of a large photo are never copied whole
SINGLE = np.sqrt(4 * np.pi)  # the first coefficient of light of radiance 1


class Basis:
    """Basis images made ready for any number of photographs.

    Parameters
    ----------
    basis : (p, terms, 3) float, A: radiance of each pixel under each basis light
    normals : (p, 3) float, unit, world
    parts : (p,) int from 0 on, of which of several objects or photographs each pixel is; None: of one

    Raises
    ------
    InputError
        Without pixels, or where the material reflects nothing.
    """

    def __init__(self, basis, normals, parts=None):
        self.images = np.asarray(basis)
        self.pixels, self.terms = self.images.shape[:2]
        if self.pixels == 0:
            raise InputError("the fit", "no usable pixels", "use a wider mask or a shorter exposure")
        self.response = self.images[:, 0].mean(0, dtype=np.float64) * SINGLE
        for c, value in enumerate(self.response):
            if not value > 0:
                raise InputError(
                    "the fit",
                    f"the material reflects nothing towards the camera in the {CHANNELS[c]} channel",
                    "choose another material",
                )
        smooth = sh.evaluate(SMOOTH_ORDER, np.asarray(normals, np.float64))[:, 1:]
        self.smooth = smooth * (SINGLE / np.sqrt(smooth.shape[1]))  # Y: its rows are of length 1
        if parts is not None:
            count = int(np.max(parts)) + 1
            apart = np.asarray(parts) * min(MOST_APART, count) // count
            of_each = apart[:, None] == np.arange(min(MOST_APART, count))
            self.smooth = (of_each[:, :, None] * self.smooth[:, None]).reshape(self.pixels, -1)
        self._prepare()

    def _prepare(self) -> None:
        self._kept = None
        if self.pixels <= CHUNK:
            self._kept = [np.ascontiguousarray(self._rows(c, slice(None))) for c in range(3)]
        self.mean_response = sum(self.rows(c).mean(0) for c in range(3)) / 3  # (terms,)

    @cached_property
    def grams(self) -> list:
        """A^T A of each channel."""
        return [self._weighted_gram(c, None) for c in range(3)]

    @cached_property
    def axes(self) -> list:
        """Eigenvalues and eigenvectors of them."""
        return [eigh(gram) for gram in self.grams]

    def with_images(self, images) -> "Basis":
        """The same with more basis images (p, k, 3), after the others."""
        out = copy.copy(self)
        out.images = np.concatenate([self.images, np.asarray(images, self.images.dtype)], 1)
        out.terms = out.images.shape[1]
        out.__dict__ = {name: value for name, value in vars(out).items() if name not in ("grams", "axes")}
        out._prepare()
        return out

    def _parts(self):
        return [slice(i, min(i + CHUNK, self.pixels)) for i in range(0, self.pixels, CHUNK)]

    def rows(self, c: int, part=slice(None)) -> np.ndarray:
        """A of a channel at unit response: (pixels of the part, terms) float64."""
        return self._rows(c, part) if self._kept is None else self._kept[c][part]

    def _rows(self, c: int, part) -> np.ndarray:
        return self.images[part, :, c] / self.response[c]

    def _weighted_gram(self, c: int, weights) -> np.ndarray:
        gram = np.zeros((self.terms, self.terms))
        for part in self._parts():
            rows = self.rows(c, part)
            gram += product(rows.T, rows if weights is None else rows * weights[part, c, None])
        return gram

    def weighted_grams(self, weights) -> list:
        """A^T W A of each channel for ``weights`` (p, 3), None: all 1."""
        return self.grams if weights is None else [self._weighted_gram(c, weights) for c in range(3)]

    def predicted(self, x) -> np.ndarray:
        """A x: (p, 3), of coefficients (terms, 3), in the photograph's unit."""
        out = np.empty((self.pixels, 3))
        unit = float(np.abs(x).max()) or 1.0  # so that no photo's unit is too large or too small for single precision
        for c in range(3):
            out[:, c] = product(self.images[:, : len(x), c], (x[:, c] / unit).astype(self.images.dtype))
        return out * unit

    def condition(self, order: int) -> float:
        """Condition number of A up to an order, of the worst channel."""
        n = sh.term_count(order)
        each = [np.linalg.eigvalsh(g[:n, :n])[::-1] * r**2 for g, r in zip(self.grams, self.response, strict=True)]
        worst = np.sqrt(np.maximum(min(each, key=lambda values: values[-1] / values[0]), 0))
        return float(worst[0] / max(worst[-1], worst[0] * 1e-15))


@dataclass(frozen=True)
class Rows:
    """The square root of A^T N^-1 A and A^T N^-1 b at one noise: see the head of this file.

    Attributes
    ----------
    root : for each channel (r, terms), R; target : for each channel (r,), y
    rest : what no light explains, |b|^2 in N^-1 less |y|^2
    log_determinant : half the logarithm of det(I + F^T W F)
    """

    root: list
    target: list
    rest: float
    log_determinant: float

    def residual(self, x) -> np.ndarray:
        """R x - y of all channels, of coefficients (3, terms)."""
        each = zip(self.root, self.target, strict=True)
        return np.concatenate([product(r, x[c]) - y for c, (r, y) in enumerate(each)])


@dataclass(frozen=True)
class Smooth:
    """A channel's products of F at one D and at W = 1, along the axes of F^T F: what `Photograph.rows` scales.

    Attributes
    ----------
    squares : (k,), F^T F there; own : (k of F, k), the axes, times what D makes of F's columns
    of_light, of_photo : F^T A (k, terms), F^T b (k,); along : of_light along the axes of A^T A
    """

    squares: np.ndarray
    own: np.ndarray
    of_light: np.ndarray
    of_photo: np.ndarray
    along: np.ndarray

    def at(self, w: float) -> tuple[np.ndarray, np.ndarray]:
        """F^T W F (k,), and what makes F^T A and F^T b those of (I + F^T W F)^(-1/2) F^T W: (k,)."""
        ff = w * self.squares
        return ff, w / np.sqrt(1 + ff)


class Photograph:
    """The products of one photograph with a `Basis`.

    Parameters
    ----------
    basis : Basis
    radiance : (p, 3) float, b, linear
    weights : (p, 3) float >= 0, 1 over the variance of each channel of each pixel; None: all 1
    coarsening : how many times less a pixel counts than it would
    effective : how many independent channels the misfit is taken to have; None: learned from a first fit
    departing : (p,) float, how many times as far as D the object of a pixel may be from what the model has of it, where
        there are several; None: once
    slopes : (p, k, 3) float, what the photo may differ by beside noise, each as large as it usually is: what a camera
        that is a little off makes; None: nothing
    field : LogField, of the rich model; None: the natural one

    Raises
    ------
    InputError
        When the photo is black there.
    """

    def __init__(
        self,
        basis: Basis,
        radiance,
        *,
        weights=None,
        coarsening: float = 1.0,
        effective=None,
        departing=None,
        slopes=None,
        field=None,
    ):
        self.basis, self._stiff, self._field = basis, coarsening, field or natural_field()
        even = as_vivid(even_field()) if self._field.vivid else even_field()
        self._even = even if self._field.hidden is None else replace(even, hidden=self._field.hidden)
        b = np.asarray(radiance, np.float64) / basis.response
        weight = np.ones_like(b) if weights is None else np.asarray(weights, np.float64)
        level = (weight * b).sum(0) / np.maximum(weight.sum(0), 1e-300)
        if not level.max() > 0:
            raise InputError("the fit", "the photo is black where the object is", "use a longer exposure")
        self.level = np.maximum(level, 1e-3 * level.max())  # (3,), the unit of each channel
        self.b = b / self.level
        self.grams = basis.weighted_grams(weights)
        self._axes = basis.axes if weights is None else [eigh(gram) for gram in self.grams]
        self.count = weight.sum(0)
        self._weight, self._smooth = weight, None
        self._departing = departing
        self._slopes = None if slopes is None else slopes / (basis.response * self.level)
        self._axis_rows = [np.ascontiguousarray(own.T) for _, own in self._axes]
        self._take_in()
        self._effective, self.effective = effective, 1.0 if effective is None else effective

    def _take_in(self) -> None:
        """The products of the photograph's own values, `b`."""
        self.moments = [product(self._weight[:, c] * self.b[:, c], self.basis.rows(c)) for c in range(3)]
        self.energies = (self._weight * self.b**2).sum(0)
        # at least 1 where the unit is the channel's mean; a channel that is black has no less noise for that
        self.mean_square = np.maximum(self.energies / np.maximum(self.count, 1e-300), 1.0)

    shadowed = None
    """(n, 3) directions -> (n,) bool, those of lamps whose shadow would be seen; None: nothing shows shadows."""

    @property
    def fields(self) -> tuple[LogField, LogField]:
        """The natural and the even field, with as many coefficients as the products are of."""
        return self._field, self._even

    @property
    def noise_unit(self) -> np.ndarray:
        """(3,), what noises are relative to."""
        return self.mean_square

    @property
    def noise_count(self) -> np.ndarray:
        """(3,), how many numbers have each noise."""
        return self.count

    def reaches(self, field) -> np.ndarray:
        """Which of a field's directions (n,) light the pixels well enough for a lamp to be seen from there."""
        response = self.basis.mean_response @ field.to_coefficients
        return (response > SEEN * response.max()) & field.reaching

    @property
    def coarsening(self) -> float:
        """h: 1 over the power that the likelihood of a number is taken to."""
        return self._stiff * 3 / self.effective * (1 + self.basis.pixels / EVIDENCE)

    def learn_from(self, x) -> None:
        """Sets, from a first fit's coefficients x (3, terms), what the discrepancy is a part of, and the channels.

        `effective`, how many independent channels the misfit has: 1, all alike, to 3. Evidences can be compared where
        it is the same: it says how much of a photo's evidence counts, and a few per cent of that decide anything.
        """
        predicted = np.stack([product(self.basis.rows(c), x[c]) for c in range(3)], 1)
        left = (self.b - predicted) * np.sqrt(self._weight)
        together = left.T @ left
        if self._effective is None:
            self.effective = float(np.trace(together) ** 2 / max((together**2).sum(), 1e-300))
        self._first, self._smooth, self._products = predicted, {}, []
        for c in range(3):
            f = self._misfits(c)
            weighted = f * self._weight[:, c, None]
            each = (f, self.basis.rows(c), self.b[:, c])
            self._products.append(tuple(product(weighted.T, values) for values in each))

    def again(self, radiance) -> "Photograph":
        """The products of another photograph ``radiance`` (p, 3) of much the same light.

        Weights, unit, and what the misfit is a part of are this one's: what is new is A^T N^-1 b alone.
        """
        out = copy.copy(self)
        out.b = np.asarray(radiance, np.float64) / (self.basis.response * self.level)
        out._take_in()
        misfits = [product(self._weight[:, c] * out.b[:, c], self._misfits(c)) for c in range(3)]
        out._products = [(*of_f, f) for (*of_f, _), f in zip(self._products, misfits, strict=True)]
        out._smooth = {
            discrepancy: [replace(own, of_photo=own.own.T @ f) for own, f in zip(each, misfits, strict=True)]
            for discrepancy, each in self._smooth.items()
        }
        return out

    def _misfits(self, c: int) -> np.ndarray:
        """F of a channel at D = 1, (p, k): what the photo may differ by beside noise."""
        size = self._first[:, c] if self._departing is None else self._first[:, c] * self._departing
        f = self.basis.smooth * size[:, None]
        return f if self._slopes is None else np.concatenate([f, self._slopes[:, :, c]], 1)

    def _at(self, discrepancy: float) -> list[Smooth]:
        """The products of F of each channel at D."""
        if discrepancy not in self._smooth:
            each = []
            for c, (gram, of_light, of_photo) in enumerate(self._products):
                unit = np.ones(len(gram))
                unit[: self.basis.smooth.shape[1]] = discrepancy
                size, own = eigh(unit[:, None] * gram * unit)
                own = unit[:, None] * own
                light = product(own.T, of_light)
                each.append(Smooth(np.maximum(size, 0), own, light, own.T @ of_photo, product(light, self._axes[c][1])))
            self._smooth[discrepancy] = each
        return self._smooth[discrepancy]

    def rows(self, v, discrepancy: float) -> Rows:
        """The products at the pixels' noise v (3,), relative to the channels' levels, and at a discrepancy D >= 0."""
        root, target, rest, log_determinant = [], [], 0.0, 0.0
        for c in range(3):
            w = 1 / (v[c] * self.coarsening)
            # what is negligible without a discrepancy is so with one
            kept = slice(int(np.searchsorted(w * self._axes[c][0], NEGLIGIBLE / 10, side="right")), None)
            sizes, axes = w * self._axes[c][0][kept], self._axis_rows[c][kept]
            moment, energy = w * product(axes, self.moments[c]), w * self.energies[c]
            if self._smooth is None:  # the axes themselves, of which those that say something
                told = sizes > NEGLIGIBLE
                size = np.sqrt(sizes[told])
                root.append(size[:, None] * axes[told])
                target.append(moment[told] / size)
                rest += max(float(energy - target[-1] @ target[-1]), 0.0)
                continue
            smooth = self._at(discrepancy)[c]
            ff, size = smooth.at(w)
            fa, fb = size[:, None] * smooth.along[:, kept], size * smooth.of_photo
            gram, moment, energy = -product(fa.T, fa), moment - fb @ fa, energy - fb @ fb
            np.einsum("ii->i", gram)[:] += sizes
            log_determinant += 0.5 * float(np.log1p(ff).sum())
            lower, order, rank, _ = lapack.dpstrf(gram.T, lower=1, tol=NEGLIGIBLE, overwrite_a=1)
            upper, order = np.triu(lower.T[:rank]), order - 1
            root.append(product(upper, axes[order]))
            y = moment[order[:rank]]
            if rank:
                y, _ = lapack.dtrtrs(lower[:rank, :rank], y, lower=1)
            target.append(y)
            rest += max(float(energy - y @ y), 0.0)
        return Rows(root, target, rest, log_determinant)

    def scores(self, radiance, v, discrepancy: float) -> np.ndarray:
        """A^T N^-1 b of other values b (p, 3) than the photo's, in the photo's own unit: (3, terms)."""
        b, out = np.asarray(radiance, np.float64) / (self.basis.response * self.level), []
        for c in range(3):
            w = 1 / (v[c] * self.coarsening)
            weighted = w * self._weight[:, c] * b[:, c]
            out.append(product(weighted, self.basis.rows(c)))
            if self._smooth is not None:
                smooth = self._at(discrepancy)[c]
                of_f = smooth.own.T @ product(weighted, self._misfits(c))
                out[c] = out[c] - smooth.of_light.T @ (np.square(smooth.at(w)[1]) / w * of_f)
        return np.stack(out)

    def misfit(self, x) -> np.ndarray:
        """Mean square of b - A x in each channel, of coefficients (3, terms): (3,)."""
        out = [
            e - 2 * x[c] @ m + x[c] @ g @ x[c]
            for c, (g, m, e) in enumerate(zip(self.grams, self.moments, self.energies, strict=True))
        ]
        return np.maximum(out, 0) / np.maximum(self.count, 1e-300)

    def left_over(self, x, v, discrepancy: float) -> np.ndarray:
        """b - A x - F a of each pixel, with the most probable a, as of `noise`: (p, 3), in the photo's own unit."""
        out = np.empty_like(self.b)
        for c in range(3):
            w, smooth = 1 / (v[c] * self.coarsening), self._at(discrepancy)[c]
            a = w * (smooth.of_photo - smooth.of_light @ x[c]) / (1 + w * smooth.squares)
            out[:, c] = self.b[:, c] - product(self.basis.rows(c), x[c]) - product(self._misfits(c), smooth.own @ a)
        return out

    def noise(self, x, v, discrepancy: float) -> np.ndarray:
        """Mean square of b - A x - F a with the most probable a, at the noise v and a discrepancy: (3,)."""
        out = self.misfit(x)
        for c in range(3 if self._smooth is not None else 0):
            w, smooth = 1 / (v[c] * self.coarsening), self._at(discrepancy)[c]
            ff, size = smooth.at(w)
            score = size * (smooth.of_photo - smooth.of_light @ x[c])  # of a in its own unit, (I + F^T W F)^(1/2) a
            out[c] -= (np.square(score) * (2 + ff) / (1 + ff)).sum() / (w * max(self.count[c], 1e-300))
        return np.maximum(out, 0)
