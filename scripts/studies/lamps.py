# SPDX-License-Identifier: GPL-3.0-or-later
"""How well lamps and suns are found, on photographs by Cycles.

scripts/study lamps --make FOLDER     photographs objects under Blender's studio lights, some with a Sun lamp added
scripts/study lamps PHOTOS [PHOTOS …]

PHOTOS: folders of jobs OBJECT_MATERIAL_LIGHT, as --make or scripts/study photos leave them; a truth.json beside the job
says what was added to Blender's light. Whole estimates, preset balanced, the right material given. Prints a table of
the lights:

    lamp         how much of the true light comes from within 10 degrees of its brightest direction (or is the Sun lamp)
    found        photos in which a key light is told apart within 20 degrees of it
    direction    of the one that was found, from the true one: median (worst), and the median of what was stated
    share        of the light that it was given, over the lamp's own: median
    elsewhere    further key lights, and key lights that stand nowhere near: how many in all photos
    order 1, 2   errors of all of the light, relative L2 with one free scale: median (worst)
    over stated  the error up to order 2 over the stated one: median (worst)
    68 %, 95 %   true coefficients up to order 2 within 1 and 1.96 stated standard deviations; 95 % range: in the range
"""

import itertools
import json
from pathlib import Path

import numpy as np
from tqdm import tqdm

from btfsep_engine.conventions import pixel_directions, pixel_solid_angles
from btfsep_engine.light.maps import read_map
from btfsep_engine.light.sun import Sun
from scripts.cycles.lights import light_path, true_lighting
from scripts.studies import parser, photos, tables
from scripts.studies.estimates import estimated, worth

MADE = (  # object, material
    ("suzanne", "white"),
    ("knot", "leather/brown-grain"),
    ("vase", "fabric/denim-twill"),
    ("blob", "wood/walnut-lacquered"),
)
LIGHTS = (  # Blender's, and how much of the light a Sun lamp adds: 0.3 is 30 % of the sum
    ("sunrise", 0.0),
    ("forest", 0.0),
    ("studio", 0.0),
    ("forest", 0.3),
    ("courtyard", 0.5),
)
SUN_FROM, SUN_DEGREES = (-0.55, -0.35, 0.76), 0.526
LAMP_DEGREES, NEAR_DEGREES = 10.0, 20.0


def make(folder: Path) -> None:
    """Photographs what `MADE` and `LIGHTS` name, one job folder each; those that are there stay."""
    shots = []
    for (name, material), (light, part) in itertools.product(MADE, LIGHTS):
        job, sun = folder / f"{name}_{material.replace('/', '-')}_{light}{'sun' if part else ''}", None
        if part:
            even = np.sqrt(4 * np.pi) * true_lighting(light, 0)[0]
            sun = {"direction": SUN_FROM, "irradiance": [float(even.mean() * part / (1 - part))] * 3}
            job.mkdir(parents=True, exist_ok=True)
            (job / "truth.json").write_text(json.dumps({"light": light, **sun}))
            sun["degrees"] = SUN_DEGREES
        shots.append(photos.Shot(str(job), name, material, light, sun=sun))
    photos.take(shots, resolution=192, samples=64)


def truth_of(folder: Path, light: str):
    """True coefficients to order 9 (100, 3), the strongest light's direction (3,), and its share of all light."""
    beside = folder / "truth.json"
    if beside.exists():
        told = json.loads(beside.read_text())
        sun = Sun(told["direction"], told["irradiance"], [0, 0, 0])
        x = true_lighting(told["light"], 9) + sun.coefficients(9)
        return x, sun.direction, sun.share_of(x)
    radiance = read_map(light_path(light)).sum(2)
    toward = pixel_directions(*radiance.shape)
    brightest = toward[np.unravel_index(radiance.argmax(), radiance.shape)]
    power = radiance * pixel_solid_angles(*radiance.shape)[:, None]
    lamp = toward @ brightest > np.cos(np.radians(LAMP_DEGREES))
    return true_lighting(light, 9), brightest, float(power[lamp].sum() / power.sum())


def study(photo) -> dict:
    """One photograph."""
    truth, direction, share = truth_of(photo.folder, photo.light)
    found = estimated(photo.folder, photo.material)
    suns = found.lighting.suns
    off = [np.degrees(np.arccos(np.clip(sun.direction @ direction, -1, 1))) for sun in suns]
    near = int(np.argmin(off)) if off and min(off) < NEAR_DEGREES else None
    row = {"light": photo.light, "lamp": share, "found": near is not None, "elsewhere": len(off) - (near is not None)}
    if near is not None:
        row |= {"off": off[near], "off_stated": suns[near].direction_stddev_degrees, "share": suns[near].share / share}
    return row | worth(found, truth)


def of_found(words):
    """A column of the photos in which the lamp is found."""

    def cell(rows):
        hits = [r for r in rows if r["found"]]
        return words(hits) if hits else "–"

    return cell


def lamp(rows) -> str:
    """Of one light."""
    return "" if len({r["light"] for r in rows}) > 1 else f"{100 * rows[0]['lamp']:.0f} %"


OFF, STATED = tables.spread_of("off", "{:.1f}°"), tables.median_of("off_stated", "{:.1f}°")
COLUMNS = (
    ("photos", len),
    ("lamp", lamp),
    ("found", lambda rows: sum(r["found"] for r in rows)),
    ("direction: off, stated", of_found(lambda hits: f"{OFF(hits)}, {STATED(hits)}")),
    ("share", of_found(tables.median_of("share"))),
    ("elsewhere", lambda rows: sum(r["elsewhere"] for r in rows)),
    ("order 1", tables.spread_of("order1")),
    ("order 2", tables.spread_of("order2")),
    ("over stated", tables.spread_of("order2", over="stated2")),
    ("68 %", tables.percent_of("within68")),
    ("95 %", tables.percent_of("within95")),
    ("95 % range", tables.percent_of("inside")),
)


def main(arguments) -> int:
    options = parser("lamps", __doc__)
    options.add_argument("photos", type=Path, nargs="*")
    options.add_argument("--make", type=Path, metavar="FOLDER", help="photograph what the study is made of")
    options.add_argument("--lights", nargs="+", help="some of the lights")
    given = options.parse_args(arguments)
    if not (given.photos or given.make):
        options.error("name folders of photos, or --make FOLDER")
    if given.make:
        make(given.make.resolve())
    for root in [*([given.make] if given.make else []), *given.photos]:
        rows = [study(p) for p in tqdm(photos.photographs_in(root, lights=given.lights))]
        print(tables.summary("light", COLUMNS, tables.groups(rows, "light")) + "\n")
    return 0
