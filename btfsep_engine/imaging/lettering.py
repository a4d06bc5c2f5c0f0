# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures side by side with a line of text above each, drawn with letters of ``data/letters.npz``.

A library for charts takes a second to import and to lay out one row.
"""

from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np

FILE = Path(__file__).parents[1] / "data" / "letters.npz"
HEIGHT = 330  # of a picture
ABOVE, BESIDE, BELOW = 55, 13, 4  # of white around it
BASELINE = 12  # above the picture
MISSING, CUT = "\ufffd", "…"


@lru_cache(maxsize=1)
def letters() -> dict:
    """{letter: ((h, w) uint8 how much of each pixel it covers, left, top above the baseline, advance)}"""
    with np.load(FILE) as stored:
        atlas, codes, sizes, places = (stored[name] for name in ("atlas", "codes", "sizes", "places"))
    ends = np.cumsum(sizes[:, 1])
    pictures = [atlas[:h, end - w : end] for (h, w), end in zip(sizes.tolist(), ends.tolist(), strict=True)]
    return {chr(c): (p, *place) for c, p, place in zip(codes.tolist(), pictures, places.tolist(), strict=True)}


def width(text: str) -> float:
    """Of a line of text, in pixels."""
    known = letters()
    return sum(known.get(letter, known[MISSING])[3] for letter in text)


def shortened(text: str, most: float) -> str:
    """``text``, or so much of it that it is no wider than ``most`` pixels."""
    if width(text) <= most:
        return text
    while text and width(text + CUT) > most:
        text = text[:-1]
    return text + CUT


def write_on(picture, text: str, x: float, baseline: float, *, before: float = 0.5, level: int = 0) -> None:
    """Writes a line of text on ``picture`` (h, w, 3) uint8; what is outside it is cut off.

    ``before`` : the share of the line that stands left of ``x`` (0.5: it is centred); ``level`` : of its grey
    """
    known, x = letters(), x - before * width(text)
    for letter in text:
        cover, left, top, advance = known.get(letter, known[MISSING])
        row, column = round(baseline - top), round(x + left)
        cut = cover[max(-row, 0) :, max(-column, 0) :]
        place = picture[max(row, 0) :, max(column, 0) :][: cut.shape[0], : cut.shape[1]]
        cover = cut[: place.shape[0], : place.shape[1], None] / 255
        place[:] = place * (1 - cover) + level * cover + 0.5
        x += advance


def scaled(picture, height: int) -> np.ndarray:
    """A picture (h, w, 3) uint8 at another height, averaged or smoothly enlarged."""
    h, w = picture.shape[:2]
    size = max(1, round(w * height / h)), height
    return cv2.resize(picture, size, interpolation=cv2.INTER_AREA if h > height else cv2.INTER_CUBIC)


def row(panels) -> np.ndarray:
    """(h, w, 3) uint8: labelled pictures side by side.

    ``panels`` : list of (label, (h, w, 3) uint8)
    """
    pictures = [scaled(picture, HEIGHT) for _, picture in panels]
    wide = sum(p.shape[1] for p in pictures) + BESIDE * (len(panels) + 1)
    out = np.full((ABOVE + HEIGHT + BELOW, wide, 3), 255, np.uint8)
    x = BESIDE
    for (label, _), picture in zip(panels, pictures, strict=True):
        w = picture.shape[1]
        out[ABOVE : ABOVE + HEIGHT, x : x + w] = picture
        write_on(out, shortened(label, w + BESIDE), x + w / 2, ABOVE - BASELINE)
        x += w + BESIDE
    return out
