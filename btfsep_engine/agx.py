# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender's view transform AgX, undone: what a render was before it was saved as an ordinary picture.

AgX, by T. J. Sobotka, as Blender has it since 4.0 (there the default): colours are drawn together, each channel goes
through a curve like a film's over 16.5 stops, and hues are restored. Channels depend on each other, so that its
inverse is a table of colours: the cube roots of linear Rec.709, because steps of these look alike. Blender's own
inverse fills it (`scripts/study tabulate-agx`); between its entries it is interpolated, 0.3 % off in the median and 1 %
at nine of ten.
"""

from functools import lru_cache
from pathlib import Path

import numpy as np

TABLE = Path(__file__).resolve().parent / "data" / "agx.npz"
AT_ONCE = 1 << 20  # pixels: a large photo's coordinates are not made all at once
STEP = 1 / 512  # of a code, of a numerical derivative
LEAST = 1e-12  # of a volume


@lru_cache(maxsize=1)
def _roots() -> np.ndarray:
    """(3, n, n, n) float32: of each channel, by the codes of red, green and blue."""
    with np.load(TABLE, allow_pickle=False) as file:
        return np.moveaxis(file["roots"].astype(np.float32), -1, 0)


def to_linear(codes) -> np.ndarray:
    """Linear Rec.709 (..., 3) float64 of codes (..., 3), 0 to 1; colours that no light makes are negative."""
    from scipy.ndimage import map_coordinates  # slow to import, and most photos are not of this kind

    roots, codes = _roots(), np.asarray(codes, np.float64)
    flat = codes.reshape(-1, 3)
    out = np.empty(flat.shape)
    for start in range(0, len(flat), AT_ONCE):
        at = np.clip(flat[start : start + AT_ONCE].T, 0, 1) * (roots.shape[1] - 1)
        for c in range(3):
            out[start : start + AT_ONCE, c] = map_coordinates(roots[c], at, output=np.float64, order=1, mode="nearest")
    return (out**3).reshape(codes.shape)


def log_volume(codes) -> np.ndarray:
    """Logarithm of the determinant of what `to_linear` does to small changes of codes (..., 3): (...)."""
    codes = np.clip(np.asarray(codes, np.float64), STEP, 1 - STEP)
    moves = STEP * np.eye(3)
    columns = [(to_linear(codes + move) - to_linear(codes - move)) / (2 * STEP) for move in moves]
    return np.log(np.maximum(np.abs(np.linalg.det(np.stack(columns, -1))), LEAST))
