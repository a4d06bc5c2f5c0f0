# SPDX-License-Identifier: GPL-3.0-or-later
"""Makes the training lights of the engine from a folder of environment maps.

scripts/study prepare-lights SOURCE_DIR

Every .hdr or .exr in SOURCE_DIR, averaged by solid angle to 128 x 64, scaled to a mean luminance of 1 / pi, is
written as a half-float EXR to btfsep_engine/data/lights, under its name without a resolution ("_1k").
Record where new maps come from, and under which licence, in btfsep_engine/data/README.md.
"""

import re
from pathlib import Path

import numpy as np

from btfsep_engine.conventions import luminance, pixel_solid_angles
from btfsep_engine.errors import InputError
from btfsep_engine.imaging import images
from btfsep_engine.light.lightings import shrink
from btfsep_engine.light.maps import FOLDER, read_map
from scripts.studies import parser

WIDTH = 128


def normalised(radiance) -> np.ndarray:
    """An environment map (h, w, 3) scaled so that its mean luminance over the sphere is 1 / pi; float64.

    Raises ValueError: the map is black.
    """
    a = np.asarray(radiance, np.float64)
    weight = pixel_solid_angles(*a.shape[:2])[:, None] / (4 * np.pi)
    mean = float((luminance(a) * weight).sum())
    if not mean > 0:
        raise ValueError("a black map has no scale")
    return a / (np.pi * mean)


def main(arguments) -> None:
    options = parser("prepare-lights", __doc__)
    options.add_argument("folder", type=Path)
    options.add_argument("--to", type=Path, default=FOLDER)
    given = options.parse_args(arguments)
    files = sorted(f for f in given.folder.glob("*") if f.suffix.lower() in (".hdr", ".exr"))
    if not files:
        raise InputError(str(given.folder), "there is no .hdr or .exr in it", "give a folder of environment maps")
    for file in files:
        radiance = read_map(file)
        if radiance.shape[1] % WIDTH:
            raise InputError(file.name, f"it is {radiance.shape[1]} wide", f"give maps of a multiple of {WIDTH}")
        small = normalised(shrink(radiance, radiance.shape[1] // WIDTH))
        target = given.to / (re.sub(r"_\d+k$", "", file.stem) + ".exr")
        images.write_exr(target, small, half=True)
        print(f"{target.name}: brightest {small.max():.3g}, {target.stat().st_size} bytes")
