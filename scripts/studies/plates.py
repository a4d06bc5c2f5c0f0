# SPDX-License-Identifier: GPL-3.0-or-later
"""Plates as users have them: everyday surfaces, tables, suns, JPEG by sRGB or AgX, a camera a little off; by Cycles.

scripts/study plates FOLDER --make     takes them, once
scripts/study plates FOLDER
scripts/study plates FOLDER --maps MAPS --sets tenth "unsaid anew"     under other maps, with --make and without
scripts/study plates FOLDER --sets chrome --show 05 07 23 26 --to docs/images/mirrors.jpg     pictures of some

Objects of a plain Blender material ("as in Blender" in the job), alone or on a coloured table whose material the job
has, under Blender's studio lights, turned, half of them with a Sun lamp. Each is estimated as the job is (*as it
is*), with the camera in line (*in line*), with nothing said of what it is made of (*as recognised*) or only that it is
plastic (*as any plastic*), with the roughness that a new material has (*roughness 0.5*), and a render that was saved
with AgX also as if nothing were known of that but what the file says (*not said*), or as if it were sRGB (*taken for
sRGB*). Objects of the set *several* have three such materials, and are estimated with their mean, too (*as their
mean*). Those of the set *stage* stand in dim light under lamps with filters of strong colours; of the sets *unsaid*,
jobs say of the object what a user sees by eye, and nothing of what light does below its skin, of its bumps and its
paint, nor of a lens that darkens corners, is out of focus or has glare, nor of noise; of the sets *painted*, nothing of
a paint in pieces, half of them in the dark under lamps; those of *softboxes* stand under one to three of them, 0.3 to
1.2 metres away, and the light is that at their middle; of the sets *shadowed*, nothing of what keeps the sun from a
part of the object; of the sets *covered*, nothing of what is before a part of it. Those of *glossy tables* stand on
such, those of *patterned* on tables of two colours, of which jobs have the mean; what shows of a table may be left
unread (*table not read*), and it may be said to be matte, or as a new material (*told matte*, *satin*); or the job has
none (*not told*), and the photo may not be asked for it (*nor looked for*). Of the sets *cut* an edge of the picture
cuts the object; those of *flash* have a flash on the camera, indoors; those of *sweep* stand on paper that rises behind
them, under softboxes. Those of *scanned* have a texture with the light in it that it was taken under, which may be left
there (*not de-lit*), or not have been there (*without light in the texture*). The jobs of *remeshed* have meshes as
scans are, smoother, noisy and a little off. Things of the sets *angular* are of few flat faces; those of *finished* are
velvet, coated, brushed, waxen, frosted or dusty, and jobs say what a user sees by eye, and nothing of that; those of
*dusty* are all dusty. Beside those of *neighbours* stands a wall, or a thing, of which jobs say nothing; the light is
that at their middle.
With ``--maps`` lights are drawn from a folder of maps, not from Blender's. The error of plates with a table is that
of the light from above it: what comes from below, nothing in such a photo shows; *of all light* has that, too.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
from tqdm import tqdm

from btfsep_engine.btf.surfaces import Surface
from btfsep_engine.errors import InputError
from btfsep_engine.fit.stated import expected_error
from btfsep_engine.job.load import load_job
from btfsep_engine.light.maps import read_map
from btfsep_engine.pipeline.mirrors import SHARP
from btfsep_engine.storage.atomic import write_json
from scripts.cycles.figure import display, exposure, write_rows
from scripts.cycles.lights import AROUND, light_path
from scripts.studies import parser, photos, tables
from scripts.studies.estimates import estimated, scene_of, worth
from scripts.studies.ground import above
from scripts.studies.measures import errors
from scripts.studies.plate_light import truth
from scripts.studies.plate_sets import SETS, of_set

AS_IS, IN_LINE, AS_MEAN = "as it is", "in line", "as their mean"
NOT_SAID, AS_SRGB = "not said", "taken for sRGB"
RECOGNISED, AS_PLASTIC = "as recognised", "as any plastic"
OF_AGX = {NOT_SAID: "auto", AS_SRGB: "srgb"}
NO_MIRROR = "as no mirror"
NOT_LOOKED = "roughness 0.5"
NOT_READ, MATTE, SATIN = "table not read", "table told matte", "table told satin"
NOT_TOLD, NOT_LOOKED_FOR = "table not told", "table not told, nor looked for"
TOLD = {MATTE: {"roughness": 1.0, "specular": 0.0}, SATIN: {"roughness": 0.5, "specular": 0.5}}
OF_TABLES = (NOT_READ, *TOLD, NOT_TOLD, NOT_LOOKED_FOR)
NOT_DE_LIT, CLEAN = "not de-lit", "without light in the texture"
EVIDENCE = {NOT_READ: "never", NOT_LOOKED_FOR: "job"}
WAYS = (AS_IS, IN_LINE, RECOGNISED, AS_PLASTIC, NOT_SAID, AS_SRGB, AS_MEAN, NO_MIRROR, NOT_LOOKED, *OF_TABLES)
OF_SCANS = (NOT_DE_LIT, CLEAN)
WAYS += OF_SCANS


def as_mean(job):
    """A job whose first object's surface is the mean of its images over the mesh; as it is where it has none."""
    (first, *others), surface = job.objects, job.objects[0].surface
    if surface.image is None:
        return job
    corners, n = first.mesh.vertices[first.mesh.faces], len(surface.image)
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    column, up = (first.mesh.corner_uv.mean(1) * n).astype(int).T
    there = n - 1 - up.clip(0, n - 1), column.clip(0, n - 1)
    colour, numbers = np.average(surface.image[there], 0, area), (surface.roughness, surface.metallic, surface.specular)
    if surface.finish is not None:
        numbers = np.average(surface.finish[there], 0, area)
    return replace(job, objects=(replace(first, surface=Surface(tuple(colour), *map(float, numbers))), *others))


def as_recognised(job):
    """A job that says of its first object only where it is: the library has no such material."""
    first, *others = job.objects
    return replace(job, objects=(replace(first, surface=None), *others))


def as_plastic(job):
    """A job whose first object is of plastic, of which it says neither colour nor roughness."""
    first, *others = job.objects
    return replace(job, objects=(replace(first, surface=None, material="surface/plastic"), *others))


def with_blenders_roughness(job):
    """A job whose first object has the roughness that a new material in Blender has."""
    first, *others = job.objects
    return replace(job, objects=(replace(first, surface=replace(first.surface, roughness=0.5)), *others))


def without_table(job):
    """A job that says nothing of what stands around."""
    return replace(job, occluders=())


def as_no_mirror(job):
    """A job whose first object's surface is a little rougher than what counts as a mirror."""
    first, *others = job.objects
    return replace(job, objects=(replace(first, surface=replace(first.surface, roughness=SHARP + 0.01)), *others))


def with_table(job, way: str):
    """The job with a table that is said to be matte, or as a new Blender material."""
    tables = tuple(replace(o, surface=replace(o.surface, **TOLD[way])) for o in job.occluders)
    return replace(job, occluders=tables)


def worth_of(plate, found, folder: Path | None = None) -> dict:
    """What an Estimate of a plate is worth: `estimates.worth`, of one on a table that of the light from above.

    ``folder`` : as of `plate_light.truth`
    """
    true = truth(plate, folder)
    row = worth(found, true, free_scale=True)
    row["of all light"] = row["order2"]
    if plate["table"]:
        light, samples = above(found.fit.all_coefficients), np.array([above(sample) for sample in found.fit.samples])
        row |= errors(light, above(true)) | {"stated2": expected_error(light, samples)["order_2"]["median"]}
    return row


def judged(plate, job, folder: Path | None = None, **told) -> dict:
    """What the estimate of a plate's job is worth; ``told`` : settings; ``folder`` : as of `plate_light.truth`."""
    scene = scene_of(job)
    found = estimated(scene, **told)
    row = {"name": plate["name"], "kinds": plate["kinds"], "choice": found.choice} | worth_of(plate, found, folder)
    row["over"] = row["order2"] / row["stated2"]
    row["curve doubted"] = any("tone curve is doubtful" in said for said in scene.reporter.warnings)
    return row


def told(plate, folder: Path, way: str) -> tuple:
    """A plate's job as it is told in a way, and the settings of its estimate."""
    where = folder / plate["name"] / {IN_LINE: "in line", CLEAN: "clean"}.get(way, "job")
    job = load_job(where, colorspace=OF_AGX.get(way))
    made = {
        AS_MEAN: as_mean,
        NO_MIRROR: as_no_mirror,
        NOT_LOOKED: with_blenders_roughness,
        NOT_TOLD: without_table,
        NOT_LOOKED_FOR: without_table,
        RECOGNISED: as_recognised,
        AS_PLASTIC: as_plastic,
    }
    if way in TOLD:
        job = with_table(job, way)
    settings = {"evidence": EVIDENCE[way]} if way in EVIDENCE else {}
    settings |= {"delight": "never"} if way == NOT_DE_LIT else {}
    return made[way](job) if way in made else job, settings


def study(plate, folder: Path, way: str) -> dict:
    """One estimate."""
    job, settings = told(plate, folder, way)
    return {"way": way} | judged(plate, job, folder, **settings)


def true_map(plate, folder: Path) -> np.ndarray:
    """The light (h, w, 3) without its suns; of a plate with a neighbour as Cycles sees it from the object's middle."""
    if "neighbour" in plate:
        return read_map(folder / plate["name"] / AROUND)
    light = read_map(light_path(plate["light"]))
    return np.roll(light, -round(plate["turn"] / 360 * light.shape[1]), 1)


def shown(plate, folder: Path, ways) -> list:
    """A row of a picture: the photo, and the lights that are found in each way and the true one without its sun."""
    true = true_map(plate, folder)
    jobs = [told(plate, folder, way) for way in ways]
    found = [estimated(scene_of(job), **settings).map for job, settings in jobs]
    photo, kinds = jobs[0][0].photo.radiance, plate["kinds"][-3:] if "told" in plate else plate["kinds"][:-2]
    return [
        (display(photo, exposure(photo)), ", ".join(kinds)),
        *((display(each, exposure(true)), Path(plate["light"]).stem) for each in (*found, true)),
    ]


COLUMNS = (
    ("plates", lambda rows: len(rows)),
    ("error", tables.spread_of("order2")),
    ("of all light", tables.spread_of("of all light")),
    ("direction", tables.spread_of("direction", "{:.1f}°")),
    ("stated", tables.median_of("stated2")),
    ("over stated", tables.spread_of("over")),
    ("95 % range", tables.percent_of("inside")),
    ("curve doubted", tables.percent_of("curve doubted")),
)


def groups(rows):
    """All of each way, then those as they are by what they have."""
    yield from (((f"**{way}**",), some) for way, some in tables.groups(rows, "way", every=None))
    own = [r for r in rows if r["way"] == AS_IS]
    for kind in sorted({k for r in own for k in r["kinds"]}):
        yield (kind,), [r for r in own if kind in r["kinds"]]


def main(arguments) -> int:
    options = parser("plates", __doc__)
    options.add_argument("folder", type=Path)
    options.add_argument("--make", action="store_true", help="take the plates")
    options.add_argument("--sets", nargs="+", choices=list(SETS), default=list(SETS))
    options.add_argument("--maps", type=Path, metavar="FOLDER", help="with .hdr files, in place of Blender's lights")
    options.add_argument("--ways", nargs="+", choices=WAYS, default=WAYS, metavar="WAY", help="; ".join(WAYS))
    options.add_argument("--numbers", type=Path, metavar="FILE", help="write all numbers, JSON")
    options.add_argument("--show", nargs="+", metavar="NAME", default=[], help="draw these plates and their lights")
    options.add_argument("--to", type=Path, metavar="FILE", help="the picture of --show")
    given = options.parse_args(arguments)
    lights = [str(path) for path in sorted(given.maps.resolve().glob("*.hdr"))] if given.maps else None
    if lights == []:
        raise InputError(str(given.maps), "it has no .hdr files", "name a folder with maps")
    places = [(given.folder.resolve() / name, of_set(name, lights)) for name in given.sets]
    if given.make:
        for folder, plates in places:
            photos.in_blender("scripts.cycles.plates", {"plates": plates, "folder": str(folder)})
        return 0
    if given.show:
        ways = (AS_IS,) if given.ways == WAYS else given.ways
        rows = [shown(p, folder, ways) for folder, plates in places for p in plates if p["name"] in given.show]
        lights = ["the light that was found"] if len(ways) == 1 else [f"the light, {way}" for way in ways]
        write_rows(given.to, rows, titles=("photo", *lights, "the true light"))
        return 0
    todo = [(plate, folder, way) for folder, plates in places for plate in plates for way in given.ways]
    todo = [t for t in todo if t[2] not in (RECOGNISED, AS_PLASTIC) or not t[1].name.startswith(("several", "chrome"))]
    todo = [t for t in todo if t[2] not in OF_AGX or t[0]["curve"] == "agx"]
    todo = [t for t in todo if t[2] != AS_MEAN or {"more", "scan"} & set(t[0])]
    todo = [t for t in todo if t[2] not in OF_SCANS or "scan" in t[0]]
    todo = [t for t in todo if t[2] != NO_MIRROR or t[1].name.startswith("chrome")]
    todo = [t for t in todo if t[2] != NOT_LOOKED or not {"more", "told"} & set(t[0])]
    todo = [t for t in todo if t[2] != IN_LINE or any(t[0]["off"])]
    todo = [t for t in todo if t[2] not in OF_TABLES or t[0]["table"]]
    rows = [study(*each) for each in tqdm(todo)]
    if given.numbers:
        write_json(given.numbers, rows)
    print(tables.summary(("plates",), COLUMNS, groups(rows)))
    stand = sum("standing" in row["choice"] for row in rows)
    print(f"\nOf {len(rows)} estimates {stand} have a ground that no job says (`pipeline/standing.py`).")
    return 0
