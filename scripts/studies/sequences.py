# SPDX-License-Identifier: GPL-3.0-or-later
"""Frames of a sequence beside an estimate of each alone: how far apart, how fast, how still.

scripts/study sequences PHOTOS [--objects …] [--materials …]    a folder of jobs OBJECT_MATERIAL_LIGHT

Of every view (an object in a material) seven sequences are made:

- cuts: one photograph after another, each under another light
- change: from each photograph to the next in --steps mixtures, which are photographs of mixed lights; noise of 1 %
- still: the first photograph --frames times, each with noise of its own of 1 % of its mean
- moving: the camera turns by 2 degrees about the vertical in each frame; photos by the engine's own kernel, of the
  material under the first photograph's light, straight from outside, with that noise
- off: as still, of the first photograph moved by 1.5 pixels
- sun, sun moves: as still, by the kernel under a sky and a sun, which stands or moves by 0.05 degrees in each frame (a
  sun does so in 12 seconds)

Each is solved by `pipeline.sequence`, and each frame alone by the whole way of an estimate in the same process, which
keeps as much. Prints, by how the light of a frame was found: frames; how many coefficients are the same in every digit;
the relative difference up to order 2; the largest difference of a coefficient in its stated standard deviations; and
milliseconds of light and doubts (without reading and writing), beside those alone. "jitter": root mean square of the
angles between the main directions (order 1, mean of the channels) of a still scene's frames and their mean.
"""

import itertools
import json
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from btfsep_engine.btf.library import open_library
from btfsep_engine.commands.sequence import run_sequence
from btfsep_engine.imaging import images
from btfsep_engine.job.load import load_job
from btfsep_engine.job.photograph import read_photo
from btfsep_engine.job.poses import posed_jobs
from btfsep_engine.light.files import read_lighting
from btfsep_engine.light.lightings import SHLighting
from btfsep_engine.light.sun import Sun
from btfsep_engine.pipeline.estimation import estimate
from btfsep_engine.pipeline.settings import choose
from btfsep_engine.progress import Reporter
from scripts.studies import parser, photos, tables
from scripts.studies.estimates import scene_of

NOISE = 0.01  # of a photo's mean
TURN = np.radians(2)
SUN_TURN = 0.05  # degrees
SKY = np.array([[1.3, 1.4, 1.7], [0.3, 0.3, 0.3], [0.5, 0.5, 0.5], [-0.2, -0.2, -0.2]])  # coefficients, of order 1
ABOUT_CAMERA = np.array([[-0.45, 0.3, 0.84], [0.84, 0.0, 0.45]])  # to the sun, behind the camera, and where it goes
OF_SUN = np.array([3.3, 3.0, 2.7])  # irradiance
HEADS = ("sequence", "found", "frames", "same digits", "order 2", "in deviations", "ms", "ms alone")


def mixtures(shown, steps: int, random):
    """Photographs from each of some to the next: (h, w, 3), of the same mean."""
    pictures = [images.read_linear(p.folder / "photo.exr").pixels for p in shown]
    pictures = [p / p.mean() for p in pictures]
    for a, b in itertools.pairwise(pictures):
        for i in range(steps):
            yield noisy(a + (b - a) * (i / steps), random)


def noisy(picture, random) -> np.ndarray:
    return np.maximum(picture + NOISE * picture.mean() * random.normal(size=picture.shape), 0)


def moving(shown, library, schemas, random):
    """Photographs of the first one's things and light in other poses, by the kernel: (h, w, 3)."""
    light, material = SHLighting(shown.truth(9)), library.load(shown.material)
    for schema in schemas:
        job = load_job(shown.folder, with_photo=False, schema=schema)
        scene = scene_of(job)
        points = scene.points(0, textured=False)
        image = np.zeros((job.camera.height, job.camera.width, 3))
        image[tuple(points.pixels.T)] = scene.radiance(points, material.mean_material(), light, directions=512)[:, 0]
        yield noisy(image, random)


def moved(picture):
    """A photograph (h, w, 3) half a pixel and one more to the right."""
    left = np.roll(picture, 1, 1)
    return (left + np.roll(left, 1, 1)) / 2


def sunlit(shown, library, frames: int, degrees: float, random):
    """Photographs of the first one's things under a sky and a sun, which turns by so much in each, by the kernel."""
    scene, material = scene_of(load_job(shown.folder)), library.load(shown.material).mean_material()
    camera, points = scene.job.camera, scene.points(0, textured=False)
    middle, aside = (a / np.linalg.norm(a) for a in ABOUT_CAMERA @ camera.to_world[:3, :3].T)
    below = scene.radiance(points, material, SHLighting(SKY), directions=4096)[:, 0]
    for i in range(frames):
        towards = middle + np.tan(np.radians(degrees * i)) * aside
        sun = Sun(towards / np.linalg.norm(towards), OF_SUN, np.zeros(3))
        image = np.zeros((camera.height, camera.width, 3))
        image[tuple(points.pixels.T)] = below + scene.sun_radiance(points, material, sun)
        yield noisy(image, random)


def sequences_of(shown, library, schemas, given):
    """(name, pictures) of each sequence of a view."""
    random = np.random.default_rng(0)
    first = images.read_linear(shown[0].folder / "photo.exr").pixels
    yield "cuts", [images.read_linear(p.folder / "photo.exr").pixels for p in shown]
    yield "change", mixtures(shown, given.steps, random)
    yield "still", [noisy(first, random) for _ in range(given.frames)]
    yield "moving", moving(shown[0], library, schemas, random)
    yield "off", [noisy(moved(first), random) for _ in range(given.frames)]
    yield "sun", sunlit(shown[0], library, given.frames, 0.0, random)
    yield "sun moves", sunlit(shown[0], library, given.frames, SUN_TURN, random)


def poses_of(job, frames) -> dict:
    """The content of a poses.json: the camera goes round the world's vertical."""
    turned = {}
    for i, name in enumerate(frames):
        c, s = np.cos(i * TURN), np.sin(i * TURN)
        turn = np.array([[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
        turned[name] = {"camera": {"to_world": (turn @ job.camera.to_world).tolist()}}
    return {"format": "btfsep-poses", "version": 1, "frames": turned}


def alone(job, path, library, settings, material):
    """The light of a frame by the whole way of an estimate, and its milliseconds."""
    scene = scene_of(replace(job, photo=read_photo(path, job.camera)))
    begun = time.perf_counter()
    found = estimate(scene, library, settings, material=material)
    return found.lighting, 1000 * (time.perf_counter() - begun)


def study(shown, library, given, folder: Path):
    """A row for each frame of each sequence of a view, and the jitter of the still one in degrees."""
    settings, job, rows, jitter = choose(align="never"), load_job(shown[0].folder), [], None
    poses = folder / "poses.json"
    poses.write_text(json.dumps(poses_of(job, [f"{i:04d}" for i in range(given.frames)])))
    schemas = posed_jobs(poses, shown[0].folder)
    for kind, pictures in sequences_of(shown, library, schemas.values(), given):
        out, files = folder / kind, []
        for i, picture in enumerate(pictures):
            files.append(out / f"{i:04d}.exr")
            images.write_exr(files[-1], np.asarray(picture, np.float32))
        asked = {"frames": out / "*.exr", "material": shown[0].material, "out": out / "lights"}
        asked["poses"] = poses if kind == "moving" else None
        result = run_sequence(shown[0].folder, library, settings, **asked, reporter=Reporter())
        lights = [read_lighting(out / "lights" / f["lighting"]) for f in result["frames"]]
        for file, frame, light in zip(files[1:], result["frames"][1:], lights[1:], strict=True):
            own = load_job(job.folder, with_photo=False, schema=schemas[file.stem]) if kind == "moving" else job
            other, took = alone(own, file, library, settings, shown[0].material)
            apart = light.coefficients - other.coefficients
            rows.append(
                {
                    "kind": kind,
                    "by": frame["by"],
                    "same": not apart.any(),
                    "order2": np.linalg.norm(apart[:9]) / np.linalg.norm(other.coefficients[:9]),
                    "deviations": np.abs(apart / other.stddev).max(),
                    "ms": frame["milliseconds"],
                    "alone": took,
                }
            )
        if kind == "still":
            main = np.array([light.coefficients[[3, 1, 2]].mean(1) for light in lights])
            main /= np.linalg.norm(main, axis=1, keepdims=True)
            middle = main.mean(0) / np.linalg.norm(main.mean(0))
            jitter = float(np.degrees(np.sqrt(np.square(np.arccos(np.clip(main @ middle, -1, 1))).mean())))
    return rows, jitter


def cells(rows):
    """Of each sequence and way of finding a light."""
    for kind, some in tables.groups(rows, "kind", every=None):
        for by, found in tables.groups(some, "by", every=None):
            apart = [tables.spread([r[key] for r in found], "{:.3f}") for key in ("order2", "deviations")]
            took = [f"{np.median([r[key] for r in found]):.0f}" for key in ("ms", "alone")]
            yield kind, by, len(found), tables.percent([r["same"] for r in found]), *apart, *took


def main(arguments) -> int:
    options = parser("sequences", __doc__)
    options.add_argument("photos", type=Path)
    options.add_argument("--objects", nargs="+", help="some of the objects")
    options.add_argument("--materials", nargs="+", help="some of the materials, as folders are named")
    options.add_argument("--steps", type=int, default=12, help="from a photograph to the next")
    options.add_argument("--frames", type=int, default=12, help="of a still scene, and of a moving camera")
    given = options.parse_args(arguments)
    library, rows, jitters = open_library(None), [], {}
    shown = photos.photographs_in(given.photos, objects=given.objects, materials=given.materials)
    for name, each in photos.views(shown).items():
        with tempfile.TemporaryDirectory() as folder:
            more, jitters[name] = study(each, library, given, Path(folder))
        rows += more
    print(tables.table(HEADS, cells(rows)))
    print(
        "\n" + tables.table(("object", "material", "jitter, degrees"), [(*n, f"{j:.2f}") for n, j in jitters.items()])
    )
    return 0
