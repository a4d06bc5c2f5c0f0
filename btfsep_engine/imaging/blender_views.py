# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender's view transforms, undone: what a render was before it was saved as an ordinary picture.

AgX, by T. J. Sobotka, as Blender has it since 4.0 (there the default): colours are drawn together, each channel goes
through a curve like a film's over 16.5 stops, and hues are restored. Channels depend on each other, so that its
inverse is a table of colours: the cube roots of linear Rec.709, because steps of these look alike. Blender's own
inverse fills it (`scripts/study tabulate-views`); between its entries it is interpolated, 0.3 % off in the median and
1 % at nine of ten. Filmic, the default before, is another such table. AgX's looks change the logarithms that its curve
gets, v = (log2 c + 12.47) / 25 of colours c drawn together: contrast about 0.4 with less or more saturation, or deeper
shadows (*Punchy*, which is tabulated). Khronos PBR Neutral is a formula (Khronos Group, 2024).
"""

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from btfsep_engine.conventions import REC709_LUMINANCE
from btfsep_engine.imaging.srgb import srgb_to_linear

TABLE = Path(__file__).resolve().parents[1] / "data" / "blender_views.npz"
AT_ONCE = 1 << 20  # pixels: a large photo's coordinates are not made all at once
STEP = 1 / 512  # of a code, of a numerical derivative
LEAST = 1e-12  # of a volume
LEAST_LOG, STOPS, PIVOT = -12.47393, 25.0, 0.4  # of AgX's logarithms
DRAWN_TOGETHER = np.array(  # linear Rec.709 to the colours of which AgX takes logarithms, by way of Rec.2020
    [
        [0.856627153315983, 0.0951212405381588, 0.0482516061458583],
        [0.137318972929847, 0.761241990602591, 0.101439036467562],
        [0.11189821299995, 0.0767994186031903, 0.811302368396859],
    ]
) @ np.array([[0.6274039, 0.3292830, 0.0433131], [0.0690973, 0.9195404, 0.0113623], [0.0163914, 0.0880133, 0.8955953]])
WHITISH, NEAR_WHITE = 0.98, 0.6  # of the largest code; of what it stands for
COMPRESSED_FROM, DESATURATED, TOE = 0.76, 0.15, 0.08  # of Khronos PBR Neutral


@dataclass(frozen=True)
class View:
    """A view: its name in Blender, that of its look, and of which table its inverse is; "": of none.

    ``contrast`` and ``saturation`` : of AgX's looks; None: the look is tabulated
    """

    view: str
    look: str = "None"
    table: str = "agx"
    contrast: float | None = 1.0
    saturation: float = 1.0

    @property
    def description(self) -> str:
        """For people."""
        look = self.look.removeprefix("AgX - ")
        return f"Blender's view transform {self.view}" + ("" if look == "None" else f", {look}")


VIEWS = {
    "agx": View("AgX"),
    "agx-punchy": View("AgX", "AgX - Punchy", contrast=None),
    "agx-medium-high-contrast": View("AgX", "AgX - Medium High Contrast", contrast=1.2),
    "agx-high-contrast": View("AgX", "AgX - High Contrast", contrast=1.4, saturation=0.95),
    "filmic": View("Filmic", table="filmic"),
    "khronos": View("Khronos PBR Neutral", table=""),
}
"""By their names in jobs (``image_colorspace``)."""


@lru_cache(maxsize=1)
def _tables() -> dict:
    """(3, n, n, n) float32 of each view, by the codes of red, green and blue; (2, k): greys' logarithms, Punchy's."""
    with np.load(TABLE, allow_pickle=False) as file:
        tables = {name: file[name].astype(np.float32) for name in file.files}
    return {name: np.moveaxis(each, -1, 0) if each.ndim == 4 else each for name, each in tables.items()}


def to_linear(codes, name: str = "agx") -> np.ndarray:
    """Linear Rec.709 (..., 3) float64 of codes (..., 3), 0 to 1; colours that no light makes are negative.

    ``name`` : of `VIEWS`
    """
    view = VIEWS[name]
    if not view.table:
        return _khronos_undone(srgb_to_linear(codes))
    linear = _looked_up(_tables()[view.table], np.asarray(codes, np.float64))
    if view.look == "None":
        return linear
    logs = (np.log2(np.maximum(linear @ DRAWN_TOGETHER.T, 2.0**LEAST_LOG)) - LEAST_LOG) / STOPS
    if view.contrast is None:
        logs = np.interp(logs, *_tables()["punchy"][::-1])
    else:
        grey = (logs @ REC709_LUMINANCE)[..., None]
        logs = PIVOT + (grey + (logs - grey) / view.saturation - PIVOT) / view.contrast
    return 2.0 ** (LEAST_LOG + STOPS * logs) @ np.linalg.inv(DRAWN_TOGETHER).T


def near_white(codes, linear, name: str = "agx") -> np.ndarray:
    """Where codes (..., 3) say no more than that it was at least so bright: (..., 3) bool.

    A view brings all that is bright to white: near it a code more is a tenth more light, and a JPEG's are off by some.

    ``linear`` : (..., 3), their `to_linear`
    """
    white = to_linear(np.ones(3), name).max()
    return (codes >= WHITISH) | (np.max(linear, -1, keepdims=True) >= NEAR_WHITE * white)


def _looked_up(roots, codes) -> np.ndarray:
    """The cubes of what a table of cube roots has at codes (..., 3)."""
    from scipy.ndimage import map_coordinates  # slow to import, and most photos are not of this kind

    flat = codes.reshape(-1, 3)
    out = np.empty(flat.shape)
    for start in range(0, len(flat), AT_ONCE):
        at = np.clip(flat[start : start + AT_ONCE].T, 0, 1) * (roots.shape[1] - 1)
        for c in range(3):
            out[start : start + AT_ONCE, c] = map_coordinates(roots[c], at, output=np.float64, order=1, mode="nearest")
    return (out**3).reshape(codes.shape)


def _khronos_undone(shown) -> np.ndarray:
    """Linear Rec.709 of what Khronos PBR Neutral displays, linear (..., 3)."""
    peak = shown.max(-1, keepdims=True)
    left = 1 - COMPRESSED_FROM
    before = left**2 / np.maximum(1 - peak, 1e-4) - left + COMPRESSED_FROM
    kept = 1 / (DESATURATED * (before - peak) + 1)  # what is not white of it
    bright = (shown - peak * (1 - kept)) / kept * before / np.maximum(peak, COMPRESSED_FROM)
    colours = np.where(peak < COMPRESSED_FROM, shown, bright)
    least = colours.min(-1, keepdims=True)
    toe = np.where(least < TOE / 2, np.sqrt(np.maximum(least, 0) * 2 * TOE), least + TOE / 2)
    return colours + toe - least


def log_volume(codes, name: str = "agx") -> np.ndarray:
    """Logarithm of the determinant of what `to_linear` does to small changes of codes (..., 3): (...)."""
    codes = np.clip(np.asarray(codes, np.float64), STEP, 1 - STEP)
    moves = STEP * np.eye(3)
    columns = [(to_linear(codes + move, name) - to_linear(codes - move, name)) / (2 * STEP) for move in moves]
    return np.log(np.maximum(np.abs(np.linalg.det(np.stack(columns, -1))), LEAST))
