# SPDX-License-Identifier: GPL-3.0-or-later
"""A process from its start to its result: jobs of the dented sphere, estimated by the command line."""

import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from btfsep_engine import images
from btfsep_engine.btf.library import open_library
from btfsep_engine.light.lightings import SHLighting
from btfsep_engine.render import radiosity
from scripts.transport.stage import MATERIALS, METRES, ROOT, Stage, relative, table
from tests.render.scenes import positive_light

SIZE = 320
WHITE = "reference/white-diffuse"
CASES = (  # label, material, options, counted in --quick
    ("first ever: tries libLLVM, compiles", WHITE, "--no-report", False),
    ("after that", WHITE, "--no-report", True),
    ("after that, again", WHITE, "--no-report", False),
    ("a textured material, first", MATERIALS[0], "--no-report", False),
    ("a textured material, after that", MATERIALS[0], "--no-report", True),
    ("white, with the report's first compilation", WHITE, "--report", False),
    ("white, with the report", WHITE, "--report", False),
)


def write_job(folder: Path, material, *, directions: int) -> np.ndarray:
    """A job of the dented sphere of a material under a known light; the light's coefficients ((L + 1)^2, 3)."""
    folder.mkdir()
    stage, light = Stage(level=5, size=SIZE, textured=material.name != WHITE), positive_light(3)
    points, photo = stage.points, np.zeros((SIZE, SIZE, 3), np.float32)
    transport, lighting = stage.transport(points, directions), SHLighting(light)
    albedo = radiosity.diffuse_albedo(material)
    indirect = radiosity.Indirect(stage.tracer, [albedo], lighting, bounces=3)
    seen = transport.radiance(material, lighting) + indirect.reflected(transport, material)
    photo[points.pixels[:, 0], points.pixels[:, 1]] = seen[:, 0]
    images.write_exr(folder / "photo.exr", photo)
    stage.shape.export(folder / "ball.ply")
    camera = {k: getattr(stage.job.camera, k) for k in ("width", "height", "fx", "fy", "cx", "cy")}
    job = {"format": "btfsep-job", "version": 1, "image": "photo.exr", "metres_per_unit": METRES}
    job["camera"] = {**camera, "to_world": stage.job.camera.to_world.tolist()}
    job["objects"] = [{"name": "ball", "mesh": "ball.ply"}]
    (folder / "job.json").write_text(json.dumps(job))
    return light


def cold(options) -> str:
    """Seconds of whole processes, with a home and caches of their own that are empty at first."""
    library, rows = open_library(options.library), []
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        (folder / "home").mkdir()
        lights = {
            name: write_job(folder / name.replace("/", "-"), library.load(name), directions=options.photo_directions)
            for name in (WHITE, MATERIALS[0])
        }
        environment = {**os.environ, "HOME": str(folder / "home"), "BTFSEP_CACHE": str(folder / "cache")}
        for label, name, more, quick in CASES:
            if quick or not options.quick:
                row = _run(folder / name.replace("/", "-"), name, more, environment, lights[name], options)
                rows.append((label, *row))
                print(f"  {label}: {row[0]} s", flush=True)
    head = ("`btfsep estimate JOB --material …`", "s", "processor s", "of it in stages", "light up to order 3, to")
    return table(head, rows)


def _run(job: Path, name: str, more: str, environment, light, options) -> tuple:
    base = [sys.executable, "-P", "-m", "btfsep_engine", "estimate", str(job), "--json", "--material", name, more]
    base += ["--library", str(options.library)] if options.library else []
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    run = subprocess.run(base, env=environment, capture_output=True, text=True, cwd=ROOT)
    seconds, after = time.perf_counter() - start, resource.getrusage(resource.RUSAGE_CHILDREN)
    if run.returncode:
        raise SystemExit(run.stderr)
    result = json.loads(run.stdout.splitlines()[-1])["result"]
    found = np.array(json.loads(Path(result["lighting"]).read_text())["coefficients"])[: len(light)]
    truth = light[: len(found)]
    stages = ", ".join(f"{k} {v:.2f}" for k, v in result["seconds"].items())
    work = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return f"{seconds:.2f}", f"{work:.2f}", stages, f"{relative(found, truth):.3f}"
