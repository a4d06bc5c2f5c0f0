# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender's own inverse of its views, tabulated: ``python -m scripts.cycles.blender_views`` with {"entries", "out"}.

Codes of a picture of 16 bits are read in a view's colour space and saved as floats, which are linear. A look has no
such space: what it does to greys is found by saving them with it and without.
"""

import json
import sys
import tempfile
from pathlib import Path

import bpy
import numpy as np

from btfsep_engine.imaging.blender_views import LEAST_LOG, STOPS
from btfsep_engine.imaging.images import write_exr
from scripts.cycles import studio

SPACES = {"agx": "AgX Base sRGB", "filmic": "Filmic sRGB"}
PUNCHY = "AgX - Punchy"
ACROSS = 512
LOGS, GREYS = (0.12, 0.6), 64  # of AgX's logarithms; of Punchy's table
FINE = np.linspace(0.02, 0.66, 4096)  # logarithms up to which no grey is white


def linear_of(codes, space: str) -> np.ndarray:
    """(n, 3) float32 linear Rec.709 of codes (n, 3), 0 to 1, as Blender undoes a view."""
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
        image.colorspace_settings.name = space
        image.save_render(str(exr), scene=bpy.context.scene)  # its settings: an EXR of 32 bits
        return studio.read_image(exr).reshape(-1, 3)[: len(codes)]


def codes_of(greys, look: str) -> np.ndarray:
    """Codes of linear ``greys : (n,)`` that were saved with AgX and a look, 0 to 1."""
    import cv2

    scene = studio.clear()
    scene.view_settings.view_transform, scene.view_settings.look = "AgX", look
    scene.render.image_settings.file_format, scene.render.image_settings.color_depth = "PNG", "16"
    with tempfile.TemporaryDirectory() as folder:
        exr, png = Path(folder) / "greys.exr", Path(folder) / "codes.png"
        write_exr(exr, np.repeat(np.asarray(greys)[None, :, None], 3, -1))
        bpy.data.images.load(str(exr)).save_render(str(png), scene=scene)
        return cv2.imread(str(png), cv2.IMREAD_UNCHANGED)[0, :, 1] / 65535


def punchy() -> np.ndarray:
    """(2, `GREYS`) float32: AgX's logarithms of greys, and those that Punchy makes of them."""
    greys, logs = 2.0 ** (LEAST_LOG + STOPS * FINE), np.linspace(*LOGS, GREYS)
    plain, with_look = codes_of(greys, "None"), codes_of(greys, PUNCHY)
    return np.float32([logs, np.interp(np.interp(logs, FINE, with_look), plain, FINE)])


def tabulate(entries: int, out: str) -> None:
    """Writes the tables of `btfsep_engine.imaging.blender_views`."""
    each = np.linspace(0, 1, entries)
    codes = np.stack(np.meshgrid(each, each, each, indexing="ij"), -1)
    linear = {name: linear_of(codes.reshape(-1, 3), space).reshape(codes.shape) for name, space in SPACES.items()}
    roots = {name: np.cbrt(each).astype(np.float16) for name, each in linear.items()}
    np.savez_compressed(out, punchy=punchy(), **roots)


if __name__ == "__main__":
    with studio.quiet():
        tabulate(**json.load(sys.stdin))
