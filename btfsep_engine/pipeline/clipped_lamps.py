# SPDX-License-Identifier: GPL-3.0-or-later
"""How bright lamps are that are clipped in a mirror: as in natural light, and as a table shows it.

A mirror shows where lamps stand, and of those that are too bright for the photo a lower bound. What lies above it, as a
rule, measured maps say: so much for all of it, and for each patch of the sky far more or less than for the next. But a
table beside the mirror receives all of it. Of places r on a matte table of a colour rho,

    r = rho (B + sum_k f_k P_k) + n,    log f = D z,    z ~ N(0, I),

with what the mirror shows of the light (B) and what its patches' lamps would add (P_k), the table's own shadows in
both. log rho is known to `SAID` where the job says it, so that it is the pattern that counts: how deep shadows are, and
where. n is what is left over (light between surfaces, a pattern), so many places of it as one. z and rho are the most
probable ones, by Gauss-Newton steps, and what is known of f is Laplace's.
"""

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from scipy.spatial import cKDTree

from btfsep_engine.conventions import fibonacci_sphere
from btfsep_engine.fit.ground import SKY
from btfsep_engine.light.lightings import bilinear
from btfsep_engine.linear_algebra import cholesky, product
from btfsep_engine.pipeline.ground_places import blocks_of, shadows_on, tried_as_evidence, used_as_evidence

PATCHES = 100  # that share out the sphere, 23 degrees apart
# What is clipped lacks light, over all light there is, that grows with the share of all directions that it takes, as
# exp(LACKS[0]) share**LACKS[1], give or take a factor exp(ALIKE) for all of it, and exp(EACH) for each patch by itself.
# By seven measured maps, each at nine exposures (`scripts/study clipped`): while one factor was for all, a third of the
# errors lay beyond 97.5 % of those that were stated, now one of twenty; of eight others two fifths, now one of twelve.
LACKS, ALIKE, EACH = (1.5, 0.5), 1.6, 1.5
SAID, USUAL, UNSAID = 0.3, 0.3, 1.0  # of the logarithm of a table's colour as the job says it; where it does not: that
INDEPENDENT = 5  # of a table's places: what is left over of them goes on over all of it
LEAST_NOISE = 0.02  # of a table's root mean square: light between surfaces is known no better
WORTH = 0.75  # of what a table leaves over of the lamps as they are as a rule: else it tells nothing of them
DARKEST = 0.01  # that is believed
ROUNDS, STEPS, SETTLED = 4, 40, 1e-3  # of noise; for each; of chi^2: less is not worth a further one


@dataclass(frozen=True)
class Lamps:
    """What clipped patches of a mirror's picture lack.

    Attributes
    ----------
    patches : (k,) int, of `patch_of`; times : (k,), how often what is seen of each is to be added
    doubt : (k, q), logarithm of how much more or less of each by a deviation of q unknowns
    by_table : whether a table tells of them
    """

    patches: np.ndarray
    times: np.ndarray
    doubt: np.ndarray
    by_table: bool = False

    def added_to(self, directions) -> np.ndarray:
        """(n,), how often what is clipped in ``directions`` (n, 3) is to be added to it."""
        of_patches = np.zeros(PATCHES)
        of_patches[self.patches] = self.times
        return of_patches[patch_of(directions)]

    def parts(self, lost) -> np.ndarray:
        """(k, n, 3), what is to be added to a light in `fibonacci_sphere` of n, of which ``lost`` (n, 3) is clipped."""
        here = patch_of(fibonacci_sphere(len(lost)))[None] == self.patches[:, None]
        return (here * self.times[:, None])[..., None] * lost


def whitened(lost) -> np.ndarray:
    """(n, 3), clipped light (n, 3) as bright in each channel that is clipped: it has not a coloured mirror's colour."""
    there = lost > 0
    return there * (lost.sum(1) / np.maximum(there.sum(1), 1))[:, None]


def of_one_colour(seen, over, directions, weights) -> np.ndarray:
    """(n, 3), what pixels show of clipped lamps, as bright as their clipped channels are, in the colour of their patch.

    Of a lamp's rim and by a JPEG's noise one pixel has one channel clipped and the next another one. And it has not the
    colour of the mirror, but what the channels say that are not clipped; the others are at least as bright.

    Parameters
    ----------
    seen : (n, 3), what pixels show of the light; over : (n, 3) bool, where they are clipped
    directions : (n, 3), from which they show it; weights : (n,), their solid angles
    """
    patch, colours = patch_of(directions), np.where(over, seen.max(1, keepdims=True), seen) * over.any(1, keepdims=True)
    total = np.stack([np.bincount(patch, weights * c, PATCHES) for c in colours.T], -1)
    shares = total / np.maximum(total.sum(1, keepdims=True), 1e-300)
    return (seen * over).sum(1, keepdims=True) * shares[patch]


def patch_of(directions) -> np.ndarray:
    """(n,) int, in which of `PATCHES` directions (n, 3) lie."""
    return _patches().query(directions)[1]


@lru_cache(maxsize=1)
def _patches() -> cKDTree:
    return cKDTree(fibonacci_sphere(PATCHES))


def as_a_rule(light, lost, share: float) -> Lamps:
    """What natural light is like where it is clipped.

    Parameters
    ----------
    light, lost : (n, 3), what is seen in `fibonacci_sphere` of n directions, and what of it is clipped
    share : of all directions, that is clipped
    """
    patches = np.unique(patch_of(fibonacci_sphere(len(lost)))[lost.any(1)])
    lacks = np.exp(LACKS[0] + LACKS[1] * np.log(share)) if share > 0 else 0.0
    times = lacks * light.sum() / max(lost.sum(), 1e-300)
    k = len(patches)
    return Lamps(patches, np.full(k, float(times)), np.concatenate([np.full((k, 1), ALIKE), EACH * np.eye(k)], 1))


@dataclass(frozen=True)
class Table:
    """A table beside a mirror, by which it may be told how bright what is clipped in it is.

    Attributes
    ----------
    scene : PreparedScene; materials : Material of each object; settings : TransportSettings
    number : of the occluder
    """

    scene: object
    materials: list
    settings: object
    number: int

    @cached_property
    def _seen(self):
        """Places, and (p, pixels of `SKY`, 3) what they would show if they were white; None: too little is seen."""
        seen = blocks_of(self.scene, self.number)
        if seen is None:
            return None
        points, places = seen
        return places, shadows_on(self.scene, self.materials, points, self.settings).response(points, None)

    @property
    def _colour(self) -> tuple[np.ndarray, float]:
        """What the table reflects (3,), as far as it is known, and the deviation of its logarithm."""
        said = self.scene.job.occluders[self.number].surface is not None or self.number in self.scene.colours
        colour = np.asarray(self.scene.occluder_albedos[self.number]).reshape(-1, 3).mean(0)
        return (np.maximum(colour, DARKEST), SAID) if said else (np.full(3, USUAL), UNSAID)

    def told(self, lamps: Lamps, light, lost, photo) -> Lamps:
        """The lamps as bright as the table in a ``photo`` has them; as they are, where it does not tell.

        ``light``, ``lost`` : as of `as_a_rule`, in the photo's exposure
        """
        if not len(lamps.patches) or self._seen is None:  # where nothing is clipped, no shadow is traced
            return lamps
        places, response = self._seen
        usable = places.means(photo.usable[..., None])[:, 0] == 1
        lit = usable & (response.sum((1, 2)) > 0)
        shown, response = places.means(photo.radiance)[lit], response[lit]
        if not len(shown) or not shown.any(0).all():
            return lamps
        lights = np.concatenate([light[None], lamps.parts(lost)])
        straight, *parts = np.moveaxis(_under(response, lights), 1, 0)
        asked = Asked(shown, straight, np.stack(parts, 1), lamps.doubt, *self._colour)
        log_factors, root = asked.most_probable()
        if not asked.left(log_factors) < WORTH * asked.left(np.zeros(len(log_factors))):
            return lamps
        return replace(lamps, times=lamps.times * np.exp(log_factors), doubt=root, by_table=True)


def table_of(scene, materials, settings) -> Table | None:
    """The Table that may be read beside a scene's mirrors; None: there is none."""
    ground = used_as_evidence(scene.job, settings) or tried_as_evidence(scene, settings)
    return Table(scene, materials, settings, ground[0]) if ground else None


def _under(response, lights) -> np.ndarray:
    """(p, l, 3), what places show that respond by ``response`` (p, pixels, 3) under lights (l, n, 3)."""
    directions = fibonacci_sphere(lights.shape[1])
    to_pixels = bilinear(directions, *SKY) * (4 * np.pi / len(directions))
    return np.stack([product(response[..., c].astype(float), to_pixels.T @ lights[..., c].T) for c in range(3)], -1)


@dataclass(frozen=True)
class Asked:
    """What a table is asked: the r, B, P and D of this module.

    Attributes
    ----------
    shown : (p, 3); straight : (p, 3); parts : (p, k, 3); doubt : (k, q)
    colour : (3,), rho as far as it is known; spread : the standard deviation of its logarithm
    """

    shown: np.ndarray
    straight: np.ndarray
    parts: np.ndarray
    doubt: np.ndarray
    colour: np.ndarray
    spread: float

    def left(self, log_factors) -> float:
        """What the table in its best colour leaves over, relative, by the logarithms (k,) of lamps' factors."""
        m = self._predicted(log_factors)[0]
        rest = self.shown - m * ((self.shown * m).sum(0) / np.maximum(np.square(m).sum(0), 1e-300))
        return float(np.sqrt((np.square(rest).sum(0) / np.square(self.shown).sum(0)).mean()))

    def _predicted(self, log_factors) -> tuple[np.ndarray, np.ndarray]:
        """(p, 3), of a white table, and (p, k, 3), the part of each patch in it."""
        each = self.parts * np.exp(log_factors)[:, None]
        return self.straight + each.sum(1), each

    def most_probable(self) -> tuple[np.ndarray, np.ndarray]:
        """The logarithms (k,) of lamps' factors, and a root (k, k) of their covariance."""
        q = self.doubt.shape[1]
        z = np.zeros(3 + q)
        noise = max(self.left(np.zeros(len(self.doubt))), LEAST_NOISE)
        for _ in range(ROUNDS):
            per_value = min(1.0, INDEPENDENT / len(self.shown)) / np.square(self.shown).mean(0) / noise**2
            z, curvature = self._settled(z, per_value)
            noise = max(self.left(self.doubt @ z[3:]), LEAST_NOISE)
        spread = np.linalg.inv(curvature)[3:, 3:]
        covariance = self.doubt @ spread @ self.doubt.T
        return self.doubt @ z[3:], cholesky(covariance + 1e-9 * np.eye(len(covariance)))

    def _settled(self, z, per_value) -> tuple[np.ndarray, np.ndarray]:
        """The unknowns (3 + q,), of the colour and z, from ``z`` on, and the curvature of half of chi^2 there."""
        damping, (chi2, gradient, curvature) = 1e-3, self._chi2(z, per_value)
        for _ in range(STEPS):
            step = np.linalg.solve(curvature + damping * np.diag(np.diag(curvature)), gradient)
            there = self._chi2(z + step, per_value)
            if there[0] < chi2:
                worth, damping, z = chi2 - there[0], damping / 5, z + step
                chi2, gradient, curvature = there
                if worth < SETTLED:
                    break
            elif (damping := 5 * damping) > 1e6:
                break
        return z, curvature

    def _chi2(self, z, per_value):
        """Of unknowns ``z`` chi^2, half of its descent and half of its curvature."""
        colour = self.colour * np.exp(self.spread * z[:3])
        white, each = self._predicted(self.doubt @ z[3:])
        rest, root = self.shown - colour * white, np.sqrt(per_value)
        slopes = np.zeros((*rest.shape, len(z)))
        slopes[:, np.arange(3), np.arange(3)] = self.spread * colour * white
        slopes[..., 3:] = np.einsum("pkc,kq->pcq", each, self.doubt) * colour[:, None]
        rows, left = (slopes * root[:, None]).reshape(-1, len(z)), (rest * root).ravel()
        return left @ left + z @ z, rows.T @ left - z, rows.T @ rows + np.eye(len(z))
