# SPDX-License-Identifier: GPL-3.0-or-later
"""Speed against accuracy over many photographs by Cycles: every setting, the presets, and the paper's way.

scripts/study speed-accuracy PHOTOS --work FOLDER   jobs OBJECT_MATERIAL_LIGHT, as scripts/study photos leaves them
--paper 8     on so many of them the paper's way, too, at 8 to 64 paths a pixel, which takes minutes for each
--work FOLDER every photo's numbers are kept there: a run that was stopped goes on where it was

What `btfsep chart` measures of one job against its true light, summed up: fills in docs/results/speed-accuracy.md and
draws docs/results/images/speed-accuracy.png. Every way of one photo is timed in one process, warm, in turn. Ratios
of seconds and errors are of the same photo and process; they and the means are geometric.
"""

import random
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from tqdm import tqdm

from btfsep_engine.commands.chart_picture import write_chart
from btfsep_engine.commands.tradeoff import measure, pareto_front
from scripts.studies import ROOT, parser, photos, tables
from scripts.studies.estimates import kept, library, scene_of

BALANCED, SAME = ("preset", "balanced"), ("preset", "paper")  # SAME: the paper's estimator by the kernel
TRACED = (8, 16, 32, 64)  # paths a pixel and basis light of the paper's way
FIRM = 1.0  # standard errors: by so much must a way be faster, and more accurate, to beat another for certain


@dataclass(frozen=True)
class MeanPoint:
    """One way over all photographs that it was tried on.

    Attributes
    ----------
    axis, name : of pipeline.tradeoff.Point
    seconds, error : geometric means; of a way that was tried on some photos only, balanced's times the ratio on these
    ratio, spread : error over balanced's on the same photo, geometric mean, and its relative standard error
    worst : error; direction : degrees, median
    paper_ratio : the path-traced paper's seconds (of the most paths) over this way's, of the same photo; None where it
        was not tried
    front : whether no other point is both faster and more accurate
    beaten : whether another is so on the same photos by more than `FIRM` standard errors in both
    """

    axis: str
    name: str
    seconds: float
    error: float
    ratio: float
    spread: float
    worst: float
    direction: float
    paper_ratio: float | None
    front: bool
    beaten: bool


def by_way(found: list) -> tuple[list, dict]:
    """The ways (axis, name), and "seconds", "error" and "direction" of each on each photo: (ways, photos), or NaN."""
    ways = list(dict.fromkeys((p["axis"], p["name"]) for rows in found for p in rows))
    out = {key: np.full((len(ways), len(found)), np.nan) for key in ("seconds", "error", "direction")}
    for photo, rows in enumerate(found):
        for p in rows:
            for key, values in out.items():
                values[ways.index((p["axis"], p["name"])), photo] = np.nan if p[key] is None else p[key]
    return ways, out


def summed_up(found: list) -> list[MeanPoint]:
    """The points of all ways.

    ``found`` : for each photo a list of {axis, name, seconds, error, direction}; "balanced" is among each
    """
    ways, values = by_way(found)
    times, errors = np.log(values["seconds"]), np.log(values["error"])
    base = ways.index(BALANCED)
    slow = next((times[i] for i, (axis, _) in reversed(list(enumerate(ways))) if axis == "paper"), None)
    ratios = [mean_and_spread(errors[i] - errors[base]) for i in range(len(ways))]
    seconds = [np.exp(np.nanmean(times[base]) + np.nanmean(times[i] - times[base])) for i in range(len(ways))]
    mean_errors = [np.exp(np.nanmean(errors[base]) + mean) for mean, _ in ratios]
    front = pareto_front(seconds, mean_errors)
    return [
        MeanPoint(
            *way,
            seconds=float(seconds[i]),
            error=float(mean_errors[i]),
            ratio=float(np.exp(ratios[i][0])),
            spread=float(ratios[i][1]),
            worst=float(np.nanmax(values["error"][i])),
            direction=float(np.nanmedian(values["direction"][i])),
            paper_ratio=None if slow is None else float(np.exp(np.nanmean(slow - times[i]))),
            front=bool(front[i]),
            beaten=any(beats(times[j] - times[i], errors[j] - errors[i]) for j in range(len(ways)) if j != i),
        )
        for i, way in enumerate(ways)
    ]


def mean_and_spread(differences) -> tuple[float, float]:
    """The mean of what is not NaN, and its standard error."""
    known = differences[~np.isnan(differences)]
    return float(known.mean()), float(known.std() / len(known) ** 0.5)


def beats(slower, worse) -> bool:
    """Whether differences of log seconds and log errors on the same photos, (photos,), are both below 0 for certain."""
    return all(mean + FIRM * spread < 0 for mean, spread in map(mean_and_spread, (slower, worse)))


def at_equal_error(found: list) -> list[dict]:
    """The paper's path tracing with each number of paths, beside the same estimator by the kernel and balanced.

    Returns
    -------
    [{name, seconds, error, and of "same" and "balanced": (error over it, its relative standard error, seconds over it,
    whether its light errs no more for certain)}], geometric means over the photos that the paper's way was tried on
    """
    ways, values = by_way(found)
    times, errors, out = np.log(values["seconds"]), np.log(values["error"]), []
    for i, (axis, name) in enumerate(ways):
        if axis != "paper":
            continue
        tried = ~np.isnan(errors[i])
        row = {"name": name, **{k: float(np.exp(np.log(values[k][i, tried]).mean())) for k in ("seconds", "error")}}
        for word, way in (("same", SAME), ("balanced", BALANCED)):
            if way in ways:
                j = ways.index(way)
                mean, spread = mean_and_spread(errors[i] - errors[j])
                slower, _ = mean_and_spread(times[i] - times[j])
                row[word] = (float(np.exp(mean)), spread, float(np.exp(slower)), mean <= FIRM * spread)
        out.append(row)
    return out


def equal_words(rows: list) -> str:
    """From how many paths on the paper's way gives as good a light, and how much longer it takes then."""
    said = []
    for key, words in (("same", "the same estimator by the kernel (preset `paper`)"), ("balanced", "`balanced`")):
        reached = next((r for r in rows if key in r and r[key][3]), None)
        if reached:
            said.append(
                f"the light of {words} is reached by {reached['name']}, in {reached[key][2]:.0f} times the time"
            )
        else:
            said.append(f"none reaches the light of {words}")
    return f"At equal error of the light (within a standard error): {'; '.join(said)}."


def page(points, equal, *, count: int, total: int, lights, paper: int) -> str:
    """What is filled into the page, as Markdown.

    Parameters
    ----------
    points : list of MeanPoint; equal : of :func:`at_equal_error`
    count : photographs; total : of so many; lights : names of the lights that they are under
    paper : how many of them the paper's way was tried on
    """
    out = [
        f"{count} of {total} photographs ({', '.join(lights)}); the paper's way of {paper} of them "
        f"(`--count {count} --paper {paper}`).",
        "![error against seconds for every setting, with the Pareto front](images/speed-accuracy.png)",
    ]
    rows = []
    for p in sorted(points, key=lambda p: p.seconds):
        name = f"**{p.name}**" if p.axis == "preset" else p.name
        over = f"{p.ratio:.2f} ± {p.ratio * p.spread:.2f}"
        ratio = "" if p.paper_ratio is None else f"{p.paper_ratio:.0f}"
        front = "**yes**" if p.front else "" if p.beaten else "within noise"
        error = f"{p.error:.3f} / {p.worst:.2f}"
        rows.append((p.axis, name, f"{p.seconds:.3f}", error, over, f"{p.direction:.0f}", ratio, front))
    heads = ("what is changed", "how", "seconds", "error: mean / worst", "over balanced", "direction °", "paper's time")
    out += [tables.table((*heads, "front"), rows)]
    if equal:
        rows = []
        for r in equal:
            ratios = [r.get(key) for key in ("same", "balanced")]
            cells = [c for v in ratios if v for c in (f"{v[0]:.2f} ± {v[0] * v[1]:.2f}", f"{v[2]:.0f}")]
            rows.append((r["name"], f"{r['seconds']:.1f}", f"{r['error']:.3f}", *cells))
        heads = [h for key, words in (("same", "preset paper"), ("balanced", "balanced")) if key in equal[0]
                 for h in (f"error over {words}'s", "its time over that")]  # fmt: skip
        out += ["## The paper's way at equal error of the light", equal_words(equal)]
        out.append(tables.table(("path tracing", "seconds", "error", *heads), rows))
    return "\n\n".join(out)


def measured(photo, warm: set, traced, given) -> list[dict]:
    """Every way of one photograph, and the paper's with each number of paths; ``warm``: the materials that were met."""
    scene, truth, warm_up = scene_of(photo.folder), photo.truth(4), photo.shown not in warm
    warm.add(photo.shown)
    told = {"material": photo.material, "truth": truth, "quick": given.quick}
    runs = [{"paper_samples": 0, "repeats": 1, "warm_up": warm_up}]
    runs += [{"only": (), "paper_samples": n} for n in traced]
    points = [p for run in runs for p in measure(scene, library(), **told, **run)["points"]]
    return [
        {"axis": p.axis, "name": p.name, "seconds": p.seconds, "error": p.error, "direction": p.direction}
        for p in points
    ]


def main(arguments) -> int:
    options = parser("speed-accuracy", __doc__)
    options.add_argument("photos", type=Path, help="folder of the photos and jobs")
    options.add_argument("--count", type=int, help="photos, drawn from the folder  [default: all]")
    options.add_argument("--work", type=Path, required=True, help="folder in which each photo's numbers are kept")
    options.add_argument("--paper", type=int, default=8, help="photos that the paper's way is tried on, too")
    options.add_argument("--traced", type=int, nargs="+", default=TRACED, help="paths a pixel of the paper's way")
    options.add_argument("--quick", action="store_true", help="fewer settings")
    options.add_argument("--out", type=Path, default=ROOT / "docs" / "results" / "speed-accuracy.md")
    given = options.parse_args(arguments)
    warm, found, shown = set(), [], photos.photographs_in(given.photos)
    total = len(shown)
    random.Random(0).shuffle(shown)
    shown = shown[: given.count]
    for number, photo in enumerate(tqdm(shown)):
        traced = given.traced if number < given.paper else ()
        found.append(kept(given.work, photo.folder.name, partial(measured, photo, warm, traced, given)))
    points, equal = summed_up(found), at_equal_error(found)
    picture = given.out.parent / "images" / "speed-accuracy.png"
    picture.parent.mkdir(parents=True, exist_ok=True)
    title = f"Geometric means over {len(found)} photographs by Cycles"
    write_chart(picture, points, reference="truth", title=title)
    lights, paper = sorted({p.light for p in shown}), min(given.paper, len(found))
    text = page(points, equal, count=len(found), total=total, lights=lights, paper=paper)
    tables.fill(given.out, "points", text)
    print("\n" + text)
    return 0
