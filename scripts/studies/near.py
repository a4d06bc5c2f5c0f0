# SPDX-License-Identifier: GPL-3.0-or-later
"""How near a lamp stands, and what it is worth to know that, on the stability study's photographs by Cycles.

scripts/study stability --work FOLDER --axes "near light" --stages photos
scripts/study near FOLDER

Half of the light comes from a ball that stands 1.5 to 12 radii from the middle of the object, the rest from one of
Blender's studio lights; each of the four objects under both. Whole estimates, preset balanced, the right material
given; errors are of the light at the middle, relative, with one free scale: median (worst). Prints a row a distance:

    believed     photographs in which a lamp is said to stand near
    distance     of those, over the true one: median (least to most); inside: in how many the true one is in the range
    direction    of that lamp, off: median (worst)
    order 2      the error, and the same where all light is taken to come from far away; stated: the expected error
"""

import tempfile
from pathlib import Path

import numpy as np
from tqdm import tqdm

from btfsep_engine.btf.library import open_library
from btfsep_engine.job.load import load_job
from btfsep_engine.pipeline.estimation import estimate
from btfsep_engine.pipeline.refine import near
from btfsep_engine.pipeline.scene import PreparedScene
from btfsep_engine.pipeline.settings import choose
from btfsep_engine.progress import Reporter
from scripts.studies import parser, tables
from scripts.studies.measures import judged
from scripts.studies.stability import scenes
from scripts.studies.stability.axes import AXES, Setting
from scripts.studies.stability.cases import write_job

HEADS = (
    "distance, radii", "photos", "believed", "distance, over the true one", "inside", "direction", "order 2",
    "all far away", "over stated", "over stated, all far away", "95 % range",
)  # fmt: skip


def study(setting: Setting, radii: float, library) -> dict:
    """One photograph, with and without lamps that may stand near."""
    case = AXES["near light"].make(setting, radii)
    with tempfile.TemporaryDirectory() as folder:
        write_job(case, folder)
        job = load_job(folder)
    row, usual = {"radii": radii}, near.SPEAKS
    try:
        for name, speaks in (("", usual), ("far ", np.inf)):
            near.SPEAKS = speaks
            found = estimate(PreparedScene(job, Reporter()), library, choose(), material=case.material)
            row |= {name + k: v for k, v in judged(found.lighting, found.fit.samples, case.truth).items()}
            if found.light.near:
                corners = job.objects[0].mesh.vertices
                true = radii * np.linalg.norm(np.ptp(corners, axis=0)) / 2
                direction, how = found.light.near[0]
                off = float(np.degrees(np.arccos(np.clip(direction @ scenes.unit(scenes.LAMP_FROM), -1, 1))))
                row |= {"ratio": how.distance / true, "inside range": how.low <= true <= how.high, "off": off}
    finally:
        near.SPEAKS = usual
    return row


def lines(rows):
    """Each distance, and all."""
    for name, some in tables.groups(rows, "radii"):
        told = [r for r in some if "ratio" in r]
        ratios = np.array([r["ratio"] for r in told])
        between = f"{np.median(ratios):.2f} ({ratios.min():.2f} to {ratios.max():.2f})" if told else "–"
        yield (
            name if isinstance(name, str) else f"{name:g}",
            len(some),
            len(told),
            between,
            sum(r["inside range"] for r in told),
            tables.spread([r["off"] for r in told], "{:.1f}°"),
            tables.spread([r["order2"] for r in some]),
            tables.spread([r["far order2"] for r in some]),
            tables.spread([r["order2"] / r["stated2"] for r in some]),
            tables.spread([r["far order2"] / r["far stated2"] for r in some]),
            tables.percent([r["inside"] for r in some]),
        )


def main(arguments) -> int:
    options = parser("near", __doc__)
    options.add_argument("work", type=Path, help="folder of the stability study's photographs")
    given = options.parse_args(arguments)
    library = open_library(None)
    settings = [Setting(given.work, s, light, scenes.LIGHTS) for s in scenes.SCENES for light in scenes.LIGHTS]
    todo = [(setting, radii) for radii in scenes.NEAR for setting in settings]
    rows = [study(setting, radii, library) for setting, radii in tqdm(todo)]
    print(tables.table(HEADS, lines(rows)))
    return 0
