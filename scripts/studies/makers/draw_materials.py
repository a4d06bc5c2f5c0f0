# SPDX-License-Identifier: GPL-3.0-or-later
"""Draws all procedural materials from their maps, docs/images/materials.png: a row for each class.

scripts/study draw-materials                   all 42
scripts/study draw-materials stone/ wood/pine  those whose names begin so

Each patch is traced as the virtual gonioreflectometer does, seen from straight above under a slanting lamp, a weak one
beside the viewer, for gloss, and a sky.
"""

from pathlib import Path

import cv2
import numpy as np
from tqdm import tqdm

from btfsep_engine.btf import procedural
from btfsep_engine.conventions import fibonacci_sphere
from btfsep_engine.errors import InputError
from btfsep_engine.imaging.srgb import linear_to_srgb
from btfsep_engine.render.patch import Patch
from scripts.studies import ROOT, parser
from scripts.studies.makers import BACKGROUND, mosaic

LAMPS = (((-1.0, 1.0, 1.15), 2.9), ((-0.24, 0.24, 1.0), 0.3))  # direction, irradiance
SKY, SKY_RADIANCE = fibonacci_sphere(60), 0.42  # its upper half
COLUMNS, GAP = 6, 4


def shade(maps, side: int, samples: int):
    """Radiance (side, side, 3) of the patch; row 0 is the largest v."""
    sky = SKY[SKY[:, 2] > 0.1]
    lamps = np.array([np.array(d) / np.linalg.norm(d) for d, _ in LAMPS])
    strength = np.concatenate([[e for _, e in LAMPS], np.full(len(sky), SKY_RADIANCE * 4 * np.pi / len(SKY))])
    (block,) = Patch(maps, np.concatenate([lamps, sky])).views([[0.0, 0.0, 1.0]], texels=side, samples=samples)
    return (block @ strength).reshape(3, side, side).transpose(1, 2, 0)[::-1]


def picture(name, side, samples):
    """(side + caption, side, 3) uint8 RGB of one material."""
    maps = procedural.maps(name, 2 * side)
    image = shade(maps, side, samples)
    image = 1.05 * image / (1 + 0.22 * image.max(-1, keepdims=True))  # highlights bend before they clip
    # 52 levels a channel look the same on such textures and make the file half as large
    code = (np.clip(linear_to_srgb(np.clip(image, 0, 1)), 0, 1) * 51 + 0.5).astype(np.uint8) * 5
    label, text = np.full((18, side, 3), BACKGROUND, np.uint8), f"{name.split('/')[1]} {maps.size_mm:.0f} mm"
    (width, _), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, 1.0, 1)
    size = min(0.31, (side - 4) / width)
    cv2.putText(label, text, (2, 13), cv2.FONT_HERSHEY_SIMPLEX, size, (225, 225, 225), 1, cv2.LINE_AA)
    return np.concatenate([code, label])


def main(arguments) -> None:
    options = parser("draw-materials", __doc__)
    options.add_argument("names", nargs="*", help="beginnings of names; none: all")
    options.add_argument("--to", type=Path, default=ROOT / "docs" / "images" / "materials.png")
    options.add_argument("--side", type=int, default=128, help="pixels of a material's edge")
    options.add_argument("--samples", type=int, default=16, help="paths a pixel")
    given = options.parse_args(arguments)
    names = [n for n in procedural.NAMES if not given.names or n.startswith(tuple(given.names))]
    if not names:
        raise InputError("NAME", " or ".join(given.names), "give the beginning of a procedural material's name")
    tiles = [np.pad(picture(n, given.side, given.samples), ((GAP, 0), (GAP, 0), (0, 0)), constant_values=BACKGROUND)
             for n in tqdm(names)]  # fmt: skip
    mosaic(given.to, tiles, columns=COLUMNS)
