# SPDX-License-Identifier: GPL-3.0-or-later
"""What a photo without colours costs: whole estimates of photographs by Cycles, in colours and black and white.

scripts/study black-and-white PHOTOS [--objects vase suzanne]       jobs, as `scripts/study photos` leaves them

The right material is given. "Taken for colours": the black-and-white photo with red brighter by a fiftieth, which makes
it one in colours. Its light, and that of the black-and-white photo, are compared with the luminance of the true one.
Errors are up to order 2, with one free scale; "coloured" is how far apart the light's mean channels are, over the
mean.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
from tqdm import tqdm

from btfsep_engine.conventions import grey
from btfsep_engine.job.load import load_job
from scripts.studies import parser, photos, tables
from scripts.studies.estimates import estimated, scene_of, worth

AS_COLOURS = (1.02, 1.0, 1.0)
COLUMNS = (("photographs", len), *tables.OF_LIGHT, ("coloured", tables.spread_of("coloured")))


def ways_of(photo, truth) -> dict:
    """{way: (radiance, true coefficients)} of a photo (h, w, 3)."""
    alone = grey(photo)
    return {
        "in colours": (photo, truth),
        "black and white": (alone, grey(truth)),
        "taken for colours": (alone * np.float32(AS_COLOURS), grey(truth)),
    }


def rows_of(shot) -> list[dict]:
    """What each way finds of a photograph."""
    job, rows = load_job(shot.folder), []
    for way, (radiance, truth) in ways_of(job.photo.radiance, shot.truth(4)).items():
        found = estimated(scene_of(replace(job, photo=replace(job.photo, radiance=radiance))), shot.material)
        row, mean = worth(found, truth), found.fit.coefficients[0]
        rows.append(row | {"way": way, "over": row["order2"] / row["stated2"], "coloured": np.ptp(mean) / mean.mean()})
    return rows


def main(arguments) -> int:
    options = parser("black-and-white", __doc__)
    options.add_argument("photos", type=Path)
    options.add_argument("--objects", nargs="+", help="some of the objects")
    given = options.parse_args(arguments)
    some = [p for p in photos.photographs_in(given.photos, objects=given.objects) if p.material != photos.WHITE]
    rows = [row for shot in tqdm(some) for row in rows_of(shot)]
    print(tables.summary("photo", COLUMNS, tables.groups(rows, "way", every=None)))
    return 0
