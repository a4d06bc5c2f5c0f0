# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender's own inverse of AgX, tabulated: ``python -m scripts.cycles.agx`` with {"entries", "out"} on standard input.

Codes of a picture of 16 bits are read in the colour space "AgX Base sRGB" and saved as floats, which are linear.
"""

import json
import sys
import tempfile
from pathlib import Path

import bpy
import numpy as np

from scripts.cycles import studio

SPACE = "AgX Base sRGB"
ACROSS = 512


def linear_of(codes) -> np.ndarray:
    """(n, 3) float32 linear Rec.709 of codes (n, 3), 0 to 1, as Blender undoes AgX."""
    import cv2

    rows = -(-len(codes) // ACROSS)
    picture = np.zeros((rows * ACROSS, 3))
    picture[: len(codes)] = codes
    studio.clear()
    with tempfile.TemporaryDirectory() as folder:
        png, exr = Path(folder) / "codes.png", Path(folder) / "linear.exr"
        sixteen = np.round(picture.reshape(rows, ACROSS, 3) * 65535).astype(np.uint16)
        cv2.imwrite(str(png), sixteen[..., ::-1])
        image = bpy.data.images.load(str(png))
        image.colorspace_settings.name = SPACE
        image.save_render(str(exr), scene=bpy.context.scene)  # its settings: an EXR of 32 bits
        return studio.read_image(exr).reshape(-1, 3)[: len(codes)]


def tabulate(entries: int, out: str) -> None:
    """Writes the table of `btfsep_engine.agx`."""
    each = np.linspace(0, 1, entries)
    codes = np.stack(np.meshgrid(each, each, each, indexing="ij"), -1)
    linear = linear_of(codes.reshape(-1, 3)).reshape(codes.shape)
    np.savez_compressed(out, roots=np.cbrt(linear).astype(np.float16))


if __name__ == "__main__":
    with studio.quiet():
        tabulate(**json.load(sys.stdin))
