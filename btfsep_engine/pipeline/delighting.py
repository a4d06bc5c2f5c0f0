# SPDX-License-Identifier: GPL-3.0-or-later
"""Textures of scans, which have the light of the day in them that they were taken in: what is found of it is taken off.

A scan brings mesh and texture, and its base colours are darker below and in hollows, where less light came. Taken for
paint, that leaves nothing of the photo's own shading to tell of its light. What goes by the shape in the texture, and
not only by chance (`fit.texture_light`), is divided out of it.

Tried without gain: how much of it is known left free in the fit, in strength and side by side (`Problem.beside`). Of
seven scans in the photo's own light the light then errs 1.3 times as much, 1.0 times what is stated in place of 1.3.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from scipy.spatial import cKDTree

from btfsep_engine import sh
from btfsep_engine.btf.surfaces import Surface
from btfsep_engine.conventions import fibonacci_sphere
from btfsep_engine.fit.texture_light import ASIDE, DARKEST, TextureLight, neighbours, texture_light
from btfsep_engine.imaging.images import resized
from btfsep_engine.job.model import JobObject, TriangleMesh
from btfsep_engine.linear_algebra import product
from btfsep_engine.pipeline.settings import TransportSettings
from btfsep_engine.render.radiosity import is_wound_outwards
from btfsep_engine.render.texels import Texels, texels_on
from btfsep_engine.render.tracer import tracer_of
from btfsep_engine.storage import kept
from btfsep_engine.threads import one_thread

DE_LIT = "de_lit"  # its name among what is chosen
SIDE, FINER = 256, 512  # of the image in which it is looked for, and in which it is taken off where it is found: light
# of one chart is not to be another's, and those of a scan may be small
PLACES, ORDER, RAYS = 3000, 4, 256
AROUND = 4  # places that the light at a texel is the mean of
FEWEST = 500  # texels
WHITEST = 0.999  # of the texels: darker than white
METAL = 0.5  # share of a surface that is metal: it mirrors, and what is mirrored moves with the camera


@dataclass(frozen=True)
class LightInTexture:
    """The light that was found in an image of base colours.

    Attributes
    ----------
    light : TextureLight, at some places
    laid : (n, n) bool, row 0 at the top, the texels that lie on the mesh
    logarithm : (n, n, 3) float32, its logarithm there, and beside charts that of the nearest texel
    """

    light: TextureLight
    laid: np.ndarray
    logarithm: np.ndarray


def de_lit(obj: JobObject, settings: TransportSettings) -> Surface:
    """The surface of an object, the light that was found in its texture taken off."""
    found = light_in_texture(obj, settings)
    return obj.surface if found is None else replace(obj.surface, image=_without(obj.surface.image, found))


def light_in_texture(obj: JobObject, settings: TransportSettings) -> LightInTexture | None:
    """What is found of it in an object's texture; None where there is none, or nobody asks."""
    if settings.delight == "never" or not obj.pictured or obj.surface.metallic > METAL:
        return None
    image = obj.surface.image
    return kept.recalled("light in texture", [obj.mesh, image], lambda: _found(obj.mesh, image))


def words_of(objects, settings: TransportSettings) -> str:
    """What is to be said of objects in whose textures light was found; empty where none was."""
    found = {o.name: light_in_texture(o, settings) for o in objects}
    named = [f"object '{name}' ({100 * one.light.contrast:.0f} %)" for name, one in found.items() if one is not None]
    if not named:
        return ""
    return (
        f"the texture of {' and '.join(named)} has light in it, as scans have that were not de-lit: it goes by "
        "the shape; it was taken off, as well as that is known; give base colours without it, or say that these are "
        "its colours (--delight never)"
    )


@one_thread()
def _found(mesh: TriangleMesh, image) -> LightInTexture | None:
    side = min(SIDE, len(image))
    texels = texels_on(mesh, side)
    if texels is None or len(texels.number) < FEWEST:
        return None
    random = np.random.default_rng(0)
    places = np.sort(random.choice(len(texels.number), min(PLACES, len(texels.number)), replace=False))
    feature = _feature(mesh, texels)
    tree = cKDTree(feature[places])
    nearest = tree.query(feature)[1]
    colours = resized(image, side).reshape(-1, 3)[texels.number].astype(np.float64)
    count = np.bincount(nearest, minlength=len(places))[:, None]
    mean = np.stack([np.bincount(nearest, colours[:, c], len(places)) for c in range(3)], 1) / np.maximum(count, 1)
    position, normal = texels.position[places], texels.normal[places]
    images, closed = _irradiance(mesh, position, normal, texels.flat_normal[places])
    found = texture_light(mean, images, closed, neighbours(position, normal, mean))
    if found is None:
        return None
    finer = texels_on(mesh, min(FINER, len(image))) or texels
    return _everywhere(found, tree, _feature(mesh, finer), finer)


def _everywhere(found: TextureLight, tree: cKDTree, feature, texels: Texels) -> LightInTexture:
    """What was found at the places of a tree, at texels whose `_feature` is known, and beside them."""
    distance, around = tree.query(feature, k=AROUND)
    share = 1 / np.square(distance + 1e-4)
    share /= share.sum(1, keepdims=True)
    side = texels.side
    laid, every = np.zeros(side * side, bool), np.zeros((side * side, 3), np.float32)
    laid[texels.number] = True
    every[texels.number] = np.einsum("mk,mkc->mc", share, found.logarithm[around])
    laid = laid.reshape(side, side)
    beside = 1 - laid.astype(np.uint8)
    label = cv2.distanceTransformWithLabels(beside, cv2.DIST_L2, 3, labelType=cv2.DIST_LABEL_PIXEL)[1]
    nearest = np.zeros(label.max() + 1, np.int64)
    nearest[label.ravel()[texels.number]] = texels.number
    return LightInTexture(found, laid, every[nearest[label]])


def _feature(mesh: TriangleMesh, texels: Texels) -> np.ndarray:
    size = max(float(np.linalg.norm(np.ptp(mesh.vertices, axis=0))), 1e-300)
    return np.concatenate([texels.position / size, ASIDE * texels.normal], 1)


def _irradiance(mesh: TriangleMesh, position, normal, flat_normal) -> tuple[np.ndarray, np.ndarray]:
    """(n, terms), of each spherical harmonic, the object's own shadows in it, and (n,), how closed each place is."""
    outwards = 1 if is_wound_outwards(mesh) else -1
    flat = outwards * flat_normal
    normal = normal * np.sign((normal * flat).sum(1, keepdims=True))
    directions = fibonacci_sphere(RAYS)
    cosine = np.maximum(product(normal, directions.T), 0) * (4 * np.pi / RAYS)
    seen = cosine * tracer_of([mesh]).visible(position, flat, directions)
    closed = 1 - seen.sum(1) / np.maximum(cosine.sum(1), 1e-300)
    return product(seen, sh.evaluate(ORDER, directions)), closed


def _without(image, found: LightInTexture) -> np.ndarray:
    """A texture (n, n, 3) less the light in it, which is 1 in the median where the texture is not black.

    Darker where something would be brighter than white: dark places that no light explains, as walls within walls are,
    say nothing of how bright the others are, and what is cut off is no colour.
    """
    n = len(image)
    light = np.exp(cv2.resize(found.logarithm, (n, n)))
    laid = cv2.resize(found.laid.astype(np.uint8), (n, n)) > 0
    coloured = laid & (image.min(-1) > DARKEST)
    laid = coloured if coloured.any() else laid
    out = image * (np.median(light[laid], 0) / light)
    brightest = float(np.quantile(out[laid].max(-1), WHITEST))
    return np.clip(out / max(brightest, 1.0), 0, 1).astype(np.float32)
