# SPDX-License-Identifier: GPL-3.0-or-later
"""Plates as users have them: everyday surfaces, tables, suns, JPEG by sRGB or AgX, a camera a little off; by Cycles.

scripts/study plates FOLDER --make     takes them, once
scripts/study plates FOLDER
scripts/study plates FOLDER --sets chrome --show 05 07 23 26 --to docs/images/mirrors.jpg     pictures of some

Objects of a plain Blender material ("as in Blender" in the job), alone or on a coloured table whose material the job
has, under Blender's studio lights, turned, half of them with a Sun lamp. Each is estimated as the job is (*as it
is*), with the camera in line (*in line*), with nothing said of what it is made of (*as recognised*) or only that it is
plastic (*as any plastic*), and a render that was saved with AgX also as if nothing were known of that but what the file
says (*not said*), or as if it were sRGB (*taken for sRGB*). Objects of the set *several* have three such materials, and
are estimated with their mean, too (*as their mean*). Those of the set *stage* stand in dim light under lamps
with filters of strong colours. The error of plates with a table is that of the light from above
it: what comes from below, nothing in such a photo shows; *of all light* has that, too.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
from tqdm import tqdm

from btfsep_engine import sh
from btfsep_engine.btf.surfaces import Surface
from btfsep_engine.fit.stated import expected_error
from btfsep_engine.job.load import load_job
from btfsep_engine.light.maps import read_map
from btfsep_engine.pipeline.mirrors import SHARP
from btfsep_engine.storage.atomic import write_json
from scripts.cycles.figure import display, exposure, write_rows
from scripts.cycles.lights import light_path, studio_lights, true_lighting
from scripts.studies import parser, photos, tables
from scripts.studies.estimates import estimated, scene_of, worth
from scripts.studies.ground import above
from scripts.studies.measures import errors

SETS = {
    "first": 1,
    "second": 2,
    "third": 3,
    "several": 4,
    "chrome": 5,
    "fourth": 6,
    "fifth": 7,
    "sixth": 8,
    "seventh": 9,
    "stage": 10,
    "eighth": 11,
    "ninth": 12,
}  # seeds; what was chosen by which of them, docs/accuracy.md says
COUNT = 32
OBJECTS = ("suzanne", "blob", "knot", "vase", "pebble", "cushion")
COLOURS = {
    "teal": (0.05, 0.35, 0.33), "red": (0.5, 0.04, 0.03), "clay": (0.55, 0.28, 0.17), "white": (0.78, 0.78, 0.76),
    "grey": (0.3, 0.3, 0.3), "yellow": (0.75, 0.5, 0.05), "navy": (0.03, 0.05, 0.2), "green": (0.12, 0.3, 0.06),
}  # fmt: skip
SURFACES = {"matte": (0.9, 0), "satin": (0.5, 0), "gloss": (0.2, 0), "metal": (0.4, 1)}  # roughness, metallic
OF_SURFACES = (0.35, 0.3, 0.25, 0.1)
METALS = (
    (0.55, 0.556, 0.554),
    (0.97, 0.96, 0.91),
    (1.0, 0.77, 0.34),
    (0.95, 0.64, 0.54),
)  # chrome, silver, gold, copper
POLISHED = (0.0, 0.1, 0.2)  # roughness
CURVES = ("srgb", "srgb", "agx", "floats")
WITH_TABLE, WITH_SUN, SUNNY = 0.6, 0.4, 0.5  # shares of the plates; of the light by the sun
SUN_COLOUR = np.array([1.05, 1.0, 0.9])
FILTERS = {
    "red": (1, 0.03, 0.02), "amber": (1, 0.45, 0.05), "green": (0.05, 1, 0.1), "cyan": (0.05, 0.8, 1),
    "blue": (0.03, 0.06, 1), "magenta": (1, 0.03, 0.8), "white": (1, 1, 1),
}  # fmt: skip
LAMPS, DIMMED, STRONG = 3, (0.03, 0.15), (1.0, 2.0)  # of a stage: at most; its other light, times what it is; lamps'
# irradiance, times what that of the other light would be undimmed
AS_IS, IN_LINE, AS_MEAN = "as it is", "in line", "as their mean"
NOT_SAID, AS_SRGB = "not said", "taken for sRGB"
RECOGNISED, AS_PLASTIC = "as recognised", "as any plastic"
OF_AGX = {NOT_SAID: "auto", AS_SRGB: "srgb"}
NO_MIRROR = "as no mirror"
WAYS = (AS_IS, IN_LINE, RECOGNISED, AS_PLASTIC, NOT_SAID, AS_SRGB, AS_MEAN, NO_MIRROR)


def drawn(seed: int) -> list[dict]:
    """The plates of a set, as `scripts.cycles.plates` takes them; ``kinds`` in words."""
    random, out = np.random.default_rng(seed), []
    lights, colours = sorted(studio_lights()), list(COLOURS)
    for i in range(COUNT):
        kind = random.choice(list(SURFACES), p=OF_SURFACES)
        colour, light, top = random.choice(colours), str(random.choice(lights)), random.choice(colours)
        turn, off, way = random.uniform(0, 360), int(random.integers(3)), random.uniform(0, 2 * np.pi)
        azimuth, height, table = random.uniform(0, 2 * np.pi), random.uniform(0.35, 1.2), random.random() < WITH_TABLE
        sunny, curve = random.random() < WITH_SUN, str(random.choice(CURVES))
        towards = [np.cos(azimuth) * np.cos(height), -abs(np.sin(azimuth)) * np.cos(height), np.sin(height)]
        strength = SUNNY * np.sqrt(4 * np.pi) * true_lighting(light, 0).mean()
        roughness, metallic = SURFACES[kind]
        out.append(
            {
                "name": f"{i:02d}",
                "object": OBJECTS[i % len(OBJECTS)],
                "seed": 11 + i,
                "surface": {"colour": COLOURS[colour], "roughness": roughness, "metallic": metallic},
                "light": light,
                "turn": turn,
                "sun": {"direction": towards, "irradiance": list(strength * SUN_COLOUR)} if sunny else None,
                "table": COLOURS[top] if table else None,
                "curve": curve,
                "off": [off * np.cos(way), off * np.sin(way)],
                "kinds": [f"{off} px off", curve, "on a table" if table else "alone", str(kind)],
            }
        )
    return out


def several(plates: list[dict]) -> list[dict]:
    """The plates with two more materials each."""
    random, kinds = np.random.default_rng(SETS["several"]), list(SURFACES)
    out = []
    for plate in plates:
        more = []
        for colour, kind in zip(random.choice(list(COLOURS), 2), random.choice(kinds, 2, p=OF_SURFACES), strict=True):
            roughness, metallic = SURFACES[kind]
            more.append({"colour": COLOURS[colour], "roughness": roughness, "metallic": metallic})
        out.append(plate | {"more": more})
    return out


def mirroring(plates: list[dict]) -> list[dict]:
    """The plates with polished metal, every second one of a ball."""
    random, out = np.random.default_rng(SETS["chrome"]), []
    for i, plate in enumerate(plates):
        colour, roughness = METALS[random.integers(len(METALS))], float(random.choice(POLISHED))
        surface = {"colour": colour, "roughness": roughness, "metallic": 1}
        kinds = [*plate["kinds"][:-1], f"roughness {roughness}", "an object" if i % 2 else "a ball"]
        out.append(plate | {"object": plate["object"] if i % 2 else "sphere", "surface": surface, "kinds": kinds})
    return out


def on_stage(plates: list[dict]) -> list[dict]:
    """The plates under lamps with filters in place of the sun, and dim light."""
    random, out = np.random.default_rng(SETS["stage"]), []
    for plate in plates:
        count, usual = int(random.integers(1, LAMPS + 1)), np.sqrt(np.pi / 4) * true_lighting(plate["light"], 0).mean()
        lamps = []
        for colour in random.choice(list(FILTERS), count, replace=False):
            azimuth, height = random.uniform(0, 2 * np.pi), random.uniform(0.1, 1.2)
            towards = [np.cos(azimuth) * np.cos(height), -abs(np.sin(azimuth)) * np.cos(height), np.sin(height)]
            irradiance = random.uniform(*STRONG) * usual * 2 * np.array(FILTERS[colour])
            lamps.append({"direction": towards, "irradiance": irradiance.tolist()})
        kinds = [*plate["kinds"], f"{count} lamp{'s' if count > 1 else ''}"]
        more = {"lamps": lamps, "dimmed": random.uniform(*DIMMED), "sun": None, "kinds": kinds}
        out.append(plate | more)
    return out


def of_set(name: str) -> list[dict]:
    """The plates of a set by its name."""
    made = {"several": several, "chrome": mirroring, "stage": on_stage}
    return made.get(name, list)(drawn(SETS[name]))


def as_mean(job):
    """A job whose first object's surface is the mean of its images over the mesh; as it is where it has none."""
    (first, *others), surface = job.objects, job.objects[0].surface
    if surface.finish is None:
        return job
    corners, n = first.mesh.vertices[first.mesh.faces], len(surface.image)
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    column, up = (first.mesh.corner_uv.mean(1) * n).astype(int).T
    colour, numbers = (np.average(each[n - 1 - up, column], 0, area) for each in (surface.image, surface.finish))
    return replace(job, objects=(replace(first, surface=Surface(tuple(colour), *map(float, numbers))), *others))


def as_recognised(job):
    """A job that says of its first object only where it is: the library has no such material."""
    first, *others = job.objects
    return replace(job, objects=(replace(first, surface=None), *others))


def as_plastic(job):
    """A job whose first object is of plastic, of which it says neither colour nor roughness."""
    first, *others = job.objects
    return replace(job, objects=(replace(first, surface=None, material="surface/plastic"), *others))


def as_no_mirror(job):
    """A job whose first object's surface is a little rougher than what counts as a mirror."""
    first, *others = job.objects
    return replace(job, objects=(replace(first, surface=replace(first.surface, roughness=SHARP + 0.01)), *others))


def truth(plate) -> np.ndarray:
    """The light's coefficients (100, 3)."""
    c, s = np.cos(np.radians(plate["turn"])), np.sin(np.radians(plate["turn"]))
    x = true_lighting(plate["light"], 9, rotation=np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]))
    x = x * plate.get("dimmed", 1)
    for lamp in lamps_of(plate):
        beam = sh.evaluate(9, np.array([lamp["direction"]]))[0]
        x = x + beam[:, None] * lamp["irradiance"]
    return x


def lamps_of(plate) -> list:
    """Its bare lamps, be it a sun."""
    return [plate["sun"]] * bool(plate["sun"]) + plate.get("lamps", [])


def worth_of(plate, found) -> dict:
    """What an Estimate of a plate is worth: `estimates.worth`, of one on a table that of the light from above."""
    true = truth(plate)
    row = worth(found, true, free_scale=True)
    row["of all light"] = row["order2"]
    if plate["table"]:
        light, samples = above(found.fit.all_coefficients), np.array([above(sample) for sample in found.fit.samples])
        row |= errors(light, above(true)) | {"stated2": expected_error(light, samples)["order_2"]["median"]}
    return row


def judged(plate, job) -> dict:
    """What the estimate of a plate's job is worth."""
    scene = scene_of(job)
    found = estimated(scene)
    row = {"name": plate["name"], "kinds": plate["kinds"], "choice": found.choice} | worth_of(plate, found)
    row["over"] = row["order2"] / row["stated2"]
    row["curve doubted"] = any("tone curve is doubtful" in said for said in scene.reporter.warnings)
    return row


def study(plate, folder: Path, way: str) -> dict:
    """One estimate."""
    where = folder / plate["name"] / ("in line" if way == IN_LINE else "job")
    job = load_job(where, colorspace=OF_AGX.get(way))
    made = {AS_MEAN: as_mean, NO_MIRROR: as_no_mirror, RECOGNISED: as_recognised, AS_PLASTIC: as_plastic}
    return {"way": way} | judged(plate, made[way](job) if way in made else job)


def shown(plate, folder: Path) -> list:
    """A row of a picture: the photo, and the light that is found and the true one without its sun, as maps."""
    job = load_job(folder / plate["name"] / "job")
    found, true = estimated(scene_of(job)).map, read_map(light_path(plate["light"]))
    true = np.roll(true, -round(plate["turn"] / 360 * true.shape[1]), 1)
    photo = job.photo.radiance
    return [
        (display(photo, exposure(photo)), ", ".join(plate["kinds"][:-2])),
        *((display(each, exposure(true)), plate["light"]) for each in (found, true)),
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
    options.add_argument("--ways", nargs="+", choices=WAYS, default=WAYS, metavar="WAY", help="; ".join(WAYS))
    options.add_argument("--numbers", type=Path, metavar="FILE", help="write all numbers, JSON")
    options.add_argument("--show", nargs="+", metavar="NAME", default=[], help="draw these plates and their lights")
    options.add_argument("--to", type=Path, metavar="FILE", help="the picture of --show")
    given = options.parse_args(arguments)
    places = [(given.folder.resolve() / name, of_set(name)) for name in given.sets]
    if given.make:
        for folder, plates in places:
            photos.in_blender("scripts.cycles.plates", {"plates": plates, "folder": str(folder)})
        return 0
    if given.show:
        rows = [shown(p, folder) for folder, plates in places for p in plates if p["name"] in given.show]
        write_rows(given.to, rows, titles=("photo", "the light that was found", "the true light"))
        return 0
    todo = [(plate, folder, way) for folder, plates in places for plate in plates for way in given.ways]
    todo = [t for t in todo if t[2] not in (RECOGNISED, AS_PLASTIC) or t[1].name not in ("several", "chrome")]
    todo = [t for t in todo if t[2] not in OF_AGX or t[0]["curve"] == "agx"]
    todo = [t for t in todo if t[2] != AS_MEAN or "more" in t[0]]
    todo = [t for t in todo if t[2] != NO_MIRROR or t[1].name == "chrome"]
    todo = [t for t in todo if t[2] != IN_LINE or any(t[0]["off"])]
    rows = [study(*each) for each in tqdm(todo)]
    if given.numbers:
        write_json(given.numbers, rows)
    print(tables.summary(("plates",), COLUMNS, groups(rows)))
    return 0
