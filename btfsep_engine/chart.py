# SPDX-License-Identifier: GPL-3.0-or-later
"""The chart of speed against accuracy, drawn from :mod:`btfsep_engine.pipeline.tradeoff`'s points."""

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullFormatter

from btfsep_engine.atomic import replacing

MARKERS = "oDs^vP*X<>"
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
    for p in points:
        axes.annotate(
            p.name, (p.seconds, p.error), xytext=(5, 4), textcoords="offset points", fontsize=7.5, color="0.25",
            weight="bold" if p.axis == "preset" else "normal",
        )  # fmt: skip
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
    axes.set_title(title, fontsize=11)
    figure.legend(fontsize=8, loc="outside right upper")
    with replacing(path) as scratch:
        figure.savefig(scratch, format="png")
