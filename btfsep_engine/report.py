# SPDX-License-Identifier: GPL-3.0-or-later
"""The report picture: one row, as in the paper's figures 3 and 4."""

import numpy as np
from scipy.spatial import cKDTree

from btfsep_engine.atomic import replacing
from btfsep_engine.images import linear_to_srgb
from btfsep_engine.light.files import lighting_map, seen_lighting
from btfsep_engine.light.maps import training_lights
from btfsep_engine.render.sampling import spread

PIXELS = 40_000  # most pixels of an object that the report renders; the others are filled from their neighbours
DIRECTIONS = 256  # a picture to look at
SIDE = 1024  # largest edge of what the report is made of; its panels are smaller
GREY = 0.18  # display value of the photo's median luminance


def exposure(image, region) -> float:
    """The factor that shows ``region`` of a linear image well: its 99th percentile just below white."""
    values = np.asarray(image)[region].reshape(-1, 3)
    values = values[np.isfinite(values).all(-1)]
    return float(0.85 / max(np.percentile(values, 99), 1e-12)) if len(values) else 1.0


def display(image, factor: float = 1.0) -> np.ndarray:
    """8-bit sRGB of a linear image (h, w, 3) times ``factor``."""
    values = np.nan_to_num(np.asarray(image, np.float64) * factor, nan=0.0, posinf=1.0, neginf=0.0)
    return (np.clip(linear_to_srgb(np.clip(values, 0, 1)), 0, 1) * 255 + 0.5).astype(np.uint8)


def write_row(path, panels) -> None:
    """Writes labelled pictures side by side.

    Parameters
    ----------
    path : PNG
    panels : list of (label, (h, w, 3) uint8)
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # slow to import, and a run may want no picture
    from matplotlib.figure import Figure

    ratios, height = [image.shape[1] / image.shape[0] for _, image in panels], 3.0
    size = height * sum(ratios) + 0.12 * len(panels), height + 0.5
    figure = Figure(figsize=size, dpi=110, facecolor="white")
    FigureCanvasAgg(figure)
    figure.subplots_adjust(left=0.005, right=0.995, bottom=0.01, top=height / size[1], wspace=0.03)
    grid = figure.subplots(1, len(panels), width_ratios=ratios, squeeze=False)[0]
    for axes, (label, image) in zip(grid, panels, strict=True):
        axes.imshow(image, interpolation="antialiased")
        axes.set_axis_off()
        axes.set_title(label, fontsize=11, pad=5, parse_math=False)
    with replacing(path) as scratch:
        figure.savefig(scratch, format="png")


def render_objects(
    scene, materials, lightings, *, textured: bool, directions: int, indirect=None, suns=()
) -> np.ndarray:
    """Images (M, h, w, 3) float32 of a prepared scene's objects, NaN where none is; ``suns`` shine beside each light.

    A material without a texture needs no charts. Large objects are rendered at `PIXELS` pixels and filled from the
    nearest of them.
    """
    camera = scene.job.camera
    out = np.full((lightings.count, camera.height, camera.width, 3), np.nan, np.float32)
    for index, material in enumerate(materials):
        region = scene.view.mesh == index
        points = scene.points(index, region=region, textured=textured and material.has_texture)
        points = points.take(spread(points, PIXELS))
        values = scene.radiance(points, material, lightings, directions=directions, indirect=indirect)
        for sun in suns:
            values = values + scene.sun_radiance(points, material, sun)[:, None]
        if len(points) < region.sum():
            values = values[cKDTree(points.pixels).query(np.argwhere(region))[1]]
        out[:, region] = values.transpose(1, 0, 2)
    return out


def write_estimate_report(path, estimate) -> None:
    """The report of an estimate: photo, recognised material, estimated light, re-rendering, difference.

    Parameters
    ----------
    path : PNG
    estimate : pipeline.estimation.Estimate
    """
    scene, settings = estimate.scene.at_most(SIDE), estimate.settings
    photo = scene.job.photo.radiance.astype(np.float64)  # a photo may be in any unit, and its squares overflow
    materials = [m.material for m in estimate.materials]
    textured = settings.appearance == "textured"
    region = (scene.view.mesh >= 0) & (scene.view.mesh < len(materials))
    light = estimate.lighting
    whole, sky = seen_lighting(light)
    indirect = scene.indirect(materials, whole, settings, bounces=settings.reflections)
    shown = [m if textured or m.lines_up else m.mean_material() for m in materials]
    again = render_objects(
        scene,
        shown,
        sky,
        textured=textured,
        directions=DIRECTIONS,
        indirect=indirect,
        suns=light.suns,
    )[0].astype(np.float64)
    sample = render_objects(
        scene, materials, training_lights(rotations=1).selected([0]), textured=True, directions=DIRECTIONS
    )[0]
    factor = exposure(photo, region)
    background = np.full_like(photo, 1.0)
    difference = np.where(region[..., None], np.abs(again - photo) * factor, 1.0)
    compared = region & scene.job.photo.usable & np.isfinite(again).all(-1)
    error = np.linalg.norm((again - photo)[compared]) / max(np.linalg.norm(photo[compared]), 1e-30)
    size = (128, 256)
    estimated = lighting_map(light, *size, radiance=estimate.radiance)  # as lighting.exr has it
    count = len(light.suns)
    suns = {0: "", 1: " and a sun"}.get(count, f" and {count} suns")
    names = ", ".join(dict.fromkeys(m.name for m in estimate.materials))
    panels = [
        ("photo", display(photo, factor)),
        (names, display(np.where(region[..., None], sample * exposure(sample, region), background))),
        (
            f"estimated light, order {settings.order}{suns}",
            display(estimated, exposure(estimated, ...)),
        ),
        ("re-rendered", display(np.where(region[..., None], again * factor, background))),
        (f"difference (relative error {error:.2f})", display(difference)),
    ]
    write_row(path, panels)
