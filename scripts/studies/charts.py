# SPDX-License-Identifier: GPL-3.0-or-later
"""The charts of the stability study: one small picture for each axis, and a sheet of photographs."""

from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

from scripts.studies import scenes
from scripts.studies.axes import AXES
from scripts.studies.methods import NAMES, STATES_SPREAD

# Okabe and Ito's colours, told apart by everybody; ours is drawn last and thick
LOOKS = {
    "ours": {"color": "#0072B2", "linewidth": 2.6, "marker": "o", "markersize": 4.5, "zorder": 5},
    "paper-btf": {"color": "#D55E00", "linewidth": 1.4, "marker": "s", "markersize": 3.5},
    "paper-mean": {"color": "#E69F00", "linewidth": 1.4, "marker": "D", "markersize": 3.2},
    "paper-order": {"color": "#56B4E9", "linewidth": 1.4, "marker": "X", "markersize": 3.8},
    "lambertian": {"color": "#777777", "linewidth": 1.2, "marker": "v", "markersize": 3.5},
    "alternating": {"color": "#009E73", "linewidth": 1.2, "marker": "^", "markersize": 3.5},
    "joint": {"color": "#CC79A7", "linewidth": 1.4, "marker": "P", "markersize": 3.8},
}
MEASURES = {  # name of the picture: (measure, title, scale, limits)
    "stability": ("order2", "Error of the coefficients up to order 2 (relative, one free scale)", "log", (0.03, 3.0)),
    "stability-direction": ("direction", "Angle between the main directions of the light, degrees", "linear", (0, 180)),
    "stability-spheres": ("spheres", "Three spheres: mean si-RMSE of diffuse, silver, mirror", "log", (0.01, 0.5)),
    "stability-psnr": ("psnr", "The photograph rendered again under the estimated light: PSNR, dB", "linear", (8, 40)),
}
TICKS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2)
COLUMNS = 4


def _grid(names, title: str):
    """A figure with an Axes for each of ``names``, and a free place for the legend: figure, all axes, the place."""
    rows = -(-(len(names) + 1) // COLUMNS)
    figure = Figure(figsize=(3.1 * COLUMNS, 2.45 * rows + 0.5), layout="constrained")
    FigureCanvasAgg(figure)
    axes = np.atleast_1d(figure.subplots(rows, COLUMNS, squeeze=False)).ravel()
    figure.suptitle(title, fontsize=13)
    for name, ax in zip(names, axes, strict=False):
        axis = AXES[name]
        ax.set_title(name, fontsize=10)
        ax.set_xlabel(axis.label, fontsize=8)
        ax.set_xticks(range(6), ["none", *(f"{v:g}" for v in axis.values)], fontsize=7.5)
        ax.set_xlim(-0.2, 5.2)
        ax.tick_params(axis="y", labelsize=7.5)
        ax.grid(color="#dddddd", linewidth=0.6)
        ax.set_axisbelow(True)
        for side in ("top", "right"):
            ax.spines[side].set_visible(False)
    for ax in axes[len(names) :]:
        ax.set_axis_off()
    return figure, axes, axes[len(names)]


def _legend(place, ax) -> None:
    handles, labels = ax.get_legend_handles_labels()
    order = sorted(range(len(labels)), key=lambda i: not labels[i].startswith("ours"))
    place.legend(
        [handles[i] for i in order], [labels[i] for i in order], loc="center left", fontsize=8.5, frameon=False
    )


def measure_chart(path, answers, name: str) -> None:
    """Medians of a measure against severity; of ours also the middle half and, of errors, what it states."""
    measure, title, scale, limits = MEASURES[name]
    figure, axes, place = _grid(answers.names, title)
    x = np.arange(6)
    for axis, ax in zip(answers.names, axes, strict=False):
        for method in sorted(answers.methods, key=lambda m: m == "ours"):
            y = np.array([answers.median(axis, i, method, measure) for i in x])
            shown = np.clip(y, *limits)
            ax.plot(x, shown, label=NAMES[method], clip_on=False, **LOOKS[method])
            for i in x[_beyond(y, limits)]:
                ax.annotate(
                    f"{y[i]:.3g}",
                    (i, shown[i]),
                    textcoords="offset points",
                    xytext=(0, -9),
                    ha="center",
                    fontsize=6,
                    color=LOOKS[method]["color"],
                )
        if "ours" in answers.methods:
            spread = [answers.values(axis, i, "ours", measure) for i in x]
            low, high = (
                np.clip([np.quantile(v, q) if len(v) else np.nan for v in spread], *limits) for q in (0.25, 0.75)
            )
            ax.fill_between(x, low, high, color=LOOKS["ours"]["color"], alpha=0.15, linewidth=0)
            if measure == "order2":
                stated = [answers.median(axis, i, "ours", "stated") for i in x]
                look = {"color": LOOKS["ours"]["color"], "linewidth": 1.3, "linestyle": (0, (3, 2))}
                ax.plot(x, np.clip(stated, *limits), label="ours: error that it states", zorder=4, **look)
        ax.set_ylim(*limits)
        if scale == "log":
            ax.set_yscale("log")
            ax.yaxis.set_major_locator(FixedLocator([t for t in TICKS if limits[0] <= t <= limits[1]]))
            ax.yaxis.set_minor_locator(NullLocator())
            ax.yaxis.set_major_formatter(FuncFormatter(lambda v, _: f"{v:g}"))
    _legend(place, axes[0])
    figure.savefig(path, dpi=110)


def _beyond(y, limits) -> np.ndarray:
    """Where a value lies above the picture."""
    return np.flatnonzero(np.nan_to_num(y) > limits[1])


def coverage_chart(path, answers) -> None:
    """Share of the true coefficients inside the stated intervals, of the methods that state any."""
    figure, axes, place = _grid(answers.names, "Truth inside the stated intervals (coefficients up to order 2)")
    x = np.arange(6)
    for axis, ax in zip(answers.names, axes, strict=False):
        for method in (m for m in STATES_SPREAD if m in answers.methods):
            for key, style, words in (("within95", "-", "95 %"), ("within68", ":", "68 %")):
                y = [100 * answers.mean(axis, i, method, key) for i in x]
                ax.plot(x, y, linestyle=style, label=f"{NAMES[method]}, {words}", clip_on=False, **LOOKS[method])
        for level in (68, 95):
            ax.axhline(level, color="#000000", linewidth=0.7, zorder=1)
        ax.set_ylim(0, 100)
        ax.set_yticks([0, 25, 50, 68, 95])
    _legend(place, axes[0])
    figure.savefig(path, dpi=110)


def warnings_chart(path, answers) -> None:
    """Share of the photographs of which the engine said something."""
    figure, axes, place = _grid(answers.names, "Photographs that were warned of, %")
    x = np.arange(6)
    for axis, ax in zip(answers.names, axes, strict=False):
        for method in (m for m in STATES_SPREAD if m in answers.methods):
            counts = [answers.warned(axis, i, method) if i else _zero(answers, axis, method) for i in x]
            ax.plot(x, [_percent(*pair) for pair in counts], label=NAMES[method], clip_on=False, **LOOKS[method])
        if "ours" in answers.methods:
            anew = [answers.warned(axis, i, "ours", anew=True) for i in x[1:]]
            shares = [0, *(_percent(*pair) for pair in anew)]
            look = {"color": LOOKS["ours"]["color"], "linewidth": 1.3, "linestyle": (0, (3, 2))}
            ax.plot(x, shares, label="ours: what it had not said undisturbed", zorder=4, **look)
        ax.set_ylim(0, 100)
    _legend(place, axes[0])
    figure.savefig(path, dpi=110)


def _percent(count: int, total: int) -> float:
    """NaN of none: it leaves a gap."""
    return 100 * count / total if total else np.nan


def _zero(answers, axis, method):
    found = answers.of(axis, 0, method)
    return sum(bool(r["warnings"]) for r in found), len(found)


def photographs(path, chosen, options) -> bool:
    """A sheet of what is photographed: a row for each scene. False where photographs are missing."""
    from scripts.studies.run import UNDISTURBED, Task

    wanted = [(UNDISTURBED, 0, light, f"undisturbed, {scenes.light_name(light)}") for light in options.lights]
    wanted += [(a, 5, options.lights[0], a) for a in ("sun", "near light", "coloured light", "second object")]
    wanted += [("flat geometry", 3, options.lights[0], "flat geometry"), ("noise", 4, options.lights[0], "noise")]
    wanted = [w for w in wanted if w[0] in (UNDISTURBED, *options.axes)]
    figure = Figure(figsize=(1.5 * len(wanted), 1.5 * len(chosen) + 0.3), layout="constrained")
    FigureCanvasAgg(figure)
    places = figure.subplots(len(chosen), len(wanted), squeeze=False)
    for row, scene in zip(places, chosen, strict=True):
        for ax, (axis, index, light, words) in zip(row, wanted, strict=True):
            try:
                case = Task(axis, index, scene, light).case(options.work, options.lights)
            except Exception as error:  # a photograph that was not made yet
                if not _is_missing(error):
                    raise
                return False
            picture = np.clip(case.image * (0.75 / np.percentile(case.clean[case.region], 97)), 0, 1) ** (1 / 2.2)
            ax.imshow(picture, interpolation="nearest")
            ax.set_xticks([])
            ax.set_yticks([])
            if scene is chosen[0]:
                value = "" if index == 0 else f", {AXES[axis].values[index - 1]:g}"
                ax.set_title(words + value, fontsize=7.5)
        row[0].set_ylabel(scene.name, fontsize=9)
    figure.savefig(path, dpi=130)
    return True


def _is_missing(error: Exception) -> bool:
    from btfsep_engine.errors import InputError

    return isinstance(error, InputError | FileNotFoundError)


def draw_all(folder, answers, chosen, options) -> list[str]:
    """Draws every chart into ``folder``; gives their names."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    for name in MEASURES:
        measure_chart(folder / f"{name}.png", answers, name)
    coverage_chart(folder / "stability-coverage.png", answers)
    warnings_chart(folder / "stability-warnings.png", answers)
    names = [*MEASURES, "stability-coverage", "stability-warnings"]
    if photographs(folder / "stability-photos.png", chosen, options):
        names.append("stability-photos")
    return names
