# SPDX-License-Identifier: GPL-3.0-or-later
"""Rows of labelled pictures, and the demo's: photo, recognised material, true and estimated light, re-rendering."""

from pathlib import Path

import numpy as np

from btfsep_engine import sh
from btfsep_engine.fit import compare
from btfsep_engine.imaging.srgb import linear_to_srgb
from scripts.studies import tables

DIFFERENCE_GAIN = 2.0
BALL = 180  # pixels, under a light's map of twice that
TITLES = (
    "photo", "recognised material", "true light", "estimated light", "re-rendered",
    f"difference × {DIFFERENCE_GAIN:.0f}",
)  # fmt: skip


def exposure(radiance) -> float:
    """The factor that brings the 99th percentile of ``radiance`` to a linear display value of 0.8."""
    return 0.8 / max(float(np.percentile(radiance, 99.0)), 1e-12)


def display(radiance, factor: float) -> np.ndarray:
    """Display values in [0, 1] (sRGB-coded) of linear radiance."""
    return np.clip(linear_to_srgb(np.clip(np.nan_to_num(radiance) * factor, 0, 1)), 0, 1)


def on_white(picture, mask) -> np.ndarray:
    """A display picture over white, ``mask : (h, w)`` in [0, 1]."""
    return picture * mask[..., None] + 1 - mask[..., None]


def light_picture(coefficients, factors, view) -> np.ndarray:
    """A light: its map, and below it a white and a chrome ball under it, seen as the camera sees."""
    balls = compare.spheres(coefficients, size=BALL, view=view)
    shown = [on_white(display(balls[k], factors[k]), np.isfinite(balls[k]).all(-1)) for k in ("diffuse", "mirror")]
    above = display(sh.to_map(coefficients, BALL, 2 * BALL), factors["map"])
    return np.concatenate([above, np.ones((BALL // 20, 2 * BALL, 3)), np.concatenate(shown, 1)])


def write_rows(path: Path, rows, *, titles, side: float = 2.0) -> None:
    """Draws rows of (picture (h, w, 3) in [0, 1], words), each column under its title; ``side``: inches, of a row."""
    widths = [picture.shape[1] / picture.shape[0] for picture, _ in rows[0]]
    figure = tables.figure(side * sum(widths) + 0.3, (side + 0.3) * len(rows) + 0.3, dpi=150)
    grid = figure.subplots(len(rows), len(widths), width_ratios=widths, squeeze=False)
    for places, row in zip(grid, rows, strict=True):
        for axes, (picture, words) in zip(places, row, strict=True):
            axes.imshow(np.clip(picture, 0, 1), interpolation="antialiased")
            tables.empty(axes)
            axes.set_xlabel(words, fontsize=8.5, color="0.35", labelpad=3)
    for axes, words in zip(grid[0], titles, strict=True):
        axes.set_title(words, fontsize=11, pad=5)
    tables.save(figure, path)


def write(path: Path, *, photo, mask, material, rerendered, truth, estimate, view, words) -> None:
    """Composes the demo's figure.

    Parameters
    ----------
    photo, rerendered, material : (h, w, 3) float, linear; ``material`` is the object as the library's material
    mask : (h, w) in [0, 1], the object
    truth, estimate : ((L + 1)^2, 3) coefficients of the same order
    view : (3,) the direction in which the camera looks
    words : a line for each picture
    """
    factor, ball = exposure(photo[mask > 0.99]), compare.spheres(truth, size=64, view=view)["diffuse"]
    bright = exposure(sh.to_map(truth, 32, 64))
    factors = {"map": bright, "mirror": bright, "diffuse": exposure(ball[np.isfinite(ball)])}
    difference = np.abs(rerendered - photo) * DIFFERENCE_GAIN
    pictures = [
        display(photo, factor),
        on_white(display(material, factor), mask),
        light_picture(truth, factors, view),
        light_picture(estimate, factors, view),
        *(on_white(display(picture, factor), mask) for picture in (rerendered, difference)),
    ]
    write_rows(path, [list(zip(pictures, words, strict=True))], titles=TITLES, side=2.3)
