# SPDX-License-Identifier: GPL-3.0-or-later
"""Tabulates the inverse of Blender's view transform AgX, btfsep_engine/data/agx.npz, as Blender itself has it.

scripts/study tabulate-agx
"""

from btfsep_engine import agx
from scripts.studies import parser, photos

ENTRIES = 25  # for each channel


def main(arguments) -> None:
    parser("tabulate-agx", __doc__).parse_args(arguments)
    photos.in_blender("scripts.cycles.agx", {"entries": ENTRIES, "out": str(agx.TABLE)})
    print(f"{agx.TABLE}, {agx.TABLE.stat().st_size / 1000:.0f} kB")
