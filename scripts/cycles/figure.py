# SPDX-License-Identifier: GPL-3.0-or-later
"""The demo's figure: photo, recognised material, true light, estimated light, re-rendering, difference, in one row."""

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from btfsep_engine import sh
from btfsep_engine.fit import compare
from btfsep_engine.images import linear_to_srgb

HEIGHT = 2.3  # inches, of a square picture
GAP, TOP, BOTTOM = 0.07, 0.36, 0.34  # inches
DIFFERENCE_GAIN = 2.0


def exposure(radiance, percentile: float = 99.0, level: float = 0.8) -> float:
    """The factor that brings a percentile of ``radiance`` to a linear display value."""
    return level / max(float(np.percentile(radiance, percentile)), 1e-12)


def display(radiance, factor: float) -> np.ndarray:
    """Display values in [0, 1] (sRGB-coded) of linear radiance."""
    return np.clip(linear_to_srgb(np.clip(np.nan_to_num(radiance) * factor, 0, 1)), 0, 1)


def on_white(picture, mask) -> np.ndarray:
    """A display picture over white, ``mask : (h, w)`` in [0, 1]."""
    return picture * mask[..., None] + 1 - mask[..., None]


def _ball(values, factor: float) -> np.ndarray:
    inside = np.isfinite(values).all(-1)
    return np.dstack([display(values, factor), inside.astype(float)])


class Row:
    """A row of labelled panels, laid out in inches from left to right."""

    def __init__(self, widths):
        self.width = sum(widths) + GAP * (len(widths) + 1)
        self.height = TOP + HEIGHT + BOTTOM
        self.figure = Figure(figsize=(self.width, self.height), dpi=150, facecolor="white")
        FigureCanvasAgg(self.figure)
        self.left = GAP

    def image(self, picture, x, y, width, height):
        """Draws ``picture`` with its lower left corner ``x, y`` inches from the panel's."""
        axes = self.figure.add_axes(
            [
                (self.left + x) / self.width,
                (BOTTOM + y) / self.height,
                width / self.width,
                height / self.height,
            ]
        )
        axes.imshow(picture, interpolation="antialiased", aspect="auto")
        axes.set_axis_off()

    def label(self, title, words, width):
        """Title above and words below the panel, and goes on to the next one."""
        centre = (self.left + width / 2) / self.width
        self.figure.text(centre, 1 - 0.6 * TOP / self.height, title, ha="center", va="center", fontsize=11)
        self.figure.text(
            centre, 0.5 * BOTTOM / self.height, words, ha="center", va="center", fontsize=8.5, color="0.35"
        )
        self.left += width + GAP


def _light(row, coefficients, factors, view, width):
    """A light: its map, and below it a white and a chrome ball under it, seen as the camera sees."""
    row.image(display(sh.to_map(coefficients, 200, 400), factors["map"]), 0, HEIGHT - width / 2, width, width / 2)
    side = HEIGHT - width / 2 - GAP
    balls = compare.spheres(coefficients, size=360, view=view)
    for column, kind in enumerate(("diffuse", "mirror")):
        x = width * (0.25 + 0.5 * column) - side / 2
        row.image(_ball(balls[kind], factors[kind]), x, 0, side, side)


def write(path, *, photo, mask, material, rerendered, truth, estimate, view, words) -> None:
    """Composes the figure.

    Parameters
    ----------
    path : PNG
    photo, rerendered, material : (h, w, 3) float, linear; ``material`` is the object as the library's material
    mask : (h, w) in [0, 1], the object
    truth, estimate : ((L + 1)^2, 3) coefficients of the same order
    view : (3,) the direction in which the camera looks
    words : dict with a line for each of photo, material, truth, estimate, rerendered, difference
    """
    solid = mask > 0.99
    factor = exposure(photo[solid])
    balls = compare.spheres(truth, size=64, view=view)
    factors = {"map": exposure(sh.to_map(truth, 32, 64), 99.0), "mirror": 0.0}
    factors["mirror"] = factors["map"]
    factors["diffuse"] = exposure(balls["diffuse"][np.isfinite(balls["diffuse"])])
    difference = np.abs(rerendered - photo) * DIFFERENCE_GAIN
    wide = 1.28 * HEIGHT
    row = Row([HEIGHT, HEIGHT, wide, wide, HEIGHT, HEIGHT])
    row.image(display(photo, factor), 0, 0, HEIGHT, HEIGHT)
    row.label("photo", words["photo"], HEIGHT)
    row.image(on_white(display(material, factor), mask), 0, 0, HEIGHT, HEIGHT)
    row.label("recognised material", words["material"], HEIGHT)
    _light(row, truth, factors, view, wide)
    row.label("true light", words["truth"], wide)
    _light(row, estimate, factors, view, wide)
    row.label("estimated light", words["estimate"], wide)
    row.image(on_white(display(rerendered, factor), mask), 0, 0, HEIGHT, HEIGHT)
    row.label("re-rendered", words["rerendered"], HEIGHT)
    row.image(on_white(display(difference, factor), mask), 0, 0, HEIGHT, HEIGHT)
    row.label(f"difference × {DIFFERENCE_GAIN:.0f}", words["difference"], HEIGHT)
    row.figure.savefig(path)
