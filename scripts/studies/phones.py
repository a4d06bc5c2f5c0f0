# SPDX-License-Identifier: GPL-3.0-or-later
"""Photographs as phones save them: plates whose tones were moved place by place, read as a camera's and as a phone's.

scripts/study plates FOLDER --make --sets ninth        takes the plates, once
scripts/study phones FOLDER --sets ninth
scripts/study phones FOLDER --sets ninth --show 20 25 --to docs/images/phones.jpg     pictures of some

What phones do is not published, and no phone took these. Tones are left as they are, or moved in one of two ways that
are: two exposures of the same picture, two stops apart, fused (Mertens et al. 2007, as Hasinoff et al. 2016 have it),
or the large contrasts pressed together to 0.6 of what they were, as logarithms, by a bilateral filter (Durand and
Dorsey 2002). Neither is what the engine undoes. Then comes the measured curve of the one phone of `cameras.MEASURED`,
and a JPEG. The camera is in line.
"""

import itertools
import json
from pathlib import Path

import cv2
import numpy as np
from scipy.stats import gmean
from tqdm import tqdm

from btfsep_engine.conventions import REC709_LUMINANCE
from btfsep_engine.imaging.images import read_linear
from btfsep_engine.imaging.srgb import linear_to_srgb, srgb_to_linear
from btfsep_engine.job.load import load_job
from btfsep_engine.storage.atomic import write_json
from scripts.cycles.figure import write_rows
from scripts.studies import parser, tables
from scripts.studies.cameras import AT, BRIGHT, save_jpeg
from scripts.studies.plate_sets import SETS, of_set
from scripts.studies.plates import COLUMNS, judged

PHONE, READ = "Nokia", ("camera", "phone")
STOPS, PRESSED, EDGE, REACH = 2, 0.6, 1.3, 0.06  # of light; of a contrast; of light; of the picture's width
DARKEST = 1e-4  # of white


def fused(linear) -> np.ndarray:
    """A picture (h, w, 3), 1: white, as two exposures of its brightest channels, fused."""
    brightest = np.maximum(linear.max(-1), DARKEST)
    codes = [linear_to_srgb(np.clip(brightest * 2.0**stops, 0, 1)) for stops in (0, STOPS)]
    each = [np.repeat(np.round(255 * c).astype(np.uint8)[..., None], 3, -1) for c in codes]
    out = cv2.createMergeMertens(0.0, 0.0, 1.0).process(each)[..., 0]
    return linear * (srgb_to_linear(np.clip(out, 0, 1)) / brightest)[..., None]


def pressed(linear) -> np.ndarray:
    """A picture (h, w, 3) with its large contrasts pressed together and its details kept."""
    log = np.log2(np.maximum(linear @ REC709_LUMINANCE, DARKEST)).astype(np.float32)
    large = cv2.bilateralFilter(log, -1, EDGE, REACH * linear.shape[1])
    return linear * np.exp2((PRESSED - 1) * (large - np.percentile(large, BRIGHT)))[..., None]


AS_CAMERA = "as a camera's"
GAIN = ((f"over {AS_CAMERA}", tables.spread_of("order2", over=AS_CAMERA, middle=gmean)),)
WAYS = {"left as they are": np.asarray, "exposures fused": fused, "contrast pressed": pressed}


def take(plate, folder: Path, way: str) -> Path:
    """The job folder of a plate whose tones were moved in one way; what is there already stays."""
    source, out = folder / plate["name"] / "in line", folder / plate["name"] / way
    if (out / "job.json").exists():
        return out
    out.mkdir(exist_ok=True)
    linear = read_linear(folder / plate["name"] / "linear.exr").pixels.astype(np.float64)
    moved = WAYS[way](linear * (AT / np.percentile(linear.max(-1), BRIGHT)))
    save_jpeg(out / "photo.jpg", moved, PHONE, bright=np.percentile(moved.max(-1), BRIGHT))
    for mesh in source.glob("*.ply"):
        (out / mesh.name).write_bytes(mesh.read_bytes())
    told = json.loads((source / "job.json").read_text()) | {"image": "photo.jpg", "image_colorspace": "camera"}
    (out / "job.json").write_text(json.dumps(told))
    return out


def main(arguments) -> int:
    options = parser("phones", __doc__)
    options.add_argument("folder", type=Path)
    options.add_argument("--sets", nargs="+", choices=list(SETS), default=["ninth"])
    options.add_argument("--numbers", type=Path, metavar="FILE", help="write all numbers, JSON")
    options.add_argument(
        "--show", nargs="+", metavar="NAME", default=[], help="draw these plates, tones moved each way"
    )
    options.add_argument("--to", type=Path, metavar="FILE", help="the picture of --show")
    given = options.parse_args(arguments)
    plates = [(plate, given.folder.resolve() / name) for name in given.sets for plate in of_set(name)]
    if given.show:
        rows = [[(cv2.imread(str(take(*each, way) / "photo.jpg"))[..., ::-1] / 255, "") for way in WAYS]
                for each in plates if each[0]["name"] in given.show]  # fmt: skip
        write_rows(given.to, rows, titles=tuple(WAYS))
        return 0
    todo, rows = list(itertools.product(plates, WAYS)), []
    for each, way in tqdm(todo):
        told = {"moved": way, "set": each[1].name}
        both = [judged(each[0], load_job(take(*each, way), colorspace=read)) for read in READ]
        rows += [told | {"read": f"as a {read}'s", AS_CAMERA: both[0]["order2"]} | row
                 for read, row in zip(READ, both, strict=True)]  # fmt: skip
    if given.numbers:
        write_json(given.numbers, rows)
    print(tables.summary(("tones", "read"), (*COLUMNS, *GAIN), groups(rows)))
    return 0


def groups(rows):
    """Tones moved in each way, read in each."""
    for way, read in itertools.product(WAYS, READ):
        some = [r for r in rows if (r["moved"], r["read"]) == (way, f"as a {read}'s")]
        if some:
            yield (way, f"**as a {read}'s**"), some
