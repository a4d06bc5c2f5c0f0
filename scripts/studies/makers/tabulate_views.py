# SPDX-License-Identifier: GPL-3.0-or-later
"""Tabulates inverses of Blender's view transforms, btfsep_engine/data/blender_views.npz, as Blender itself has them.

scripts/study tabulate-views
"""

from btfsep_engine.imaging import blender_views
from scripts.studies import parser, photos

ENTRIES = 25  # for each channel


def main(arguments) -> None:
    parser("tabulate-views", __doc__).parse_args(arguments)
    table = blender_views.TABLE
    photos.in_blender("scripts.cycles.blender_views", {"entries": ENTRIES, "out": str(table)})
    print(f"{table}, {table.stat().st_size / 1000:.0f} kB")
