# SPDX-License-Identifier: GPL-3.0-or-later
"""The basis images A of the fit, by the kernel or by the reference.

How many light directions: on photographs by Cycles estimates with the usual count err as little as with any larger
number (docs/results/sampling.md), because what the model misses of a photo is several times as large as what they miss.
"""

import numpy as np

from btfsep_engine.pipeline.settings import TransportSettings

USUAL = 256  # directions; with fewer estimates err more, with more as much (docs/results/speed-accuracy.md)


def basis_images(scene, materials, chosen, lights, settings: TransportSettings) -> tuple[list, dict]:
    """Radiance of the chosen points of every object under every basis light.

    Parameters
    ----------
    scene : PreparedScene
    materials : the Material that stands for each object in the fit
    chosen : SurfacePoints of each object
    lights : light.lightings.SHBasis, M lights
    settings : TransportSettings

    Returns
    -------
    list of (p, M, 3) float32, one for each object, and a dict that says how they were made, for ``result.json``
    """
    if settings.transport == "reference":
        return _by_reference(scene, materials, chosen, lights, settings)
    directions = USUAL if settings.directions == "auto" else settings.directions
    indirect = scene.indirect(materials, lights, settings, bounces=settings.reflections)
    basis = []
    for i, (points, material) in enumerate(zip(chosen, materials, strict=True)):
        straight = scene.radiance(points, material, lights, directions=directions)
        basis.append(straight if indirect is None else straight + scene.received(i, points, material, indirect))
        scene.reporter.progress("transport", (i + 1) / len(chosen), material.name)
    return basis, {"by": "kernel", "directions": directions, "bounces": settings.reflections}


def _by_reference(scene, materials, chosen, lights, settings: TransportSettings):
    from btfsep_engine.render.reference import Reference  # an estimate by the kernel starts without it

    reference = Reference(
        scene.job,
        scene.tracer,
        materials,
        bounces=settings.reflections,
        textured=settings.appearance == "textured",
        grey=scene.grey,
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
