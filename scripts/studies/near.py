# SPDX-License-Identifier: GPL-3.0-or-later
"""How near a lamp stands, and what it is worth to know that, on the stability study's photographs by Cycles.

scripts/study stability --work FOLDER --axes "near light" --stages photos
scripts/study near FOLDER
scripts/study near FOLDER --pairs        two lamps

Half of the light comes from a ball that stands 1.5 to 12 radii from the middle of the object, the rest from one of
Blender's studio lights; each of the four objects under both. With --pairs a quarter comes from each of two lamps (a
right angle apart; one may be far away), the rest from one studio light. Whole estimates, preset balanced, the right
material given; errors are of the light at the middle, relative, with one free scale: median (worst). Prints a row a
distance:

    believed     lamps that are said to stand near, within 30 degrees of a true one that does; elsewhere: that are not
    distance     of those, over the true one: median (least to most); inside: of how many the true one is in the range
    direction    of those, off: median (worst)
    order 2      the error, and the same where all light is taken to come from far away; stated: the expected error
"""

import tempfile
from functools import partial
from pathlib import Path

import numpy as np
from tqdm import tqdm

from btfsep_engine.job.load import load_job
from btfsep_engine.pipeline.estimation import REFINEMENTS
from btfsep_engine.pipeline.refine.near import near_lamps
from scripts.studies import parser, photos, tables
from scripts.studies.estimates import estimated, kept, worth
from scripts.studies.stability import NOISE, scenes
from scripts.studies.stability.axes import Setting, with_lamps
from scripts.studies.stability.cases import undisturbed, write_job

EDGE, SAMPLES = 160, 64  # of a photograph: the stability study's defaults
SHARE = 0.5  # of all light, of the lamps together

FIRST, SECOND, FAR = scenes.LAMP_FROM, scenes.SECOND_FROM, scenes.SUNS[1]
PAIRS = (
    ((1.5, FIRST), (2.2, SECOND)),
    ((2.2, FIRST), (3.5, SECOND)),
    ((3.5, FIRST), (2.2, SECOND)),
    ((2.2, FIRST), (None, FAR)),
)
SAME = 30.0  # degrees: a lamp that is believed in and stands no nearer to any is none of them


def study(setting: Setting, lamps) -> dict:
    """One photograph under lamps (distance in radii, or None: far away; direction), with and without places of them."""
    case = undisturbed(setting.work, setting.scene, setting.light)
    with_lamps(case, setting, lamps, SHARE)
    with tempfile.TemporaryDirectory() as folder:
        write_job(case, folder)
        job = load_job(folder)
    row = {"radii": " and ".join("far" if d is None else f"{d:g}" for d, _ in lamps)}
    row |= {"scene": setting.scene.name, "light": setting.light, "lamps": []}
    for name, refinements in (("", None), ("far ", [r for r in REFINEMENTS if r is not near_lamps])):
        found = estimated(job, case.material, refinements=refinements)
        row |= {name + k: v for k, v in worth(found, case.truth).items()}
        row["lamps"] += [beside_truth(lamps, direction, how, job) for direction, how in found.light.near]
        row[name + "said"] = found.choice.get("near")
    return row


def beside_truth(lamps, direction, how, job) -> dict:
    """What is said of a lamp that is believed to stand near, beside the true one in its direction (or none)."""
    unit = float(np.linalg.norm(np.ptp(job.objects[0].mesh.vertices, axis=0))) / 2
    off = [float(np.degrees(np.arccos(np.clip(direction @ scenes.unit(d), -1, 1)))) for _, d in lamps]
    which = int(np.argmin(off))
    true = lamps[which][0]
    if true is None or off[which] > SAME:
        return {"of": None, "off": off[which]}
    away = {"ratio": how.distance / (unit * true), "inside": how.low <= unit * true <= how.high}
    return {"of": which, "off": off[which], **away}


def right(rows) -> list:
    """The lamps that are believed to stand near, and do."""
    return [lamp for r in rows for lamp in r["lamps"] if lamp["of"] is not None]


def believed(rows):
    """How many lamps, of how many where there are more than photos, and those that stand nowhere near."""
    wrong = sum(len(r["lamps"]) for r in rows) - len(right(rows))
    there = sum(word != "far" for r in rows for word in r["radii"].split(" and "))
    elsewhere = f", {wrong} elsewhere" if wrong else ""
    return f"{len(right(rows))} of {there}{elsewhere}" if there > len(rows) or wrong else len(right(rows))


def distance(rows) -> str:
    """Over the true one, median (least to most)."""
    ratios = np.array([lamp["ratio"] for lamp in right(rows)])
    return f"{np.median(ratios):.2f} ({ratios.min():.2f} to {ratios.max():.2f})" if len(ratios) else "–"


COLUMNS = (
    ("photos", len),
    ("believed", believed),
    ("distance, over the true one", distance),
    ("inside", lambda rows: sum(lamp["inside"] for lamp in right(rows))),
    ("direction", lambda rows: tables.spread([lamp["off"] for lamp in right(rows)], "{:.1f}°")),
    ("order 2", tables.spread_of("order2")),
    ("all far away", tables.spread_of("far order2")),
    ("over stated", tables.spread_of("order2", over="stated2")),
    ("over stated, all far away", tables.spread_of("far order2", over="far stated2")),
    ("95 % range", tables.percent_of("inside")),
)


def main(arguments) -> int:
    options = parser("near", __doc__)
    options.add_argument("work", type=Path, help="folder of the stability study's photographs")
    options.add_argument("--pairs", action="store_true", help="two lamps; what is not there is photographed")
    options.add_argument("--only", nargs="+", choices=[s.name for s in scenes.SCENES], help="some of the objects")
    options.add_argument("--keep", type=Path, help="folder for each photo's numbers: what is there is not done again")
    given = options.parse_args(arguments)
    chosen = [s for s in scenes.SCENES if not given.only or s.name in given.only]
    lights = scenes.LIGHTS[:1] if given.pairs else scenes.LIGHTS
    many = PAIRS if given.pairs else [((d, FIRST),) for d in scenes.NEAR]
    if given.pairs:
        axes = ("near light", "second lamp", "sun")
        wanted = [shot for s in chosen for shot in scenes.shots(given.work, s, lights, axes, under=lights)]
        photos.take(wanted, resolution=EDGE, samples=SAMPLES, threads=2, noise=NOISE)
    rows = []
    settings = [Setting(given.work, s, light, scenes.LIGHTS) for s in chosen for light in lights]
    for lamps, setting in tqdm([(lamps, setting) for lamps in many for setting in settings]):
        name = "_".join([setting.scene.name, setting.light, *(scenes.lamp_name(lamp) for lamp in lamps)])
        rows.append(kept(given.keep, name, partial(study, setting, lamps)))
    print(tables.summary("distance, radii", COLUMNS, tables.groups(rows, "radii")))
    return 0
