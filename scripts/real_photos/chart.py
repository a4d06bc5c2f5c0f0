# SPDX-License-Identifier: GPL-3.0-or-later
"""One picture: the median error of every estimator against severity, an axis each."""

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from scripts.real_photos.axes import SEVERITIES, SHARES, TITLES

COLOURS = ("#D55E00", "#0072B2", "#009E73", "#E69F00", "#CC79A7", "#56B4E9")  # Okabe and Ito's


def draw(path, answers: dict) -> None:
    """``answers`` : {axis: [{estimator: [error at each severity]}]}, a dict for each photo."""
    figure = Figure(figsize=(12, 7.2), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(2, 3).ravel()
    figure.suptitle("Median relative error of the light up to order 2", fontsize=13)
    errors = {name: rows for name, rows in answers.items() if name not in SHARES}
    for ax, (name, rows) in zip(axes, errors.items(), strict=True):
        x = np.arange(len(SEVERITIES[name]))
        for colour, estimator in zip(COLOURS, rows[0], strict=False):
            y = np.median([row[estimator] for row in rows], 0)
            if name == "textures":  # kinds of appearance, no severities
                where = x + 0.14 * (COLOURS.index(colour) - (len(rows[0]) - 1) / 2)
                ax.bar(where, y, 0.13, color=colour, label=estimator)
            else:
                ax.plot(x, y, marker="o", markersize=4, color=colour, label=estimator)
        ax.set_title(TITLES[name], fontsize=10)
        ax.set_xticks(x, [s.replace(", ", ",\n") for s in SEVERITIES[name]], fontsize=8)
        ax.tick_params(axis="y", labelsize=8)
        ax.grid(axis="y", color="#dddddd", linewidth=0.6)
        ax.set_axisbelow(True)
        for side in ("top", "right"):
            ax.spines[side].set_visible(False)
        ax.set_ylim(0, 1.4 * ax.get_ylim()[1])
        ax.legend(fontsize=7.5, frameon=False, loc="upper left")
    figure.savefig(path, dpi=110)
