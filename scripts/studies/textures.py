# SPDX-License-Identifier: GPL-3.0-or-later
"""Textured materials that no library holds: what the light is worth where the object is recognised, or told in part.

scripts/study textures FOLDER --maps MAPS --make     takes the photographs, once
scripts/study textures FOLDER --maps MAPS

MAPS has a folder for each texture set (colour, height and roughness, as `btfsep measure` reads them) and `meta.json`:
{"name of the folder": {"size_mm": …, "height_mm": …}}. Cycles shows them as true displaced geometry; the job has the
smooth mesh. Ways: *as recognised*; *by its numbers*, the set's mean colour and roughness as a user reads them off;
*as any plastic*.
"""

import json
from dataclasses import replace
from pathlib import Path

from tqdm import tqdm

from btfsep_engine.btf.surfaces import Surface
from btfsep_engine.btf.texture_maps import read_maps
from btfsep_engine.errors import InputError
from btfsep_engine.job.load import load_job
from btfsep_engine.storage.atomic import write_json
from scripts.studies import parser, photos, tables
from scripts.studies.estimates import estimated, scene_of, worth

OBJECTS, LIGHTS = ("pebble", "knot"), ("forest", "sunset")
RECOGNISED, NUMBERS, PLASTIC = "as recognised", "by its numbers", "as any plastic"
WAYS = (RECOGNISED, NUMBERS, PLASTIC)
OF_OTHERS = "others"  # what stands for a class in the names of photographs
RESOLUTION = 256  # of maps whose mean is taken
TRUE_ORDER = 4


def texture_sets(folder: Path) -> dict:
    """{name: {folder, size_mm, height_mm}} of the sets in a folder. Raises InputError."""
    try:
        told = json.loads((folder / "meta.json").read_text())
        return {
            name.replace("_", "-"): {"folder": str((folder / name).resolve())}
            | {key: float(each[key]) for key in ("size_mm", "height_mm")}
            for name, each in told.items()
        }
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        what = 'write {"name of a folder": {"size_mm": 60, "height_mm": 2}} into it'
        raise InputError(str(folder / "meta.json"), f"it cannot be read ({error})", what) from None


def shots(folder: Path, sets: dict, objects, lights) -> list:
    """The photographs; those of an object in a material stand together."""
    return [
        photos.shot(folder, thing, f"{OF_OTHERS}/{name}", light, maps=maps)
        for thing in objects
        for name, maps in sets.items()
        for light in lights
    ]


def surface_of(maps: dict) -> Surface:
    """What a user reads off a set: its mean colour and roughness."""
    read = read_maps(Path(maps["folder"]), name=OF_OTHERS, resolution=RESOLUTION, **_sizes(maps)).maps
    return Surface(tuple(float(c) for c in read.base_colour.mean((0, 1))), float(read.roughness.mean()))


def _sizes(maps: dict) -> dict:
    return {key: maps[key] for key in ("size_mm", "height_mm")}


def study(photograph, surfaces: dict, way: str) -> dict:
    """One estimate."""
    name, job = photograph.shown.removeprefix(f"{OF_OTHERS}-"), load_job(photograph.folder)
    told = {NUMBERS: {"surface": surfaces[name], "material": None}, PLASTIC: {"material": "surface/plastic"}}
    job = replace(job, objects=tuple(replace(o, **told.get(way, {})) for o in job.objects))
    found = estimated(scene_of(job))
    row = {"photograph": photograph.folder.name, "set": name, "way": way, "taken for": found.materials[0].name}
    row |= worth(found, photograph.truth(TRUE_ORDER), free_scale=True)
    return row | {"over": row["order2"] / row["stated2"]}


COLUMNS = (("photographs", len), *tables.OF_LIGHT)


def main(arguments) -> int:
    options = parser("textures", __doc__)
    options.add_argument("folder", type=Path)
    options.add_argument("--maps", type=Path, metavar="FOLDER", required=True, help="texture sets, and meta.json")
    options.add_argument("--make", action="store_true", help="take the photographs")
    options.add_argument("--objects", nargs="+", default=OBJECTS)
    options.add_argument("--lights", nargs="+", default=LIGHTS)
    options.add_argument("--ways", nargs="+", choices=WAYS, default=WAYS, metavar="WAY", help="; ".join(WAYS))
    options.add_argument("--numbers", type=Path, metavar="FILE", help="write all numbers, JSON")
    given = options.parse_args(arguments)
    sets, folder = texture_sets(given.maps), given.folder.resolve()
    if given.make:
        photos.take(shots(folder, sets, given.objects, given.lights))
        return 0
    seen = photos.photographs_in(folder, objects=given.objects, lights=given.lights)
    surfaces = {name: surface_of(maps) for name, maps in sets.items()}
    rows = [study(p, surfaces, way) for way in given.ways for p in tqdm(seen, desc=way)]
    if given.numbers:
        write_json(given.numbers, rows)
    print(tables.summary(("way", "texture set"), COLUMNS, tables.groups_of_ways(rows, "set")))
    return 0
