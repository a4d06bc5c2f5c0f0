# SPDX-License-Identifier: GPL-3.0-or-later
"""What is clipped in a mirror: how well a light is known of which the brightest is cut off, by measured maps.

scripts/study clipped MAPS

Each map as a mirror all around would show it, in cells of 4 degrees, exposed so that 0.2 to 15 % of the sphere are
clipped. *As a rule*: with what such light lacks in the median, and what is stated of it, patch by patch, as
`pipeline/clipped_lamps.py` has it; *one factor for all*: as if all that is clipped lacked as much. A truth that lies
beyond 97.5 % of the samples' errors should be one of forty. Prints what of a light is lacking by the share that is
clipped, too: a line through the logarithms, and what scatters about it.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from btfsep_engine import sh
from btfsep_engine.conventions import fibonacci_sphere, pixel_directions, pixel_solid_angles
from btfsep_engine.errors import InputError
from btfsep_engine.light.lightings import shrink
from btfsep_engine.light.maps import read_map
from btfsep_engine.pipeline.clipped_lamps import ALIKE, EACH, as_a_rule
from btfsep_engine.pipeline.mirrors import CELLS
from scripts.studies import parser, tables
from scripts.studies.measures import order2

PERCENTILES = (85, 90, 93, 95, 97, 98, 99, 99.5, 99.8)  # of a map's pixels: where it is cut off
ROWS = 128  # of the maps, at most: as fine as a ball of 200 pixels shows them
SAMPLES = 200
RULE, ONE, SCATTERS = "as a rule", "one factor for all", 1.7  # logarithm of what all of it scatters by


def in_cells(values, at, area) -> np.ndarray:
    """(CELLS, 3), the light of a map (h, w, 3), whose pixels are ``at`` cells (h w,) and of solid angles (h w,)."""
    return np.stack([np.bincount(at, area * v, CELLS) for v in values.reshape(-1, 3).T], -1)


def exposed(radiance, percentile: float) -> dict:
    """A map (h, w, 3) cut off at a percentile of its pixels: light, what is clipped of it, the truth; which share."""
    directions, cells = pixel_directions(*radiance.shape[:2]).reshape(-1, 3), fibonacci_sphere(CELLS)
    at = cKDTree(cells).query(directions)[1]
    area = np.repeat(pixel_solid_angles(*radiance.shape[:2]), radiance.shape[1])
    most = np.percentile(radiance.max(-1), percentile)
    over, seen = radiance >= most, np.minimum(radiance, most)
    light, lost, true = (in_cells(v, at, area) for v in (seen, seen * over, radiance))
    return {"light": light, "lost": lost, "true": true, "share": float(in_cells(over, at, area).sum() / (12 * np.pi))}


def study(name: str, radiance, percentile: float, random) -> list[dict]:
    """What is found and stated of a map that is cut off, each way."""
    cut, y = exposed(radiance, percentile), sh.evaluate(2, fibonacci_sphere(CELLS))
    lamps = as_a_rule(cut["light"], cut["lost"], cut["share"])
    parts = np.einsum("nt,knc->ktc", y, lamps.parts(cut["lost"]))
    found, true = y.T @ cut["light"] + parts.sum(0), y.T @ cut["true"]
    lacking = cut["true"].sum() - cut["light"].sum()
    row = {"map": name, "share": cut["share"], "lacking": lacking / cut["light"].sum(), "error": order2(found, true)}
    one = replace(lamps, doubt=np.full((len(parts), 1), SCATTERS))
    rows = []
    for way, known in ((RULE, lamps), (ONE, one)):
        factors = np.expm1(random.normal(size=(SAMPLES, known.doubt.shape[1])) @ known.doubt.T)
        off = np.array([order2(found, found + each) for each in np.einsum("nk,ktc->ntc", factors, parts)])
        stated = float(np.median(off))
        beyond = {f"beyond {p}": row["error"] > np.percentile(off, p) for p in (84, 97.5)}
        rows.append(row | {"way": way, "stated": stated, "over": row["error"] / max(stated, 1e-9)} | beyond)
    return rows


COLUMNS = (
    ("exposures", len),
    ("error", tables.spread_of("error")),
    ("stated", tables.median_of("stated")),
    ("over stated", tables.spread_of("over")),
    ("beyond 84 %", tables.percent_of("beyond 84")),
    ("beyond 97.5 %", tables.percent_of("beyond 97.5")),
)


def main(arguments) -> int:
    options = parser("clipped", __doc__)
    options.add_argument("maps", type=Path, help="a folder with .hdr or .exr files")
    given = options.parse_args(arguments)
    files = [path for path in sorted(given.maps.iterdir()) if path.suffix in (".hdr", ".exr")]
    if not files:
        raise InputError(str(given.maps), "it has no .hdr or .exr files", "name a folder with maps")
    random, rows = np.random.default_rng(0), []
    for path in files:
        radiance = read_map(path)
        while radiance.shape[0] > ROWS:
            radiance = shrink(radiance, 2)
        for percentile in PERCENTILES:
            rows += study(path.stem, radiance.astype(np.float64), percentile, random)
    print(tables.summary(("way",), COLUMNS, [((way,), some) for way, some in tables.groups(rows, "way", every=None)]))
    own = [row for row in rows if row["way"] == RULE]
    share, lacking = np.log([[row["share"], row["lacking"]] for row in own]).T
    slope, first = np.polyfit(share, lacking, 1)
    left = np.std(lacking - first - slope * share)
    print(f"\nlacking: exp({first:.1f}) share^{slope:.2f} of what is seen, give or take a factor exp({left:.1f});")
    print(f"stated: exp({ALIKE}) for all of it, exp({EACH}) for each patch")
    return 0
