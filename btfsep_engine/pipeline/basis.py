# SPDX-License-Identifier: GPL-3.0-or-later
"""The basis images A of the fit, by the kernel or by the reference.

How many light directions: on photographs by Cycles estimates with the usual count err as little as with any larger
number (docs/sampling.md), because what the model misses of a photo is several times as large as what they miss. Only a
photo that the light explains to a few per cent asks for more.
"""

from dataclasses import replace

import numpy as np

from btfsep_engine.pipeline.settings import Settings
from btfsep_engine.render.quadrature import USUAL, enough_directions
from btfsep_engine.render.reference import Reference

CLEAN = 0.1  # misfit, relative: below, the error by the usual count could show
TOLERATED = 0.3  # of the misfit, then


def basis_images(scene, materials, chosen, lights, settings: Settings) -> tuple[list, dict]:
    """Radiance of the chosen points of every object under every basis light.

    Parameters
    ----------
    scene : PreparedScene
    materials : the Material that stands for each object in the fit
    chosen : SurfacePoints of each object
    lights : light.lightings.SHBasis, M lights
    settings : Settings

    Returns
    -------
    list of (p, M, 3) float32, one for each object, and a dict that says how they were made, for ``result.json``
    """
    if settings.transport == "reference":
        return _by_reference(scene, materials, chosen, lights, settings)
    directions, error = shared_directions(scene, materials, chosen, settings)
    indirect = scene.indirect(materials, lights, settings, bounces=settings.reflections)
    basis = []
    for i, (points, material) in enumerate(zip(chosen, materials, strict=True)):
        basis.append(scene.radiance(points, material, lights, directions=directions, indirect=indirect))
        scene.reporter.progress("transport", (i + 1) / len(chosen), material.name)
    record = {"by": "kernel", "directions": directions, "bounces": settings.reflections}
    return basis, record if error is None else {**record, "direction_error": error}


def shared_directions(scene, materials, chosen, settings: Settings) -> tuple[int, float | None]:
    """How many light directions, and their estimated error (None where that was not looked at)."""
    if settings.directions != "auto":
        return settings.directions, None
    if settings.tolerance is None:
        return USUAL, None
    found = [
        enough_directions(
            lambda p, n: scene.transport(p, directions=n),
            points,
            material,
            order=settings.fit_order,
            tolerance=settings.tolerance,
        )
        for points, material in zip(chosen, materials, strict=True)
    ]
    return max(n for n, _ in found), max(e for _, e in found)


def finer(problems, materials, settings: Settings, residual: float) -> Settings | None:
    """Settings with more light directions, where a photo is so clean that those which were taken could show; or None.

    Parameters
    ----------
    problems : list of pipeline.problem.Problem, as they were fitted
    materials : for each of them the Material of each object, as in the fit
    residual : of the fit, relative
    """
    if settings.transport == "reference" or settings.directions != "auto":
        return None
    if settings.tolerance is not None or residual > CLEAN:
        return None
    strict = replace(settings, tolerance=TOLERATED * residual)
    wanted = max(
        shared_directions(p.scene, used, p.points, strict)[0] for p, used in zip(problems, materials, strict=True)
    )
    return replace(settings, directions=wanted) if wanted > max(p.transport["directions"] for p in problems) else None


def _by_reference(scene, materials, chosen, lights, settings):
    reference = Reference(
        scene.job,
        scene.tracer,
        materials,
        bounces=settings.reflections,
        textured=settings.appearance == "textured",
        reporter=scene.reporter,
    )
    pixels = np.concatenate([points.pixels for points in chosen])
    found = reference.radiance(pixels, lights, samples=settings.samples, seed=settings.seed, reporter=scene.reporter)
    noise = np.sqrt(found.variance.mean() / max(np.mean(np.square(found.radiance, dtype=np.float64)), 1e-30))
    record = {
        "by": "reference",
        "samples": settings.samples,
        "bounces": settings.reflections,
        "seconds_per_light": float(found.seconds.mean()),
        "relative_noise": float(noise),
    }
    return np.split(found.radiance, np.cumsum([len(points) for points in chosen])[:-1]), record
