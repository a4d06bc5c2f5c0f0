# SPDX-License-Identifier: GPL-3.0-or-later
"""The answers of a study, gathered: medians by axis, severity and method, and what was said of them."""

import re

import numpy as np

from scripts.studies import run, scenes
from scripts.studies.axes import AXES
from scripts.studies.run import UNDISTURBED, Task

POOR = 0.5  # an order-2 error that is a failure ...
HIDDEN = 2.0  # ... and is hidden where it is more than so many times what was stated, without a new word


class Answers:
    """All answers that are there.

    Parameters
    ----------
    chosen : scenes of the study
    options : work, lights, axes, methods
    """

    def __init__(self, chosen, options):
        self.work, self.names, self.methods = options.work, list(options.axes), list(options.methods)
        self.pairs = scenes.pairs(chosen, options.lights, half=options.half)
        self.records = {}
        for task in run.tasks(self.pairs, options.axes):
            for method in options.methods:
                found = run.read(task, options.work, method)
                if found is not None:
                    self.records[task, method] = found

    def of(self, axis: str, index: int, method: str) -> list[dict]:
        """The answers at one severity (0: of the same photographs, undisturbed)."""
        out = []
        for scene, light in self.pairs:
            if axis != UNDISTURBED and not AXES[axis].concerns(scene):
                continue
            task = Task(axis, index, scene, light)
            found = self.records.get((run.zero_of(task) if index == 0 else task, method))
            if found is not None:
                out.append(found)
        return out

    def values(self, axis: str, index: int, method: str, measure: str) -> np.ndarray:
        """One measure of them, where it is defined."""
        found = [spheres(r) if measure == "spheres" else r.get(measure) for r in self.of(axis, index, method)]
        return np.array([v for v in found if v is not None], np.float64)

    def median(self, axis, index, method, measure) -> float:
        """NaN where there is none."""
        values = self.values(axis, index, method, measure)
        return float(np.median(values)) if len(values) else np.nan

    def mean(self, axis, index, method, measure) -> float:
        """NaN where there is none."""
        values = self.values(axis, index, method, measure)
        return float(np.mean(values)) if len(values) else np.nan

    def warned(self, axis: str, index: int, method: str, *, anew: bool = False):
        """How many were warned of, of how many; ``anew``: in words that were not said of the photo undisturbed."""
        count = total = 0
        for scene, light in self.pairs:
            task = Task(axis, index, scene, light)
            here, zero = (self.records.get((t, method)) for t in (task, run.zero_of(task)))
            if here is None or (anew and zero is None):
                continue
            total += 1
            before = {kind(w) for w in zero["warnings"]} if anew else set()
            count += any(kind(w) not in before for w in here["warnings"])
        return count, total

    def refused(self, axis, index, method) -> int:
        """How many a method refused."""
        return sum(r["refused"] for r in self.of(axis, index, method))

    def failures(self, axis, method):
        """Answers with an order-2 error above POOR.

        Returns
        -------
        their number, how many of them nobody told of, how many of them had failed undisturbed too, and of how many
        """
        bad = hidden = already = total = 0
        for index in range(1, 6):
            for scene, light in self.pairs:
                task = Task(axis, index, scene, light)
                here, zero = (self.records.get((t, method)) for t in (task, run.zero_of(task)))
                if here is None or here["refused"]:
                    continue
                total += 1
                failed = here["order2"] > POOR
                before = {kind(w) for w in zero["warnings"]} if zero else set()
                silent = all(kind(w) in before for w in here["warnings"])
                bad += failed
                already += failed and zero is not None and not zero["refused"] and zero["order2"] > POOR
                hidden += failed and silent and here["order2"] > HIDDEN * here.get("stated", 0)
        return bad, hidden, already, total


def spheres(record: dict):
    """The mean si-RMSE of the three band-limited spheres, None where one is undefined."""
    from scripts.studies.measures import SPHERES

    found = [record.get(f"{kind}_si_rmse") for kind in SPHERES]
    return None if None in found else float(np.mean(found))


def kind(warning: str) -> str:
    """A warning without its numbers."""
    return re.sub(r"[-+]?\d+(\.\d+)?", "#", warning)


def light_words(lights) -> str:
    return ", ".join(f"'{scenes.light_name(light)}'" for light in lights)
