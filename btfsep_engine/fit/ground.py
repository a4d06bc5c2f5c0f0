# SPDX-License-Identifier: GPL-3.0-or-later
"""What surfaces beside the objects show of the light: a table or a floor, with the objects' shadows on it.

The photograph of a ground of one colour, channel by channel and in the photo's own unit, is taken to be

    t = G x + F a + n,    t = b / s,    n ~ N(0, h v I),    a ~ N(0, I),    F = (G x') (o) Y.

G x is what a white ground shows under the light. Order 9 has neither the edges of shadows nor the darkness of what lies
behind the ground, so G is of beams, from each pixel of a map of the sky; all that the ground can tell of them apart
(`NULL`) stands beside the light's coefficients in the search (`LogField.beside`).

s is the ground's colour, as a first light x' has it, and free: Y has a constant (`FREE`) for each surface, and what
grounds vary by over the place, smoothly (`DRIFT`; over the normals, as with objects, there is nothing to vary). So
nothing but the pattern counts: how deep a shadow is, and where. F goes by what x' predicts and not by the photo, else a
ground that is all factor and no light would explain any photo. n is all else: texture, edges, the camera's noise; v is
found as the objects' is, so that a ground that is not as the model has it counts for little. A pattern, or the shadow
of something unknown, leaves over alike what lies side by side: then so many places speak as one (`WithGround.alike`).
a is integrated out as in `fit.products`, and what a light has to explain of the ground is stacked on what it has to
explain of the objects.
"""

from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from scipy.linalg import block_diag, lapack, solve_triangular

from btfsep_engine.fit.products import NEGLIGIBLE, SEEN, Photograph, Rows
from btfsep_engine.fit.search import FLOOR, Solution
from btfsep_engine.light.lightings import bilinear_taps
from btfsep_engine.linear_algebra import cholesky, eigh, product

SKY = (30, 60)  # pixels of the map of beams: 6 degrees
DIRECTIONS, FEW_DIRECTIONS = 800, 400  # of a field: 7 degrees apart; of a first look: 10 degrees
LOOKED_AT, EVERY = 150, 20  # places that a first look at a ground has at least, and of so many at least one
EVIDENCE = 500  # places that count as such
LEAST_NOISE = 0.02  # of the ground's root mean square: light between surfaces is known no better
FREE, DRIFT = 1.0, 0.03  # of the ground's reflectance: its own; its deviation over the place
SHADOWED = 0.1  # of the most light that a direction gives the ground: deviation between places that shows a lamp there
BESIDE, STEPS = 1.0, 8  # of the objects' radius: what lies nearer may be of one plank, check or vein; of distances
NULL = 2e-3  # of the largest singular value of G


@dataclass(frozen=True)
class Ground:
    """Places on surfaces beside the objects.

    Attributes
    ----------
    response : (p, h w, 3) float32, the surface white: radiance under a beam of irradiance 1 from each pixel of a map of
        `SKY`, averaged over the pixel
    radiance : (p, 3) float64, b, linear
    surface : (p,) int, which of the surfaces it is
    at : (p, 2) float64, where on it, in the objects' radii
    """

    response: np.ndarray
    radiance: np.ndarray
    surface: np.ndarray
    at: np.ndarray

    @cached_property
    def axes(self) -> np.ndarray:
        """(h w, k): what the ground tells of beams apart, orthonormal, its singular vectors.

        Found by the eigenvectors of the smaller square, exact far below `NULL`. Channels are mixtures of two responses,
        of what a surface has a colour of and of what is white: their mean and that which is farthest from it stand for
        them, which leaves out no more of a response than all three do, in a third of the time.
        """
        seen = np.moveaxis(self.response, 2, 0).astype(np.float64)
        mean = seen.mean(0)
        off = seen - mean
        sizes = np.linalg.norm(off, axis=(1, 2))
        far = off[sizes.argmax()] * (np.linalg.norm(sizes) / max(sizes.max(), 1e-300))
        rows = np.concatenate([np.sqrt(3) * mean, far])
        small = len(rows) < rows.shape[1]
        squares, axes = eigh(product(rows, rows.T) if small else product(rows.T, rows))
        axes = axes[:, squares > NULL**2 * squares[-1]]
        if small:
            axes = product(rows.T, axes)
            axes /= np.linalg.norm(axes, axis=0)
        return axes

    @property
    def thinned(self) -> "Ground":
        """The same with every second or third place, or fewer, but `LOOKED_AT` at least: for a first look."""
        some = slice(None, None, min(max(1, len(self.radiance) // LOOKED_AT), EVERY))
        return Ground(*(values[some] for values in (self.response, self.radiance, self.surface, self.at)))

    @cached_property
    def columns(self) -> np.ndarray:
        """(3, p, k): the response along the axes."""
        places, pixels = self.response.shape[:2]
        seen = np.ascontiguousarray(np.moveaxis(self.response, 2, 0), np.float64).reshape(-1, pixels)
        return product(seen, self.axes).reshape(3, places, -1)

    @cached_property
    def grams(self) -> list:
        """G^T G (k, k) of each channel, along the axes."""
        return [product(columns.T, columns) for columns in self.columns]


class WithGround:
    """The products of a photograph with ground beside its objects, for `fit.search` in the place of a `Photograph`.

    Noises v are (6,): the objects', then the ground's.

    Parameters
    ----------
    photo : Photograph, of the objects
    ground : Ground, in the photo's exposure
    first : Solution for the objects alone
    alike : how many places speak as one
    directions : of the field
    """

    def __init__(
        self, photo: Photograph, ground: Ground, first: Solution, *, alike: float = 1.0, directions: int = DIRECTIONS
    ):
        self.photo, self.ground, self._alike = photo, ground, alike
        self.basis, self.level, self.mean_square = photo.basis, photo.level, photo.mean_square
        self._columns, beside = ground.columns, partial(_between, ground.axes)
        self.fields = tuple(replace(f, beside=beside, count=directions) for f in photo.fields)
        self._drift, self._shown = _drift(ground), 0.0
        field = self.fields[0 if first.model.field.order else 1]
        self.learn_ground(replace(first.model, field=field).light(first.white)[0])

    @property
    def coarsening(self) -> float:
        """Of the objects' pixels, in whose unit `noise_count` is."""
        return self.photo.coarsening

    @property
    def effective(self) -> float:
        """How many independent channels the objects' misfit has."""
        return self.photo.effective

    @property
    def count(self) -> np.ndarray:
        """(3,), of the objects."""
        return self.photo.count

    @property
    def _stiffness(self) -> float:
        return self._alike * 3 / self.effective * (1 + len(self.ground.radiance) / EVIDENCE)

    @property
    def noise_unit(self) -> np.ndarray:
        """(6,), as of `Photograph`; the ground's floor is another."""
        return np.concatenate([self.mean_square, self.energy * (LEAST_NOISE / FLOOR) ** 2])

    @property
    def noise_count(self) -> np.ndarray:
        """(6,), as of `Photograph`."""
        return np.concatenate([self.count, np.full(3, len(self.ground.radiance) * self.coarsening / self._stiffness)])

    def learn_from(self, x) -> None:
        """As of `Photograph`: of the objects; of the ground all is said by the light of the objects alone."""
        self.photo.learn_from(x[:, : self.basis.terms])

    def learn_ground(self, x) -> float:
        """Sets, from a light's coefficients x (3, terms), the surfaces' colours, and what they depart from them by.

        Returns how much what a light predicts of the ground's pattern has changed, relative root mean square.
        """
        seen, departures, shown, self._log_scales = [], [], [], 0.0
        for c, columns in enumerate(self._columns):
            b, predicted = self.ground.radiance[:, c] / self.level[c], columns @ x[c, self.basis.terms :]
            scale = np.ones(len(b))
            for own in (self.ground.surface == i for i in range(self.ground.surface.max() + 1)):
                energy = max(float(np.square(predicted[own]).sum()), 1e-300)
                scale[own] = max(float(b[own] @ predicted[own]) / energy, 1e-6)
            self._log_scales += float(np.log(scale).sum())
            seen.append(b / scale)
            shown.append(predicted * scale)
            departures.append(predicted[:, None] * self._drift)
        before, self._shown = self._shown, np.array(shown)
        self._seen, self._departures = seen, departures
        self._products = [
            [product(f.T, values) for values in (f, columns, t)] + [product(columns.T, t), float(t @ t)]
            for f, columns, t in zip(departures, self._columns, seen, strict=True)
        ]  # F^T F, F^T G, F^T t, G^T t, t^T t: what does not depend on the noise
        self.energy = np.array([np.square(t).mean() for t in seen])
        return float(np.linalg.norm(self._shown - before) / np.linalg.norm(self._shown))

    def evidence(self, found: Solution) -> float:
        """A solution's, of what the ground itself shows: comparable where another response gives it other colours."""
        return found.evidence - self._log_scales / self._stiffness

    def rows(self, v, discrepancy: float) -> Rows:
        """As of `Photograph`, of objects and ground."""
        own = self.photo.rows(v[:3], discrepancy)
        root, target, rest, log_determinant = [], [], own.rest, own.log_determinant
        for c, (square, (ff, fg, ft, gt, tt)) in enumerate(zip(self.ground.grams, self._products, strict=True)):
            w = 1 / (v[3 + c] * self._stiffness)
            lower = cholesky(np.eye(len(ff)) + w * ff)
            fa, fb = (w * solve_triangular(lower, values, lower=True) for values in (fg, ft))
            gram, moment = w * square - product(fa.T, fa), w * gt - fa.T @ fb
            log_determinant += float(np.log(np.diag(lower)).sum())
            half, order, rank, _ = lapack.dpstrf(gram, lower=1, tol=NEGLIGIBLE)
            half, order = np.tril(half)[:, :rank], order - 1
            y = solve_triangular(half[:rank], moment[order[:rank]], lower=True)
            rest += max(float(w * tt - fb @ fb - y @ y), 0.0)
            root.append(block_diag(own.root[c], half.T[:, np.argsort(order)]))
            target.append(np.concatenate([own.target[c], y]))
        return Rows(root, target, rest, log_determinant)

    def noise(self, x, v, discrepancy: float) -> np.ndarray:
        """(6,), as of `Photograph`."""
        left = np.square(self._left_over(x, v)).mean(1)
        return np.concatenate([self.photo.noise(x[:, : self.basis.terms], v[:3], discrepancy), left])

    def _left_over(self, x, v) -> np.ndarray:
        """(3, p): what neither the light explains of the ground, nor what its surfaces vary by."""
        out = []
        for c, columns in enumerate(self._columns):
            w, f, (ff, fg, ft, *_) = 1 / (v[3 + c] * self._stiffness), self._departures[c], self._products[c]
            of_light = x[c, self.basis.terms :]
            left = self._seen[c] - columns @ of_light
            a = np.linalg.solve(np.eye(len(ff)) + w * ff, w * (ft - fg @ of_light))
            out.append(left - product(f, a))
        return np.array(out)

    def alike(self, found: Solution) -> float:
        """How many places speak as one, by how what a solution leaves over goes together with that beside it; >= 1.

        One, and of all places up to `BESIDE` away the correlation at their distance: where it is not negative, as
        between checks, since a shadow may end between them.
        """
        left, together = self._left_over(found.x, found.v), np.zeros(STEPS)
        left = left / np.maximum(np.sqrt(np.square(left).mean(1, keepdims=True)), 1e-300)
        for number in range(self.ground.surface.max() + 1):
            own = self.ground.surface == number
            at, of_own = self.ground.at[own], left[:, own]
            away = (np.linalg.norm(at[:, None] - at, axis=2) / BESIDE * STEPS).astype(int)
            np.fill_diagonal(away, STEPS)
            near = away < STEPS
            together += np.bincount(away[near], (of_own.T @ of_own)[near] / len(left), STEPS)
        return 1 + float(np.maximum(together, 0).sum()) / left.shape[1]

    def misfit(self, x) -> np.ndarray:
        """As of `Photograph`: of the objects."""
        return self.photo.misfit(x[:, : self.basis.terms])

    def scores(self, radiance, v, discrepancy: float) -> np.ndarray:
        """As of `Photograph`: of the objects."""
        return self.photo.scores(radiance, v[:3], discrepancy)

    def shadowed(self, directions) -> np.ndarray:
        """Whether the ground would show a lamp in each of the directions (n, 3): (n,) bool."""
        return self._lit_by(directions).std(0) > self._faintest

    def _lit_by(self, directions) -> np.ndarray:
        """(p, n): the ground white, under a beam from each of the directions (n, 3)."""
        return self._columns[1] @ self.fields[0].beside(directions).T

    @cached_property
    def _shown_by(self) -> np.ndarray:
        """(2, n): mean and deviation over the places, of the ground under a beam from each direction of the field."""
        seen = self._lit_by(self.fields[0].directions)
        return np.stack([seen.mean(0), seen.std(0)])

    @property
    def _faintest(self) -> float:
        """The deviation that is seen."""
        return SHADOWED * self._shown_by[0].max()

    def reaches(self, field) -> np.ndarray:
        """Which of a field's directions (n,) light the objects well enough, or have a shadow on the ground."""
        response = self.basis.mean_response @ field.to_coefficients[: self.basis.terms]
        alike = len(field.directions) == self._shown_by.shape[1]
        seen = self._shown_by[1] > self._faintest if alike else self.shadowed(field.directions)
        return ((response > SEEN * response.max()) & field.reaching) | seen


def _between(axes, directions) -> np.ndarray:
    """(…, k), ``axes`` (h w, k) of a map of `SKY` in directions (…, 3), bilinear."""
    flat = np.reshape(directions, (-1, 3))
    pixels, weights = bilinear_taps(flat, *SKY)
    return np.einsum("nk,nkc->nc", weights, axes[pixels]).reshape(*np.shape(directions)[:-1], axes.shape[1])


def _drift(ground: Ground) -> np.ndarray:
    """Y: for each surface a constant, and what is linear and quadratic in the place: (p, 6 surfaces)."""
    u, v = ground.at.T
    smooth, out = np.stack([u, v, u * u, u * v, v * v], 1), []
    for own in (ground.surface == i for i in range(ground.surface.max() + 1)):
        each = smooth - smooth[own].mean(0)
        each *= DRIFT / np.sqrt(each.shape[1]) / np.maximum(np.sqrt(np.square(each[own]).mean(0)), 1e-12)
        out.append(own[:, None] * np.concatenate([np.full((len(u), 1), FREE), each], 1))
    return np.concatenate(out, 1)
