# SPDX-License-Identifier: GPL-3.0-or-later
"""Rebuilds the shipped material library and its contact sheet, docs/images/library.png.

scripts/build_library                    the shipped materials that are not there with the same settings
scripts/build_library --all --into FOLDER --sheet-to FILE    all 42
scripts/build_library leather/brown-grain --into FOLDER --samples 1 --texels 48
scripts/build_library --sheet            only the contact sheet
"""

from pathlib import Path

import cv2
import numpy as np

from btfsep_engine.btf import library, procedural, thumbnail
from btfsep_engine.commands import measure as measuring
from btfsep_engine.imaging.srgb import linear_to_srgb
from scripts.studies import ROOT, parser
from scripts.studies.makers import BACKGROUND, mosaic

SIDE = 184  # pixels of one picture of the sheet


def tell_speed(measured):
    """Prints what a material took."""
    million = measured["rays"] / 1e6, measured["rays_per_second"] / 1e6
    told = f"{measured['seconds']:.1f} s, {million[0]:.0f} M rays, {million[1]:.1f} M rays/s"
    print(f"{measured['name']:28s} {told}", flush=True)


def sheet(shown, path):
    """Writes the contact sheet of a library: each material flat, and as a ball before it."""
    tiles = []
    for name in shown.entries:
        image = linear_to_srgb(np.clip(1.4 * thumbnail.render(shown.load(name), SIDE), 0, 1))
        label = np.full((22, SIDE, 3), BACKGROUND, np.uint8)
        cv2.putText(label, name, (6, 15), cv2.FONT_HERSHEY_SIMPLEX, 0.42, (230, 230, 230), 1, cv2.LINE_AA)
        tiles.append(np.concatenate([np.round(255 * image).astype(np.uint8), label]))
    mosaic(path, tiles, columns=7)


def main(arguments) -> None:
    options = parser("build-library", __doc__)
    options.add_argument("names", nargs="*", help=f"some of: {', '.join(procedural.NAMES)}")
    options.add_argument("--all", action="store_true", help="all procedural materials, not only the shipped")
    options.add_argument("--into", type=Path, default=ROOT / "btfsep_engine" / "data" / "library")
    options.add_argument("--sheet", action="store_true", help="only draw the contact sheet")
    options.add_argument("--sheet-to", type=Path, default=ROOT / "docs" / "images" / "library.png")
    for key, value in measuring.DEFAULT_SETTINGS.items():
        options.add_argument(f"--{key}", type=int, default=value)
    given = options.parse_args(arguments)
    settings = {key: getattr(given, key) for key in measuring.DEFAULT_SETTINGS}
    if not given.sheet:
        names = given.names or (procedural.NAMES if given.all else list(library.open_library().entries))
        measuring.build(given.into, names=names, on_measured=tell_speed, **settings)
    made = library.open_library(given.into)
    sheet(made, given.sheet_to)
    for entry in made.entries.values():
        print(f"{entry.name:28s} {entry.size / 1e6:5.2f} MB  K {entry.components}  error {entry.relative_error}")
