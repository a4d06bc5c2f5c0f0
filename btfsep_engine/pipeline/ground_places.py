# SPDX-License-Identifier: GPL-3.0-or-later
"""What a photo shows of a table or a floor, place by place, and what light reaches these places."""

from dataclasses import dataclass, replace

import numpy as np

from btfsep_engine import sh
from btfsep_engine.btf.model import Lambertian
from btfsep_engine.btf.surfaces import Surface
from btfsep_engine.conventions import pixel_directions
from btfsep_engine.fit.ground import SKY
from btfsep_engine.light.lightings import SHBasis
from btfsep_engine.pipeline.scene import INDIRECT_DIRECTIONS
from btfsep_engine.pipeline.settings import MODELLED_BOUNCES
from btfsep_engine.render.homogeneous import reflected_share, under_beams
from btfsep_engine.render.radiosity import diffuse_albedo
from btfsep_engine.render.surface import SurfacePoints, eroded, surface_points, with_any_tangent
from btfsep_engine.storage import kept

PLACES = 400  # of all that is seen of a ground: means over as many blocks of pixels, about
FEWEST = 40
ENOUGH = 100  # pixels of a block: of a large photo not all are read
FULL = 0.5  # of a block that has to show the ground
FINER = 2  # rays to each pixel of the sky's map, a side
WHITE = Lambertian("ground/white", np.ones(3))


def used_as_evidence(job, settings) -> list[int]:
    """Numbers of the occluders that job or settings ask for."""
    if settings.evidence == "never":
        return []
    return [k for k, o in enumerate(job.occluders) if o.evidence or settings.evidence == "all"]


def tried_as_evidence(scene, settings) -> list[int]:
    """Of those that nobody asks for and that may be matte or plastic, the number of that of which most is seen."""
    if settings.evidence != "auto" or settings.refine != "all":
        return []
    job, count = scene.job, len(scene.job.objects)
    plain = [k for k, o in enumerate(job.occluders) if o.surface is None or replace(o.surface, image=None).plain]
    seen = np.bincount(scene.view.mesh[scene.view.mesh >= count] - count, minlength=len(job.occluders))
    return sorted(plain, key=lambda k: -seen[k])[:1]


@dataclass(frozen=True)
class Places:
    """Blocks of the pixels that show a ground, in the order of the points in their middle.

    Attributes
    ----------
    rows, columns : (n,) int, of pixels
    place : (n,) int, which of the p blocks each is of
    """

    rows: np.ndarray
    columns: np.ndarray
    place: np.ndarray

    def means(self, image) -> np.ndarray:
        """(p, channels) float64, of an image (h, w, channels) over each block."""
        values = image[self.rows, self.columns].astype(np.float64)
        return np.stack([np.bincount(self.place, v) for v in values.T], 1) / np.bincount(self.place)[:, None]


def blocks_of(scene, k: int) -> tuple[SurfacePoints, Places] | None:
    """Points in the middle of blocks of the pixels that show an occluder, and these; None where it shows too little."""
    photo, index = scene.job.photo, len(scene.job.objects) + k
    region = eroded(scene.view.mesh == index) & photo.usable
    for mask in (o.mask for o in scene.job.objects if o.mask is not None):
        region &= ~mask  # the photo shows an object there, whatever the geometry says
    rows, columns = np.nonzero(region)
    every = max(1, int(np.sqrt(len(rows) / (PLACES * ENOUGH))))
    few = (rows % every == 0) & (columns % every == 0)
    rows, columns = rows[few], columns[few]
    edge = every * max(1, int(np.sqrt(len(rows) / PLACES)))
    block, number, count = np.unique(
        rows // edge * region.shape[1] + columns // edge, return_inverse=True, return_counts=True
    )

    def mean(values):
        return np.bincount(number, values) / count

    middle = np.square(rows - mean(rows)[number]) + np.square(columns - mean(columns)[number])
    first = np.lexsort((middle, number))[np.concatenate([[0], np.cumsum(count)[:-1]])] if len(block) else []
    full = count >= FULL * (edge / every) ** 2
    if full.sum() < FEWEST:
        return None
    chosen = first[full]
    shown = np.zeros_like(region)
    shown[rows[chosen], columns[chosen]] = True
    points = with_any_tangent(surface_points(scene.view, scene.job, index, region=shown))
    place = np.full(len(block), -1)
    place[np.flatnonzero(full)[np.lexsort((columns[chosen], rows[chosen]))]] = np.arange(len(chosen))
    of_full = full[number]
    return points, Places(rows[of_full], columns[of_full], place[number[of_full]])


def places_of(scene, k: int) -> tuple[SurfacePoints, np.ndarray] | None:
    """Points in the middle of blocks of the pixels that show an occluder, and the photo's mean over each (p, 3).

    None where too little of it is seen.
    """
    seen = blocks_of(scene, k)
    return None if seen is None else (seen[0], seen[1].means(scene.job.photo.radiance))


@dataclass(frozen=True)
class Shadows:
    """What reaches a ground's points from each pixel of a map of `SKY`, whatever the ground is like.

    Attributes
    ----------
    open : (p, n) float32, how much of the pixel is seen; cosine : the same, times the cosine, averaged
    sent : (p, n, 3) float32, what objects and other surfaces make of a beam from there, on a white matte ground
    """

    open: np.ndarray
    cosine: np.ndarray
    sent: np.ndarray

    def response(self, points, surface: Surface | None) -> np.ndarray:
        """`fit.ground.Ground.response` by a ground's ``surface``, or as it would be white and matte."""
        if surface is None:
            return self.cosine[..., None] / np.float32(np.pi) + self.sent
        directions = pixel_directions(*SKY).reshape(-1, 3)
        straight = self.open[..., None] * under_beams(surface, points.normal, points.to_eye, directions)
        return straight + reflected_share(surface).astype(np.float32) * self.sent


def shadows_on(scene, materials, points, settings) -> Shadows:
    """The Shadows of a ground's points.

    What objects and other surfaces send it is smooth: of the fit's order, and nowhere negative.
    """

    def found():
        h, w = (FINER * n for n in SKY)
        rays = pixel_directions(h, w).reshape(-1, 3)
        seen = scene.tracer.visible(points.position, points.flat_normal, rays).astype(np.float32)
        free, cosine = (_over_pixels(each) for each in (seen, seen * np.maximum(points.normal @ rays.T, 0)))
        indirect = scene.indirect(materials, SHBasis(settings.fit_order), settings, bounces=MODELLED_BOUNCES)
        sent = indirect.reflected(scene.transport(points, directions=INDIRECT_DIRECTIONS), WHITE)
        y = sh.evaluate(settings.fit_order, pixel_directions(*SKY).reshape(-1, 3)).astype(np.float32)
        above = cosine.any(0)  # what is behind the ground for all of it reaches nothing on it
        between = np.maximum(np.einsum("ptc,nt->pnc", sent, y * above[:, None], optimize=True), 0)
        return Shadows(free, cosine.astype(np.float32), between.astype(np.float32))

    albedos = [*map(diffuse_albedo, materials), *scene.occluder_albedos]
    parts = [scene.tracer.key, points.position, albedos, settings.fit_order, settings.surface_samples, settings.seed]
    return kept.recalled("ground", parts, found)


def _over_pixels(of_rays) -> np.ndarray:
    """(p, h w): values (p, rays) in a map finer than `SKY`, averaged over its pixels."""
    fine = of_rays.reshape(-1, SKY[0], FINER, SKY[1], FINER)
    return fine.mean((2, 4)).reshape(len(of_rays), -1)
