# SPDX-License-Identifier: GPL-3.0-or-later
"""What the transport costs, every speed with the accuracy reached beside it.

scripts/study bench-transport                         everything, a few minutes on a quiet machine
scripts/study bench-transport --write                 and puts the tables into docs/results/speed.md, with charts
scripts/study bench-transport --only reference rays   some of: reference, rays, warm, between, cold, traced, lookups,
                                                       growth
scripts/study bench-transport --quick                 each part in small, within a minute: only to see that it runs

The object is a sphere with dents that shade one another. Seconds are by the clock, and of all processors together:
the second kind hardly depends on what else the machine does.
"""

import os
import platform
from pathlib import Path

from scripts.studies import ROOT, parser, tables
from scripts.studies.measures import timed

FULL = {
    "size": 512, "directions": [128, 512], "judged": 200, "judge_samples": 1024, "pairs": 9, "repeats": 5,
    "photo_directions": 2048, "low_samples": 2, "between_truth": (12000, 1024, 1024),
}  # fmt: skip
QUICK = {
    "size": 96, "directions": [128], "judged": 40, "judge_samples": 16, "pairs": 2, "repeats": 1,
    "photo_directions": 128, "low_samples": 2, "between_truth": (4000, 128, 128),
}  # fmt: skip


def main(arguments) -> None:
    from btfsep_engine.render.backend import choose_backend
    from scripts.studies.bench_transport import cold, equal_error, growth, rates, traced
    from scripts.studies.stage import MATERIALS

    each = (
        equal_error.reference,
        rates.rays,
        rates.warm,
        rates.between,
        cold.cold,
        traced.traced,
        rates.lookups,
        growth.growth,
    )
    parts = {f.__name__: f for f in each}
    options = parser("bench-transport", __doc__)
    options.add_argument("--only", nargs="*", choices=parts, default=list(parts))
    options.add_argument("--images", type=Path, default=Path("bench"), help="folder for the charts  [default: bench]")
    options.add_argument("--write", action="store_true", help="tables into docs/results/speed.md, with charts")
    options.add_argument("--quick", action="store_true")
    given = options.parse_args(arguments)
    if given.quick and given.write:
        options.error("--quick only shows that the parts run: its figures are not for the page")
    vars(given).update(QUICK if given.quick else FULL, materials=MATERIALS[: 1 if given.quick else None])
    if given.write:
        given.images = ROOT / "docs" / "results" / "images"
    for name in given.only:
        load = os.getloadavg()[0]
        print(f"{name} …", flush=True)
        processors = f"{os.cpu_count()} processors ({platform.machine()}), {choose_backend().variant}"
        machine = f"{processors}, load {load:.1f} when it began"
        seconds, text = timed(lambda name=name: parts[name](given))
        text = f"{text}\n\n{machine}; `scripts/study bench-transport --only {name}`."
        print(f"\n{text}\n\n{name} took {seconds[0]:.0f} s\n", flush=True)
        if given.write:
            tables.fill(ROOT / "docs" / "results" / "speed.md", f"bench-transport {name}", text)
