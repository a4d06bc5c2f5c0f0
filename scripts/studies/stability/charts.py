# SPDX-License-Identifier: GPL-3.0-or-later
"""The charts of the stability study: one small picture for each axis."""

from pathlib import Path

import numpy as np

from scripts.studies import tables
from scripts.studies.stability.axes import AXES
from scripts.studies.stability.methods import NAMES, STATES_SPREAD

# colours told apart by everybody; ours is drawn last and thick, the paper's orders are of one colour, dotted and dashed
LOOKS = {
    "ours": {"color": tables.COLOURS[0], "linewidth": 2.6, "marker": "o", "markersize": 4.5, "zorder": 5},
    **{
        method: {
            "color": tables.COLOURS[colour], "linestyle": line, "linewidth": 1.4, "marker": marker, "markersize": 3.4,
        }
        for method, colour, line, marker in (
            ("paper-btf", 1, "-", "s"), ("paper-mean", 3, "-", "D"), ("paper-2", 3, ":", ""), ("paper-3", 3, "-.", ""),
            ("paper-order", 5, "-", "X"), ("lambertian", 6, "-", "v"), ("alternating", 2, "-", "^"),
            ("joint", 4, "-", "P"),
        )
    },
}  # fmt: skip
MEASURES = {  # name of the picture: (measure, title, scale, limits)
    "stability": ("order2", "Error of the coefficients up to order 2 (relative, one free scale)", "log", (0.03, 3.0)),
    "stability-direction": ("direction", "Angle between the main directions of the light, degrees", "linear", (0, 180)),
    "stability-spheres": ("spheres", "Three spheres: mean si-RMSE of diffuse, silver, mirror", "log", (0.01, 0.5)),
    "stability-psnr": ("psnr", "The photograph rendered again under the estimated light: PSNR, dB", "linear", (8, 40)),
}
COLUMNS = 4
X = np.arange(6)
DASHED = {"color": tables.COLOURS[0], "linewidth": 1.3, "linestyle": (0, (3, 2)), "zorder": 4}


def _drawn(path: Path, names, title: str, draw) -> None:
    """A chart for each of ``names``, by ``draw(axes, name)``, and a legend beside them."""
    rows = -(-(len(names) + 1) // COLUMNS)
    figure = tables.figure(3.1 * COLUMNS, 2.45 * rows + 0.5)
    every = figure.subplots(rows, COLUMNS, squeeze=False).ravel()
    figure.suptitle(title, fontsize=13)
    for name, axes in zip(names, every, strict=False):
        tables.plain(axes, size=7.5, grid="both")
        axes.set_title(name, fontsize=10)
        axes.set_xlabel(AXES[name].label, fontsize=8)
        axes.set_xticks(X, ["none", *(f"{v:g}" for v in AXES[name].values)])
        axes.set_xlim(-0.2, 5.2)
        draw(axes, name)
    for axes in every[len(names) :]:
        axes.set_axis_off()
    shown = sorted(zip(*every[0].get_legend_handles_labels(), strict=True), key=lambda p: not p[1].startswith("ours"))
    every[len(names)].legend(*zip(*shown, strict=True), loc="center left", fontsize=8.5, frameon=False)
    tables.save(figure, path)


def measure_chart(path: Path, answers, name: str) -> None:
    """Medians of a measure against severity; of ours also the middle half and, of errors, what it states."""
    measure, title, scale, limits = MEASURES[name]

    def draw(axes, axis):
        for method in sorted(answers.methods, key=lambda m: m == "ours"):
            y = answers.series(axis, method, measure)
            shown = np.clip(y, *limits)
            axes.plot(X, shown, label=NAMES[method], clip_on=False, **LOOKS[method])
            for i in np.flatnonzero(np.nan_to_num(y) > limits[1]):
                look = {"ha": "center", "fontsize": 6, "color": LOOKS[method]["color"]}
                axes.annotate(f"{y[i]:.3g}", (i, shown[i]), textcoords="offset points", xytext=(0, -9), **look)
        if "ours" in answers.methods:
            low, high = (
                answers.series(axis, "ours", measure, of=lambda v, q=q: np.quantile(v, q)) for q in (0.25, 0.75)
            )
            band = {"color": LOOKS["ours"]["color"], "alpha": 0.15, "linewidth": 0}
            axes.fill_between(X, np.clip(low, *limits), np.clip(high, *limits), **band)
            if measure == "order2":
                stated = np.clip(answers.series(axis, "ours", "stated"), *limits)
                axes.plot(X, stated, label="ours: error that it states", **DASHED)
        axes.set(ylim=limits, yscale=scale)
        if scale == "log":
            tables.log_ticks(axes.yaxis, *limits)

    _drawn(path, answers.names, title, draw)


def coverage_chart(path: Path, answers) -> None:
    """Share of the true coefficients inside the stated intervals, of the methods that state any."""

    def draw(axes, axis):
        for method in (m for m in STATES_SPREAD if m in answers.methods):
            for key, style, words in (("within95", "-", "95 %"), ("within68", ":", "68 %")):
                look = LOOKS[method] | {"linestyle": style, "label": f"{NAMES[method]}, {words}", "clip_on": False}
                axes.plot(X, 100 * answers.series(axis, method, key, of=np.mean), **look)
        for level in (68, 95):
            axes.axhline(level, color="#000000", linewidth=0.7, zorder=1)
        axes.set(ylim=(0, 100), yticks=[0, 25, 50, 68, 95])

    _drawn(path, answers.names, "Truth inside the stated intervals (coefficients up to order 2)", draw)


def warnings_chart(path: Path, answers) -> None:
    """Share of the photographs of which the engine said something."""

    def share(axis, method, **kind):
        counts = [answers.warned(axis, i, method, **kind) for i in X]
        return [100 * count / total if total else np.nan for count, total in counts]

    def draw(axes, axis):
        for method in (m for m in STATES_SPREAD if m in answers.methods):
            axes.plot(X, share(axis, method), label=NAMES[method], clip_on=False, **LOOKS[method])
        if "ours" in answers.methods:
            label = "ours: what it had not said undisturbed"
            axes.plot(X, share(axis, "ours", anew=True), label=label, **DASHED)
        axes.set_ylim(0, 100)

    _drawn(path, answers.names, "Photographs that were warned of, %", draw)


def draw_all(folder: Path, answers) -> None:
    """Draws every chart into ``folder``."""
    for name in MEASURES:
        measure_chart(folder / f"{name}.png", answers, name)
    coverage_chart(folder / "stability-coverage.png", answers)
    warnings_chart(folder / "stability-warnings.png", answers)
