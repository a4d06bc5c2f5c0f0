# SPDX-License-Identifier: GPL-3.0-or-later
"""The report picture: one row, as in the paper's figures 3 and 4."""

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import cv2
import numpy as np
from scipy.spatial import cKDTree

from btfsep_engine import sh
from btfsep_engine.btf.surfaces import GIVEN
from btfsep_engine.btf.thumbnail import LIGHTS
from btfsep_engine.conventions import pixel_directions
from btfsep_engine.imaging.images import write_png
from btfsep_engine.imaging.lettering import row
from btfsep_engine.imaging.srgb import linear_to_srgb
from btfsep_engine.light.files import lighting_map
from btfsep_engine.light.lightings import EnvironmentMaps, shrink
from btfsep_engine.pipeline.refine.dusty import lighter
from btfsep_engine.render.sampling import spread, thinned

IMAGE_PIXELS = 40_000  # most pixels of an object that are rendered for an image; the others are filled from the nearest
PIXELS, TEXTURED_PIXELS = 15_000, 50_000  # about so many of an object are rendered for a report
FEW_PIXELS, FEW = 2000, 50  # for light between surfaces: of all objects, of one at least
DIRECTIONS, SAMPLE = 128, 96  # of a rendering that only says how a better one goes on; of a textured material
BETWEEN = 64  # directions of light between surfaces
SIDE = 660  # largest edge of what the report is made of; its panels are smaller
SOFT, NEAR = 0.4, 0.02  # over the pixels' distance, how far one is smeared; of their density, what is a gap
AROUND, SPARSE = 2.0, 1.0  # of the fit's pixels: so many distances are looked at; how many count as few
STIFF, STEEP = 0.02, 1.5  # over the mean, squared: what a slope is held by; the largest
LINEAR = 65535  # steps of linear light, a twentieth of a code where the curve is steepest
COARSE, FINE = (32, 64), (64, 128)  # environment maps; mirrors show them
FILL, BROAD = 0.25, 8.0  # a studio's light from everywhere; its lamps are exp(BROAD cos), 30 degrees wide


def exposure(image, region) -> float:
    """The factor that shows ``region`` of a linear image well: its 99th percentile just below white."""
    values = np.asarray(image)[region].reshape(-1, 3)
    values = values[np.isfinite(values).all(-1)]
    return float(0.85 / max(np.percentile(values, 99), 1e-12)) if len(values) else 1.0


def display(image, factor: float = 1.0) -> np.ndarray:
    """8-bit sRGB of a linear image (h, w, 3) times ``factor``."""
    values = np.nan_to_num(np.asarray(image, np.float64) * factor, nan=0.0, posinf=1.0, neginf=0.0)
    return _codes()[(np.clip(values, 0, 1) * LINEAR + 0.5).astype(np.int32)]


@lru_cache(maxsize=1)
def _codes() -> np.ndarray:
    """8-bit sRGB of each of `LINEAR` steps: a power for each pixel would be half of a report's own arithmetic."""
    return (linear_to_srgb(np.arange(LINEAR + 1) / LINEAR) * 255 + 0.5).astype(np.uint8)


def write_row(path, panels) -> None:
    """Writes pictures side by side, each with its label: a list of (label, (h, w, 3) uint8)."""
    write_png(path, row(panels))


def render_objects(
    scene, materials, lightings, *, textured: bool, directions: int, indirect=None, suns=()
) -> np.ndarray:
    """Images (M, h, w, 3) float32 of a prepared scene's objects, NaN where none is; ``suns`` shine beside each light.

    A material without a texture needs no charts. Large objects are rendered at `IMAGE_PIXELS` pixels and filled from
    the nearest of them.
    """
    camera = scene.job.camera
    out = np.full((lightings.count, camera.height, camera.width, 3), np.nan, np.float32)
    for index, material in enumerate(materials):
        region = scene.view.mesh == index
        points = scene.points(index, region=region, textured=textured and material.has_texture)
        points = points.take(spread(points, IMAGE_PIXELS))
        values = scene.radiance(points, material, lightings, directions=directions, indirect=indirect)
        if suns:
            values = values + scene.sun_radiance(points, material, *suns)[:, None]
        if len(points) < region.sum():
            values = values[cKDTree(points.pixels).query(np.argwhere(region))[1]]
        out[:, region] = values.transpose(1, 0, 2)
    return out


def filled(pixels, values, region, spacing: float, *, soft: float = SOFT) -> np.ndarray:
    """Values of some pixels of a region, smoothly filled in between.

    Parameters
    ----------
    pixels : (n, 2) int, row and column, within the region
    values : (n, c) float
    region : (h, w) bool
    spacing : of the pixels, in pixels; 1: they are all of the region
    soft : over the spacing, how far a pixel is smeared

    Returns
    -------
    (h, w, c) float32, of meaning within the region
    """
    out = np.zeros((*region.shape, values.shape[1] + 1), np.float32)
    out[tuple(pixels.T)] = np.concatenate([values, np.ones((len(values), 1))], 1)
    if spacing <= 1:
        return out[..., :-1]
    # what no pixel is near to has the value of the nearest one
    known = np.where(out[..., -1] > 0, 0, 1).astype(np.uint8)
    _, label = cv2.distanceTransformWithLabels(known, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    nearest = np.empty((label.max() + 1, values.shape[1]), np.float32)
    nearest[label[tuple(pixels.T)]] = values
    smooth = cv2.GaussianBlur(out, (0, 0), soft * spacing, borderType=cv2.BORDER_CONSTANT)
    near = smooth[..., -1:] > NEAR / spacing**2
    return np.where(near, smooth[..., :-1] / np.maximum(smooth[..., -1:], 1e-12), nearest[label])


def carried(guide, pixels, values, region) -> np.ndarray:
    """Values that are known at some pixels of a region carried over all of it, along a rough picture of the same thing.

    Around each pixel the values are taken for a line in the guide's, each channel its own, with the guide's slope where
    few are near (He, Sun, Tang: Guided image filtering, ECCV 2010, here of scattered values).

    Parameters
    ----------
    guide : (h, w, 3) float32, >= 0, of meaning within the region
    pixels : (n, 2) int; n >= 1
    values : (n, 3) float

    Returns
    -------
    (h, w, 3) float32, >= 0, of meaning within the region
    """
    at = tuple(pixels.T)
    x, y = guide[at].astype(np.float64), np.asarray(values, np.float64)
    unit = max(float(y.mean()), 1e-30)
    gain = y.sum(0) / np.maximum(x.sum(0), 1e-30)
    x, y = x * (gain / unit), y / unit
    spacing = max(float(np.sqrt(region.sum() / len(y))), 1.0)
    cell = max(1, int(spacing / 2))
    h, w = (-(-side // cell) for side in region.shape)
    where = pixels[:, 0] // cell * w + pixels[:, 1] // cell
    each = np.concatenate([np.ones((len(y), 1)), x, y, x * x, x * y], 1)
    sums = np.stack([np.bincount(where, column, h * w) for column in each.T], -1).reshape(h, w, -1)
    # around the object there are none: the line at its edge is that of its inside
    sums = cv2.GaussianBlur(sums, (0, 0), AROUND * spacing / cell, borderType=cv2.BORDER_CONSTANT)
    count = sums[..., :1]
    mean_x, mean_y, xx, xy = np.split(sums[..., 1:] / np.maximum(count, 1e-12), 4, -1)
    trust = count / (count + SPARSE * (cell / spacing) ** 2)
    slope = 1 + trust * (np.clip((xy - mean_x * mean_y + STIFF) / (xx - mean_x**2 + STIFF), 0, STEEP) - 1)
    lines = np.concatenate([slope, trust * (mean_y - slope * mean_x)], -1).astype(np.float32)
    size = w * cell, h * cell
    lines = cv2.resize(lines, size, interpolation=cv2.INTER_LINEAR)[: region.shape[0], : region.shape[1]]
    return np.maximum(lines[..., :3] * gain.astype(np.float32) * guide + lines[..., 3:] * np.float32(unit), 0)


def studio(to_world, height: int, width: int) -> np.ndarray:
    """An environment map (height, width, 3): broad lamps about a camera as a material's small picture has them."""
    directions = pixel_directions(height, width)
    out = np.full((height, width, 3), FILL)
    for direction, strength in LIGHTS:
        towards = to_world[:3, :3] @ (np.array(direction) / np.linalg.norm(direction))
        out += strength * np.exp(BROAD * (directions @ towards - 1))[..., None]
    return out


def seen_flat(points, camera, *, millimetres_per_unit: float):
    """The points with a texture that lies in the picture's plane: for a sample of a material it needs no charts."""
    right, up = camera.to_world[:3, 0], camera.to_world[:3, 1]
    tangent = right - (points.normal @ right)[:, None] * points.normal
    tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-12)
    uv = (points.position - points.position.mean(0)) @ np.stack([right, up], 1) * millimetres_per_unit
    return replace(points, tangent=tangent, bitangent=np.cross(points.normal, tangent), uv=uv)


@dataclass(frozen=True)
class Part:
    """An object of a picture.

    Attributes
    ----------
    index : its number
    whole : (h, w) bool, where the camera sees it
    total : how many pixels all objects have
    """

    index: int
    whole: np.ndarray
    total: int

    @cached_property
    def box(self) -> tuple[slice, slice]:
        """Rows and columns that it lies in."""
        return tuple(slice(ends.min(), ends.max() + 1) for ends in np.nonzero(self.whole))

    def within(self, pixels) -> np.ndarray:
        """Pixels (n, 2) of the picture, counted from the box's corner."""
        return pixels - [side.start for side in self.box]

    def thinned(self, most: int):
        """Where about ``most`` pixels of all objects are, (h, w) bool, and how far apart these are."""
        stride = max(1, round(float(np.sqrt(self.total / most))))
        return thinned(self.whole, self.whole.sum() // stride**2), stride

    def filled(self, points, values, spacing: float, **how) -> np.ndarray:
        """`filled`, of the box."""
        return filled(self.within(points.pixels), values, self.whole[self.box], spacing, **how)


def rough_rendering(estimate, scene, part: Part, lights) -> np.ndarray:
    """An object as the fit has it under both ``lights``, and under all suns: (h, w, 9) float32 of its box, roughly.

    Light between surfaces, where the fit has any, is that of few pixels.
    """
    model = estimate.model
    material = model.problems[0].materials[part.index]
    region, stride = part.thinned(PIXELS)
    points = scene.points(part.index, region=region, textured=material.has_texture)
    seen = scene.transport(points, directions=DIRECTIONS).radiance(material, lights).reshape(len(points), 6).copy()
    suns = scene.sun_radiance(points, material, *estimate.light.suns)
    if part.index in model.dust:
        on_top = lighter(points.normal, *model.dust[part.index]).astype(np.float32)
        seen[:, :3], suns = seen[:, :3] * on_top, suns * on_top
    out = part.filled(points, np.concatenate([seen, suns], 1), stride)
    between = scene.indirect(model.problems[0].materials, lights, model.modelled, bounces=model.bounces)
    if between is not None and all(mirror.index != part.index for mirror in scene.mirrors):
        few = points.take(spread(points, max(FEW, FEW_PIXELS * int(part.whole.sum()) // part.total)))
        sent = between.reflected(scene.transport(few, directions=BETWEEN), material).reshape(len(few), 6)
        out[..., :6] += part.filled(few, sent, float(np.sqrt(part.whole.sum() / len(few))), soft=1.0)
    return out


def sample_of(estimate, scene, part: Part, lights) -> np.ndarray:
    """A textured material on its object under the second of ``lights``: (h, w, 3) float32 of its box."""
    model, material = estimate.model, estimate.materials[part.index].material
    region, stride = part.thinned(TEXTURED_PIXELS)
    charted = model.appearance == "textured" or model.untried is None or material.lines_up  # for the fit
    points = scene.points(part.index, region=region, textured=charted)
    if not charted:
        points = seen_flat(points, scene.job.camera, millimetres_per_unit=scene.millimetres_per_unit)
    shown = scene.transport(points, directions=SAMPLE).radiance(material, lights)[:, 1]
    return part.filled(points, shown, stride)


def pictures(estimate, scene) -> tuple[np.ndarray, np.ndarray]:
    """An estimate's first photograph re-rendered, and its materials in a studio: two images (h, w, 3), NaN outside.

    The fit's pixels and basis images say what the first is there, with all that was modelled; a rendering of few
    directions says how it goes on between them. Shadows of suns are rendered.
    """
    problem, fit, camera = estimate.model.problems[0], estimate.fit, scene.job.camera
    edge = estimate.scene.job.camera.width // camera.width
    tint = np.ones(3) if fit.tint is None else fit.tint.gain
    order = sh.order_of(len(fit.all_coefficients))
    beams = sum((sun.coefficients(order) for sun in estimate.light.suns), np.zeros_like(fit.shown))
    known = problem.by_object(problem.predicted(fit.shown - beams / tint))
    scales = np.ones((len(known), 3)) if problem.scales is None else problem.scales
    size = FINE if any(m.mirror_reflectance is not None for m in problem.materials) else COARSE
    sky = replace(estimate.lighting, suns=(), coefficients=estimate.lighting.sky)
    sky = lighting_map(sky, *size, radiance=estimate.radiance)
    lights = EnvironmentMaps(np.stack([sky, studio(camera.to_world, *size)]), ("estimate", "studio"))
    again, sample = np.full((2, *scene.view.mesh.shape, 3), np.nan, np.float32)
    total = int(((scene.view.mesh >= 0) & (scene.view.mesh < len(known))).sum())
    for index, values in enumerate(known):
        part = Part(index, scene.view.mesh == index, total)
        if not part.whole.any():  # of a smaller camera
            continue
        mine = part.whole[part.box]
        rough, shown, suns = np.split(rough_rendering(estimate, scene, part, lights), 3, -1)
        if len(values):
            rough = carried(rough, part.within(problem.points[index].pixels // edge), values, mine)
        if estimate.materials[index].material.has_texture:
            shown = sample_of(estimate, scene, part, lights)
        again[part.box][mine] = ((rough + suns / tint) * scales[index])[mine]
        sample[part.box][mine] = shown[mine]
    return again, sample


def write_estimate_report(path, estimate) -> None:
    """The report of an estimate: photo, recognised material, estimated light, re-rendering, difference.

    Parameters
    ----------
    path : PNG
    estimate : pipeline.estimation.Estimate
    """
    scene = estimate.scene.at_most(SIDE)
    photo = scene.job.photo.radiance.astype(np.float64)  # a photo may be in any unit, and its squares overflow
    again, sample = pictures(estimate, scene)
    region = np.isfinite(again).all(-1)
    factor = exposure(photo, region)
    difference = np.where(region[..., None], np.abs(again - photo) * factor, 1.0)
    compared = region & scene.job.photo.usable
    error = np.linalg.norm((again - photo)[compared]) / max(np.linalg.norm(photo[compared]), 1e-30)
    light = shrink(estimate.map, 2)
    count = len(estimate.lighting.suns)
    suns = {0: "", 1: " and a sun"}.get(count, f" and {count} suns")
    names = ", ".join(dict.fromkeys("the material as given" if m.name == GIVEN else m.name for m in estimate.materials))
    panels = [
        ("photo", display(photo, factor)),
        (names, display(np.where(region[..., None], sample * exposure(sample, region), 1.0))),
        (f"estimated light, order {estimate.settings.order}{suns}", display(light, exposure(light, ...))),
        ("re-rendered", display(np.where(region[..., None], again * factor, 1.0))),
        (f"difference (relative error {error:.2f})", display(difference)),
    ]
    write_row(path, panels)
