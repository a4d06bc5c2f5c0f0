# SPDX-License-Identifier: GPL-3.0-or-later
"""What an estimate is worth that knows a depth in place of the meshes, on photographs by Cycles.

scripts/study depth PHOTOS [--all] [--only VARIANT …]

PHOTOS: jobs OBJECT_MATERIAL_LIGHT, as scripts/study photos leaves them. For each, whole estimates (preset balanced, the
right material given) with the mesh, with its depth as the engine's own camera sees it, and with worse depths: coarse
numbers, noise, holes. Errors are relative, with one free scale, against the true map's coefficients; "expected" is what
the estimate states; 95 % says how many of the 27 coefficients up to order 2 lie within 1.96 stated standard deviations,
"95 % range" how many in the stated range. Prints a table: medians, and the worst in brackets. Without --all, white and
leather.
"""

import json
import tempfile
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
from scipy.ndimage import binary_dilation
from tqdm import tqdm

from btfsep_engine.imaging import images
from btfsep_engine.job.load import load_job
from scripts.studies import parser, photos, tables
from scripts.studies.estimates import estimated, scene_of, worth

SOME = ("white", "leather-brown-grain")


def coarse(z, rng):
    """Depths as one of 256 numbers between the nearest and the farthest."""
    low, step = z[z > 0].min(), np.ptp(z[z > 0]) / 255
    return np.where(z > 0, low + np.round((z - low) / step) * step, 0)


def noisy(share):
    """Gaussian noise, independent from pixel to pixel, of ``share`` of the depth."""
    return lambda z, rng: z * (1 + share * rng.standard_normal(z.shape))


def holes(z, rng):
    """One pixel in fifty missing, and six discs, each a fifteenth of the object wide."""
    seen = z > 0
    gone = rng.random(z.shape) < 0.02
    rows, columns = np.nonzero(seen)
    y, x = np.mgrid[: z.shape[0], : z.shape[1]]
    for i in rng.choice(len(rows), 6, replace=False):
        gone |= (y - rows[i]) ** 2 + (x - columns[i]) ** 2 < (np.sqrt(seen.sum()) / 30) ** 2
    return np.where(gone, 0, z)


def frayed(z, rng):
    """The outline eaten away by up to eight pixels, here more and there less, as where a sensor grazes the surface."""
    lost = rng.random((z.shape[0] // 16 + 1, z.shape[1] // 16 + 1)) * 9
    lost = np.kron(lost, np.ones((16, 16)))[: z.shape[0], : z.shape[1]]
    near, out = z == 0, z.copy()
    for step in range(8):
        near = binary_dilation(near)
        out[near & (lost > step + 1)] = 0
    return out


VARIANTS = {  # what is done to the depth; None: no depth
    "mesh": None,
    "depth": lambda z, rng: z,
    "depth, one side only": lambda z, rng: z,
    "half floats": lambda z, rng: z.astype(np.float16),
    "8 bits": coarse,
    "noise 0.03 %": noisy(0.0003),
    "noise 0.1 %": noisy(0.001),
    "noise 0.3 %": noisy(0.003),
    "holes": holes,
    "frayed outline": frayed,
}
OPEN = "depth, one side only"


def z_depth(scene):
    """(h, w) z-depth of what the scene's camera sees, 0 where nothing is."""
    camera = scene.job.camera
    rows, columns = np.mgrid[: camera.height, : camera.width]
    _, directions = camera.rays(columns.ravel() + 0.5, rows.ravel() + 0.5)
    along = (directions @ -camera.to_world[:3, 2]).reshape(rows.shape)
    return np.where(scene.view.mesh >= 0, scene.view.distance * along, 0)


def with_depth(folder: Path, depth, out: Path):
    """The job of ``folder`` with a depth for its meshes, written to ``out`` and read again."""
    told = json.loads((folder / "job.json").read_text())
    images.write_exr(out / "depth.exr", depth)
    photo = out / f"photo{Path(told['image']).suffix}"
    photo.write_bytes((folder / told["image"]).read_bytes())
    (out / "job.json").write_text(json.dumps(told | {"image": photo.name, "objects": [], "depth": "depth.exr"}))
    return load_job(out)


def study(photo, name: str) -> dict:
    """One variant of one photograph."""
    job = load_job(photo.folder)
    with tempfile.TemporaryDirectory() as scratch:
        if VARIANTS[name] is not None:
            depth = VARIANTS[name](z_depth(scene_of(job)), np.random.default_rng(7))
            job = with_depth(photo.folder, depth, Path(scratch))
        if name == OPEN:  # one side is all there is
            job = replace(job, objects=tuple(replace(o, unseen=None) for o in job.objects))
        scene = scene_of(job)
        found = estimated(scene, photo.material)
    warnings = "; ".join(scene.reporter.warnings)
    row = {"job": photo.folder.name, "material": photo.shown, "variant": name, "residual": found.fit.residual}
    row |= {"warned": bool(warnings), "not aligned": "line up" in warnings}
    return row | worth(found, photo.truth(9))


COLUMNS = (
    ("order 1", tables.spread_of("order1")),
    ("order 2", tables.spread_of("order2")),
    ("expected", tables.median_of("stated2")),
    ("over expected", tables.spread_of("order2", over="stated2")),
    ("95 %", tables.percent_of("within95")),
    ("95 % range", tables.percent_of("inside")),
    ("residual", tables.median_of("residual")),
    ("warned", tables.percent_of("warned")),
    ("not aligned", tables.percent_of("not aligned")),
)


def main(arguments) -> int:
    options = parser("depth", __doc__)
    options.add_argument("photos", type=Path)
    options.add_argument("--all", action="store_true", help="all materials")
    options.add_argument("--only", nargs="+", choices=list(VARIANTS), default=list(VARIANTS), metavar="VARIANT")
    options.add_argument("--objects", nargs="+", help="some of the objects")
    given = options.parse_args(arguments)
    shown = photos.photographs_in(given.photos, objects=given.objects, materials=None if given.all else SOME)
    rows = [study(photo, name) for photo, name in tqdm(list(product(shown, given.only)))]
    for title, some in tables.groups(rows, "material", every="all"):
        text = tables.summary("known", COLUMNS, tables.groups(some, "variant", every=None))
        print(f"\n### {title} ({len({r['job'] for r in some})} photos)\n\n{text}")
    return 0
