# SPDX-License-Identifier: GPL-3.0-or-later
"""Large photographs and fine meshes through the whole of `btfsep estimate`: peak memory and seconds.

scripts/study bench-big-input                  photographs of 4096 x 4096 (EXR, PNG) and a mesh of 2 million triangles
scripts/study bench-big-input --size 2048 --side 500
scripts/study bench-big-input --only exr mesh

Each estimate is a process of its own, and its memory is what the system says that it had resident at most. The
photographs are of a dented ring of 100,000 triangles in leather under a light of order 3, made by the kernel at 40,000
pixels, each of which lends its light to those around it, with 1 % noise: the handling is measured, not the accuracy.
"""

import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import trimesh
from scipy.interpolate import NearestNDInterpolator

from btfsep_engine.btf.library import open_library
from btfsep_engine.imaging import images
from btfsep_engine.job.load import load_job
from btfsep_engine.job.model import TriangleMesh
from btfsep_engine.light.lightings import SHLighting
from btfsep_engine.render.parametrise import physical_uv
from btfsep_engine.render.sampling import spread
from scripts.cycles import engine
from scripts.studies import ROOT, parser
from scripts.studies.estimates import scene_of
from scripts.studies.measures import timed
from scripts.studies.stage import looking_down, positive_light, waves, write_job

CASES = ("small", "exr", "png", "mesh", "charts")
MATERIAL = "leather/brown-grain"
SMALL = 512  # pixels, of the photograph to compare with, and of the fine mesh
COARSE = 224  # quads along and around the ring of the photographs: 100,352 triangles
METRES = 0.05  # of a world unit


def ring(side: int) -> trimesh.Trimesh:
    """A dented ring of 2 side^2 triangles."""
    shape = trimesh.creation.torus(0.85, 0.36, major_sections=side, minor_sections=side)
    shape.vertices *= 1 + 0.05 * waves(shape.vertices)
    return shape


def make_job(folder: str, size: int, side: int, suffix: str) -> None:
    """Writes a job of one ring, seen from above and aside."""
    folder, aside = Path(folder), trimesh.transformations.rotation_matrix(np.radians(50), [1, 0, 0])
    camera = looking_down(size, 1.55 * size)
    camera = replace(camera, to_world=aside @ camera.to_world)
    write_job(folder, ring(side), camera, image=f"photo.{suffix}", metres=METRES, material=MATERIAL)
    scene = scene_of(load_job(folder, with_photo=False))
    region = scene.view.mesh == 0
    rows, columns = np.nonzero(region)
    some = np.zeros_like(region)
    some[::8, ::8] = region[::8, ::8]
    points = scene.points(0, region=some if size > SMALL else region, textured=False)
    points = points.take(spread(points, 40_000))
    leather = open_library().load(MATERIAL).mean_material()
    values = scene.radiance(points, leather, SHLighting(positive_light(3)), directions=256)[:, 0]
    shaded = NearestNDInterpolator(points.pixels, values)
    picture = np.full((size, size, 3), 0.05, np.float32)
    picture[region] = shaded(rows, columns) * (1 + 0.01 * np.random.default_rng(3).normal(size=(len(rows), 3)))
    if suffix == "exr":
        images.write_exr(folder / "photo.exr", picture)
    else:
        images.write_png(folder / "photo.png", np.clip(picture * (0.8 / picture.max()), 0, 1))


def time_charts(side: int) -> None:
    """Seconds of the charts of a mesh of 2 side^2 triangles."""
    shape = ring(side)
    faces = np.asarray(shape.faces, np.int32)
    mesh = TriangleMesh(np.asarray(shape.vertices), faces, np.zeros((len(faces), 3, 3), np.float32))
    for name in ("first", "again", "again"):
        (clock, work), _ = timed(lambda: physical_uv(mesh, "xatlas", millimetres_per_unit=50.0))
        print(f"charts of {len(faces):,} triangles, {name}: {clock:.1f} s by the clock, {work:.1f} s of processor")


def main(arguments) -> None:
    options = parser("bench-big-input", __doc__)
    options.add_argument("--only", nargs="+", choices=CASES, default=list(CASES))
    options.add_argument("--size", type=int, default=4096, help="edge of the large photographs, pixels")
    options.add_argument("--side", type=int, default=1000, help="the fine mesh has 2 SIDE^2 triangles")
    given = options.parse_args(arguments)
    wanted = {
        "small": (SMALL, COARSE, "exr"),
        "exr": (given.size, COARSE, "exr"),
        "png": (given.size, COARSE, "png"),
        "mesh": (SMALL, given.side, "exr"),
    }
    print(f"{'':28}{'peak GB':>9}{'seconds':>9}{'of processor':>14}  stages")
    with tempfile.TemporaryDirectory() as scratch:
        for case in (c for c in wanted if c in given.only):
            size, side, suffix = wanted[case]
            folder = Path(scratch) / case
            # made by a child: what this process held would count as the memory of those that it starts
            call = f"make_job{(str(folder), size, side, suffix)}"
            code = f"from {__name__} import make_job; {call}"
            subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT)
            # the fine mesh's charts are made, whatever the photo asks for
            more = ["--appearance", "textured"] if case == "mesh" else []
            result, (seconds, processor, peak) = engine.measured("estimate", folder, *more)
            stages = ", ".join(f"{k} {v:.1f}" for k, v in result["seconds"].items() if k != "total" and v >= 0.05)
            name = f"{size} x {size} {suffix.upper()}, {2 * side * side:,} tri"
            print(f"{name:28}{peak:9.2f}{seconds:9.1f}{processor:14.1f}  {stages}", flush=True)
    if "charts" in given.only:
        time_charts(given.side)
