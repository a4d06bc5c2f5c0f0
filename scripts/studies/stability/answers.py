# SPDX-License-Identifier: GPL-3.0-or-later
"""The answers of a study, gathered: medians by axis, severity and method, and what was said of them."""

import csv
from pathlib import Path

import numpy as np

from scripts.studies.real import kind
from scripts.studies.stability import run, scenes
from scripts.studies.stability.axes import AXES
from scripts.studies.stability.run import UNDISTURBED, Task
from scripts.studies.stability.scenes import light_name

POOR = 0.5  # an order-2 error that is a failure ...
FIRST_MEASURE = 8  # column of the table
HIDDEN = 2.0  # ... and is hidden where it is more than so many times what was stated, without a new word


class Answers:
    """All answers that are there.

    Parameters
    ----------
    chosen : scenes of the study
    given : work, lights, axes, methods; out : the page, beside which a table has the answers that ``work`` lacks
    """

    def __init__(self, chosen, given):
        self.names, self.methods = list(given.axes), list(given.methods)
        self.pairs = scenes.pairs(chosen, given.lights, half=given.half)
        asked = [(t, m) for t in run.tasks(self.pairs, given.axes) for m in given.methods]
        every = {(t, m): run.read(t, given.work, m) for t, m in asked}
        anew = {m for (_, m), found in every.items() if found is not None}
        for (t, m), found in printed(given.out.with_suffix(".csv"), asked).items():
            if m not in anew:  # of a method that was run anew, no answer is an earlier one
                every[t, m] = found
        self.records = {key: found for key, found in every.items() if found is not None}

    def _with_zero(self, axis: str, index: int, method: str):
        """(the answer, that of the same photograph undisturbed or None) at one severity."""
        for scene, light in self.pairs:
            task = Task(axis, index, scene, light)
            here, zero = (self.records.get((t, method)) for t in (task, run.zero_of(task)))
            if here is not None:
                yield here, zero

    def of(self, axis: str, index: int, method: str) -> list[dict]:
        """The answers at one severity (0: of the same photographs, undisturbed)."""
        chosen = [(s, l) for s, l in self.pairs if axis == UNDISTURBED or AXES[axis].concerns(s)]
        asked = [Task(axis, index, s, l) for s, l in chosen]
        found = [self.records.get((run.zero_of(t) if index == 0 else t, method)) for t in asked]
        return [f for f in found if f is not None]

    def values(self, axis: str, index: int, method: str, measure: str) -> np.ndarray:
        """One measure of them, where it is defined."""
        found = [r.get(measure) for r in self.of(axis, index, method)]
        return np.array([v for v in found if v is not None], np.float64)

    def middle(self, axis, index, method, measure, *, of=np.median) -> float:
        """Their median (or mean); NaN where there is none."""
        values = self.values(axis, index, method, measure)
        return float(of(values)) if len(values) else np.nan

    def series(self, axis, method, measure, *, of=np.median) -> np.ndarray:
        """(6,) of all severities, from none on."""
        return np.array([self.middle(axis, i, method, measure, of=of) for i in range(6)])

    def refused(self, axis, index, method) -> int:
        """How many a method refused."""
        return sum(r["refused"] for r in self.of(axis, index, method))

    def warned(self, axis: str, index: int, method: str, *, anew: bool = False):
        """How many were warned of, of how many; ``anew``: in words that were not said of the photo undisturbed."""
        if index == 0:
            found = self.of(axis, 0, method)
            return 0 if anew else sum(bool(r["warnings"]) for r in found), len(found)
        found = [pair for pair in self._with_zero(axis, index, method) if pair[1] is not None or not anew]
        return sum(bool(said_anew(*pair) if anew else pair[0]["warnings"]) for pair in found), len(found)

    def failures(self, axis, method) -> np.ndarray:
        """Answers with an order-2 error above POOR.

        Gives their number, how many of them nobody told of, how many had failed undisturbed too, and of how many.
        """
        out = np.zeros(4, int)
        for index in range(1, 6):
            for here, zero in self._with_zero(axis, index, method):
                if here["refused"]:
                    continue
                failed, silent = here["order2"] > POOR, not said_anew(here, zero)
                before = zero is not None and not zero["refused"] and zero["order2"] > POOR
                hidden = silent and here["order2"] > HIDDEN * here.get("stated", 0)
                out += [failed, failed and hidden, failed and before, 1]
        return out


def said_anew(here: dict, zero: dict | None) -> bool:
    """Whether something was said that had not been said of the same photograph undisturbed."""
    before = {kind(w) for w in zero["warnings"]} if zero else set()
    return any(kind(w) not in before for w in here["warnings"])


def printed(path: Path, asked) -> dict:
    """(task, method) of those that are ``asked`` -> the answer, of a page's table; of none, nothing."""
    if not path.exists():
        return {}
    keys = {(t.axis, str(t.index), t.scene.name, light_name(t.light), m): (t, m) for t, m in asked}
    out = {}
    with path.open(newline="", encoding="utf-8") as file:
        for row in csv.DictReader(file):
            key = keys.get(tuple(row[name] for name in ("axis", "index", "scene", "light", "method")))
            if key is not None:
                said = {"refused": row["refused"] == "True", "warnings": [w for w in row["warnings"].split(" | ") if w]}
                out[key] = {name: float(v) for name, v in list(row.items())[FIRST_MEASURE:] if v} | said
    return out
