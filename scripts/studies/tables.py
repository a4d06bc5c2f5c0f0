# SPDX-License-Identifier: GPL-3.0-or-later
"""Tables in Markdown, pages with parts that a study fills in, and the charts' common looks."""

import csv
import io
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from btfsep_engine.atomic import replacing, write_text

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#E69F00", "#CC79A7", "#56B4E9", "#777777")  # Okabe and Ito's, and grey


def table(head, rows) -> str:
    """A Markdown table: the head's words, and rows of words or numbers."""
    lines = [f"| {' | '.join(map(str, line))} |" for line in (head, *rows)]
    return "\n".join([lines[0], "|---" * len(head) + "|", *lines[1:]])


def spread(values, form: str = "{:.2f}", *, between=" ({})", middle=np.median, far=np.max) -> str:
    """A table's cell: the median and, in brackets, the worst; a dash where a value is missing."""
    values = np.asarray(values, np.float64)
    if not len(values) or np.isnan(values).any():
        return "–"
    return form.format(middle(values)) + between.format(form.format(far(values)))


def percent(values) -> str:
    """The mean of shares; a dash where there are none."""
    return f"{100 * np.mean(values):.0f} %" if len(values) else "–"


def groups(rows, key, *, every: str | None = "**all**") -> list:
    """(name, rows) of each value of a key (a name, or a function of a row), and of all."""
    of = key if callable(key) else lambda row: row[key]
    out = [(name, [r for r in rows if of(r) == name]) for name in dict.fromkeys(map(of, rows))]
    return [*out, (every, rows)] if every else out


def fill(page: Path, part: str, text: str) -> None:
    """Puts a study's ``text`` between the lines of its part of a page; what people wrote around them stays.

    A page that is not there is made of that part alone.

    Raises
    ------
    ValueError
        Where the page lacks one of the lines, or has it twice.
    """
    before, after = f"<!-- {part} -->", f"<!-- end of {part} -->"
    old = page.read_text(encoding="utf-8") if page.exists() else f"{before}\n{after}\n"
    if old.count(before) != 1 or old.count(after) != 1 or old.index(before) > old.index(after):
        raise ValueError(f"{page} needs the lines {before} and {after}, once each, in this order")
    head, tail = old[: old.index(before) + len(before)], old[old.index(after) :]
    write_text(page, f"{head}\n\n{text.strip()}\n\n{tail}")


def write_csv(path: Path, rows, fields) -> None:
    """Dicts as a table of all numbers."""
    out = io.StringIO()
    writer = csv.DictWriter(out, fields, extrasaction="ignore", lineterminator="\n")
    writer.writeheader()
    writer.writerows({k: f"{v:.4g}" if isinstance(v, float) else v for k, v in r.items()} for r in rows)
    write_text(path, out.getvalue())


def figure(width: float, height: float, **options) -> Figure:
    """An empty figure, in inches."""
    made = Figure(figsize=(width, height), facecolor="white", **{"layout": "constrained", "dpi": 110, **options})
    FigureCanvasAgg(made)
    return made


def plain(axes, *, size: float = 8, grid: str = "y") -> None:
    """The looks of a small chart: a pale grid behind, no frame above and at the right."""
    axes.grid(axis=grid, color="#dddddd", linewidth=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(labelsize=size)


def log_ticks(axis, low: float, high: float, ticks=(0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2)) -> None:
    """Few round numbers on a logarithmic axis."""
    kept = [t for t in ticks if low <= t <= high]
    axis.set_ticks(kept, [f"{t:g}" for t in kept])
    axis.set_ticks([], minor=True)


def empty(axes) -> None:
    """No ticks and no frame: for pictures."""
    axes.set(xticks=[], yticks=[])
    axes.spines[:].set_visible(False)


def save(made: Figure, path: Path) -> None:
    """Writes a figure as PNG."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as scratch:
        made.savefig(scratch, format="png")
