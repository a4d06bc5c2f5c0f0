# SPDX-License-Identifier: GPL-3.0-or-later
"""Textures that line up with the photo: what the light gains by the BTF's texture over its mean ABRDF, and where.

scripts/study aligned FOLDER --make             takes the photographs, once
scripts/study aligned FOLDER --other PHOTOS     beside those that scripts/study photos leaves

The library's own texels in the mesh's own UVs, displaced by Cycles; beside them PHOTOS, which have the same UVs and
other texels: these line up nowhere, and nothing says so but the photo. The material is given. Ways: *mean*, the mean
ABRDF; *textured*, the BTF; *auto*, what an estimate takes of the two; *better*, whichever of the first two errs less,
which nobody knows: what is left to gain by choosing.
"""

from pathlib import Path

import numpy as np
from tqdm import tqdm

from btfsep_engine.btf.library import open_library
from btfsep_engine.storage.atomic import write_json
from scripts.studies import parser, photos, tables
from scripts.studies.estimates import estimated, scene_of, worth

OBJECTS, LIGHTS = ("pebble", "cushion", "suzanne"), ("interior", "courtyard")
ALIGNED, OTHER = "the library's own texels", "other texels"
WAYS = ("mean", "textured", "auto")
TRUE_ORDER = 4


def shots(folder: Path, materials, objects, lights) -> list:
    """The photographs; those of an object in a material stand together. The library's variation is 0."""
    return [
        photos.shot(folder, thing, photos.studio_name(material), light, variation=0)
        for thing in objects
        for material in materials
        for light in lights
    ]


def study(photograph, kind: str) -> list[dict]:
    """One estimate each way."""
    rows = []
    for way in WAYS:
        found = estimated(scene_of(photograph.folder, uv="mesh"), photograph.material, appearance=way)
        row = {"photograph": photograph.folder.name, "kind": kind, "material": photograph.material, "way": way}
        row |= {"with texture": found.model.appearance == "textured"}
        row |= worth(found, photograph.truth(TRUE_ORDER))
        rows.append(row | {"over": row["order2"] / row["stated2"]})
    better = min(rows[:2], key=lambda row: row["order2"])
    return [row | {"gain": row["order2"] / rows[0]["order2"]} for row in (*rows, better | {"way": "better"})]


def mean_gain(rows) -> str:
    """The geometric mean of what the error is of that with the mean ABRDF."""
    return f"{np.exp(np.mean(np.log([r['gain'] for r in rows]))):.2f}"


COLUMNS = (
    ("photographs", len),
    ("textured", tables.percent_of("with texture")),
    ("error over the mean ABRDF's", mean_gain),
    *tables.OF_LIGHT,
)


def main(arguments) -> int:
    options = parser("aligned", __doc__)
    options.add_argument("folder", type=Path)
    options.add_argument("--make", action="store_true", help="take the photographs")
    options.add_argument("--other", type=Path, metavar="PHOTOS", help="of other texels, of scripts/study photos")
    options.add_argument("--materials", nargs="+", help="all of the library that have a texture, by default")
    options.add_argument("--objects", nargs="+", default=OBJECTS)
    options.add_argument("--lights", nargs="+", default=LIGHTS)
    options.add_argument("--numbers", type=Path, metavar="FILE", help="write all numbers, JSON")
    given = options.parse_args(arguments)
    library, folder = open_library(), given.folder.resolve()
    materials = given.materials or [n for n in library.names() if library.load(n).has_texture]
    if given.make:
        photos.take(shots(folder, materials, given.objects, given.lights))
        return 0
    seen = {ALIGNED: photos.photographs_in(folder, objects=given.objects, lights=given.lights)}
    if given.other:
        seen[OTHER] = photos.photographs_in(given.other)
    seen = {kind: [p for p in some if p.material in materials] for kind, some in seen.items()}
    rows = [row for kind, some in seen.items() for p in tqdm(some, desc=kind) for row in study(p, kind)]
    if given.numbers:
        write_json(given.numbers, rows)
    for kind, some in tables.groups(rows, "kind", every=None):
        print(f"\n{kind}:\n")
        print(tables.summary(("way", "material"), COLUMNS, tables.groups_of_ways(some, "material")))
    return 0
