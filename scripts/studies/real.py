# SPDX-License-Identifier: GPL-3.0-or-later
"""Estimates of photographs whose light is known, beside three plain fits of the same pixels.

scripts/study real FOLDER [--only GLOB] [--chart FILE] [--json FILE]

FOLDER: job folders, each with a `truth.json`: {"coefficients": (order + 1)^2 rows of 1 or 3 numbers}, order 2 or more,
the light's spherical harmonics in the world of the job, in any scale (docs/conventions.md has axes and signs). The
job names its material. Prints Markdown: a line a job, then medians and worst by the part of the name before the first
"_" and of all; draws the errors against what was stated.

The error is of the coefficients up to order 2, relative, with one free scale; the angle is that of the main direction
(order 1); ranges are held against the truth in that same scale. Plain fits know no shadows, no other material than
Lambert's and no prior. They get the normals of the engine's surface points that face the camera:

    lamp       one lamp, n.l by least squares on the lit pixels
    order 1    light of order 1 by least squares on all pixels; what it lacks of order 2 counts as 0
    order 2    the same of order 2
"""

import argparse
import json
import sys
from collections import Counter
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from btfsep_engine import sh
from btfsep_engine.atomic import replacing, write_text
from btfsep_engine.btf.library import open_library
from btfsep_engine.errors import InputError
from btfsep_engine.fit.compare import direction_error
from btfsep_engine.fit.expected_error import expected_error
from btfsep_engine.job.load import load_job
from btfsep_engine.pipeline.estimation import estimate
from btfsep_engine.pipeline.scene import PreparedScene
from btfsep_engine.pipeline.settings import choose
from btfsep_engine.progress import Reporter
from scripts.studies.measures import ERROR_ORDER, covered, scaled_error
from scripts.studies.summary import kind

ROOT = Path(__file__).resolve().parents[2]
TERMS = sh.term_count(ERROR_ORDER)
FACING = 0.15  # cosine to the camera: beyond, a pixel holds too many normals
LIT = 0.15  # of the 99th percentile of the object's brightness
PLAIN = {"lamp": "one lamp", "order1": "order 1", "order2": "order 2"}
TICKS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0)
LOOKS = {  # Okabe and Ito's colours
    "ours": {"color": "#0072B2", "marker": "o", "s": 46, "zorder": 4, "label": "ours"},
    "lamp": {"color": "#E69F00", "marker": "v", "s": 26, "label": "plain: one lamp"},
    "order1": {"color": "#009E73", "marker": "s", "s": 20, "label": "plain: order 1"},
    "order2": {"color": "#D55E00", "marker": "^", "s": 26, "label": "plain: order 2"},
}


def true_light(folder: Path) -> np.ndarray:
    """(terms, 3) of a folder's `truth.json`, up to order 2."""
    told = np.array(json.loads((folder / "truth.json").read_text())["coefficients"], np.float64)
    if told.ndim != 2 or len(told) < TERMS or told.shape[1] not in (1, 3):
        raise InputError(
            str(folder / "truth.json"), f"coefficients {told.shape}", f"give {TERMS} rows or more of 1 or 3 numbers"
        )
    return np.broadcast_to(told[:TERMS], (TERMS, 3))


def facing(scene: PreparedScene) -> tuple[np.ndarray, np.ndarray]:
    """Normals (p, 3) and grey radiance (p,) of all objects' usable pixels that face the camera."""
    points = [scene.points(i, textured=False) for i in range(len(scene.regions))]
    points = [p.take(np.flatnonzero(scene.usable(p))) for p in points]
    normal = np.concatenate([p.normal for p in points])
    b = np.concatenate([scene.photo_at(p).mean(1) for p in points]).astype(np.float64)
    to_camera = scene.job.camera.to_world[:3, 3] - np.concatenate([p.position for p in points])
    seen = (normal * to_camera).sum(1) > FACING * np.linalg.norm(to_camera, axis=1)
    return normal[seen], b[seen]


def plain_fits(normal, b) -> dict:
    """The plain fits' light, coefficients (9,) in any scale, of normals (p, 3) and radiance (p,)."""
    lit = b > LIT * np.percentile(b, 99)
    lamp = np.linalg.lstsq(normal[lit], b[lit], rcond=None)[0]
    rows = sh.evaluate(ERROR_ORDER, normal) * np.repeat(sh.cosine_lobe(ERROR_ORDER), [1, 3, 5])
    fits = {"lamp": sh.evaluate(ERROR_ORDER, lamp / np.linalg.norm(lamp))}
    for order in (1, 2):
        n = sh.term_count(order)
        fits[f"order{order}"] = np.zeros(TERMS)
        fits[f"order{order}"][:n] = np.linalg.lstsq(rows[:, :n], b, rcond=None)[0]
    return fits


def study(folder: Path, library) -> dict:
    """One photograph: ours and the plain fits against the truth."""
    truth, reporter = true_light(folder), Reporter()
    scene = PreparedScene(load_job(folder), reporter)
    found = estimate(scene, library, choose())
    light, fit = found.lighting, found.fit
    x = light.coefficients[:TERMS]
    error, scale = scaled_error(x, truth)
    stated = expected_error(light.coefficients, fit.samples)["order_2"]["median"]
    row = {
        "job": folder.name,
        "ours_error": error,
        "ours_angle": direction_error(x, truth),
        "stated": stated,
        **covered(scale * x, scale * light.stddev[:TERMS], truth, interval=scale * light.interval[:, :TERMS]),
        "suns": len(light.suns),
        "residual": fit.residual,
        "warnings": reporter.warnings,
    }
    for name, grey in plain_fits(*facing(scene)).items():
        plain = np.repeat(grey[:, None], 3, 1)
        row[f"{name}_error"] = scaled_error(plain, truth)[0]
        row[f"{name}_angle"] = direction_error(plain, truth)
    return row


COLUMNS = (
    ("ours_error", "error", "{:.2f}"),
    ("ours_angle", "angle", "{:.1f}°"),
    ("stated", "stated", "{:.2f}"),
    ("over", "over stated", "{:.2f}"),
    ("within68", "68 %", "{:.0f} %"),
    ("within95", "95 %", "{:.0f} %"),
    ("inside", "95 % range", "{:.0f} %"),
    ("warned", "warnings", "{:.0f}"),
    *((f"{name}_{what}", words, form) for name in PLAIN for what, words, form in (
        ("error", f"{PLAIN[name]}: error", "{:.2f}"), ("angle", f"{PLAIN[name]}: angle", "{:.1f}°"))),
)  # fmt: skip
MEANS = ("within68", "within95", "inside")  # of shares the mean and the least; of all else the median and the most


def cells(row: dict) -> dict:
    """A row's numbers, shares in per cent."""
    more = {"over": row["ours_error"] / row["stated"], "warned": len(row["warnings"])}
    return row | more | {key: 100 * row[key] for key in MEANS}


def table(rows: list) -> str:
    """A line a job."""
    lines = ["| job | " + " | ".join(words for _, words, _ in COLUMNS) + " |", "|---|" + "---|" * len(COLUMNS)]
    for row in rows:
        told = cells(row)
        lines.append(f"| {row['job']} | " + " | ".join(form.format(told[key]) for key, _, form in COLUMNS) + " |")
    return "\n".join(lines)


def summary(rows: list) -> str:
    """Medians and worst by kind, and of all."""
    names = dict.fromkeys(r["job"].split("_")[0] for r in rows)
    groups = [(name, [r for r in rows if r["job"].split("_")[0] == name]) for name in names]
    lines = ["| | jobs | " + " | ".join(words for _, words, _ in COLUMNS) + " |", "|---|" + "---|" * (len(COLUMNS) + 1)]
    for name, group in [*groups, ("**all**", rows)]:
        told, out = [cells(r) for r in group], []
        for key, _, form in COLUMNS:
            values = np.array([t[key] for t in told], np.float64)
            middle, far = (values.mean(), values.min()) if key in MEANS else (np.median(values), values.max())
            out.append(f"{form.format(middle)} ({form.format(far)})")
        lines.append(f"| {name} | {len(group)} | " + " | ".join(out) + " |")
    return "\n".join(lines)


def draw(path: Path, rows: list) -> None:
    """Every photograph's errors, ours and the plain fits', above the error that ours stated."""
    figure = Figure(figsize=(6.4, 5.2), dpi=120, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    stated = np.array([r["stated"] for r in rows])
    for name, look in LOOKS.items():
        axes.scatter(stated, [r[f"{name}_error"] for r in rows], linewidths=0, alpha=0.85, **look)
    ends = np.array([0.7 * stated.min(), 1.4 * stated.max()])
    axes.plot(ends, ends, color="#000000", linewidth=0.9, label="error = stated")
    axes.fill_between(ends, ends / 2, 2 * ends, color="#000000", alpha=0.06, linewidth=0, label="within a factor of 2")
    axes.set(xscale="log", yscale="log", xlim=ends, xlabel="error that the estimate states (order 2, median)")
    axes.set_ylabel("error of the light up to order 2 (relative, one free scale)")
    for axis, low, high in ((axes.xaxis, *ends), (axes.yaxis, *axes.get_ylim())):
        kept = [t for t in TICKS if low <= t <= high]
        axis.set_ticks(kept, [f"{t:g}" for t in kept])
        axis.set_ticks([], minor=True)
    axes.grid(color="#dddddd", linewidth=0.6)
    axes.set_axisbelow(True)
    axes.legend(frameon=False, fontsize=8.5)
    axes.set_title(f"{len(rows)} photographs of real objects under known lamps", fontsize=11)
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as scratch:
        figure.savefig(scratch, format="png")


def main(arguments) -> int:
    parser = argparse.ArgumentParser(
        prog="scripts/study real", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path, help="of jobs, each with a truth.json")
    parser.add_argument("--only", default="*", metavar="GLOB", help="of the jobs' names")
    parser.add_argument("--library", type=Path)
    parser.add_argument("--chart", type=Path, default=ROOT / "docs" / "images" / "accuracy-real.png")
    parser.add_argument("--json", type=Path, help="every number, and the warnings in words")
    options = parser.parse_args(arguments)
    truths = options.folder.glob(f"{options.only}/truth.json")
    folders = sorted(p.parent for p in truths if (p.parent / "job.json").exists())
    if not folders:
        parser.error(f"{options.folder} has no jobs with a truth.json")
    library, rows = open_library(options.library), []
    for folder in folders:
        rows.append(study(folder, library))
        r = rows[-1]
        print(f"{folder.name}: {r['ours_error']:.3f}, {r['stated']:.3f} stated", file=sys.stderr, flush=True)
    if options.json:
        write_text(options.json, json.dumps(rows, indent=1) + "\n")
    print(table(rows) + "\n\nMedians (worst); of shares means (least):\n\n" + summary(rows))
    said = Counter(words for r in rows for words in {kind(w) for w in r["warnings"]})
    print("\nWarned of, numbers left out:\n")
    for words, count in said.most_common():
        print(f"- {count} of {len(rows)}: {words}")
    draw(options.chart, rows)
    return 0
