# SPDX-License-Identifier: GPL-3.0-or-later
"""What it is worth to know a lamp's direction, and what it costs to be wrong about it.

scripts/study known-lamps PHOTOS [--lights NAME …] [--only GLOB]

PHOTOS: jobs OBJECT_MATERIAL_LIGHT of Blender's studio lights, as scripts/study photos and lamps leave them, or jobs of
real photographs with a `truth.json` that has `coefficients` (as of scripts/study real) and the lamps' `directions`; of
several lamps all are known. Whole estimates, preset balanced, the right material given. Prints a line for each light
(or kind of real job) and way:

    found        the lamp is found, or not, as without the word
    known        its direction is given, to 1 degree (of a studio light that of its brightest pixel)
    off by N°    a direction is given that is as far off, to a side drawn by chance
    order 1, 2   errors of all of the light, relative L2 with one free scale: median (worst)
    stated       of order 2: median; over stated: the error over it, median (worst)
    direction    of the main direction: median (worst)
    share        of the light that the known lamps have, over the true lamps' own: median
    doubted      photos in which something is said against a known lamp
"""

import fnmatch
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
from tqdm import tqdm

from btfsep_engine.conventions import across
from btfsep_engine.job.load import known_lamps, load_job
from btfsep_engine.pipeline.checks import known_lamp_doubts
from scripts.studies import parser, photos, tables
from scripts.studies.estimates import estimated, worth
from scripts.studies.lamps import truth_of
from scripts.studies.real import true_light

WAYS = {"found": None, "known": 0.0, "off by 3°": 3.0, "off by 5°": 5.0, "off by 10°": 10.0, "off by 30°": 30.0}


def turned(direction, degrees: float, random) -> np.ndarray:
    """A direction (3,) so far from another, to any side."""
    side, angle = random.uniform(0, 2 * np.pi), np.radians(degrees)
    return np.cos(angle) * direction + np.sin(angle) * ([np.cos(side), np.sin(side)] @ across(direction))


def beside_truth(folder: Path, light: str) -> dict:
    """Of a job the true coefficients, the lamps' directions and their share of all light; whether the scale is free."""
    beside = folder / "truth.json"
    if beside.exists() and "directions" in json.loads(beside.read_text()):
        directions = np.array(json.loads(beside.read_text())["directions"], np.float64)
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        return {"truth": true_light(folder), "directions": directions, "share": 1.0, "free_scale": True}
    truth, direction, share = truth_of(folder, light)
    return {"truth": truth, "directions": direction[None], "share": share, "free_scale": False}


def study(folder: Path, light: str, material):
    """A photograph's row for each way."""
    job, true, random = load_job(folder), beside_truth(folder, light), np.random.default_rng(len(folder.name))
    for way, degrees in WAYS.items():
        given = [] if degrees is None else [(turned(d, degrees, random), 1.0) for d in true["directions"]]
        found = estimated(replace(job, known_lamps=known_lamps(given, way)), material)
        shares = [lamp.share for lamp in found.fit.lamps if lamp.given]
        yield {
            "light": light,
            "way": way,
            "share": sum(shares) / true["share"],
            "doubted": bool(known_lamp_doubts(found)),
            **worth(found, true["truth"], free_scale=true["free_scale"]),
        }


def of_known(words):
    """A column that says nothing of lamps that are not known."""
    return lambda rows: "–" if rows[0]["way"] == "found" else words(rows)


COLUMNS = (
    ("photos", len),
    ("order 1", tables.spread_of("order1")),
    ("order 2", tables.spread_of("order2")),
    ("stated", tables.median_of("stated2")),
    ("over stated", tables.spread_of("order2", over="stated2")),
    ("direction", tables.spread_of("direction", "{:.1f}°")),
    ("share", of_known(tables.median_of("share"))),
    ("doubted", of_known(lambda rows: sum(r["doubted"] for r in rows))),
)


def jobs_in(folder: Path, lights, only: str) -> list:
    """(folder, light, material) of what is studied; of real photographs a kind, and the material is the job's."""
    real = [p for p in sorted(folder.glob("*")) if (p / "truth.json").exists() and p.name.count("_") == 1]
    some = [(p, f"{p.name.split('_')[0]}, {p.name.count('-') + 1} lamps", None) for p in real]
    some = some or [(p.folder, p.light, p.material) for p in photos.photographs_in(folder, lights=lights)]
    return [job for job in some if fnmatch.fnmatch(job[0].name, only)]


def main(arguments) -> int:
    options = parser("known-lamps", __doc__)
    options.add_argument("photos", type=Path)
    options.add_argument("--lights", nargs="+", help="some of the lights")
    options.add_argument("--only", default="*", metavar="GLOB", help="of the jobs' names")
    given = options.parse_args(arguments)
    rows = [row for job in tqdm(jobs_in(given.photos, given.lights, given.only)) for row in study(*job)]
    ways = [((light, way), r) for light, some in tables.groups(rows, "light")
            for way, r in tables.groups(some, "way", every=None)]  # fmt: skip
    print(tables.summary(("light", "direction"), COLUMNS, ways))
    return 0
