# SPDX-License-Identifier: GPL-3.0-or-later
"""How well a photograph that is shifted against its depth comes back by `btfsep align`, and what that is worth.

scripts/study alignment-depth PHOTOS --lights courtyard forest --every 4 [--depth holes]
scripts/study alignment-depth FOLDER    of jobs with a depth and a truth.json, as scripts/study real takes them

PHOTOS: jobs OBJECT_MATERIAL_LIGHT of meshes, as scripts/study photos leaves them, whose depth is cast by rays
(scripts/study depth has what is done to it). The photo is shifted against the depth in random directions (seeded), by
no whole pixels. Prints a table of how far it was off:

    rest             how far the photo is off after, pixels: median (90 %)
    moved, farther   photos in which the command moved anything, and in which that was away from the true place
    error before,    of the light up to order 2 (relative, one free scale) over that in the true place, by an estimate
      after          of preset draft with the right material that moves nothing itself: median (90 %)
    worse            photos whose error is larger after than before by more than a hundredth and a twentieth of it
    doubted          photos in which the estimate's own doubt speaks
    estimate mends,  photos that an estimate with --align auto moves; those of them that get worse
      then worse
    seconds          of the processor, of the alignment, reading and geometry left out: median
"""

import json
import tempfile
from pathlib import Path

import numpy as np
from tqdm import tqdm

from btfsep_engine import atomic
from btfsep_engine.btf.library import open_library
from btfsep_engine.job.load import load_job
from btfsep_engine.pipeline.alignment import align, with_camera
from btfsep_engine.pipeline.checks import shift_doubt
from btfsep_engine.pipeline.estimation import estimate
from btfsep_engine.pipeline.mending import mends
from btfsep_engine.pipeline.scene import PreparedScene, unseen_meshes
from btfsep_engine.pipeline.settings import choose
from btfsep_engine.progress import Reporter
from scripts.studies import parser, photos, tables
from scripts.studies.alignment import WORSE
from scripts.studies.depth import VARIANTS, with_depth, z_depth
from scripts.studies.measures import order2, timed
from scripts.studies.real import true_light

PIXELS = (0, 1, 2, 4, 8, 16)


def scene_of(folder: Path, variant: str) -> PreparedScene:
    """A job's scene, of a depth where it has meshes."""
    scene = PreparedScene(load_job(folder), Reporter())
    if unseen_meshes(scene.job):
        return scene
    with tempfile.TemporaryDirectory() as scratch:
        depth = VARIANTS[variant](z_depth(scene), np.random.default_rng(7))
        return PreparedScene(with_depth(folder, depth, Path(scratch)), Reporter())


def study(scene: PreparedScene, name: str, library, *, truth, material, pixels, light: bool) -> list[dict]:
    """One photograph, a dict for each of ``pixels``; ``light`` : whether errors of the light are taken."""
    camera = scene.job.camera

    def error(seen):
        if not light:
            return np.nan
        found = estimate(with_camera(scene, seen), library, choose("draft", align="never"), material=material)
        return order2(found.lighting.coefficients, truth)

    def off(seen):
        return float(np.hypot(seen.cx - camera.cx, seen.cy - camera.cy))

    best, out = error(camera), []
    for far in pixels:
        angle = np.random.default_rng([*name.encode(), far]).uniform(0, 2 * np.pi)
        start = camera.shifted(far * np.cos(angle), far * np.sin(angle))
        moved = with_camera(scene, start)
        (_, seconds), found = timed(lambda moved=moved: align(moved))
        before = error(start) if far else best
        row = {"off": far, "photo": name, "from": off(start), "rest": off(found.camera), "true": best}
        row |= {"before": before, "after": error(found.camera) if found.aligned else before, "seconds": seconds}
        row |= {"aligned": found.aligned, "why": found.why, "gain": found.gain and vars(found.gain)}
        out.append(row | {"doubted": shift_doubt(moved) is not None, "mended": mends(moved, found)})
    return out


HEADS = (
    "off by", "photos", "rest, px", "moved", "farther", "error before", "after", "worse", "doubted", "estimate mends",
    "then worse", "seconds",
)  # fmt: skip


def lines(rows):
    """A line for each distance."""

    def most(values):
        return np.percentile(values, 90)

    for far, some in tables.groups(rows, "off", every=None):
        of = {key: np.array([r[key] for r in some], float) for key in some[0] if key not in ("photo", "why", "gain")}
        worse = of["after"] > np.maximum(of["before"] + WORSE[0], of["before"] * (1 + WORSE[1]))
        yield (
            f"{far} px",
            len(some),
            tables.spread(of["rest"], far=most),
            tables.percent(of["aligned"]),
            tables.percent(of["rest"] > of["from"]),
            tables.spread(of["before"] / of["true"], far=most),
            tables.spread(of["after"] / of["true"], far=most),
            *(tables.percent(v) for v in (worse, of["doubted"], of["mended"], worse * of["mended"])),
            f"{np.median(of['seconds']):.1f}",
        )


def main(arguments) -> int:
    options = parser("alignment-depth", __doc__)
    options.add_argument("folder", type=Path)
    options.add_argument("--lights", nargs="+", help="some of the lights")
    options.add_argument("--every", type=int, default=1, help="only every so many of the photographs")
    options.add_argument("--depth", choices=[k for k, v in VARIANTS.items() if v], default="depth", metavar="VARIANT")
    options.add_argument("--place", action="store_true", help="without the errors of the light")
    options.add_argument("--pixels", nargs="+", type=int, default=PIXELS)
    options.add_argument("--work", type=Path, help="folder for each photo's numbers: what is there is not done again")
    given = options.parse_args(arguments)
    library, rows = open_library(None), []
    real = sorted(p.parent for p in given.folder.glob("*/truth.json"))
    todo = [
        (folder, true_light(folder), None) for folder in real if json.loads((folder / "job.json").read_text())["depth"]
    ]
    if not real:
        every = photos.photographs_in(given.folder, lights=given.lights)
        todo = [(photo.folder, photo.truth(2), photo.material) for photo in every]
    for folder, truth, material in tqdm(todo[:: given.every]):
        kept = given.work / f"{folder.name}.json" if given.work else None
        if kept is None or not kept.exists():
            told = {"truth": truth, "material": material, "pixels": given.pixels, "light": not given.place}
            some = study(scene_of(folder, given.depth), folder.name, library, **told)
            if kept is not None:
                atomic.write_text(kept, json.dumps(some))
        rows += json.loads(kept.read_text()) if kept else some
    print(tables.table(HEADS, lines(rows)))
    return 0
