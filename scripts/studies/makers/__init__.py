# SPDX-License-Identifier: GPL-3.0-or-later
"""Makers of what comes with the engine, of its pictures, and of the extension."""

from pathlib import Path

BACKGROUND = 24


def mosaic(path: Path, tiles, *, columns: int) -> None:
    """Writes pictures (h, w, 3) uint8 RGB, row by row, into one."""
    import cv2
    import numpy as np

    tiles = [*tiles, *[np.full_like(tiles[0], BACKGROUND)] * (-len(tiles) % columns)]
    rows = [np.concatenate(tiles[i : i + columns], 1) for i in range(0, len(tiles), columns)]
    path.parent.mkdir(parents=True, exist_ok=True)
    quality = [cv2.IMWRITE_PNG_COMPRESSION, 9, cv2.IMWRITE_JPEG_QUALITY, 90]
    cv2.imwrite(str(path), np.concatenate(rows)[..., ::-1], quality)
