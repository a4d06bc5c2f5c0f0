# SPDX-License-Identifier: GPL-3.0-or-later
"""Photographs as cameras save them: plates coded by the measured curves of eight cameras, read in several ways.

scripts/study plates FOLDER --make --sets third        takes the plates, once
scripts/study cameras FOLDER

The camera is in line and every plate is a JPEG, by the curve of one camera, exposed so that its bright parts are nearly
white. Each is estimated from what was before the curve (*floats*), as sRGB, as a camera's, and with the curve unknown;
and, coded by sRGB alone, as sRGB, as a camera's (which is wrong then), and with the curve unknown.
"""

import itertools
import json
from pathlib import Path

import cv2
import numpy as np
from scipy.interpolate import PchipInterpolator
from tqdm import tqdm

from btfsep_engine.imaging.images import read_linear, write_exr
from btfsep_engine.imaging.srgb import linear_to_srgb
from btfsep_engine.job.load import load_job
from btfsep_engine.storage.atomic import write_json
from scripts.studies import parser, tables
from scripts.studies.plate_sets import SETS, of_set
from scripts.studies.plates import COLUMNS, judged

# linear light and what is displayed of it, linear, 1: white; points of the base curves that darktable publishes
MEASURED = {
    "Nikon D7200": ((0.0074, 0.0052), (0.0173, 0.0172), (0.048, 0.0865), (0.1095, 0.2735), (0.2317, 0.5975),
                    (0.3838, 0.8058), (0.5498, 0.9183)),
    "Canon EOS 6D": ((0.006, 0.0044), (0.0203, 0.0217), (0.0481, 0.0859), (0.0939, 0.2338), (0.1623, 0.4314),
                     (0.2577, 0.6292), (0.3847, 0.8003), (0.5477, 0.9178), (0.7513, 0.9881)),
    "Sony RX100 II": ((0.0151, 0.0081), (0.0701, 0.0937), (0.1915, 0.3411), (0.3054, 0.5372), (0.5096, 0.778),
                      (0.6768, 0.8988)),
    "Fujifilm X100S": ((0.0091, 0.0079), (0.0266, 0.0322), (0.1315, 0.2897), (0.351, 0.6969), (0.615, 0.9595)),
    "Canon EOS 5D II": ((0.0066, 0.0035), (0.0273, 0.0298), (0.0459, 0.0702), (0.2066, 0.5399), (0.4423, 0.8724),
                        (0.6733, 0.9717)),
    "Pentax K-5": ((0.0095, 0.0042), (0.0319, 0.0204), (0.06, 0.0524), (0.1366, 0.1906), (0.2289, 0.3484),
                   (0.3553, 0.5135), (0.5671, 0.7328), (0.7604, 0.8818)),
    "Olympus E-M": ((0.0121, 0.0103), (0.0726, 0.1677), (0.3105, 0.7113), (0.6451, 0.9569)),
    "Nokia": ((0.0418, 0.0202), (0.1179, 0.1532), (0.3194, 0.5), (0.6388, 0.8427)),
}  # fmt: skip
AT, BRIGHT, JPEG = 0.8, 98, 92  # displayed, linear: where this percentile of the brightest channels goes; quality
AS_STORED, BY_CAMERA, SRGB, FLOATS = "as stored", "by a camera", "by sRGB alone", "as floats"
READ = {AS_STORED: None, "as sRGB": "srgb", "as a camera's": "camera", "unknown": "unknown"}


def response(name: str):
    """What a camera displays, linear, of radiance up to 1: a callable of arrays of any shape."""
    radiance, shown = np.array([(0, 0), *MEASURED[name], (1, 1)]).T
    return PchipInterpolator(radiance, shown)


def save_jpeg(path: Path, linear, coded: str, *, bright: float) -> None:
    """Saves a picture (h, w, 3), linear, as a camera of `MEASURED` does, or by `SRGB`; ``bright`` is nearly white."""
    shown, radiance = response(coded) if coded in MEASURED else (lambda r: r), np.linspace(0, 1, 4097)
    exposure = np.interp(AT, shown(radiance), radiance) / bright
    codes = np.round(255 * linear_to_srgb(shown(np.clip(exposure * linear, 0, 1)))).astype(np.uint8)
    cv2.imwrite(str(path), codes[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, JPEG])


def take(plate, folder: Path, coded: str) -> Path:
    """The job folder of a plate, coded by a camera's curve, by `SRGB`, or as `FLOATS`; what is there already stays."""
    source, out = folder / plate["name"] / "in line", folder / plate["name"] / coded
    if (out / "job.json").exists():
        return out
    out.mkdir(exist_ok=True)
    linear, photo = read_linear(folder / plate["name"] / "linear.exr").pixels, "photo.jpg"
    if coded == FLOATS:
        photo = "photo.exr"
        write_exr(out / photo, linear)
    else:
        save_jpeg(out / photo, linear, coded, bright=np.percentile(linear.max(-1), BRIGHT))
    for mesh in source.glob("*.ply"):
        (out / mesh.name).write_bytes(mesh.read_bytes())
    told = json.loads((source / "job.json").read_text()) | {"image": photo, "image_colorspace": "auto"}
    (out / "job.json").write_text(json.dumps(told))
    return out


def study(plate, folder: Path, coded: str, way: str) -> dict:
    """One estimate."""
    row = {"coded": BY_CAMERA if coded in MEASURED else coded, "camera": coded, "read": way}
    return row | judged(plate, load_job(take(plate, folder, coded), colorspace=READ[way]))


def main(arguments) -> int:
    options = parser("cameras", __doc__)
    options.add_argument("folder", type=Path)
    options.add_argument("--set", choices=list(SETS), default="third")
    options.add_argument("--numbers", type=Path, metavar="FILE", help="write all numbers, JSON")
    given = options.parse_args(arguments)
    folder, rows = given.folder.resolve() / given.set, []
    for plate, camera in tqdm(list(zip(of_set(given.set), itertools.cycle(MEASURED)))):
        rows.append(study(plate, folder, FLOATS, AS_STORED))
        rows += [study(plate, folder, coded, way) for coded in (camera, SRGB) for way in READ if way != AS_STORED]
    if given.numbers:
        write_json(given.numbers, rows)
    print(tables.summary(("saved", "read"), COLUMNS, groups(rows)))
    return 0


def groups(rows):
    """Each way of saving, read in each way; then each camera's."""
    for coded in (FLOATS, BY_CAMERA, SRGB):
        for way in READ:
            some = [r for r in rows if (r["coded"], r["read"]) == (coded, way)]
            if some:
                yield (coded, f"**{way}**"), some
    for camera, way in itertools.product(MEASURED, ("as sRGB", "as a camera's")):
        yield (camera, way), [r for r in rows if (r["camera"], r["read"]) == (camera, way)]
