# SPDX-License-Identifier: GPL-3.0-or-later
"""Compares the kernel with the reference (Mitsuba's path tracer with the BSDF plugin btf) in units of their noise.

scripts/study check-transport                   four materials x three scenes x the 25 lights of order 4
scripts/study check-transport --map FILE        and that environment map
scripts/study check-transport --quick           fewer pixels and paths
scripts/study check-transport --order 9         another order
scripts/study check-transport --between         light between surfaces instead: a ball in a bowl of the same material

mean z2: squared difference over its variance, mean over pixels, lights, channels; 1 is noise alone
worst sum: largest |z| of the sums over all pixels, among lights and channels; 75 numbers stay below 3.8 in 99 of 100
difference, reference, kernel: root mean squares relative to the radiance's: kernel minus reference, and the standard
deviations of the two. The reference's is from the spread of its paths, the kernel's from four sets of directions.
"""

import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import trimesh
from tqdm import tqdm

from btfsep_engine.btf.library import open_library
from btfsep_engine.light.lightings import EnvironmentMaps, SHBasis
from btfsep_engine.light.maps import read_map
from btfsep_engine.render.radiosity import Indirect, diffuse_albedo
from btfsep_engine.render.reference import Reference
from btfsep_engine.render.sampling import spread
from btfsep_engine.render.surface import camera_view, surface_points, with_any_tangent, with_texture
from btfsep_engine.render.tracer import Tracer
from btfsep_engine.render.transport import Transport
from scripts.studies import parser, stage, tables
from scripts.studies.stage import as_mesh

SIZE = 96
COUNTS = (7001, 7517, 8009, 8501)  # directions of the kernel's four runs
SMALL = 1.0  # millimetres in a world unit: pixels are far smaller than texels, so that nothing is filtered
USUAL = 50.0
CASES = (  # material, mean ABRDF?, millimetres in a unit
    ("felt/grey-melange", True, USUAL),
    ("wood/walnut-lacquered", True, USUAL),
    ("fabric/denim-twill", False, SMALL),
    ("leather/black-nappa", False, SMALL),
)


def scenes() -> dict:
    """name -> (object, occluders)"""
    ball = stage.ball()
    return {"ball": (ball, ()), "bowl": (stage.bowl(), ()), "shaded ball": (ball, (stage.plate(),))}


def job_of(meshes, occluders, millimetres):
    return stage.job_of(
        meshes, stage.looking_down(SIZE, 200.0), occluders=occluders, metres_per_unit=millimetres / 1000
    )


def compare(job, material, lights, *, textured, pixels, samples, jitter=False) -> list:
    """Cells of a row of the table."""
    tracer, millimetres = Tracer([job.objects[0].mesh, *(o.mesh for o in job.occluders)]), 1000 * job.metres_per_unit
    points = surface_points(camera_view(tracer, job), job, 0)
    points = points.take(spread(points, pixels))
    points = with_texture(points, job, 0) if textured else with_any_tangent(points)
    runs = []
    for count in COUNTS:
        transport = Transport(tracer, points, directions=count, millimetres_per_unit=millimetres)
        runs.append(transport.radiance(material, lights))
    runs = np.stack(runs).astype(np.float64)
    kernel, quadrature = runs.mean(0), runs.var(0, ddof=1) / len(COUNTS)
    started = time.perf_counter()
    reference = Reference(job, tracer, [material], textured=textured)
    found = reference.radiance(points.pixels, lights, samples=samples, jitter=jitter)
    seconds = (time.perf_counter() - started) / lights.count
    difference = found.radiance - kernel
    z2 = (difference**2 / (found.variance + quadrature)).mean()
    together = found.variance.sum(0) + runs.sum(1).var(0, ddof=1) / len(COUNTS)
    worst = np.abs(difference.sum(0) / np.sqrt(together)).max()
    size = np.sqrt((kernel**2).mean())
    parts = [np.sqrt(x.mean()) / size for x in (difference**2, found.variance, quadrature)]
    return [f"{z2:.2f}", f"{worst:.1f}", *(f"{100 * x:.2f} %" for x in parts), f"{seconds:.2f}"]


def between(library, *, pixels, samples):
    """Rows: what six reflections add in a ball in a bowl under even light, by both transports."""
    bowl = stage.bowl()
    ball = as_mesh(trimesh.creation.icosphere(4, 0.4).apply_translation([0.2, 0.1, -0.5]))
    job = job_of([ball, bowl], (), USUAL)
    tracer, light = Tracer([ball, bowl]), SHBasis(0)
    points = surface_points(camera_view(tracer, job), job, 0)
    points = with_any_tangent(points.take(spread(points, pixels)))
    for name in ("reference/white-diffuse", "felt/grey-melange", "leather/black-nappa", "wood/walnut-lacquered"):
        material = library.load(name).mean_material()
        one, many = (
            Reference(job, tracer, [material] * 2, bounces=n, textured=False)
            .radiance(points.pixels, light, samples=samples)
            .radiance
            for n in (1, 6)
        )
        transport = Transport(tracer, points, directions=2048, millimetres_per_unit=USUAL)
        albedo = diffuse_albedo(material)
        added = Indirect(tracer, [albedo] * 2, light, bounces=5).reflected(transport, material)
        kernel, size = transport.radiance(material, light) + added, np.sqrt((many**2).mean())
        share, part = (many - one).mean() / one.mean(), added.mean() / (many - one).mean()
        difference = np.sqrt(((kernel - many) ** 2).mean()) / size
        yield name, f"{albedo.mean():.2f}", f"{100 * share:.0f} %", f"{part:.2f}", f"{100 * difference:.1f} %"


def every(library, lights, amounts):
    """Rows of all cases."""
    for name, mean, millimetres in CASES:
        material = library.load(name)
        material = replace(material.mean_material(), name=f"{name}, mean") if mean else material
        for scene, (mesh, occluders) in scenes().items():
            for kind, lighting in lights.items():
                row = compare(job_of([mesh], occluders, millimetres), material, lighting, textured=not mean, **amounts)
                yield material.name, scene, kind, *row
    # at the usual size a pixel covers many texels: the kernel's mip pyramid against paths all over the pixel
    material, (mesh, occluders), (kind, lighting) = (
        library.load(CASES[2][0]),
        scenes()["ball"],
        next(iter(lights.items())),
    )
    row = compare(job_of([mesh], occluders, USUAL), material, lighting, textured=True, jitter=True, **amounts)
    yield f"{material.name}, filtered", "ball", kind, *row


def main(arguments) -> None:
    options = parser("check-transport", __doc__)
    options.add_argument("--order", type=int, default=4)
    options.add_argument("--map", type=Path, help="environment map, EXR or HDR")
    options.add_argument("--pixels", type=int, default=150)
    options.add_argument("--samples", type=int, default=512)
    options.add_argument("--quick", action="store_true")
    options.add_argument("--between", action="store_true")
    given = options.parse_args(arguments)
    if given.quick:
        given.pixels, given.samples, given.order = 80, 256, 2
    library = open_library(None)
    if given.between:
        heads = ("material", "albedo", "added to single reflection", "kernel's part of it", "difference, all light")
        print(tables.table(heads, tqdm(between(library, pixels=given.pixels, samples=4 * given.samples))))
        return
    lights = {f"order {given.order}": SHBasis(given.order)}
    if given.map:
        lights["map"] = EnvironmentMaps(read_map(given.map)[None], (given.map.stem,))
    print(f"{given.pixels} pixels, {given.samples} paths, kernel with 4 x about {COUNTS[0]} directions\n")
    heads = ("material", "scene", "lights", "mean z2", "worst sum", "difference", "reference", "kernel", "s a light")
    print(tables.table(heads, tqdm(every(library, lights, {"pixels": given.pixels, "samples": given.samples}))))
