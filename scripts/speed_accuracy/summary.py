# SPDX-License-Identifier: GPL-3.0-or-later
"""Many photographs' seconds and errors as one point for each way, and which of them nothing beats."""

from dataclasses import dataclass

import numpy as np

from btfsep_engine.pipeline.tradeoff import pareto_front

FIRM = 1.0  # standard errors: by so much must a way be faster, and more accurate, to beat another for certain


@dataclass(frozen=True)
class MeanPoint:
    """One way over all photographs that it was tried on.

    Attributes
    ----------
    axis, name : of pipeline.tradeoff.Point
    seconds, error : geometric means; of a way that was tried on some photos only, balanced's times the ratio on these
    ratio, spread : error over balanced's on the same photo, geometric mean, and its relative standard error
    worst : error; direction : degrees, median
    paper_ratio : the path-traced paper's seconds over this way's, of the same photo; None where it was not tried
    front : whether no other point is both faster and more accurate
    anew : whether it was measured again in a later run, beside balanced
    beaten : whether another is so on the same photos by more than `FIRM` standard errors in both
    """

    axis: str
    name: str
    seconds: float
    error: float
    ratio: float
    spread: float
    worst: float
    direction: float
    paper_ratio: float | None
    anew: bool
    front: bool
    beaten: bool


def summed_up(found: list) -> list[MeanPoint]:
    """The points of all ways.

    Parameters
    ----------
    found : for each photo a list of {axis, name, seconds, error, direction}, and "anew": True of what was measured
        again; "balanced" is among each
    """
    ways = list(dict.fromkeys((p["axis"], p["name"]) for rows in found for p in rows))
    tables = {key: np.full((len(ways), len(found)), np.nan) for key in ("seconds", "error", "direction")}
    for photo, rows in enumerate(found):
        for p in rows:
            for key, table in tables.items():
                value = p[key]
                table[ways.index((p["axis"], p["name"])), photo] = np.nan if value is None else value
    times, errors = np.log(tables["seconds"]), np.log(tables["error"])
    base = ways.index(("preset", "balanced"))
    slow = next((times[i] for i, (axis, _) in enumerate(ways) if axis == "paper"), None)
    ratios = [mean_and_spread(errors[i] - errors[base]) for i in range(len(ways))]
    seconds = [np.exp(np.nanmean(times[base]) + np.nanmean(times[i] - times[base])) for i in range(len(ways))]
    mean_errors = [np.exp(np.nanmean(errors[base]) + mean) for mean, _ in ratios]
    front = pareto_front(seconds, mean_errors)
    return [
        MeanPoint(
            axis,
            name,
            float(seconds[i]),
            float(mean_errors[i]),
            float(np.exp(ratios[i][0])),
            float(ratios[i][1]),
            float(np.nanmax(tables["error"][i])),
            float(np.nanmedian(tables["direction"][i])),
            None if slow is None else float(np.exp(np.nanmean(slow - times[i]))),
            any(p.get("anew", False) for rows in found for p in rows if (p["axis"], p["name"]) == (axis, name)),
            bool(front[i]),
            any(beats(times[j] - times[i], errors[j] - errors[i]) for j in range(len(ways)) if j != i),
        )
        for i, (axis, name) in enumerate(ways)
    ]


def mean_and_spread(differences) -> tuple[float, float]:
    """The mean of what is not NaN, and its standard error."""
    known = differences[~np.isnan(differences)]
    return float(known.mean()), float(known.std() / len(known) ** 0.5)


def beats(slower, worse) -> bool:
    """Whether differences of log seconds and log errors on the same photos, (photos,), are both below 0 for certain."""
    return all(mean + FIRM * spread < 0 for mean, spread in map(mean_and_spread, (slower, worse)))
