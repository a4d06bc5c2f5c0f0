# SPDX-License-Identifier: GPL-3.0-or-later
"""Draws the letters of the engine's pictures, btfsep_engine/data/letters.npz, from the font DejaVu Sans.

scripts/study draw-letters

Matplotlib, which brings the font, is of the development environment alone: the engine has these letters instead.
"""

from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.ft2font import FT2Font, LoadFlags

from btfsep_engine.storage.atomic import replacing
from scripts.studies import ROOT, parser

FONT = Path(matplotlib.get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf"
POINTS, DPI = 11, 110
RANGES = ((0x20, 0x7E), (0xA0, 0x17F), (0x370, 0x3FF), (0x400, 0x45F), (0x2010, 0x2026), (0x2212, 0x2212))
MISSING = 0xFFFD  # stands for all others


def main(arguments) -> None:
    parser("draw-letters", __doc__).parse_args(arguments)
    font = FT2Font(str(FONT))
    font.set_size(POINTS, DPI)
    known = font.get_charmap()
    codes = [c for low, high in RANGES for c in range(low, high + 1) if c in known] + [MISSING]
    pictures, places = [], []
    for code in codes:
        font.set_text(chr(code), 0.0, flags=LoadFlags.TARGET_LIGHT)
        glyph = font.load_char(code, flags=LoadFlags.TARGET_LIGHT)
        font.draw_glyphs_to_bitmap(antialiased=True)
        picture = np.array(font.get_image())
        left, top = glyph.bbox[0] / 64, glyph.bbox[3] / 64
        used = np.argwhere(picture)
        first, last = (used.min(0), used.max(0) + 1) if len(used) else (np.zeros(2, int), np.zeros(2, int))
        pictures.append(picture[first[0] : last[0], first[1] : last[1]])
        places.append((np.floor(left), np.ceil(top) if len(used) else 0, glyph.linearHoriAdvance / 65536))
    height = max(len(p) for p in pictures)
    atlas = np.concatenate([np.pad(p, ((0, height - len(p)), (0, 0))) for p in pictures], 1)
    path = ROOT / "btfsep_engine" / "data" / "letters.npz"
    with replacing(path) as scratch:
        np.savez_compressed(
            scratch,
            atlas=atlas,
            codes=np.array(codes, np.int32),
            sizes=np.array([p.shape for p in pictures], np.int16),
            places=np.array(places, np.float32),
        )
    print(f"{len(codes)} letters, {path.stat().st_size} bytes")
