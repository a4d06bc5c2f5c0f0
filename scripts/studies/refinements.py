# SPDX-License-Identifier: GPL-3.0-or-later
"""What each refinement of the model costs, and what it is worth: the same photographs without it.

scripts/study refinements FOLDER [--sets seventh ninth]      plates, as `scripts/study plates FOLDER --make` takes them
scripts/study refinements --real FOLDER                      jobs with a truth.json, as of `scripts/study real`
scripts/study refinements --photos FOLDER                    jobs OBJECT_MATERIAL_LIGHT, as of `scripts/study photos`,
                                                             the right material given

Every photograph is estimated as a user has it, then once more for each refinement that changed something there, with
that one left out: a refinement that leaves model and light as they are is worth nothing there, and costs what it takes
to see that. Milliseconds are of all processors together, of the first estimate of a scene in a process that has its
kernels. A *camera in line* (`--align`) is counted as one; *none* are all of them left out, and the camera, too. The
error is that of `scripts/study plates`: up to order 2, one free scale, of plates on a table that of the light from
above. *Over*: the errors without it over those with it, geometric means; *worse* and *better*: photographs that err by
a tenth more or less without it.
"""

import copy
import time
from pathlib import Path

import numpy as np
from tqdm import tqdm

from btfsep_engine.pipeline import mending
from btfsep_engine.pipeline.estimation import REFINEMENTS
from btfsep_engine.pipeline.settings import choose
from btfsep_engine.storage.atomic import write_json
from scripts.studies import parser, photos, plate_sets, plates, tables
from scripts.studies.estimates import estimated, scene_of, worth
from scripts.studies.measures import ERROR_ORDER
from scripts.studies.real import true_light

CAMERA, NONE, ALL = "camera in line", "none", "all"
WAYS = (CAMERA, *(r.__name__ for r in REFINEMENTS), NONE)
SETS = ("seventh", "ninth")
A_TENTH = 1.1


class Watched:
    """Refinements that write down what they take, and whether they change anything."""

    def __init__(self, refinements):
        self.milliseconds, self.changed = {}, set()
        self.each = [self._watched(refinement) for refinement in refinements]

    def _watched(self, refinement):
        name = refinement.__name__

        def watched(model, light):
            begun = time.process_time()
            other, found, words = refinement(model, light)
            self.milliseconds[name] = 1e3 * (time.process_time() - begun)
            if other is not model or found is not light:
                self.changed.add(name)
            return other, found, words

        return watched


def study(name: str, opened, judge, only, material: str | None = None) -> list[dict]:
    """Rows of a photograph: {"name", "way", "ms" of each refinement (of way `ALL`), "order2", "stated2"}.

    Parameters
    ----------
    opened : () -> PreparedScene, one whose camera nothing was done to
    judge : Estimate -> what it is worth
    only : ways to look at
    material : of all objects; None: as the job says
    """
    watched, scene = Watched(REFINEMENTS), opened()
    begun = time.process_time()
    mended = mending.mended(scene, choose())
    spent = {CAMERA: 1e3 * (time.process_time() - begun)}

    def in_line(refinements) -> dict:
        return judge(estimated(copy.copy(mended), material, refinements=refinements, align="never"))

    def as_it_was(**how) -> dict:
        return judge(estimated(opened(), material, align="never", **how))

    rows = [{"name": name, "way": ALL} | in_line(watched.each)]
    rows[0]["ms"] = spent | watched.milliseconds
    for left_out in [r for r in REFINEMENTS if r.__name__ in watched.changed & only]:
        others = [r for r in REFINEMENTS if r is not left_out]
        rows.append({"name": name, "way": left_out.__name__} | in_line(others))
    if mended is not scene and CAMERA in only:
        rows.append({"name": name, "way": CAMERA} | as_it_was())
    if NONE in only:
        rows.append({"name": name, "way": NONE} | as_it_was(refinements=()))
    return rows


def of_plate(plate, folder: Path, only) -> list[dict]:
    """Rows of a plate."""
    return study(
        f"{folder.name} {plate['name']}",
        lambda: scene_of(folder / plate["name"] / "job"),
        lambda found: plates.worth_of(plate, found, folder),
        only,
    )


def of_real(folder: Path, only) -> list[dict]:
    """Rows of a job with a truth."""
    truth = true_light(folder)
    return study(folder.name, lambda: scene_of(folder), lambda found: worth(found, truth, free_scale=True), only)


def of_photo(shown: photos.Photograph, only) -> list[dict]:
    """Rows of a photograph by Cycles."""
    truth = shown.truth(ERROR_ORDER)
    opened, judge = lambda: scene_of(shown.folder), lambda found: worth(found, truth)
    return study(shown.folder.name, opened, judge, only, shown.material)


HEAD = (
    "left out", "ms", "changes", "over", "worse", "better",
    "error without it", "with it", "over stated without it", "with it",
)  # fmt: skip


def summary(rows, only) -> str:
    """A line for each way that was looked at, the dearest first, and one for all refinements left out."""
    whole = {r["name"]: r for r in rows if r["way"] == ALL}
    names = sorted(next(iter(whole.values()))["ms"], key=lambda n: -np.mean([r["ms"][n] for r in whole.values()]))
    lines = []
    for way in [way for way in (*names, NONE) if way in only]:
        without = [r for r in rows if r["way"] == way]
        pairs = without, [whole[r["name"]] for r in without]
        ms = [r["ms"][way] for r in whole.values() if way != NONE]
        cells = [way.replace("_", " "), f"{np.mean(ms):.0f} ({max(ms):.0f})" if ms else "–", len(without)]
        if without:
            errors, stated = (np.array([[r[key] for r in some] for some in pairs]) for key in ("order2", "stated2"))
            ratio = errors[0] / errors[1]
            cells += [f"{np.exp(np.log(ratio).mean()):.2f}", (ratio > A_TENTH).sum(), (ratio < 1 / A_TENTH).sum()]
            cells += [tables.spread(each) for each in (*errors, *(errors / stated))]
        lines.append([*cells, *["–"] * (len(HEAD) - len(cells))])
    return f"{len(whole)} photographs.\n\n{tables.table(HEAD, lines)}"


def main(arguments) -> int:
    options = parser("refinements", __doc__)
    options.add_argument("folder", type=Path, nargs="?", help="of plates")
    options.add_argument("--sets", nargs="+", choices=list(plate_sets.SETS), default=SETS)
    options.add_argument("--real", type=Path, metavar="FOLDER", help="jobs with a truth.json")
    options.add_argument("--photos", type=Path, metavar="FOLDER", help="jobs OBJECT_MATERIAL_LIGHT")
    options.add_argument("--only", nargs="+", choices=WAYS, default=WAYS, metavar="WAY", help="; ".join(WAYS))
    options.add_argument("--numbers", type=Path, metavar="FILE", help="write all numbers, JSON")
    given = options.parse_args(arguments)
    todo = []
    if given.folder:
        for name in given.sets:
            todo += [(of_plate, plate, given.folder.resolve() / name) for plate in plate_sets.of_set(name)]
    if given.real:
        todo += [(of_real, truth.parent) for truth in sorted(given.real.glob("*/truth.json"))]
    if given.photos:
        todo += [(of_photo, shown) for shown in photos.photographs_in(given.photos)]
    if not todo:
        options.error("give a folder of plates, --real FOLDER or --photos FOLDER")
    only = set(given.only)
    todo[0][0](*todo[0][1:], set())  # its kernels are not counted
    rows = [row for rows_of, *what in tqdm(todo) for row in rows_of(*what, only)]
    if given.numbers:
        write_json(given.numbers, rows)
    print(summary(rows, only))
    return 0
