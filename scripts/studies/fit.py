# SPDX-License-Identifier: GPL-3.0-or-later
"""What the fit finds and states about itself, on photographs by Cycles: errors, ranges, lamps, warnings, cost.

scripts/study fit PHOTOS           a folder of jobs OBJECT_MATERIAL_LIGHT, as scripts/study photos leaves it
scripts/study fit PHOTOS --cost    milliseconds alone

The right material, 3,000 pixels (ours: the means of like ones, where the photo is textured), order 9, light between
surfaces followed, least squares on the same basis images and single pixels.
Prints: errors by method; the error over the expected one, and how many true coefficients lie within 1 and 1.96 stated
standard deviations and in the stated 95 % range; what light was elected; with --spheres the si-RMSE of the
three-spheres protocol, all of the light against the whole map; how often each doubt is raised with the right material,
a wrong one, a photo shifted by pixels, a light nearby (brightness by the inverse square of the distance to a lamp at 4
radii, laid over the photo) and without reflections. Photos under the lights of --tuned, on which constants of the fit
were looked at, stand apart from all others.

--cost: milliseconds of the processor, warm, on one thread, medians over the views of the median of --repeats runs, in
turns so that a busy machine is busy for all. "preparing": the products of the basis images; "photo": the election of a
model, its light and its posterior's samples; "further": another photograph under much the same light (a frame of a
sequence), with the model of the one before, from its light on. The floor is A^T A (3,000 x 300) in double precision.
"""

from collections import defaultdict
from copy import copy
from dataclasses import replace
from itertools import count
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits
from tqdm import tqdm

from btfsep_engine.btf.library import open_library
from btfsep_engine.fit.diagnose import diagnose
from btfsep_engine.fit.least_squares import solve
from btfsep_engine.fit.misalignment import silhouette_shift
from btfsep_engine.fit.stated import Fit
from btfsep_engine.fit.three_spheres import ROWS, three_spheres
from btfsep_engine.job.load import load_job
from btfsep_engine.light.files import Lighting, lighting_map
from btfsep_engine.light.maps import read_map
from btfsep_engine.linear_algebra import product
from btfsep_engine.pipeline import doubts
from btfsep_engine.pipeline.light_account import sky_radiance
from btfsep_engine.pipeline.like_pixels import as_seen_on_the_whole
from btfsep_engine.pipeline.model import stand_ins
from btfsep_engine.pipeline.points import chosen_points, photographed_regions
from btfsep_engine.pipeline.problem import make_problem
from btfsep_engine.pipeline.refine.interreflection import open_share
from btfsep_engine.pipeline.refine.order import cross_validated_order
from btfsep_engine.pipeline.settings import choose
from btfsep_engine.pipeline.together import light_solver
from btfsep_engine.storage.kept import STORE
from scripts.cycles.lights import light_path
from scripts.studies import parser, photos, tables
from scripts.studies.estimates import scene_of
from scripts.studies.measures import errors, judged, timed

SHIFTS = (1, 2, 4)
FRAME = 1.02  # brightness of a further frame over the one before
LAMP_RADII, LAMP = 4, np.array([-0.6, -0.5, 0.62])
WORDS = {"line up": "shift", "nearby": "near", "not modelled": "reflections", "does not go": "material"}
ORDERS = (2, 3, 4)
PAPER, CHOSEN, OURS = "least squares, order 4 (the paper)", "least squares, order cross-validated", "ours"
METHODS = ("least squares, order 2", "least squares, order 3", PAPER, CHOSEN, OURS)
SPHERES = ("diffuse", "matte_silver", "mirror")
COLUMNS = {"order1": "order 1", "order2": "order 2", "order4": "order 4", "order2_absolute": "order 2, no scale"}


class View:
    """One object in one material, whatever the light: what is made of it once."""

    def __init__(self, shown: list, library):
        self.scene, self.library, self.name = scene_of(shown[0].folder), library, shown[0]
        self.settings = choose("balanced")
        regions = photographed_regions(self.scene, self.settings)
        self.points = chosen_points(self.scene, self.settings, regions=regions, textured=False)[0]
        self.opened = open_share(self.scene, self.points)
        self.right = self.problem(self.name.material)

    def problem(self, name: str, **changes):
        """The pixels' basis images in a material."""
        how = choose("balanced", **changes)
        return make_problem(self.scene, stand_ins([self.library.load(name)], how.appearance), [self.points], how)

    def solver(self, *of, **changes):
        return light_solver([self.problem(*of, **changes)], choose("balanced", **changes))

    def values(self, photo) -> np.ndarray:
        """The pixels' values (p, 3)."""
        return photo[tuple(self.points.pixels.T)].astype(np.float64)

    def fitted(self, job) -> Fit:
        """An estimate's fit of a job of this view: of textured photographs, to the means of like pixels."""
        scene = copy(self.scene)
        scene.job = job
        seen = as_seen_on_the_whole(replace(self.right, scene=scene), self.settings)
        return light_solver([seen], self.settings).solve(seen.radiance())

    def doubts(self, solver, b, photo) -> dict:
        """Which doubts an estimate raises, as `pipeline.checks.all_doubts` does."""
        if doubts.alignment_doubt(silhouette_shift(photo, self.scene.view.mesh >= 0)):
            return {"raised": ["shift"]}
        p, fit = self.points, solver.solve(b)
        where = {"position": p.position, "normal": p.normal, "open_share": self.opened}
        effects = diagnose(solver, fit, b, blocks=self.right.blocks, **where)
        said = doubts.structure_doubts(effects, residual=fit.residual, names=["it"])
        return {"raised": [short for text in said for key, short in WORDS.items() if key in text]}

    def doubtful(self, solver, others: dict, photo):
        """(what is given, solver, values, photograph) of everything that should be doubted, and of what should not."""
        b = self.values(photo)
        yield "right", solver, b, photo
        for kind, each in others.items():
            yield kind.split(":")[0], each, b, photo
        for pixels in SHIFTS:
            moved = np.roll(photo, pixels, 1)
            yield f"{pixels} px to the right", solver, self.values(moved), moved
        place = self.points.position - self.points.position.mean(0)
        radius = np.sqrt(np.square(place).sum(1).max())
        yield "light nearby", solver, b / (1 - place @ LAMP / (LAMP_RADII * radius))[:, None] ** 2, photo


def on_spheres(fit, light: str) -> dict:
    """si-RMSE of each of `SPHERES`, of all of a fit's light, lamps as they are, against Blender's map of a light."""
    lighting = Lighting(fit.order, fit.coefficients, fit.stddev, fit.determined)
    estimate = lighting_map(lighting, ROWS, 2 * ROWS, radiance=sky_radiance(fit, lighting))
    found = three_spheres(estimate, read_map(light_path(light)))
    return {kind: found[kind]["si_rmse"] for kind in SPHERES}


def study(shown: list, library, given):
    """All lights of one object and material: rows of errors, and of doubts."""
    view = View(shown, library)
    solver, others = light_solver([view.right], view.settings), {}
    if not given.quick:
        wrong = [m for m in map(photos.library_name, photos.MATERIALS) if m != view.name.material]
        others = {f"wrong material: {n}": view.solver(n) for n in wrong}
        others["no reflections"] = view.solver(view.name.material, bounces=1)
    rows, raised = [], []
    for shot in shown:
        job = load_job(shot.folder)
        photo = job.photo.radiance
        b, tuned, truth = view.values(photo), shot.light in given.tuned, shot.truth(4)
        fit, basis, blocks = view.fitted(job), view.right.all_basis, view.right.blocks
        order, _ = cross_validated_order(basis, b, blocks, view.settings.fit_order)
        *plain, chosen = (solve(basis[:, : (n + 1) ** 2], b, blocks=blocks).coefficients[:25] for n in (*ORDERS, order))
        plain.append(np.pad(chosen, ((0, 25 - len(chosen)), (0, 0))))  # what it left out, it took for 0
        rows.append(
            {
                "material": shot.shown,
                "light": shot.light,
                "tuned": tuned,
                "even": fit.election.solution.model.field.order == 0,
                "lamps": len(fit.lamps),
                "by method": {
                    m: errors(x, truth, (1, 2, 4)) for m, x in zip(METHODS, (*plain, fit.coefficients), strict=True)
                },
                **judged(fit, fit.samples, truth),
                **(on_spheres(fit, shot.light) if given.spheres else {}),
            }
        )
        if not given.quick:
            for kind, how, values, image in view.doubtful(solver, others, photo):
                raised.append({"kind": kind, "tuned": tuned, **view.doubts(how, values, image)})
    return rows, raised


def cost(shown: list, library, repeats: int) -> dict:
    """Milliseconds of what is compared, what is stated included, of one object in one material: {name: median}."""
    view = View(shown, library)
    images = [view.values(load_job(p.folder).photo.radiance) for p in shown]
    a = np.ascontiguousarray(view.right.all_basis).reshape(len(images[0]), -1).astype(np.float64)
    solver, turn = light_solver([view.right], view.settings), count()
    before = [solver.solve(image) for image in images]
    noise = np.random.default_rng(0).normal(FRAME, 0.02, (len(images), len(images[0]), 1))

    def further():
        i = next(turn) % len(images)
        return solver.solve(images[i] * noise[i], start=before[i]).state()

    calls = {
        "floor": lambda: product(a.T, a),
        "preparing": lambda: STORE.forget() or light_solver([view.right], view.settings),
        "photo": lambda: solver.solve(images[next(turn) % len(images)]).state(),
        "further": further,
    }
    spent = defaultdict(list)
    for i in range(repeats + 1):
        for name, call in calls.items():
            seconds, _ = timed(call)
            spent[name] += [1000 * seconds[1]] if i else []  # the first is not counted
    return {name: float(np.median(values)) for name, values in spent.items()}


def of_cost(views: list, library, given):
    """Medians of some of the views, and over the floor's."""
    chosen = np.linspace(0, len(views) - 1, min(given.views, len(views))).round().astype(int)
    with threadpool_limits(1):
        found = [cost(views[i], library, given.repeats) for i in tqdm(chosen)]
    for what in found[0]:
        ms, ratio = np.median([(times[what], times[what] / times["floor"]) for times in found], 0)
        yield what, f"{ms:.1f}", f"{ratio:.2f}"


def of_methods(rows):
    """Errors by method, median and worst; and how much better than the paper's on the same photograph."""
    paper = np.array([r["by method"][PAPER]["order2"] for r in rows])
    for name in METHODS:
        found = [r["by method"][name] for r in rows]
        over = np.array([f["order2"] for f in found]) / paper
        yield name, *(tables.spread([f[key] for f in found]) for key in COLUMNS), f"{np.median(over):.2f}"


def of_lights(rows):
    """Errors by light, and the light that was elected."""
    for light, some in tables.groups(rows, "light", every="all"):
        ours = [r["by method"][OURS] for r in some]
        cells = [tables.spread([e[key] for e in ours]) for key in ("order1", "order2", "order4")]
        lamps = f"{np.mean([r['lamps'] for r in some]):.1f}"
        yield light, len(some), *cells, tables.percent([r["even"] for r in some]), lamps


def of_ranges(rows, key):
    """By material or light, the error over the expected one, and how many true coefficients lie in stated ranges."""
    for name, some in tables.groups(rows, key, every="all"):
        cells = []
        for order in (1, 2):
            e, x = np.array([(r[f"order{order}"], r[f"stated{order}"]) for r in some]).T
            cells.append(f"{np.median(e):.2f}, {np.median(x):.2f}, {np.median(e / x):.2f} (worst {max(e / x):.2f})")
        yield name, *cells, *(tables.percent([r[k] for r in some]) for k in ("within68", "within95", "inside"))


def of_spheres(rows):
    """By light, the si-RMSE of the three spheres."""
    for light, some in tables.groups(rows, "light", every="all"):
        yield light, len(some), *(tables.spread([r[kind] for r in some], "{:.3f}") for kind in SPHERES)


def of_doubts(raised):
    """How often each doubt is raised."""
    for kind, some in tables.groups(raised, "kind", every=None):
        cells = [tables.percent([bool(f["raised"]) for f in some])]
        cells += [tables.percent([n in f["raised"] for f in some]) for n in WORDS.values()]
        yield kind, len(some), *cells


def show(rows, raised, *, keys=(), lights=False) -> None:
    """The tables of some of the photographs."""
    print(tables.table(["method", *COLUMNS.values(), "order 2 over the paper's"], of_methods(rows)))
    if lights:
        heads = ("light", "photos", "order 1", "order 2", "order 4", "even light and lamps", "lamps a photo")
        print("\n" + tables.table(heads, of_lights(rows)))
    if SPHERES[0] in rows[0]:
        heads = ("light", "photos", *(kind.replace("_", " ") for kind in SPHERES))
        print("\n" + tables.table(heads, of_spheres(rows)))
    heads = ("order 1: error, stated, ratio", "order 2: error, stated, ratio", "68 %", "95 %", "95 % range")
    for key in keys:
        print("\n" + tables.table((key, *heads), of_ranges(rows, key)))
    if raised:
        print("\n" + tables.table(("what is given", "photos", "any", *WORDS.values()), of_doubts(raised)))


def main(arguments) -> int:
    options = parser("fit", __doc__)
    options.add_argument("photos", type=Path)
    options.add_argument("--quick", action="store_true", help="without doubts, and what raises them")
    options.add_argument(
        "--tuned", nargs="*", default=["courtyard", "forest"], help="lights that constants were looked at on"
    )
    options.add_argument("--objects", nargs="+", help="some of the objects")
    options.add_argument("--cost", action="store_true", help="milliseconds alone")
    options.add_argument("--spheres", action="store_true", help="the three spheres, too: a second or two a photo")
    options.add_argument("--repeats", type=int, default=15, help="of --cost")
    options.add_argument("--views", type=int, default=6, help="of --cost, spread over the objects and materials")
    given = options.parse_args(arguments)
    library, rows, raised = open_library(None), [], []
    views = list(photos.views(photos.photographs_in(given.photos, objects=given.objects)).values())
    if given.cost:
        print(tables.table(("", "ms", "over the floor"), of_cost(views, library, given)))
        return 0
    for shown in tqdm(views):
        more, doubted = study(shown, library, given)
        rows, raised = rows + more, raised + doubted
    tuned = f"Lights that constants were looked at on ({', '.join(given.tuned)})"
    for which, words in ((False, "Other lights"), (True, tuned)):
        part = [r for r in rows if r["tuned"] == which]
        if part:
            print(f"\n### {words}: {len(part)} photos\n")
            show(part, [f for f in raised if f["tuned"] == which], keys=("material", "light"))
    print(f"\n### All {len(rows)} photos\n")
    show(rows, [], keys=("material",), lights=True)
    return 0
