# SPDX-License-Identifier: GPL-3.0-or-later
"""Tables in Markdown, pages with parts that a study fills in, and the charts' common looks."""

import csv
import io
import operator
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from btfsep_engine.storage.atomic import replacing, write_text

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
    """(name, rows) of each value of a key (a name, several, or a function of a row), and of all."""
    if isinstance(key, tuple):
        of = operator.itemgetter(*key)
    else:
        of = key if callable(key) else operator.itemgetter(key)
    out = [(name, [r for r in rows if of(r) == name]) for name in dict.fromkeys(map(of, rows))]
    return [*out, (every, rows)] if every else out


def groups_of_ways(rows, key):
    """All of each way, then those of each value of a key: ((way, value), rows)."""
    for way, some in groups(rows, "way", every=None):
        yield (f"**{way}**", "**all**"), some
        yield from (((way, value), own) for value, own in groups(some, key, every=None))


def spread_of(key: str, form: str = "{:.2f}", *, over: str | None = None, **how):
    """A column of `summary`: the `spread` of a key of the rows, or of what it is over another."""
    return lambda rows: spread([r[key] / r[over] if over else r[key] for r in rows], form, **how)


def median_of(key: str, form: str = "{:.2f}"):
    """A column of `summary`: the median of a key."""
    return lambda rows: form.format(np.median([r[key] for r in rows]))


def percent_of(key: str):
    """A column of `summary`: the mean of a key's shares, or in how many rows it is true."""
    return lambda rows: percent([r[key] for r in rows])


# of rows that have `measures.judged`, and ``over``: the error over the one that is stated
OF_LIGHT = (
    ("error", spread_of("order2")),
    ("direction", spread_of("direction", "{:.1f}°")),
    ("stated", median_of("stated2")),
    ("over stated", spread_of("over")),
    ("95 % range", percent_of("inside")),
)


def summary(heads, columns, grouped) -> str:
    """A table with a line for each of some groups of rows.

    Parameters
    ----------
    heads : what the groups are named by, a word or several
    columns : (head, function of a group's rows that gives its cell)
    grouped : of `groups`
    """
    heads = (heads,) if isinstance(heads, str) else heads
    lines = (((n,) if isinstance(n, str) else n, some) for n, some in grouped)
    return table([*heads, *(h for h, _ in columns)], [(*name, *(f(some) for _, f in columns)) for name, some in lines])


def fill(page: Path, part: str, text: str) -> None:
    """Puts a study's ``text`` between the lines of its part of a page; what people wrote around them stays.

    A page that is not there is made of that part alone.

    Raises ValueError where the page lacks one of the lines, or has it twice.
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
