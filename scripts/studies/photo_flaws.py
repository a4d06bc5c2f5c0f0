# SPDX-License-Identifier: GPL-3.0-or-later
"""What a real photograph's flaws cost, and what helps: clipping, 8-bit codes and JPEG, edges, things in front, dyes.

scripts/study photo-flaws PHOTOS --work FOLDER    jobs OBJECT_MATERIAL_LIGHT, as scripts/study photos leaves them

Each flaw is laid over photographs by Cycles at five severities: tables, and docs/results/images/photo-flaws.png.
Errors are relative, of the coefficients up to order 2 with one free scale (dyes: with none), medians over the photos,
each object in two materials under one light (--all: in all, under two). --only AXIS … prints some of the tables, and
draws no chart. Every photo's numbers are kept in --work: a run that was stopped goes on where it was.
"""

from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path

import cv2
import numpy as np
from scipy.ndimage import distance_transform_cdt
from tqdm import tqdm

from btfsep_engine.btf.library import open_library
from btfsep_engine.errors import InputError
from btfsep_engine.fit.censored import working_values
from btfsep_engine.fit.least_squares import block_labels
from btfsep_engine.fit.log_normal import LightSolver
from btfsep_engine.fit.robust import outliers
from btfsep_engine.fit.white_balance import free_scales
from btfsep_engine.imaging.srgb import linear_to_srgb, srgb_to_linear
from btfsep_engine.job.load import load_job
from btfsep_engine.light.lightings import SHBasis
from btfsep_engine.pipeline.real_photo import STIFF
from btfsep_engine.pipeline.settings import MODELLED_BOUNCES, Settings
from btfsep_engine.render.sampling import spread
from scripts.studies import ROOT, parser, photos, tables
from scripts.studies.estimates import kept, scene_of
from scripts.studies.measures import covered, errors, order2

LIGHTS = ("courtyard", "sunset")
PIXELS, DIRECTIONS = 2000, 256
ORDER = 4
CLIPPED = (0.01, 0.05, 0.1, 0.2, 0.4)  # share of the object's pixels
CODED = ("8-bit", "JPEG 95", "JPEG 75", "JPEG 50", "8-bit, 4 stops dark")
EDGES = (1, 2, 3, 4, 6)  # pixels in from the silhouette, from which on they are used
SPECKS = (0.01, 0.02, 0.05, 0.1, 0.2)  # share of the object that something else covers
SHADES = (1.1, 1.25, 1.5, 2.0, 3.0)  # red of a piece over the library's, and blue of the library's over the piece's
BRIGHT = 0.8  # of the 99.5th percentile of the object in a well exposed 8-bit photo
INNER = 2  # pixels nearer to the silhouette are left out, as the engine does


@dataclass(frozen=True)
class View:
    """One object and material: what does not change with what is done to its photographs.

    Attributes
    ----------
    pixels : (p, 2) row and column, spread over all that shows the object, silhouettes included
    depth : (p,) int, how many pixels inside the silhouette (1: at it)
    normals : (p, 3) unit, world
    basis : (p, terms, 3) float32
    photos : {light: (h, w, 3) float32}; truths : {light: (terms, 3)}
    region : (h, w) bool, all that shows the object
    """

    pixels: np.ndarray
    depth: np.ndarray
    normals: np.ndarray
    region: np.ndarray
    basis: np.ndarray
    photos: dict
    truths: dict

    def at(self, image) -> np.ndarray:
        """The pixels' values of an image (h, w, …)."""
        return image[self.pixels[:, 0], self.pixels[:, 1]]


def view_of(shown: list, library) -> View:
    """The view of one object's photographs."""
    jobs = {p.light: load_job(p.folder) for p in shown}
    lights, material = SHBasis(9), library.load(shown[0].material).mean_material()
    scene = scene_of(jobs[shown[0].light])
    region = scene.view.mesh == 0
    points = scene.points(0, region=region, textured=False)
    points = points.take(spread(points, PIXELS, seed=0))
    indirect = scene.indirect([material], lights, Settings(), bounces=MODELLED_BOUNCES)
    basis = scene.radiance(points, material, lights, directions=DIRECTIONS, indirect=indirect)
    inside = distance_transform_cdt(np.pad(region, 1), "chessboard")[1:-1, 1:-1]
    images = {light: each.photo.radiance for light, each in jobs.items()}
    truths = {p.light: p.truth(9) for p in shown}
    return View(points.pixels, inside[tuple(points.pixels.T)], points.normal, region, basis, images, truths)


def error(fit, truth) -> float:
    """Relative error of the coefficients up to order 2, with one free scale."""
    return order2(fit.coefficients, truth)


def solver_of(view, chosen, *, coarsening=1.0) -> LightSolver:
    """The basis images of the chosen pixels, (p,) bool or numbers, made ready."""
    return LightSolver(view.basis[chosen], normals=view.normals[chosen], order=ORDER, coarsening=coarsening)


def plain(view, b, chosen):
    """The fit of the chosen pixels, (p,) bool or numbers."""
    return solver_of(view, chosen).solve(b[chosen])


def censored(view, cut, clipped, keep):
    """The fit in which clipped channels count as at least as bright as they are."""
    values, weights = working_values(solver_of(view, keep), cut[keep], clipped[keep])
    used = weights.any(1)
    return solver_of(view, np.flatnonzero(keep)[used]).solve(values[used], weights=weights[used])


def inner(view) -> np.ndarray:
    """(p,) bool: the pixels that the engine uses."""
    return view.depth >= INNER


def clipped_at(view, light, share):
    """A photograph (p, 3) clipped per channel at one limit, and where: of so large a share of the inner pixels."""
    b = view.at(view.photos[light]).astype(np.float64)
    limit = float(np.quantile(b[inner(view)].max(1), 1 - share)) if share else np.inf
    return np.minimum(b, limit), b >= limit


def clipping(view, light, rng) -> dict:
    """{estimator: (error at none and at each severity)} of photographs clipped per channel at one limit."""
    truth, keep = view.truths[light], inner(view)
    rows: dict = {"left out": [], "inequality": []}
    for share in (0, *CLIPPED):
        cut, clipped = clipped_at(view, light, share)
        rows["left out"].append(error(plain(view, cut, keep & ~clipped.any(1)), truth))
        rows["inequality"].append(error(censored(view, cut, clipped, keep), truth))
    return rows


def stated(view, light, rng) -> dict:
    """Shares of the true coefficients in what is stated, photographs clipped as in :func:`clipping`."""
    truth, keep = view.truths[light][:9], inner(view)
    rows: dict = {"1.96 standard deviations": [], "95 % range": []}
    for share in (0, *CLIPPED):
        fit = censored(view, *clipped_at(view, light, share), keep)
        held = covered(fit.coefficients[:9], fit.stddev[:9], truth, interval=fit.interval[:, :9])
        for row, name in zip(rows.values(), ("within95", "inside"), strict=True):
            row.append(held[name])
    return rows


def coded_photo(image, region, how: str) -> np.ndarray:
    """The codes (h, w, 3) uint8 of the photograph in an 8-bit file, exposed by the object's bright pixels."""
    peak = float(np.quantile(image[region].max(1), 0.995))
    exposure = BRIGHT / peak * (2**-4 if "dark" in how else 1)
    codes = np.round(np.clip(linear_to_srgb(image.astype(np.float64) * exposure), 0, 1) * 255).astype(np.uint8)
    if how.startswith("JPEG"):
        quality = int(how.split()[1])
        _, data = cv2.imencode(".jpg", codes[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])
        codes = cv2.imdecode(data, cv2.IMREAD_COLOR)[..., ::-1]
    return codes


def coding(view, light, rng) -> dict:
    """Errors of 8-bit photographs of unknown exposure."""
    image, truth, keep = view.photos[light], view.truths[light], inner(view)
    row = [error(plain(view, view.at(image).astype(np.float64), keep), truth)]
    for how in CODED:
        codes = view.at(coded_photo(image, view.region, how))
        row.append(error(plain(view, srgb_to_linear(codes / 255), keep & (codes < 255).all(1)), truth))
    return {"as decoded": row}


def edges(view, light, rng) -> dict:
    """Errors by how far inside the silhouette pixels are used (1: all), the same number in each, and all."""
    b, truth = view.at(view.photos[light]).astype(np.float64), view.truths[light]
    count = int((view.depth >= EDGES[-1]).sum())
    order = rng.permutation(len(b))
    out = {"as many pixels": [], "all that are left": []}
    for width in EDGES:
        chosen = np.zeros(len(b), bool)
        chosen[order[view.depth[order] >= width][:count]] = True
        out["as many pixels"].append(error(plain(view, b, chosen), truth))
        out["all that are left"].append(error(plain(view, b, view.depth >= width), truth))
    return out


def robust_fits(view, b, keep):
    """(name, Fit) with all pixels, and without those that the light does not explain."""
    yield "all pixels", plain(view, b, keep)
    out = outliers(solver_of(view, keep, coarsening=STIFF), b[keep])
    yield "left out by pixel (--robust)", plain(view, b, np.flatnonzero(keep)[~out])


def specks(view, light, rng) -> dict:
    """Errors where something of another colour and brightness covers parts of the object."""
    image, truth, keep = view.photos[light], view.truths[light], inner(view)
    rows: dict = {}
    rows_at, columns_at = np.nonzero(view.region)
    level = float(image[view.region].mean())
    covered, image = np.zeros_like(view.region), image.copy()
    for share in (0, *SPECKS):
        while covered[view.region].mean() < share:
            i, disc = rng.integers(len(rows_at)), np.zeros(covered.shape, np.uint8)
            cv2.circle(disc, (int(columns_at[i]), int(rows_at[i])), int(rng.integers(2, 8)), 1, thickness=-1)
            disc = disc > 0
            image[disc] = level * 2 ** rng.uniform(-3, 2, 3)
            covered |= disc
        for name, fit in robust_fits(view, view.at(image).astype(np.float64), keep):
            rows.setdefault(name, []).append(error(fit, truth))
    return rows


def shades(view, other, light, rng) -> dict:
    """Errors with no free scale, where a second object's dye is not the library's: alone held, both held, one free.

    ``other`` is under the same light in a photograph of its own; both together are a scene without reflections
    between them.
    """
    truth, keep = view.truths[light], (inner(view), inner(other))
    basis = [v.basis[k] for v, k in zip((view, other), keep, strict=True)]
    normals = [v.normals[k] for v, k in zip((view, other), keep, strict=True)]
    photos = [v.at(v.photos[light]).astype(np.float64)[k] for v, k in zip((view, other), keep, strict=True)]
    blocks = [block_labels(view.pixels)[keep[0]], block_labels(other.pixels)[keep[1]] + (1 << 20)]
    rows = {"the known object alone": [], "both as in the library": [], "the second one's scale free": []}
    alone = LightSolver(basis[0], normals=normals[0], order=ORDER).solve(photos[0])
    alone = errors(alone.coefficients, truth)["order2_absolute"]
    for ratio in (1, *SHADES):
        seen = [photos[0], photos[1] * np.array([ratio, 1, 1 / ratio])]
        scales = free_scales(basis, seen, normals=normals, blocks=blocks, free=[False, True])
        rows["the known object alone"].append(alone)
        for name, factor in (("both as in the library", 1.0), ("the second one's scale free", scales[1])):
            a = np.concatenate([basis[0], basis[1] * np.asarray(factor, np.float32)])
            fit = LightSolver(a, normals=np.concatenate(normals), order=ORDER).solve(np.concatenate(seen))
            rows[name].append(errors(fit.coefficients, truth)["order2_absolute"])
    return rows


AXES = {  # what is done -> title, severities, how
    "clipping": ("Clipped: share of the object's pixels", ("none", *(f"{100 * v:.0f} %" for v in CLIPPED)), clipping),
    "stated": (
        "Clipped, too: true coefficients in what is stated", ("none", *(f"{100 * v:.0f} %" for v in CLIPPED)), stated
    ),
    "coding": ("How the photo is stored", ("linear", *CODED), coding),
    "edges": ("Pixels used from so many pixels inside the outline", tuple(map(str, EDGES)), edges),
    "specks": ("Covered by other things: share of the object", ("none", *(f"{100 * v:.0f} %" for v in SPECKS)), specks),
    "shades": (
        "Another dye: ratio in red and blue (no free scale)", ("1", *(f"{v:g}" for v in SHADES)), shades
    ),
}  # fmt: skip
PAIRS = ("shades",)  # of two objects
SHARES = ("stated",)  # no errors: means of shares, the least in brackets


def chosen_views(shown: list, *, every: bool) -> list:
    """The photographs of each view: two materials of each object, or all."""
    by_object, out = {}, []
    for view in photos.views(shown).values():
        by_object.setdefault(view[0].object, []).append(view)
    for i, found in enumerate(by_object.values()):
        out += [view for j, view in enumerate(found) if every or (i + j) % 2 == 0]
    return out


def answers(views: list, library, given) -> dict:
    """{axis: [{estimator: [error at each severity]}]}, a dict for each photo, from --work where it is there."""
    out: dict = {name: [] for name in given.only}
    made = cache(lambda i: view_of(views[i], library))

    def laid(name, light, view, other):
        pair = (made(other),) if name in PAIRS else ()
        return AXES[name][2](made(view), *pair, light, np.random.default_rng(5))

    for i, shown in enumerate(tqdm(views)):
        other = (i + 4) % len(views)  # the second object of a pair: another one under the same light
        lights = given.lights if given.all else [given.lights[i // 2 % len(given.lights)]]
        for photo in [p for p in shown if p.light in lights]:
            for name in given.only:
                how = partial(laid, name, photo.light, i, other)
                out[name].append(kept(given.work, f"{name}_{photo.folder.name}", how))
    return out


def table(name: str, rows: list) -> str:
    """Medians, and the worst in brackets, for each estimator and severity; of shares means and the least."""
    title, severities, _ = AXES[name]
    how = {"middle": np.mean, "far": np.min} if name in SHARES else {}
    lines = [(key, *(tables.spread(v, **how) for v in np.array([r[key] for r in rows]).T)) for key in rows[0]]
    return f"\n### {title} ({len(rows)} photos)\n\n" + tables.table(("", *severities), lines)


def draw(path: Path, found: dict) -> None:
    """One picture: the median error of every estimator against severity, an axis each."""
    figure = tables.figure(12, 7.2)
    figure.suptitle("Median relative error of the light up to order 2", fontsize=13)
    shown = {name: rows for name, rows in found.items() if name not in SHARES}
    *places, empty = figure.subplots(2, 3).ravel()
    empty.axis("off")
    for axes, (name, rows) in zip(places, shown.items(), strict=True):
        title, severities, _ = AXES[name]
        x = np.arange(len(severities))
        for i, estimator in enumerate(rows[0]):
            y, look = np.median([row[estimator] for row in rows], 0), {"color": tables.COLOURS[i], "label": estimator}
            axes.plot(x, y, marker="o", markersize=4, **look)
        axes.set_title(title, fontsize=10)
        axes.set_xticks(x, [s.replace(", ", ",\n") for s in severities])
        tables.plain(axes)
        axes.set_ylim(0, 1.4 * axes.get_ylim()[1])
        axes.legend(fontsize=7.5, frameon=False, loc="upper left")
    tables.save(figure, path)


def main(arguments) -> int:
    options = parser("photo-flaws", __doc__)
    options.add_argument("photos", type=Path)
    options.add_argument("--work", type=Path, required=True, help="folder for each photo's numbers")
    options.add_argument("--lights", nargs="+", default=list(LIGHTS), metavar="LIGHT")
    options.add_argument("--all", action="store_true", help="all materials, under all of the lights")
    options.add_argument("--only", nargs="+", choices=list(AXES), default=list(AXES), metavar="AXIS")
    options.add_argument("--chart", type=Path, default=ROOT / "docs" / "results" / "images" / "photo-flaws.png")
    given = options.parse_args(arguments)
    views = chosen_views(photos.photographs_in(given.photos, lights=given.lights), every=given.all)
    found = {name: rows for name, rows in answers(views, open_library(None), given).items() if rows}
    if not found:
        raise InputError(str(given.photos), "no photo of a view under its light", "make more, or say --lights, --all")
    for name, rows in found.items():
        print(table(name, rows))
    if len(found) == len(AXES):
        draw(given.chart, found)
    return 0
