# SPDX-License-Identifier: GPL-3.0-or-later
"""How the estimate's error depends on which and how many pixels, on directions, and on light between surfaces.

scripts/study sampling PHOTOS            the photos that scripts/study photos leaves; what lacks is made
scripts/study sampling PHOTOS --quick    one object of each material, not two

Photographs by Cycles of displaced objects under Blender's own studio lights, which nothing was trained on; the
material given. Prints tables and draws docs/results/images/sampling.png; docs/results/sampling.md has them in words.
The table with a small ball is synthetic (our own transport, 10 % noise): it only says which pixels tell more.
"""

from collections import defaultdict
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import trimesh
from scipy.ndimage import distance_transform_edt
from tqdm import tqdm

from btfsep_engine.btf.library import open_library
from btfsep_engine.btf.model import Lambertian
from btfsep_engine.job.load import load_job
from btfsep_engine.job.model import TriangleMesh
from btfsep_engine.light.maps import natural_amplitude
from btfsep_engine.pipeline.model import Model
from btfsep_engine.pipeline.problem import Problem, make_problem
from btfsep_engine.pipeline.refine.interreflection import own_light, with_own_light
from btfsep_engine.pipeline.settings import MODELLED_BOUNCES, choose
from btfsep_engine.pipeline.together import fit_together, light_solver
from btfsep_engine.render import sampling
from scripts.cycles.lights import true_lighting
from scripts.studies import ROOT, parser, photos, stage, tables
from scripts.studies.estimates import scene_of
from scripts.studies.measures import order2
from scripts.studies.photos import LIGHTS, MATERIALS, OBJECTS

COUNTS, COUNT = (125, 250, 500, 1000, 2000, 4000), 1000
SHOWN = (250, COUNT, 4000)  # counts at which the rules are compared
DIRECTIONS, EXACT, DIRECTION_PIXELS = (32, 64, 128, 256, 512, 1024), 2048, 700
MARGINS = (2, 4)
OF_THE_POOL = 256  # directions of the study of pixels
MODELLED = choose(bounces=MODELLED_BOUNCES)


RULES = {  # (points, count, *, seed) -> indices
    "at random": lambda points, n, *, seed: np.sort(np.random.default_rng(seed).permutation(len(points))[:n]),
    "even over the picture": sampling.spread,
    "even over place and normal": partial(sampling.choose_pixels, leverage_share=0),
    "by information": sampling.choose_pixels,
}
DEFAULT, BASE = "by information", "even over the picture"


def part(problem: Problem, index) -> Problem:
    """The problem with some of its pixels."""
    return replace(problem, points=[problem.points[0].take(index)], basis=[problem.basis[0][index]])


def errors(problem: Problem, views, settings):
    """Errors up to order 2, one free scale, and fits of every (photo, true coefficients)."""
    solver = light_solver([problem], settings)
    fits = [solver.solve(problem.radiance(photo).astype(np.float64)) for photo, _ in views]
    return [order2(f.coefficients, truth) for f, (_, truth) in zip(fits, views, strict=True)], fits


class Study:
    """What one run collects: (table, row) -> list of values."""

    def __init__(self):
        self.rows, self.settings = defaultdict(list), choose("balanced", directions=OF_THE_POOL, bounces=1)

    def scene(self, name, material_name, views, scene, material):
        """Every measurement of one object in one material; ``views`` are (photo, truth)."""
        points = scene.points(0, textured=False)
        points = points.take(np.flatnonzero(scene.usable(points)))
        pool = make_problem(scene, [material], [points], self.settings)
        few = part(pool, sampling.choose_pixels(points, COUNT))
        if self.between_surfaces(f"{material_name}, {name}", few, views):
            pool = with_own_light(pool, MODELLED)
        self.pixels(material_name, pool, views)
        self.directions(material_name, few, material, views)

    def pixels(self, material_name, pool, views):
        """Which pixels, and how many."""
        points = pool.points[0]
        for rule, chosen in RULES.items():
            for count in COUNTS if rule == DEFAULT else SHOWN:
                for seed in (0, 1) if count < COUNT else (0,):
                    found, _ = errors(part(pool, chosen(points, count, seed=seed)), views, self.settings)
                    self.rows["pixels", rule, count, material_name] += found
        shown = distance_transform_edt(np.pad(pool.scene.view.mesh == 0, 1))[1:-1, 1:-1]
        for margin in MARGINS:
            inner = np.flatnonzero(shown[tuple(points.pixels.T)] > margin)
            index = inner[sampling.choose_pixels(points.take(inner), COUNT)]
            found, _ = errors(part(pool, index), views, self.settings)
            self.rows["pixels", f"{margin} pixels off the outline", COUNT, material_name] += found

    def directions(self, material_name, few, material, views):
        """How many directions, and what the doubling foretells."""
        scene, points = few.scene, few.points[0].take(sampling.spread(few.points[0], DIRECTION_PIXELS))
        by_count = {
            n: make_problem(scene, [material], [points], choose(directions=n, bounces=1)) for n in (*DIRECTIONS, EXACT)
        }
        _, exact = errors(by_count[EXACT], views, self.settings)
        natural = natural_amplitude(9)[:, None]

        def apart(one, other):
            one, other = by_count[one].basis[0] * natural, by_count[other].basis[0] * natural
            return float(np.linalg.norm(one - other) / np.linalg.norm(other))

        for n in DIRECTIONS:
            found, fits = errors(by_count[n], views, self.settings)
            moved = [np.abs(f.coefficients - e.coefficients) / e.stddev for f, e in zip(fits, exact, strict=True)]
            self.rows["directions", "error", n, material_name] += found
            self.rows["directions", "moved", n, material_name] += [float(m.max()) for m in moved]
            self.rows["directions", "images", n, material_name].append(apart(n, EXACT))
            if 2 * n in by_count:
                self.rows["directions", "doubling", n, material_name].append(apart(n, 2 * n))

    def between_surfaces(self, name, few, views) -> bool:
        """What light between surfaces does to the estimates; whether any of them needs it."""
        needed = False
        off, _ = errors(few, views, self.settings)
        on, _ = errors(with_own_light(few, MODELLED), views, self.settings)
        for (photo, _), error_off, error_on in zip(views, off, on, strict=True):
            job = few.scene.job
            few.scene.job = replace(job, photo=replace(job.photo, radiance=photo))
            model, light = Model(self.settings, {"mean": [few]}), fit_together([few], self.settings)
            answer = own_light(model, light, bounces=MODELLED_BOUNCES)
            few.scene.job = job
            values = (answer.share or 0.0, error_off, error_on)
            for key, value in zip(("share", "off", "on"), values, strict=True):
                self.rows["between", key, name].append(value)
            needed |= answer.modelled
        return needed

    def table_with_ball(self):
        """Synthetic: a small ball on a table, where few pixels have the normals that tell most."""
        table = trimesh.creation.box([2.2, 2.2, 0.1]).apply_translation([0, 0, -0.6])
        ball = trimesh.creation.icosphere(4, radius=0.12).apply_translation([0.3, 0.2, -0.5])
        whole = trimesh.util.concatenate([table, ball])
        normals = np.concatenate([np.repeat(table.face_normals[:, None], 3, 1), ball.vertex_normals[ball.faces]])
        mesh = TriangleMesh(np.asarray(whole.vertices), np.asarray(whole.faces, np.int32), normals.astype(np.float32))
        scene = scene_of(stage.job_of([mesh], stage.looking_down(256, 480.0), metres_per_unit=0.05))
        points = scene.points(0, textured=False)
        pool = make_problem(scene, [Lambertian("white", np.full(3, 0.8))], [points], self.settings)
        rng, views = np.random.default_rng(0), []
        for light in LIGHTS:
            truth, image = true_lighting(light, 9), np.zeros_like(scene.job.photo.radiance)
            values = pool.predicted(truth)
            image[tuple(points.pixels.T)] = values * rng.normal(1, 0.1, (len(values), 1))
            views.append((image, truth))
        for rule, chosen in RULES.items():
            for count in (250, COUNT):
                for seed in (0, 1):
                    index = chosen(points, count, seed=seed)
                    self.rows["ball", rule, count] += errors(part(pool, index), views, self.settings)[0]

    def of(self, *key):
        """All values of a row, of all materials where the last part of the key is not given."""
        return np.array([v for k, values in self.rows.items() if k[: len(key)] == key for v in values])

    def mean(self, *key, form="{:.3f}") -> str:
        values = self.of(*key)
        return form.format(values.mean()) if len(values) else ""


def compared(study: Study, rule: str, count: int) -> str:
    """A rule's mean error, and its ratio to the picture's even spread."""
    found, base = study.of("pixels", rule, count), study.of("pixels", BASE, count)
    if not len(found):
        return ""
    ratio = np.log(found / base)
    return f"{found.mean():.3f} ({np.exp(ratio.mean()):.2f} ± {ratio.std() / np.sqrt(len(ratio)):.2f})"


def printed(study: Study) -> str:
    """The tables as Markdown."""
    names, table = dict.fromkeys(k[1] for k in study.rows if k[0] == "pixels"), tables.table
    out = ["Error up to order 2, mean; in brackets the geometric mean of its ratio to the picture's even spread."]
    rows = [(rule, *(compared(study, rule, n) for n in SHOWN)) for rule in names]
    out.append(table(("pixels chosen", *(f"{n:,}" for n in SHOWN)), rows))
    out.append("A small ball on a table (synthetic):")
    rows = [(rule, *(study.mean("ball", rule, n) for n in (250, COUNT))) for rule in RULES]
    out.append(table(("pixels chosen", "250", "1,000"), rows))
    rows = [(m or "**all**", *(study.mean("pixels", DEFAULT, n, *filter(None, (m,))) for n in COUNTS))
            for m in (*MATERIALS, None)]  # fmt: skip
    out.append(table(("pixels, by information", *(f"{n:,}" for n in COUNTS)), rows))
    kinds = (
        ("error", "error up to order 2", "{:.3f}"),
        ("moved", f"most moved coefficient, in stated deviations, against {EXACT:,}", "{:.2f}"),
        ("images", f"error of the basis images, against {EXACT:,}", "{:.4f}"),
        ("doubling", "the same as foretold by doubling", "{:.4f}"),
    )
    rows = [(words, *(study.mean("directions", what, n, form=form) for n in DIRECTIONS)) for what, words, form in kinds]
    out.append(table(("directions", *DIRECTIONS), rows))
    rows = []
    for name in dict.fromkeys(k[2] for k in study.rows if k[0] == "between"):
        off, on = (study.mean("between", key, name) for key in ("off", "on"))
        rows.append((name, f"{100 * study.of('between', 'share', name).max():.1f} %", off, on))
    heads = ("light between surfaces", "share of the photo", "error without", "with")
    return "\n\n".join([*out, table(heads, rows)])


def draw(path, study: Study) -> None:
    """Error against the number of pixels and of directions, a line for each material."""
    figure = tables.figure(11, 4.6)
    left, right = figure.subplots(1, 2, sharey=True)
    for axes, counts, what, label in (
        (left, COUNTS, ("pixels", DEFAULT), "pixels (256 directions)"),
        (right, DIRECTIONS, ("directions", "error"), f"directions ({DIRECTION_PIXELS:,} pixels)"),
    ):
        for i, material in enumerate((*MATERIALS, None)):
            y = [study.of(*what, n, *filter(None, (material,))).mean() for n in counts]
            style = {"color": "black", "linewidth": 2.5} if material is None else {"color": f"C{i}", "linewidth": 1.3}
            axes.plot(counts, y, marker="o", markersize=4, label=material or "mean of all", **style)
        axes.set_xscale("log", base=2)
        axes.set_xticks(counts, [f"{n:,}" for n in counts])
        axes.minorticks_off()
        axes.set_xlabel(label)
        axes.grid(alpha=0.25)
    left.set_ylabel("error of the light up to order 2 (relative, one free scale)")
    left.set_ylim(0)
    left.legend(frameon=False)
    figure.suptitle("Estimates from photographs by Cycles")
    tables.save(figure, path)


def main(arguments) -> int:
    options = parser("sampling", __doc__)
    options.add_argument("photos", type=Path, help="folder in which the photos and jobs are kept")
    options.add_argument("--quick", action="store_true", help="one object of each material")
    options.add_argument("--out", type=Path, default=ROOT / "docs" / "results" / "images" / "sampling.png")
    given = options.parse_args(arguments)
    study, library = Study(), open_library(None)
    # two objects of each material, so that each object is met twice
    grid = [(i, j) for i in range(4) for j in range(4) if (j - i) % 4 < (1 if given.quick else 2)]
    kept = given.photos.resolve()
    views = [[photos.shot(kept, OBJECTS[j], MATERIALS[i], LIGHTS[(i + j + k) % 4]) for k in (0, 1)] for i, j in grid]
    photos.take([s for v in views for s in v])
    for shots in tqdm(views):
        jobs = [load_job(s.folder) for s in shots]
        pairs = [(job.photo.radiance, true_lighting(s.light, 4)) for job, s in zip(jobs, shots, strict=True)]
        name, material = shots[0].object, shots[0].material
        told = library.load(photos.library_name(material)).mean_material()
        study.scene(name, material, pairs, scene_of(jobs[0]), told)
    study.table_with_ball()
    print("\n" + printed(study))
    draw(given.out, study)
    return 0
