# SPDX-License-Identifier: GPL-3.0-or-later
"""How well a camera, or a photo beside its depth, comes back by `btfsep align`, and what that is worth to the light.

scripts/study alignment PHOTOS --lights courtyard forest --every 4
scripts/study alignment PHOTOS --cluttered        things with edges of their own behind the objects
scripts/study alignment PHOTOS --depth [holes]    a photo that is shifted against its depth
scripts/study alignment FOLDER --depth            jobs with a depth and a truth.json, as scripts/study real takes them

PHOTOS: jobs OBJECT_MATERIAL_LIGHT, as scripts/study photos leaves them; their own camera is the true one. It is shifted
and turned in random directions (seeded) and its focal length is changed. With --depth the meshes' depth is cast by rays
(scripts/study depth has what is done to it) and stands for them, and the photo is shifted against it, by no whole
pixels. Prints a table of how far it was off:

    start, rest      mean way of the visible surface in the picture from where it belongs, pixels: median (90 %)
    degrees          of the camera's turn, before and after: median
    moved, farther   photos in which the command moved anything, and in which that was away from the true place
    error before,    of the light up to order 2 (relative, one free scale) over that in the true place, by an estimate
      after          of preset draft with the right material that moves nothing itself: median (90 %)
    worse            photos whose error is larger after than before by more than a hundredth and a twentieth of it
    doubted          photos in which the estimate's own doubt speaks
    estimate mends,  photos that an estimate with --align auto moves, since that doubt speaks; those of them that get
      then worse     worse
    seconds          of the alignment, reading and geometry left out: median (of a depth those of the processor)
"""

import json
import tempfile
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from tqdm import tqdm

from btfsep_engine.fit.pose import Frame
from btfsep_engine.job.model import Job
from btfsep_engine.pipeline.alignment import align, with_camera
from btfsep_engine.pipeline.checks import shift_doubt
from btfsep_engine.pipeline.mending import mends
from btfsep_engine.pipeline.scene import PreparedScene, unseen_meshes
from scripts.cycles import COVERAGE
from scripts.studies import parser, photos, tables
from scripts.studies.clutter import cluttered
from scripts.studies.depth import VARIANTS, with_depth, z_depth
from scripts.studies.estimates import estimated, kept, scene_of
from scripts.studies.measures import order2, timed
from scripts.studies.real import true_light

STARTS = ((0, 0), (1, 1), (4, 2), (8, 3), (16, 5))  # pixels; degrees, and as many percent of the focal length
SHIFTS = (0, 1, 2, 4, 8, 16)  # pixels, of a photo against its depth
WORSE = (0.01, 0.05)  # of the error, and of itself


def disturbed(scene: PreparedScene, pixels: float, degrees: float, rng):
    """The true camera, so far off in random directions."""
    camera, seen = scene.job.camera, scene.view.mesh >= 0
    rows, columns = np.nonzero(seen)
    origins, rays = camera.rays(columns + 0.5, rows + 0.5)
    centre = np.median(origins + scene.view.distance[seen][:, None] * rays, 0)
    frame = Frame(camera, centre, float(np.sqrt(seen.sum() / np.pi)))
    axis, angle = rng.normal(size=3), rng.uniform(0, 2 * np.pi)
    turn = np.radians(degrees) * frame.radius * axis / np.linalg.norm(axis)
    lens = frame.at([*turn, pixels * np.cos(angle), pixels * np.sin(angle), 0, 0])
    zoom = 1 + rng.choice([-1, 1]) * degrees / 100
    return replace(camera, to_world=lens.to_world, fx=camera.fx * zoom, fy=camera.fy * zoom)


def shifted(scene: PreparedScene, pixels: float, rng):
    """The camera of a photo that is so far off against its depth."""
    angle = rng.uniform(0, 2 * np.pi)
    return scene.job.camera.shifted(pixels * np.cos(angle), pixels * np.sin(angle))


def off(scene: PreparedScene, camera) -> tuple[float, float]:
    """Mean way in pixels of what the true camera sees, and degrees between the cameras' axes."""
    right = scene.job.camera
    if unseen_meshes(scene.job):  # of a depth the camera is shifted alone
        return float(np.hypot(camera.cx - right.cx, camera.cy - right.cy)), 0.0
    points = scene.points(0, textured=False).position[::5]
    way = np.linalg.norm(camera.project(points) - right.project(points), axis=1).mean()
    turn = right.to_world[:3, :3].T @ camera.to_world[:3, :3]
    return float(way), float(np.degrees(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1))))


def study(folder: Path, truth, material, given) -> list[dict]:
    """One photograph, a dict for each start."""
    scene = of_depth(folder, given.depth) if given.depth else scene_of(folder)
    if given.cluttered:
        scene = scene_of(among_things(scene.job))

    def error(camera):
        if given.pose:
            return np.nan
        found = estimated(with_camera(scene, camera), material, preset="draft", align="never")
        return order2(found.lighting.coefficients, truth)

    best, out = error(scene.job.camera), []
    for start in [(pixels,) for pixels in SHIFTS] if given.depth else STARTS:
        random = np.random.default_rng([*folder.name.encode(), start[0]])
        camera = (shifted if given.depth else disturbed)(scene, *start, random)
        moved = with_camera(scene, camera)
        seconds, found = timed(partial(align, moved))
        row = {"start": ("{} px" if given.depth else "{} px, {}°").format(*start), "true": best}
        row |= dict(zip(("from_px", "from_degrees"), off(scene, camera), strict=True))
        row |= dict(zip(("rest_px", "rest_degrees"), off(scene, found.camera), strict=True))
        before = error(camera) if any(start) else best
        after = error(found.camera) if found.aligned else before
        worse = after > max(before + WORSE[0], before * (1 + WORSE[1]))
        mended = mends(moved, found)
        row |= {"before": before, "after": after, "worse": bool(worse), "seconds": seconds[1 if given.depth else 0]}
        row |= {"moved": found.aligned, "farther": row["rest_px"] > row["from_px"], "mended": mended}
        out.append(row | {"doubted": shift_doubt(moved) is not None, "mended worse": bool(worse and mended)})
    return out


def among_things(job: Job) -> Job:
    """A photograph's job with other things behind its object."""
    photo, random = job.photo, np.random.default_rng([*job.folder.name.encode()])
    radiance = cluttered(photo.radiance, np.load(job.folder / COVERAGE), random)
    return replace(job, photo=replace(photo, radiance=radiance))


def of_depth(folder: Path, variant: str) -> PreparedScene:
    """A job's scene, of a depth where it has meshes."""
    scene = scene_of(folder)
    if unseen_meshes(scene.job):
        return scene
    with tempfile.TemporaryDirectory() as scratch:
        depth = VARIANTS[variant](z_depth(scene), np.random.default_rng(7))
        return scene_of(with_depth(folder, depth, Path(scratch)))


def most(values):
    return np.percentile(values, 90)


def columns(depth: bool) -> list:
    """Of the table; a photo is not turned against its depth."""
    form = "{:.2f}" if depth else "{:.1f}"
    place = [
        ("start, px", tables.spread_of("from_px", form, far=most)),
        ("rest, px", tables.spread_of("rest_px", form, far=most)),
        ("start, degrees", tables.median_of("from_degrees", "{:.1f}")),
        ("rest, degrees", tables.median_of("rest_degrees", "{:.1f}")),
    ]
    return [
        ("photos", len),
        *(place[1:2] if depth else place),
        ("moved", tables.percent_of("moved")),
        ("farther", tables.percent_of("farther")),
        ("error before", tables.spread_of("before", over="true", far=most)),
        ("after", tables.spread_of("after", over="true", far=most)),
        ("worse", tables.percent_of("worse")),
        *([("doubted", tables.percent_of("doubted"))] if depth else []),
        ("estimate mends", tables.percent_of("mended")),
        ("then worse", tables.percent_of("mended worse")),
        ("seconds", tables.median_of("seconds", "{:.1f}")),
    ]


def main(arguments) -> int:
    options = parser("alignment", __doc__)
    options.add_argument("folder", type=Path)
    options.add_argument("--lights", nargs="+", help="some of the lights")
    options.add_argument("--every", type=int, default=1, help="only every so many of the photographs")
    options.add_argument("--pose", action="store_true", help="without the errors of the light")
    options.add_argument("--cluttered", action="store_true", help="with other things behind the objects")
    options.add_argument("--depth", nargs="?", const="depth", choices=[k for k, v in VARIANTS.items() if v])
    options.add_argument("--work", type=Path, help="folder for each photo's numbers: what is there is not done again")
    given = options.parse_args(arguments)
    real = sorted(p.parent for p in given.folder.glob("*/truth.json")) if given.depth else []
    todo = [(p, true_light(p), None) for p in real if json.loads((p / "job.json").read_text())["depth"]]
    if not real:
        shown = photos.photographs_in(given.folder, lights=given.lights)
        todo = [(photo.folder, photo.truth(2), photo.material) for photo in shown]
    rows = []
    for job, *known in tqdm(todo[:: given.every]):
        rows += kept(given.work, job.name, partial(study, job, *known, given))
    print(tables.summary("off by", columns(bool(given.depth)), tables.groups(rows, "start", every=None)))
    return 0
