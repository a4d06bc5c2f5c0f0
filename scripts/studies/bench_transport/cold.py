# SPDX-License-Identifier: GPL-3.0-or-later
"""A process from its start to its result: jobs of the dented sphere, estimated by the command line."""

import tempfile
from pathlib import Path

import numpy as np

from btfsep_engine.btf.library import open_library
from btfsep_engine.imaging import images
from btfsep_engine.light.lightings import SHLighting
from btfsep_engine.render import radiosity
from scripts.cycles import engine
from scripts.studies.measures import errors
from scripts.studies.photos import WHITE
from scripts.studies.stage import MATERIALS, Stage, positive_light, write_job
from scripts.studies.tables import table

CASES = (  # label, material, options, counted in --quick
    ("first ever: tries libLLVM, compiles", WHITE, "--no-report", False),
    ("after that", WHITE, "--no-report", True),
    ("after that, again", WHITE, "--no-report", False),
    ("a textured material, first", MATERIALS[0], "--no-report", False),
    ("a textured material, after that", MATERIALS[0], "--no-report", True),
    ("white, with the report's first compilation", WHITE, "--report", False),
    ("white, with the report", WHITE, "--report", False),
)


def photograph(folder: Path, material, *, directions: int) -> np.ndarray:
    """A job of the dented sphere of a material under a known light; the light's coefficients ((L + 1)^2, 3)."""
    stage, light = Stage(textured=material.name != WHITE), positive_light(3)
    points, photo = stage.points, np.zeros_like(stage.job.photo.radiance)
    transport, lighting = stage.transport(points, directions), SHLighting(light)
    indirect = radiosity.Indirect(stage.tracer, [radiosity.diffuse_albedo(material)], lighting, bounces=3)
    seen = transport.radiance(material, lighting) + indirect.reflected(transport, material)
    photo[tuple(points.pixels.T)] = seen[:, 0]
    write_job(folder, stage.shape, stage.job.camera)
    images.write_exr(folder / "photo.exr", photo)
    return light


def cold(options) -> str:
    """Seconds of whole processes, with a home and caches of their own that are empty at first."""
    library, rows = open_library(None), []
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        (folder / "home").mkdir()
        lights = {
            name: photograph(folder / name.replace("/", "-"), library.load(name), directions=options.photo_directions)
            for name in (WHITE, MATERIALS[0])
        }
        own = {"HOME": str(folder / "home"), "BTFSEP_CACHE": str(folder / "cache")}
        for label, name, more, quick in CASES:
            if quick or not options.quick:
                job = folder / name.replace("/", "-")
                result, seconds = engine.measured("estimate", job, "--material", name, more, **own)
                stages = ", ".join(f"{k} {v:.2f}" for k, v in result["seconds"].items())
                off = errors(engine.coefficients(result["lighting"]), lights[name], (3,))["order3_absolute"]
                rows.append((label, f"{seconds[0]:.2f}", f"{seconds[1]:.2f}", stages, f"{off:.3f}"))
                print(f"  {label}: {seconds[0]:.2f} s", flush=True)
    head = ("`btfsep estimate JOB --material …`", "s", "processor s", "of it in stages", "light up to order 3, to")
    return table(head, rows)
