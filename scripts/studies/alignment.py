# SPDX-License-Identifier: GPL-3.0-or-later
"""How well a camera that is a little off comes back by `btfsep align`, and what that is worth to the light.

scripts/study alignment PHOTOS --lights courtyard forest --every 4

PHOTOS: folders of jobs OBJECT_MATERIAL_LIGHT, as scripts/study photos leaves them; their own camera is the true one.
It is shifted and turned in random directions (seeded) and its focal length is changed. Prints a table of how far it was
off:

    start, rest      mean way of the visible surface in the picture from where it belongs, pixels: median (90 %)
    degrees          of the camera's turn, before and after: median
    moved, farther   photos in which the command moved anything, and in which that was away from the true camera
    error before,    of the light up to order 2 (relative, one free scale) over that with the true camera, by an
      after          estimate of preset draft with the right material: median (90 %)
    worse            photos whose error is larger after than before by more than a hundredth and a twentieth of it
    estimate mends,  photos that an estimate with --align auto moves, since its own doubt speaks; those of them that get
      then worse     worse
    seconds          of the alignment, reading and geometry left out: median
"""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
from tqdm import tqdm

from btfsep_engine import atomic
from btfsep_engine.btf.library import open_library
from btfsep_engine.fit.pose import Frame
from btfsep_engine.job.load import load_job
from btfsep_engine.pipeline.alignment import align, with_camera
from btfsep_engine.pipeline.estimation import estimate
from btfsep_engine.pipeline.mending import mends
from btfsep_engine.pipeline.scene import PreparedScene
from btfsep_engine.pipeline.settings import choose
from btfsep_engine.progress import Reporter
from scripts.studies import parser, photos, tables
from scripts.studies.measures import order2, timed

STARTS = ((0, 0), (1, 1), (4, 2), (8, 3), (16, 5))  # pixels; degrees, and as many percent of the focal length
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


def off(scene: PreparedScene, camera) -> tuple[float, float]:
    """Mean way in pixels of what the true camera sees, and degrees between the cameras' axes."""
    right, points = scene.job.camera, scene.points(0, textured=False).position[::5]
    way = np.linalg.norm(camera.project(points) - right.project(points), axis=1).mean()
    turn = right.to_world[:3, :3].T @ camera.to_world[:3, :3]
    return float(way), float(np.degrees(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1))))


def study(photo, library, *, starts, light: bool) -> list[dict]:
    """One photograph, a dict for each start; ``light`` : whether errors of the light are taken."""
    scene = PreparedScene(load_job(photo.folder), Reporter())

    def error(camera):
        if not light:
            return np.nan
        found = estimate(with_camera(scene, camera), library, choose("draft"), material=photo.material)
        return order2(found.lighting.coefficients, photo.truth(2))

    best, out = error(scene.job.camera), []
    for pixels, degrees in starts:
        seed = [*photo.folder.name.encode(), pixels]
        camera = disturbed(scene, pixels, degrees, np.random.default_rng(seed))
        moved = with_camera(scene, camera)
        (seconds, _), found = timed(lambda moved=moved: align(moved))
        row = {"start": f"{pixels} px, {degrees}°", "light": photo.light, "photo": photo.folder.name, "true": best}
        row |= dict(zip(("from_px", "from_degrees"), off(scene, camera), strict=True))
        row |= dict(zip(("rest_px", "rest_degrees"), off(scene, found.camera), strict=True))
        before = error(camera) if pixels or degrees else best
        row |= {"before": before, "after": error(found.camera) if found.aligned else before}
        row |= {"aligned": found.aligned, "why": found.why, "seconds": seconds, "mended": mends(moved, found)}
        out.append(row)
    return out


HEADS = (
    "off by", "photos", "start, px", "rest, px", "start, degrees", "rest, degrees", "moved", "farther", "error before",
    "after", "worse", "estimate mends", "then worse", "seconds",
)  # fmt: skip


def lines(rows):
    """A line for each start."""

    def most(values):
        return np.percentile(values, 90)

    for name, some in tables.groups(rows, "start", every=None):
        of = {
            key: np.array([r[key] for r in some], float)
            for key in some[0]
            if key not in ("start", "light", "photo", "why")
        }
        worse = of["after"] > np.maximum(of["before"] + WORSE[0], of["before"] * (1 + WORSE[1]))
        yield (
            name,
            len(some),
            tables.spread(of["from_px"], "{:.1f}", far=most),
            tables.spread(of["rest_px"], "{:.1f}", far=most),
            f"{np.median(of['from_degrees']):.1f}",
            f"{np.median(of['rest_degrees']):.1f}",
            tables.percent(of["aligned"]),
            tables.percent(of["rest_px"] > of["from_px"]),
            tables.spread(of["before"] / of["true"], far=most),
            tables.spread(of["after"] / of["true"], far=most),
            tables.percent(worse),
            tables.percent(of["mended"]),
            tables.percent(worse * of["mended"]),
            f"{np.median(of['seconds']):.1f}",
        )


def main(arguments) -> int:
    options = parser("alignment", __doc__)
    options.add_argument("photos", type=Path)
    options.add_argument("--lights", nargs="+", help="some of the lights")
    options.add_argument("--every", type=int, default=1, help="only every so many of the photographs")
    options.add_argument("--pose", action="store_true", help="without the errors of the light")
    options.add_argument("--starts", nargs="+", type=int, default=list(range(len(STARTS))), help="some of the starts")
    options.add_argument("--work", type=Path, help="folder for each photo's numbers: what is there is not done again")
    given = options.parse_args(arguments)
    library, rows = open_library(None), []
    for photo in tqdm(photos.photographs_in(given.photos, lights=given.lights)[:: given.every]):
        kept = given.work / f"{photo.folder.name}.json" if given.work else None
        if kept is None or not kept.exists():
            some = study(photo, library, starts=[STARTS[i] for i in given.starts], light=not given.pose)
            if kept is not None:
                atomic.write_text(kept, json.dumps(some))
        rows += json.loads(kept.read_text()) if kept else some
    print(tables.table(HEADS, lines(rows)))
    return 0
