# SPDX-License-Identifier: GPL-3.0-or-later
"""Two objects in one photograph, of which one may be painted or mottled: what the light is worth.

scripts/study pairs FOLDER --make        takes 24 photographs by Cycles, once
scripts/study pairs FOLDER

Two things side by side, each of a plain surface that its job says as a user sees it by eye (`plate_things.by_eye`),
under Blender's studio lights, turned; the second is as it is told, or painted in pieces, or mottled, of which the job
has the mean. Ways: as it is; *all alike*, with every object counting alike, whatever is left over in it. The error is
up to order 2, with one free scale; *over stated* is the error over the one that the estimate expects.
"""

from pathlib import Path

import numpy as np
from tqdm import tqdm

from btfsep_engine.pipeline.estimation import REFINEMENTS
from btfsep_engine.pipeline.refine.each_object import each_object_by_itself
from btfsep_engine.storage.atomic import write_json
from scripts.cycles import plain
from scripts.cycles.lights import studio_lights
from scripts.studies import parser, photos, plate_light, plate_sets, plate_things, tables
from scripts.studies.estimates import estimated, worth

COUNT, SEED = 24, 301
SECOND = ("as told", "painted", "mottled")
FINISHES = ("matte", "satin", "gloss")
AS_IT_IS, ALIKE = "as it is", "all alike"


def drawn(seed: int = SEED) -> list[dict]:
    """The photographs, as `scripts.cycles.pairs` takes them; a third of each of `SECOND`."""
    random, lights = np.random.default_rng(seed), [str(path) for path in studio_lights()]
    colours, out = list(plain.COLOURS), []
    for i in range(COUNT):
        second, things = SECOND[i % len(SECOND)], []
        for thing in random.choice(plate_sets.OBJECTS, 2, replace=False):
            surface = plain.of(str(random.choice(FINISHES)), str(random.choice(colours)))
            told = plate_things.by_eye(surface, random)
            things.append({"object": str(thing), "surface": surface, "told": told, "thing": None, "paint": None})
        if second != SECOND[0]:
            paint = plain.COLOURS[str(random.choice(colours))]
            things[1] |= {"thing": second, "much": float(random.uniform(0.5, 1)), "paint": paint}
            if second == "painted":
                mean = (np.array(things[1]["told"]["colour"]) + paint) / 2
                things[1]["told"] = things[1]["told"] | {"colour": mean.tolist()}
        place = {"light": lights[i % len(lights)], "turn": float(random.uniform(0, 360)), "seed": i}
        out.append({"name": f"{i:02d}", "second": second, "things": things} | place)
    return out


def study(pair: dict, folder: Path) -> list[dict]:
    """A photograph's rows."""
    ways = {AS_IT_IS: None, ALIKE: tuple(r for r in REFINEMENTS if r is not each_object_by_itself)}
    truth, out = plate_light.truth(pair | {"sun": None}), []
    for way, refinements in ways.items():
        found = estimated(folder / pair["name"], refinements=refinements)
        row = {"name": pair["name"], "second": f"second {pair['second']}", "way": way}
        row |= worth(found, truth, free_scale=True)
        out.append(row | {"over": row["order2"] / row["stated2"], "counts": found.choice.get("counts")})
    return out


COLUMNS = (("photographs", len), *tables.OF_LIGHT)


def main(arguments) -> int:
    options = parser("pairs", __doc__)
    options.add_argument("folder", type=Path)
    options.add_argument("--make", action="store_true", help="take the photographs")
    options.add_argument("--seed", type=int, default=SEED, help="of what is drawn (%(default)s)")
    options.add_argument("--numbers", type=Path, metavar="FILE", help="write all numbers, JSON")
    given = options.parse_args(arguments)
    folder, pairs = given.folder.resolve(), drawn(given.seed)
    if given.make:
        photos.in_blender("scripts.cycles.pairs", {"folder": str(folder), "pairs": pairs})
        return 0
    there = [pair for pair in pairs if (folder / pair["name"] / "job.json").exists()]
    rows = [row for pair in tqdm(there, desc="pairs") for row in study(pair, folder)]
    if given.numbers:
        write_json(given.numbers, rows)
    print(tables.summary(("way", "pairs"), COLUMNS, tables.groups_of_ways(rows, "second")))
    return 0
