# SPDX-License-Identifier: GPL-3.0-or-later
"""What a table that is seen tells of the light, on photographs by Cycles: with its pixels as evidence, and without.

scripts/study ground FOLDER --make     photographs it, once
scripts/study ground FOLDER

The object's material is given; the table's colour is known to the job, or not. "Above" is the error of the light from
above the table's plane alone, the estimate's and the true one's: what comes from below, nothing in such a photo shows.
"Over without" is the error over that of the same job without its table's pixels. The set "tuned" is what constants of
the estimator were looked at on; other objects and tables, and the studio's light turned otherwise, are "new".
"""

from functools import cache
from itertools import cycle, product
from pathlib import Path

import numpy as np
from tqdm import tqdm

from btfsep_engine import sh
from btfsep_engine.conventions import fibonacci_sphere
from btfsep_engine.imaging.images import write_exr
from btfsep_engine.job.load import load_job
from btfsep_engine.light.lightings import turned
from btfsep_engine.light.maps import read_map
from btfsep_engine.storage.atomic import write_json
from scripts.cycles.lights import light_path, true_lighting
from scripts.studies import parser, photos, tables
from scripts.studies.estimates import estimated, worth
from scripts.studies.measures import order2, timed
from scripts.studies.surroundings import KNOWN, UNKNOWN, as_told, table

FILL = 0.55  # of the frame by the object: the rest is table
TABLES = {
    "grey": table(0.3),
    "orange": table(0.8, 0.25, 0.05),
    "checks": table(0.6, 0.5, 0.35, checks=24),
    "light": table(0.6),
    "teal": table(0.08, 0.35, 0.35),
    "dark": table(0.12, 0.1, 0.09),
    "tiles": table(0.8, 0.7, 0.5, checks=16),
}
SETS = {  # objects, lights (a name, and by how many degrees it is turned), tables by turns
    "tuned": (
        (("suzanne", "white"), ("vase", "leather/brown-grain")),
        ("studio", "studio-180", "courtyard", "night", "sunset"),
        ("grey", "orange", "checks"),
    ),
    "new": (
        (("blob", "fabric/denim-twill"), ("pebble", "white"), ("cushion", "wood/walnut-lacquered")),
        ("studio-090", "studio-270", "city", "interior", "sunrise", "forest-090"),
        ("light", "teal", "dark", "tiles"),
    ),
}
WITHOUT, WITH = "never", "all"
GROUPS = {"studio": "the studio's lamps", "tiles": "a table of two colours", "checks": "a table of two colours"}
_DIRECTIONS = fibonacci_sphere(8000)


def light_of(folder: Path, light: str) -> str:
    """A studio light's name, or the path of its map turned by as many degrees as its name ends in; made if need be."""
    name, _, degrees = light.partition("-")
    if not degrees:
        return light
    path = folder / "lights" / f"{light}.exr"
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        write_exr(path, turned(read_map(light_path(name)), -float(degrees)))
    return str(path)


def make(folder: Path, which) -> None:
    """Photographs all of it, a folder for each table; what is there stays."""
    for name in which:
        (objects, lights, tops), shots = SETS[name], []
        for (thing, light), kind in zip(product(objects, lights), cycle(tops), strict=False):
            told = {"table": TABLES[kind], "fill": FILL}
            shots.append(photos.shot(folder / name / kind, *thing, light_of(folder, light), **told))
        photos.take(shots, resolution=192, samples=64)


@cache
def _of_above(terms: int) -> np.ndarray:
    """(9, terms)."""
    y = sh.evaluate(sh.order_of(terms), _DIRECTIONS[_DIRECTIONS[:, 2] > 0])
    return y[:, :9].T @ y


def above(x) -> np.ndarray:
    """Order 2 of what of a light (terms, 3) comes from above the horizon: (9, 3)."""
    return _of_above(len(x)) @ x


def study(photo, folder: Path, kind: str, knows: str, evidence: str) -> dict:
    """One estimate."""
    job = as_told(load_job(photo.folder), knows)
    truth = true_lighting(light_of(folder, photo.light), 9)
    seconds, found = timed(lambda: estimated(job, photo.material, evidence=evidence))
    row = {"object": photo.object, "light": photo.light, "table": kind, "knows": knows, "evidence": evidence}
    row |= {"seconds": seconds[0], "choice": found.choice}
    row |= {"above": order2(above(found.fit.all_coefficients), above(truth))}
    row |= {"colour": [np.asarray(c) for c in found.scene.colours.values()]}
    return row | worth(found, truth)


COLUMNS = (
    ("error", tables.spread_of("order2")),
    ("over without", tables.spread_of("order2", over="without")),
    ("above", tables.spread_of("above")),
    ("over without", tables.spread_of("above", over="above without")),
    ("direction", tables.spread_of("direction", "{:.1f}°")),
    ("stated", tables.median_of("stated2")),
    ("95 % range", tables.percent_of("inside")),
    ("seconds", tables.median_of("seconds", "{:.1f}")),
)


def kinds_of(row) -> list[str]:
    """The groups of photographs that one is in."""
    by_light = GROUPS.get(row["light"].partition("-")[0], "other lights")
    return ["all", by_light, *([GROUPS[row["table"]]] if row["table"] in GROUPS else [])]


def groups(rows):
    """Of photographs and ways: (what stands before the figures, rows)."""
    for kind in dict.fromkeys(k for r in rows for k in kinds_of(r)):
        inside = [r for r in rows if kind in kinds_of(r)]
        for (knows, evidence), some in tables.groups(inside, ("knows", "evidence"), every=None):
            yield (f"{kind} ({len(some)})", knows, "evidence" if evidence == WITH else "–"), some


EACH = ("photograph", "error", "evidence", "above", "evidence", "stated", "evidence")


def each_photograph(rows):
    """A line for each photograph whose table is known."""
    for name, some in tables.groups(rows, ("object", "light", "table", "knows"), every=None):
        both = {r["evidence"]: r for r in some}
        pairs = [f"{both[e][key]:.2f}" for key in ("order2", "above", "stated2") for e in (WITHOUT, WITH)]
        yield " ".join(name), *pairs


def main(arguments) -> int:
    options = parser("ground", __doc__)
    options.add_argument("folder", type=Path)
    options.add_argument("--make", action="store_true", help="photograph what the study is made of")
    options.add_argument("--sets", nargs="+", choices=list(SETS), default=["new"])
    options.add_argument("--knows", nargs="+", choices=(KNOWN, UNKNOWN), default=(KNOWN, UNKNOWN))
    options.add_argument("--numbers", type=Path, metavar="FILE", help="write all numbers, JSON")
    given = options.parse_args(arguments)
    folder = given.folder.resolve()
    if given.make:
        make(folder, given.sets)
        return 0
    kinds = [path for name in given.sets for path in sorted((folder / name).glob("*"))]
    if not kinds:
        options.error(f"{folder} has no photographs of {' and '.join(given.sets)}; make them by --make")
    todo = [(p, k.name) for k in kinds for p in photos.photographs_in(k)]
    todo = list(product(todo, given.knows, (WITHOUT, WITH)))
    rows = [study(photo, folder, kind, *how) for (photo, kind), *how in tqdm(todo)]
    without = {(r["object"], r["light"], r["knows"]): r for r in rows if r["evidence"] == WITHOUT}
    for row in rows:
        same = without[row["object"], row["light"], row["knows"]]
        row |= {"without": same["order2"], "above without": same["above"]}
    if given.numbers:
        write_json(given.numbers, rows)
    print(tables.summary(("photographs", "table", "its pixels"), COLUMNS, groups(rows)), end="\n\n")
    print(tables.table(EACH, each_photograph(rows)))
    return 0
