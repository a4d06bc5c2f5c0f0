# SPDX-License-Identifier: GPL-3.0-or-later
"""Photographs of real objects whose light is known, beside three plain fits of the same pixels.

scripts/study real FOLDER [--only GLOB] [--chart FILE]
scripts/study real FOLDER --saved "by sRGB alone" --read linear     as JPEGs, read so; without --read as a user's are

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

import json
import re
import shutil
import tempfile
from collections import Counter
from pathlib import Path

import numpy as np
from tqdm import tqdm

from btfsep_engine import sh
from btfsep_engine.errors import InputError
from btfsep_engine.job.load import load_job
from btfsep_engine.job.model import Job
from btfsep_engine.pipeline.scene import PreparedScene
from btfsep_engine.storage.atomic import write_json
from scripts.studies import ROOT, cameras, parser, tables
from scripts.studies.estimates import estimated, scene_of, worth
from scripts.studies.measures import ERROR_ORDER, TERMS, errors

CHART = ROOT / "docs" / "images" / "accuracy-real.png"
FACING = 0.15  # cosine to the camera: beyond, a pixel holds too many normals
SHOWN, BRIGHT = 0.02, 98  # of a photo's largest value: what is above is no background; percentile of that, nearly white
LIT = 0.15  # of the 99th percentile of the object's brightness
READ = ("srgb", "camera", "phone", "linear", "unknown")
PLAIN = {"lamp": "one lamp", "order1": "order 1", "order2": "order 2"}
LOOKS = {"ours": ("o", 46), "lamp": ("v", 26), "order1": ("s", 20), "order2": ("^", 26)}  # marker, size


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
    b = np.concatenate([scene.job.photo.radiance[tuple(p.pixels.T)].mean(1) for p in points]).astype(np.float64)
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


def as_jpeg(folder: Path, coded: str, read: str | None) -> Job:
    """A folder's job with its photograph saved as `cameras.save_jpeg` does, and read by a curve; None: as files are."""
    linear = load_job(folder).photo.radiance
    values = linear.max(-1)
    with tempfile.TemporaryDirectory() as where:
        out = Path(where) / folder.name
        shutil.copytree(folder, out)
        bright = np.percentile(values[values > SHOWN * values.max()], BRIGHT)
        cameras.save_jpeg(out / "coded.jpg", linear, coded, bright=bright)
        told = {"image": "coded.jpg", "image_colorspace": "auto"}
        write_json(out / "job.json", json.loads((folder / "job.json").read_text()) | told)
        return load_job(out, colorspace=read)


def study(folder: Path, *, saved: str | None = None, read: str | None = None) -> dict:
    """One photograph: ours and the plain fits against the truth; ``saved`` and ``read`` : as of `as_jpeg`."""
    job = as_jpeg(folder, saved, read) if saved else load_job(folder, colorspace=read)
    truth, scene = true_light(folder), scene_of(job)
    ours, warnings = worth(estimated(scene), truth, free_scale=True), scene.reporter.warnings
    row = {
        "job": folder.name,
        "ours_error": ours["order2"],
        "ours_angle": ours["direction"],
        "stated": ours["stated2"],
        "over": ours["order2"] / ours["stated2"],
        **{key: 100 * ours[key] for key in MEANS},
        "warned": len(warnings),
        "warnings": warnings,
    }
    for name, grey in plain_fits(*facing(scene)).items():
        off = errors(np.repeat(grey[:, None], 3, 1), truth)
        row |= {f"{name}_error": off["order2"], f"{name}_angle": off["direction"]}
    return row


COLUMNS = {  # what of a row, and its form
    "ours_error": ("error", "{:.2f}"),
    "ours_angle": ("angle", "{:.1f}°"),
    "stated": ("stated", "{:.2f}"),
    "over": ("over stated", "{:.2f}"),
    "within68": ("68 %", "{:.0f} %"),
    "within95": ("95 %", "{:.0f} %"),
    "inside": ("95 % range", "{:.0f} %"),
    "pattern68": ("pattern: 68 %", "{:.0f} %"),
    "pattern95": ("pattern: 95 %", "{:.0f} %"),
    "warned": ("warnings", "{:.0f}"),
    **{f"{k}_{what}": (f"{PLAIN[k]}: {what}", form) for k in PLAIN for what, form in (
        ("error", "{:.2f}"), ("angle", "{:.1f}°"))},
}  # fmt: skip
MEANS = (
    "within68",
    "within95",
    "inside",
    "pattern68",
    "pattern95",
)  # of shares the mean and the least; of all else the median and the most


def by_job(rows: list) -> str:
    """A line a job."""
    lines = [[row["job"], *(form.format(row[key]) for key, (_, form) in COLUMNS.items())] for row in rows]
    return tables.table(["job", *(words for words, _ in COLUMNS.values())], lines)


def summary(rows: list) -> str:
    """Medians and worst by kind, and of all."""
    how = {key: {"middle": np.mean, "far": np.min} if key in MEANS else {} for key in COLUMNS}
    columns = [(head, tables.spread_of(key, form, **how[key])) for key, (head, form) in COLUMNS.items()]
    return tables.summary("", [("jobs", len), *columns], tables.groups(rows, lambda r: r["job"].split("_")[0]))


def draw(path: Path, rows: list) -> None:
    """Every photograph's errors, ours and the plain fits', above the error that ours stated."""
    figure = tables.figure(6.4, 5.2, dpi=120)
    axes = figure.subplots()
    stated = np.array([r["stated"] for r in rows])
    for (name, (marker, size)), colour in zip(LOOKS.items(), tables.COLOURS, strict=False):
        look = {"color": colour, "marker": marker, "s": size, "zorder": 4 if name == "ours" else 2}
        words = "ours" if name == "ours" else f"plain: {PLAIN[name]}"
        axes.scatter(stated, [r[f"{name}_error"] for r in rows], linewidths=0, alpha=0.85, label=words, **look)
    ends = np.array([0.7 * stated.min(), 1.4 * stated.max()])
    axes.plot(ends, ends, color="#000000", linewidth=0.9, label="error = stated")
    axes.fill_between(ends, ends / 2, 2 * ends, color="#000000", alpha=0.06, linewidth=0, label="within a factor of 2")
    axes.set(xscale="log", yscale="log", xlim=ends, xlabel="error that the estimate states (order 2, median)")
    axes.set_ylabel("error of the light up to order 2 (relative, one free scale)")
    tables.plain(axes, size=10, grid="both")
    tables.log_ticks(axes.xaxis, *ends)
    tables.log_ticks(axes.yaxis, *axes.get_ylim())
    axes.legend(frameon=False, fontsize=8.5)
    axes.set_title(f"{len(rows)} photographs of real objects under known lamps", fontsize=11)
    tables.save(figure, path)


def kind(warning: str) -> str:
    """A warning without its numbers."""
    return re.sub(r"[-+]?\d+(\.\d+)?", "#", warning)


def main(arguments) -> int:
    options = parser("real", __doc__)
    options.add_argument("folder", type=Path, help="of jobs, each with a truth.json")
    options.add_argument("--only", default="*", metavar="GLOB", help="of the jobs' names")
    saved = (cameras.SRGB, *cameras.MEASURED)
    options.add_argument("--saved", choices=saved, metavar="HOW", help=f"as JPEGs: {', '.join(saved)}")
    options.add_argument("--read", choices=READ, metavar="CURVE", help="as --colorspace of btfsep estimate")
    options.add_argument("--chart", type=Path, help="where to draw, else that of docs/accuracy.md, if all is as it is")
    given = options.parse_args(arguments)
    truths = given.folder.glob(f"{given.only}/truth.json")
    folders = sorted(p.parent for p in truths if (p.parent / "job.json").exists())
    if not folders:
        options.error(f"{given.folder} has no jobs with a truth.json")
    rows = [study(folder, saved=given.saved, read=given.read) for folder in tqdm(folders)]
    print(by_job(rows) + "\n\nMedians (worst); of shares means (least):\n\n" + summary(rows))
    said = Counter(words for r in rows for words in {kind(w) for w in r["warnings"]})
    print("\nWarned of, numbers left out:\n")
    for words, count in said.most_common():
        print(f"- {count} of {len(rows)}: {words}")
    as_it_is = given.only == "*" and not given.saved and not given.read
    chart = given.chart or (CHART if as_it_is else None)
    if chart:
        draw(chart, rows)
    return 0
