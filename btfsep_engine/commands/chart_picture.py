# SPDX-License-Identifier: GPL-3.0-or-later
"""The chart of speed against accuracy, drawn from :mod:`btfsep_engine.commands.tradeoff`'s points."""

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullFormatter
from matplotlib.transforms import Bbox

from btfsep_engine.storage.atomic import replacing

MARKERS = "oDs^vP*X<>"
AROUND = [(7, 0), (-7, 0), (0, 9), (0, -9), (6, 8), (-6, 8), (6, -8), (-6, -8), (0, 20), (0, -20), (14, 20), (14, -20)]
REFERENCES = {"truth": "against the true light", "thorough": "against the most thorough setting's estimate"}


def write_chart(path, points, *, reference: str, title: str) -> None:
    """Writes a PNG: error against seconds, both logarithmic, a marker for each axis, the Pareto front as a line.

    Parameters
    ----------
    path : PNG
    points : pipeline.tradeoff.Point, or anything with its axis, name, seconds, error and front
    reference : "truth" or "thorough"
    title : above the chart
    """
    figure = Figure(figsize=(10.5, 6.4), dpi=110, facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    front = sorted((p.seconds, p.error) for p in points if p.front)
    # what is reached by a given time: a staircase
    axes.step(*zip(*front, strict=True), where="post", color="0.75", linewidth=2, zorder=1, label="Pareto front")
    kinds = list(dict.fromkeys(p.axis for p in points))
    for number, kind in enumerate(kinds):
        mine = [p for p in points if p.axis == kind]
        axes.scatter(
            [p.seconds for p in mine],
            [p.error for p in mine],
            s=90 if kind == "preset" else 45,
            marker=MARKERS[number % len(MARKERS)],
            color=f"C{number % 10}",
            label=kind,
            zorder=3,
        )
    axes.set_xscale("log")
    axes.set_yscale("log")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter(FuncFormatter(lambda v, _: f"{v:g}"))
    axes.yaxis.set_minor_formatter(FuncFormatter(lambda v, _: f"{v:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.margins(x=0.14, y=0.08)
    axes.grid(alpha=0.25, which="both")
    axes.set_xlabel("seconds of transport and fit, warm")
    axes.set_ylabel(f"error of order 2, one free scale, {REFERENCES[reference]}")
    axes.set_title(title, fontsize=11, parse_math=False)
    figure.legend(fontsize=8, loc="outside right upper")
    figure.draw_without_rendering()  # the layout, by which labels are placed
    figure.set_layout_engine("none")
    _label(axes, points, {kind: f"C{number % 10}" for number, kind in enumerate(kinds)})
    with replacing(path) as scratch:
        figure.savefig(scratch, format="png")


def short_name(point) -> str:
    """What tells a point from the others of its axis, which the legend names: "250" of "250 pixels"."""
    if point.axis == "paper":
        return point.name
    return point.name.rsplit(", ", 1)[-1].removesuffix(f" {point.axis}").removeprefix(f"{point.axis} ")


def _label(axes, points, colours) -> None:
    """Names the points, each where it covers no marker and no other name, as far as there is such a place."""
    marks = axes.transData.transform([(p.seconds, p.error) for p in points])
    taken = [Bbox.from_extents(x - 6, y - 6, x + 6, y + 6) for x, y in marks]
    frame, unit = axes.get_window_extent(), axes.figure.dpi / 72
    for number in sorted(range(len(points)), key=lambda i: points[i].axis not in ("preset", "paper")):
        p, best = points[number], None
        text = axes.annotate(
            short_name(p), (p.seconds, p.error), xytext=AROUND[0], textcoords="offset points", fontsize=8,
            color=colours[p.axis], weight="bold" if p.axis == "preset" else "normal", va="center",
        )  # fmt: skip
        size = text.get_window_extent()
        for dx, dy in AROUND:
            side = "left" if dx > 0 else "right" if dx < 0 else "center"
            x = marks[number][0] + dx * unit - size.width * {"left": 0, "right": 1, "center": 0.5}[side]
            y = marks[number][1] + dy * unit - size.height / 2
            box = Bbox.from_bounds(x, y, size.width, size.height)
            covered = sum(box.overlaps(other) for i, other in enumerate(taken) if i != number)
            covered += not (frame.x0 <= box.x0 and box.x1 <= frame.x1 and frame.y0 <= box.y0 and box.y1 <= frame.y1)
            if best is None or covered < best[0]:
                best = covered, dx, dy, side, box
        _, dx, dy, side, box = best
        text.set(position=(dx, dy), horizontalalignment=side)
        taken.append(box)
