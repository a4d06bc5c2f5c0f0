# SPDX-License-Identifier: GPL-3.0-or-later
"""What a table under the object does to an estimate, on photographs by Cycles.

scripts/study surroundings FOLDER --make     photographs it, once
scripts/study surroundings FOLDER

Objects alone and on matte tables, under lights with which nothing was tuned; the object's material is given. Each photo
on a table is estimated five times: the job as it was exported (the table's surface known), without the table's surface
(not known), with a black table, with that of a stand-in that nobody gave a material (Blender's own), and without any.
Prints a table: medians and the worst in brackets; "over alone" is the error over that of the same object under the same
light without a table, "stated" the error that is expected of itself, 95 % range the share of the true coefficients up
to order 2 in the stated range.
"""

from dataclasses import replace
from itertools import product
from pathlib import Path

from tqdm import tqdm

from btfsep_engine.btf.surfaces import Surface
from btfsep_engine.job.load import load_job
from btfsep_engine.storage.atomic import write_json
from scripts.studies import parser, photos, tables
from scripts.studies.estimates import estimated, worth
from scripts.studies.measures import timed

SETS = {  # objects, lights
    "first": ((("suzanne", "white"), ("blob", "leather/brown-grain")), ("city", "sunset")),
    "second": ((("pebble", "white"), ("cushion", "leather/brown-grain")), ("courtyard", "interior", "sunrise")),
}
EDGE = 8.0  # of the table, in the object's radii


def table(*colour: float, checks: int = 0) -> dict:
    """A table of a shot: its colour, three numbers or one, and how many checks it has a side."""
    return {"edge": EDGE, "colour": list(colour) if len(colour) > 1 else 3 * list(colour), "checks": checks}


TABLES = {
    "alone": None,
    "0.05": table(0.05),
    "0.3": table(0.3),
    "0.8": table(0.8),
    "orange": table(0.8, 0.25, 0.05),
    "teal": table(0.08, 0.35, 0.35),
    "textured": table(0.8, 0.7, 0.5, checks=16),
}
KNOWN, UNKNOWN, DARK, STAND_IN, GONE = "known", "not known", "black", "stand-in", "left out"
WRONG = {DARK: Surface((0.0,) * 3, roughness=1.0, specular=0.0), STAND_IN: Surface()}  # Blender's own white one
WAYS = KNOWN, UNKNOWN, *WRONG, GONE


def make(folder: Path, which: str) -> None:
    """Photographs all of a set, a folder for each table; what is there stays."""
    every = product(*SETS[which], TABLES.items())
    shots = [photos.shot(folder / kind, *thing, light, table=top) for thing, light, (kind, top) in every]
    photos.take(shots, resolution=192, samples=64)


def as_told(job, way: str):
    """The job with its table as known, not known, of a surface that it has not, or left out."""
    if way == GONE:
        return replace(job, occluders=())
    if way == KNOWN:
        return job
    return replace(job, occluders=tuple(replace(o, surface=WRONG.get(way)) for o in job.occluders))


def study(photo, kind: str, way: str) -> dict:
    """One estimate."""
    job = as_told(load_job(photo.folder), way)
    seconds, found = timed(lambda: estimated(job, photo.material))
    row = {"object": photo.object, "light": photo.light, "table": kind, "way": way if kind != "alone" else "–"}
    return row | {"seconds": seconds[1], "choice": found.choice} | worth(found, photo.truth(9))


COLUMNS = (
    ("error", tables.spread_of("order2")),
    ("over alone", tables.spread_of("order2", over="alone")),
    ("direction", tables.spread_of("direction", "{:.1f}°")),
    ("stated", tables.median_of("stated2")),
    ("68 %", tables.percent_of("within68")),
    ("95 % range", tables.percent_of("inside")),
    ("processor seconds", tables.median_of("seconds", "{:.1f}")),
)


def main(arguments) -> int:
    options = parser("surroundings", __doc__)
    options.add_argument("folder", type=Path)
    options.add_argument("--make", action="store_true", help="photograph what the study is made of")
    options.add_argument("--set", choices=list(SETS), default="first", help="that is photographed")
    options.add_argument("--ways", nargs="+", choices=WAYS, default=WAYS)
    options.add_argument("--tables", nargs="+", choices=list(TABLES), default=list(TABLES))
    options.add_argument("--numbers", type=Path, metavar="FILE", help="write all numbers, JSON")
    given = options.parse_args(arguments)
    if given.make:
        make(given.folder.resolve(), given.set)
        return 0
    todo = [(p, k, w) for k in given.tables for p in photos.photographs_in(given.folder / k) for w in given.ways]
    rows = [study(*each) for each in tqdm([(p, k, w) for p, k, w in todo if k != "alone" or w == given.ways[0]])]
    alone = {(r["object"], r["light"]): r["order2"] for r in rows if r["table"] == "alone"}
    rows = [r | {"alone": alone[r["object"], r["light"]]} for r in rows]
    if given.numbers:
        write_json(given.numbers, rows)
    print(tables.summary(("table", "way"), COLUMNS, tables.groups(rows, ("table", "way"), every=None)))
    return 0
