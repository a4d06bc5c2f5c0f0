# SPDX-License-Identifier: GPL-3.0-or-later
"""Learns the prior of natural light (btfsep_engine/light/log_field.py) from the shipped training lights.

scripts/study learn-natural-light                   writes btfsep_engine/data/natural_log_light.json and prints it
scripts/study learn-natural-light --judge MAP …     prints, too, how likely other maps are under it

Nothing else is read: the maps are those of btfsep_engine/data/lights (CC0). Each map is averaged over the field's
directions, its logarithm expanded in spherical harmonics (by least squares), and the mean square of each degree's
coefficients taken over the maps; a line through their logarithms gives the power law.
"""

import json
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from btfsep_engine import sh
from btfsep_engine.conventions import fibonacci_sphere, pixel_directions, pixel_solid_angles
from btfsep_engine.light import log_field, maps
from btfsep_engine.storage import atomic
from scripts.studies import parser, tables

CELLS = 600
ORDER = 14  # of the expansion: 225 terms of 600 values
CHROMA_ORDER = 6  # up to which chroma is fitted
JUDGED = 12, CHROMA_ORDER  # orders up to which a map is judged
DARKEST = 1e-4  # of the mean radiance: a map's black is not minus infinity
NAMES = ("luminance", "red_blue", "green")
TO_FIELDS = np.linalg.inv(log_field.CHROMA)


def expansions(radiance) -> np.ndarray:
    """A map (h, w, 3) -> the harmonics of its three fields, (3, terms)."""
    height, width = radiance.shape[:2]
    directions = fibonacci_sphere(CELLS)
    nearest = cKDTree(directions).query(pixel_directions(height, width).reshape(-1, 3))[1]
    area = np.repeat(pixel_solid_angles(height, width), width)
    total = np.bincount(nearest, area, CELLS)
    cells = np.stack([np.bincount(nearest, area * radiance[..., c].ravel(), CELLS) / total for c in range(3)])
    fields = TO_FIELDS @ np.log(np.maximum(cells, DARKEST * cells.mean()))
    return np.linalg.lstsq(sh.evaluate(ORDER, directions), fields.T, rcond=None)[0].T


def learn(found) -> dict:
    """The table of maps' expansions (maps, 3, terms)."""
    found = np.asarray(found)
    l = sh.degrees(ORDER)
    zonal = [float(found[:, 0, d * d + d].mean()) for d in range(1, log_field.ZONAL + 1)]
    centred = np.array(found)
    for d, value in enumerate(zonal, 1):
        centred[:, 0, d * d + d] -= value
    table: dict = {"zonal_mean": zonal}
    for i, name in enumerate(NAMES):
        fitted = np.arange(1, ORDER if i == 0 else CHROMA_ORDER)
        power = np.array([np.mean(centred[:, i, l == d] ** 2) for d in fitted])
        slope, offset = np.polyfit(np.log(fitted), 0.5 * np.log(power), 1)
        level = float(np.sqrt(np.mean(found[:, i, 0] ** 2)))
        table[name] = {"at_degree_1": float(np.exp(offset)), "decline": float(-slope), "level": level}
    return table


def log_likelihood(table: dict, expansion) -> float:
    """Of one map's expansion, without the level of its luminance, per term."""
    prior = log_field.build(table, order=JUDGED[0], chroma_order=JUDGED[1])
    ends = np.cumsum([sh.term_count(prior.order), sh.term_count(prior.chroma_order)])
    total, count = 0.0, 0
    for i, (s, m) in enumerate(zip(np.split(prior.deviation, ends), np.split(prior.mean, ends), strict=True)):
        z = (expansion[i, 1 : len(s)] - m[1:]) / s[1:]
        total -= float((0.5 * z**2 + np.log(s[1:])).sum())
        count += len(z)
    return total / count


def main(arguments) -> None:
    options = parser("learn-natural-light", __doc__)
    options.add_argument("--judge", nargs="+", type=Path, default=[], metavar="MAP")
    given = options.parse_args(arguments)
    files = sorted(maps.FOLDER.glob("*.exr"))
    found, others = (
        [expansions(np.asarray(maps.read_map(f), np.float64)) for f in some] for some in (files, given.judge)
    )
    table = learn(found)
    atomic.write_text(log_field.TABLE, json.dumps({"maps": [f.stem for f in files], **table}, indent=1) + "\n")
    print(json.dumps(table, indent=1) + "\n")
    flat, rows = {**table, "zonal_mean": [0.0] * log_field.ZONAL}, []
    for i, (file, expansion) in enumerate(zip(files, found, strict=True)):
        held = learn([e for j, e in enumerate(found) if j != i])
        rows.append((file.stem, *(f"{log_likelihood(t, expansion):.2f}" for t in (table, flat, held))))
    for file, expansion in zip(given.judge, others, strict=True):
        rows.append((f"{file.stem} (held out)", *(f"{log_likelihood(t, expansion):.2f}" for t in (table, flat)), ""))
    heads = ("map", "mean log likelihood of a term", "without light from above", "learned without it")
    print(tables.table(heads, rows))
