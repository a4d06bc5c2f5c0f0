# SPDX-License-Identifier: GPL-3.0-or-later
"""Which pixels enter a fit: those of each object that tell most of the light, and that the photo shows."""

import numpy as np

from btfsep_engine.pipeline.doubts import THRESHOLDS
from btfsep_engine.pipeline.scene import PreparedScene
from btfsep_engine.pipeline.settings import Settings
from btfsep_engine.render.sampling import REGION, choose_pixels, thinned
from btfsep_engine.render.surface import SurfacePoints, as_gathered
from btfsep_engine.storage import kept

LEAST_LEFT = 0.2  # of an object's pixels
# Cosine to the eye, of which a sheen's pixels have more: it is brightest at a slant, where tables end (75 degrees) and
# hold less than there is, and a rim brighter than that is taken for a light behind the object.
SLANT = 0.3


def chosen_points(scene: PreparedScene, settings: Settings, *, regions, textured: bool) -> list[SurfacePoints]:
    """The points of each object that tell most of the light.

    Parameters
    ----------
    settings : their pixels are shared by what is seen of each object; 0: all
    regions : (h, w) bool of each object, which of its pixels may be chosen
    textured : whether they need a texture's place
    """
    sizes = np.array([r.sum() for r in scene.regions], np.float64)
    shares = [max(int(n), 1) for n in settings.pixels * sizes / sizes.sum()] if settings.pixels else [0] * len(sizes)
    out = []
    if settings.estimator == "map":
        regions = [without_outlines(scene, region) for region in regions]
    for index, (region, share) in enumerate(zip(regions, shares, strict=True)):
        surface = scene.job.objects[index].surface
        fibrous = surface is not None and any(surface.sheen)

        def chosen(region=region, share=share, index=index, fibrous=fibrous):
            if share:  # not all is worth computing at
                region = thinned(region, max(REGION, 4 * share), seed=settings.seed)
            points = as_gathered(scene.bare_points(index, region=region))
            if fibrous:
                points = facing(points)
            return points.take(choose_pixels(points, share, seed=settings.seed)) if share else points

        parts = [scene.seen, index, np.packbits(region), region.shape, share, settings.seed, fibrous]
        points = kept.recalled("points", parts, chosen)
        out.append(scene.laid(points, index, textured=textured))
    return out


def facing(points: SurfacePoints) -> SurfacePoints:
    """The points without those at a slant, unless little would be left."""
    some = np.flatnonzero((points.normal * points.to_eye).sum(1) > SLANT)
    return points.take(some) if len(some) >= LEAST_LEFT * len(points) else points


def without_outlines(scene: PreparedScene, region) -> np.ndarray:
    """A region (h, w) bool without the pixels beside an outline, unless little would be left of it."""
    inner = region & ~scene.outlines.beside(region.shape)
    return inner if inner.sum() >= LEAST_LEFT * region.sum() else region


def photographed_regions(scene: PreparedScene, settings: Settings) -> list:
    """(h, w) bool of each object: usable pixels, and with a prior saturated ones, too, as inequalities.

    Says where much of an object is saturated or transparent, and what becomes of it.
    """
    photo, out = scene.job.photo, []
    mirrors = {mirror.index for mirror in scene.mirrors}
    for index, (region, obj) in enumerate(zip(scene.regions, scene.job.objects, strict=True)):
        unusable = region & ~photo.usable
        bounds = np.zeros_like(region)
        if settings.estimator == "map" and photo.clipped is not None:
            bounds = region & photo.clipped.any(-1)
        out.append(region & photo.usable | bounds)
        share = unusable.sum() / max(region.sum(), 1)
        if share > THRESHOLDS.clipped and index in mirrors:  # a few clipped pixels, spread over all that it would show
            scene.reporter.warn(
                f"lamps are clipped in what mirrors: how bright they are in object '{obj.name}' is not known, nor what "
                "it tells of the light around them; give a photo with a shorter exposure, or an HDR"
            )
        elif share > THRESHOLDS.clipped:
            what = (
                "; the saturated ones count as at least as bright as they are"
                if bounds.any()
                else " and were left out: what they saw of the light is not in the estimate"
            )
            scene.reporter.warn(
                f"{100 * share:.0f} % of the pixels of object '{obj.name}' are saturated or transparent{what}"
            )
    return out


def names_of(scene: PreparedScene) -> str:
    """The objects of a scene, for an error."""
    names = " and ".join(f"'{o.name}'" for o in scene.job.objects)
    return f"object{'s' if len(scene.job.objects) > 1 else ''} {names}"
