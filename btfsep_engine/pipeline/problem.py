# SPDX-License-Identifier: GPL-3.0-or-later
"""What the fit is given: the chosen points of every object, their basis images, their photograph, their blocks."""

from dataclasses import dataclass, replace

import numpy as np

from btfsep_engine.fit.least_squares import block_labels
from btfsep_engine.light.lightings import SHBasis
from btfsep_engine.linear_algebra import product
from btfsep_engine.pipeline.basis import basis_images
from btfsep_engine.pipeline.own_image import image_from_nearby
from btfsep_engine.pipeline.settings import Settings

CLIPS = 0.02  # of the values: so many may be clipped in one photograph and not in another that differs by noise
STARTED = 1 << 20  # blocks' numbers of one object


@dataclass(frozen=True)
class Flash:
    """A lamp at a ``place`` (3,), world, that was not looked for; ``irradiance`` (3,) : at ``centre`` (3,)."""

    place: np.ndarray
    centre: np.ndarray
    irradiance: np.ndarray

    @property
    def distance(self) -> float:
        """From the centre."""
        return float(np.linalg.norm(self.place - self.centre))

    @property
    def direction(self) -> np.ndarray:
        """(3,), unit, from the centre."""
        return (self.place - self.centre) / self.distance


@dataclass(frozen=True)
class Problem:
    """One photograph's part of a fit.

    Attributes
    ----------
    scene : PreparedScene
    materials : the Material that stands for each object in its basis images
    points : list of SurfacePoints, one for each object
    basis : list of (p, terms, 3) float32, their basis images
    transport : how the basis images were made, for ``result.json``
    measured : (p, 3), what is fitted instead of the photograph's own values; None: these (`pipeline.real_photo`)
    weights : (p, 3) >= 0, 1 over the variance of each value; None: all 1
    counts : what of ``weights`` is that of all of an object beside the others, of each, 1 in the mean over all pixels
        (`pipeline.refine.each_object`); empty: all alike
    scales : (objects, 3), the objects' reflectance over their materials', by which ``measured`` was divided; or None
    correction : (p, 3), what lamps make of the values beside what the basis images have of them, which is taken off
        (`pipeline.refine.near`, `pipeline.refine.sharp`); or None
    flash : Flash that lights the objects, too (`pipeline.refine.flash`), or None
    of_flash : (p, 3), what it makes of the values beside what the basis images have of a lamp far away, for an
        irradiance of 1, which is taken off, too
    paint : (p, 3), how much more of the light each pixel reflects than its object does in the mean, by which the values
        are divided (`pipeline.refine.pieces`); or None
    slopes : (p, k, 3), what it may differ by in the first photograph's exposure, since camera or sun may be a little
        off; or None
    veil : (3,), light over the photograph that never met the objects, which is taken off (`pipeline.refine.veil`); or
        None
    vivid : whether it shows light of strong colours (`pipeline.refine.vivid`)
    painted : whether ``slopes`` have pieces of the objects that are lighter or darker (`pipeline.refine.painted`)
    left_out : how many points `fit.robust.outliers` took out; None where it was not asked
    around : (p, k, 2) int32, places in the picture, row * width + column, of pairs of pixels that show what a point's
        own does (`pipeline.like_pixels`), -1 where there is none; None: the point's own stands alone
    coarsening : how many times less a pixel counts than it would: what is left over of means is no noise, where they
        are of gloss
    """

    scene: object
    materials: list
    points: list
    basis: list
    transport: dict
    measured: np.ndarray | None = None
    weights: np.ndarray | None = None
    counts: tuple = ()
    scales: np.ndarray | None = None
    correction: np.ndarray | None = None
    flash: Flash | None = None
    of_flash: np.ndarray | None = None
    paint: np.ndarray | None = None
    slopes: np.ndarray | None = None
    veil: np.ndarray | None = None
    vivid: bool = False
    painted: bool = False
    left_out: int | None = None
    around: np.ndarray | None = None
    coarsening: float = 1.0

    @property
    def all_basis(self) -> np.ndarray:
        """(p, terms, 3), of all objects; one object's are not copied."""
        return self.basis[0] if len(self.basis) == 1 else np.concatenate(self.basis)

    @property
    def blocks(self) -> np.ndarray:
        """(p,) int: blocks of neighbouring pixels of one object."""
        return np.concatenate([block_labels(p.pixels) + i * STARTED for i, p in enumerate(self.points)])

    @property
    def pixels(self) -> np.ndarray:
        """(p, 2) row and column, of all objects."""
        return np.concatenate([p.pixels for p in self.points])

    @property
    def normals(self) -> np.ndarray:
        """(p, 3) unit, world, of all objects."""
        return np.concatenate([p.normal for p in self.points])

    @property
    def rings(self) -> np.ndarray:
        """(p,) int: how far each point lies from the next outline (`render.outlines`)."""
        return self.scene.outlines.rings_at(self.pixels)

    @property
    def clipped(self) -> np.ndarray:
        """(p, 3) bool: channels of which the photograph says a lower bound only."""
        clipped = self.scene.job.photo.clipped
        return np.zeros((len(self.pixels), 3), bool) if clipped is None else self.values_of(clipped)

    def values_of(self, image) -> np.ndarray:
        """(p, …), the values of an image (h, w, …) of the same view."""
        return image[tuple(self.pixels.T)]

    def means_of(self, image, reading=None) -> np.ndarray:
        """(p, …) float64, the values of an image (h, w, …), of the points' pixels and of those `around` in the mean.

        ``reading`` : values (…) -> what the mean is of; None: of themselves
        """
        read = (lambda values: values) if reading is None else reading
        own = read(self.values_of(image)).astype(np.float64)  # floats overflow when squared
        there = np.zeros((len(own), 0), bool) if self.around is None else self.around[..., 0] >= 0
        if not there.any():
            return own
        row, _ = np.nonzero(there)
        rows, columns = np.divmod(self.around[there], image.shape[1])
        pairs = read(image[rows, columns]).astype(np.float64).sum(1)
        sums = [np.bincount(row, values, minlength=len(own)) for values in pairs.reshape(len(row), -1).T]
        count = 1 + 2 * there.sum(1).reshape(-1, *[1] * (own.ndim - 1))
        return (own + np.stack(sums, -1).reshape(own.shape)) / count

    def without_unusable(self) -> "Problem":
        """The same without pairs `around` of which the photograph has clipped a pixel, or has none."""
        if self.around is None:
            return self
        photo = self.scene.job.photo
        usable = photo.usable if photo.clipped is None else photo.usable & ~photo.clipped.any(-1)
        good = usable[np.divmod(np.maximum(self.around, 0), usable.shape[1])].all(-1)
        good &= usable[tuple(self.pixels.T)][:, None]
        return replace(self, around=np.where(good[..., None], self.around, -1))

    def of_single_pixels(self) -> "Problem":
        """The same whose points stand alone, where they were means of those `around`."""
        alone = self if self.around is None else replace(self, around=None, coarsening=1.0)
        if alone is self or self.measured is None:
            return alone
        values = alone.as_measured(alone.means_of(self.scene.job.photo.radiance))
        return replace(alone, measured=np.where(self.clipped, self.measured, values))

    def radiance(self, photo=None) -> np.ndarray:
        """(p, 3) float64 to be fitted, of the job's photograph, or of another ``photo`` (h, w, 3) of the same view."""
        if photo is None and self.measured is not None:
            values = self.measured
        else:
            values = self.means_of(self.scene.job.photo.radiance if photo is None else photo)
        if self.veil is not None:
            values = values - self.as_measured(self.veil_of_all)
        if self.paint is not None:
            values = values / self.paint
        if self.flash is not None:
            values = values - self.flash.irradiance * self.of_flash
        return values if self.correction is None else values - self.correction

    @property
    def veil_of_all(self) -> np.ndarray:
        """(p, 3), the veil of each pixel."""
        return np.broadcast_to(self.veil, (len(self.pixels), 3))

    def as_measured(self, values) -> np.ndarray:
        """The photograph's values (p, …, 3) over the objects' scales, where these are free."""
        if self.scales is None:
            return values
        return np.concatenate([part / s for part, s in zip(self.by_object(values), self.scales, strict=True)])

    def by_object(self, values) -> list:
        """Rows of all points, (p, …), cut by object; views into them."""
        return np.split(values, np.cumsum([len(p) for p in self.points])[:-1])

    def again(self, scene) -> "Problem | None":
        """The same of another photograph of the same view, that of ``scene``; what was settled of this one stays.

        None where it shows not all of these pixels, or other ones are clipped.
        """
        out = replace(self, scene=scene).without_unusable()
        was, now = self.clipped, out.clipped
        if (was != now).mean() > CLIPS or not (self.values_of(scene.job.photo.usable) | now.any(1)).all():
            return None
        if self.measured is None:
            return out
        values = self.as_measured(out.means_of(scene.job.photo.radiance))
        return replace(out, measured=np.where(was, self.measured, values))

    def subset(self, used) -> "Problem":
        """The same with some of its points: ``used`` (p,) bool."""
        parts = self.by_object(used)
        return replace(
            self,
            points=[p.take(np.flatnonzero(u)) for p, u in zip(self.points, parts, strict=True)],
            basis=[a[u] for a, u in zip(self.basis, parts, strict=True)],
            measured=None if self.measured is None else self.measured[used],
            weights=None if self.weights is None else self.weights[used],
            correction=None if self.correction is None else self.correction[used],
            of_flash=None if self.of_flash is None else self.of_flash[used],
            paint=None if self.paint is None else self.paint[used],
            slopes=None if self.slopes is None else self.slopes[used],
            around=None if self.around is None else self.around[used],
        )

    def of_materials(self, materials, settings: Settings) -> "Problem":
        """The same points, objects made of other ``materials``."""
        return self.made_of(materials, make_problem(self.scene, materials, self.points, settings).basis)

    def made_of(self, materials, basis) -> "Problem":
        """The same of other ``materials``, whose basis images are known."""
        made = replace(self, materials=materials, basis=basis)
        return made if self.flash is None else made.under(self.flash)

    def under(self, flash: Flash) -> "Problem":
        """The same under a flash."""
        return replace(self, flash=flash, of_flash=image_from_nearby([self], flash.place, flash.centre).excess)

    def beside(self, more) -> "Problem":
        """The same whose photograph may differ by ``more`` (p, k, 3) beside what it may differ by (`slopes`)."""
        return replace(self, slopes=more if self.slopes is None else np.concatenate([self.slopes, more], 1))

    @property
    def counts_of_each(self) -> np.ndarray:
        """(objects,), `counts`."""
        return np.array(self.counts or (1.0,) * len(self.points))

    def counting(self, counts) -> "Problem":
        """The same whose objects' pixels count by ``counts`` (objects,)."""
        known = np.ones((len(self.pixels), 3)) if self.weights is None else self.weights
        change = np.repeat(np.asarray(counts) / self.counts_of_each, [len(p) for p in self.points])
        return replace(self, weights=known * change[:, None], counts=tuple(map(float, counts)))

    def up_to(self, order: int) -> "Problem":
        """The same with fewer basis lights."""
        return replace(self, basis=[a[:, : (order + 1) ** 2] for a in self.basis])

    def predicted(self, x) -> np.ndarray:
        """A x: (p, 3) float64, of coefficients (terms, 3), as many as there are basis lights or fewer."""
        out = []
        unit = float(np.abs(x).max()) or 1.0  # so that no photo's unit is too large or too small for single precision
        for a in (a[:, : len(x)] for a in self.basis):
            columns = np.zeros((a.shape[1], 3, 3), np.float32)
            columns[:, np.arange(3), np.arange(3)] = x / unit
            out.append(product(np.ascontiguousarray(a).reshape(len(a), -1), columns.reshape(-1, 3)))
        return np.concatenate(out).astype(np.float64) * unit


def make_problem(scene, materials, points, settings: Settings) -> Problem:
    """The basis images of ``points`` (a SurfacePoints for each object), whose ``materials`` stand for the objects."""
    basis, transport = basis_images(scene, materials, points, SHBasis(settings.fit_order), settings)
    return Problem(scene, materials, points, basis, transport)
