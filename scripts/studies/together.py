# SPDX-License-Identifier: GPL-3.0-or-later
"""Several photographs of one light, solved together: what that is worth beside each alone.

scripts/study together FOLDER [--most 3] [--only GLOB] [--numbers FILE]

FOLDER: jobs OBJECT_MATERIAL_LIGHT as scripts/study photos leaves them, or jobs of real photographs OBJECT_LIGHT with a
`truth.json`, as of scripts/study real. Those of other objects under one light are joined, two and more at a time, each
photograph with the next ones in the folder; whole estimates, preset balanced, the right material given. Prints medians
(and the worst) of

    alone      every photograph by itself, and of each group the better and the worse one
    together   as `btfsep estimate JOB --with JOB` has it
    alike      together, every object counting alike, whatever is left over in it

The error is up to order 2, with one free scale; *over stated* is the error over the one that the estimate expects.
"""

import fnmatch
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
from tqdm import tqdm

from btfsep_engine.errors import InputError
from btfsep_engine.job.load import load_job
from btfsep_engine.pipeline.estimation import REFINEMENTS, estimate
from btfsep_engine.pipeline.mending import mended
from btfsep_engine.pipeline.refine.each_object import each_object_by_itself
from btfsep_engine.pipeline.settings import choose
from btfsep_engine.storage.atomic import write_json
from scripts.studies import parser, photos, tables
from scripts.studies.estimates import library, scene_of, worth
from scripts.studies.measures import ERROR_ORDER
from scripts.studies.real import true_light

ALONE, TOGETHER, ALIKE = "alone", "together", "together, all alike"
BETTER, WORSE = "the better one", "the worse one"
SAME = 0.01  # of the largest coefficient: lights that differ by less are one


def photographs_of(folder: Path, only: str) -> list[dict]:
    """The photographs of a folder: name, light, object, true coefficients, and the job with its material."""
    out = []
    for path in sorted(p for p in folder.iterdir() if (p / "job.json").exists() and fnmatch.fnmatch(p.name, only)):
        thing, *shown, light = path.name.split("_")
        job = load_job(path)
        if shown:
            photograph = photos.Photograph(path, thing, *shown, light)
            truth, material = photograph.truth(ERROR_ORDER), photograph.material
            things = tuple(replace(o, material=material, name=f"{thing} {o.name}") for o in job.objects)
        else:
            truth, things = true_light(path), tuple(replace(o, name=f"{thing} {o.name}") for o in job.objects)
        out.append(
            {"name": path.name, "object": thing, "light": light, "truth": truth} | {"job": replace(job, objects=things)}
        )
    if not out:
        raise InputError(str(folder), f"it has no jobs '{only}'", "make them by scripts/study photos")
    return out


def joined(every: list[dict], most: int) -> list[tuple]:
    """Groups of two to ``most`` photographs of other objects under one light.

    Of many photographs under a light not all groups: those whose objects follow each other in the folder.
    """
    out = []
    for light in dict.fromkeys(p["light"] for p in every):
        some = [p for p in every if p["light"] == light]
        objects = list(dict.fromkeys(p["object"] for p in some))
        for count in range(2, most + 1):
            for things in combinations(objects, count):
                of_each = [[p for p in some if p["object"] == thing] for thing in things]
                # every photograph once, beside another material of the next object's
                turns = max(map(len, of_each))
                groups = [tuple(own[(turn + i) % len(own)] for i, own in enumerate(of_each)) for turn in range(turns)]
                out += [g for g in groups if all(_one_light(g[0]["truth"], p["truth"]) for p in g[1:])]
    return out


def _one_light(truth, other) -> bool:
    return bool(np.abs(truth - other).max() < SAME * np.abs(truth).max())


def solved(group, refinements=None) -> dict:
    """The row of one estimate."""
    settings = choose("balanced")
    first, *others = (mended(scene_of(p["job"]), settings) for p in group)
    found = estimate(first, library(), settings, others=others, refinements=refinements)
    row = {"photographs": [p["name"] for p in group], "count": len(group), "light": group[0]["light"]}
    row |= worth(found, group[0]["truth"], free_scale=True)
    return row | {"over": row["order2"] / row["stated2"], "chosen": found.choice.get("counts")}


def study(every: list[dict], most: int) -> list[dict]:
    """Rows of all ways."""
    groups = joined(every, most)
    used = list({p["name"]: p for group in groups for p in group}.values())
    alone = {p["name"]: solved([p]) | {"way": ALONE} for p in tqdm(used, desc=ALONE)}
    rows = list(alone.values())
    for group in tqdm(groups, desc=TOGETHER):
        each = sorted((alone[p["name"]] for p in group), key=lambda row: row["order2"])
        rows += [row | {"way": way, "count": len(group)} for way, row in ((BETTER, each[0]), (WORSE, each[-1]))]
        rows.append(solved(group) | {"way": TOGETHER, "best": each[0]["order2"]})
        alike = tuple(r for r in REFINEMENTS if r is not each_object_by_itself)
        rows.append(solved(group, alike) | {"way": ALIKE, "best": each[0]["order2"]})
    return rows


COLUMNS = (("estimates", len), *tables.OF_LIGHT)


def grouped(rows):
    """Each way, of every number of photographs; singles first."""
    for name, some in tables.groups(rows, "count", every=None):
        yield from (((str(name), way), own) for way, own in tables.groups(some, "way", every=None))


def main(arguments) -> int:
    options = parser("together", __doc__)
    options.add_argument("folder", type=Path)
    options.add_argument("--most", type=int, default=3, help="photographs that are joined at most")
    options.add_argument("--only", default="*", metavar="GLOB", help="some of the jobs")
    options.add_argument("--numbers", type=Path, metavar="FILE", help="write all numbers, JSON")
    given = options.parse_args(arguments)
    rows = study(photographs_of(given.folder.resolve(), given.only), given.most)
    if given.numbers:
        write_json(given.numbers, rows)
    print(tables.summary(("photographs", "way"), COLUMNS, grouped(rows)))
    return 0
