# SPDX-License-Identifier: GPL-3.0-or-later
"""How the stages tell what they are doing: a Reporter is handed down, nobody prints."""

import logging
import time
from contextlib import contextmanager
from dataclasses import dataclass, field

log = logging.getLogger("btfsep")

_SCENE = {"reading": 3, "geometry": 5}
_ALIGNED = {**_SCENE, "alignment": 2, "standing": 1}  # the first seldom
_LEARNING = {"training rays": 4, "training images": 23, "dictionaries": 10, "classifier": 10, "recognition": 5}
_SEEN = {**_SCENE, **_LEARNING, "transport": 20}
RUNS = {
    "estimate": {
        "starting": 3,
        **_ALIGNED,
        **_SEEN,
        "fit": 5,
        "reflectance": 2,
        "alternatives": 1,
        "writing": 3,
        "checks": 3,
        "report": 9,
        "record": 1,
    },
    "align": {**_SCENE, "alignment": 40, "writing": 2},
    "recognise": {**_SCENE, **_LEARNING},
    "train": {**_SCENE, **_LEARNING},
    "relight": {**_SEEN, "writing": 1},
    "plan": {**_SCENE, "transport": 20, "plan": 4, "writing": 2},
    "sequence": {**_ALIGNED, **_SEEN, "fit": 5, "reflectance": 2, "alternatives": 1, "photos": 19},
    "chart": {"reading": 1, "chart": 99},
    "measure": {"maps": 2, "measure": 95, "writing": 3},
    "batch": {"batch": 1},
    "library_build": {"library": 1},
    "library_check": {"check": 1},
    "library_import": {"import": 1},
    "library_list": {"thumbnails": 1},
}
"""Command -> its stages in the order of their first beginning -> their shares of its time; a rough guide only."""

TITLES = {
    "starting": "Starting",
    "reading": "Reading the job",
    "geometry": "Preparing the geometry",
    "training": "Learning the materials",
    "training rays": "Learning the materials: rays",
    "training images": "Learning the materials: images",
    "dictionaries": "Learning the materials: words",
    "classifier": "Learning the materials: classes",
    "recognition": "Recognising",
    "transport": "Light transport",
    "reflectance": "Looking whether the material is just the library's",
    "fit": "Solving for the light",
    "alternatives": "Solving for the light, were it another material",
    "photos": "Solving for the lights",
    "checks": "Looking for what speaks against it",
    "report": "Making the report",
    "writing": "Writing the results",
    "record": "Writing down how it was found",
    "alignment": "Bringing geometry and photo into line",
    "standing": "Looking for what the objects stand on",
    "maps": "Reading the maps",
    "measure": "Measuring",
}
"""Stage -> words for people, where its name is not enough."""


@dataclass
class Reporter:
    """Takes progress, warnings and timings of one run. The base class logs; the command line prints.

    Attributes
    ----------
    warnings : list of str, in words, in the order they came; they stand in ``result.json``
    seconds : dict, stage -> wall-clock seconds
    command : whose stages they are, a key of `RUNS`
    whole : how much of the whole run is over, 0 to 1
    """

    warnings: list = field(default_factory=list)
    seconds: dict = field(default_factory=dict)
    command: str = ""
    whole: float = 0.0

    def advance(self, stage: str, fraction: float) -> float:
        """`whole`, now that ``stage`` stands at ``fraction``; never falls, and a stage that `RUNS` lacks leaves it."""
        shares = RUNS.get(self.command, {})
        if stage in shares:
            names = list(shares)
            over = sum(shares[name] for name in names[: names.index(stage)]) + fraction * shares[stage]
            self.whole = max(self.whole, min(over / sum(shares.values()), 1.0))
        return self.whole

    def progress(self, stage: str, fraction: float, message: str = "") -> None:
        """A stage stands at ``fraction`` (0 to 1)."""
        log.debug("%s %.0f%% %s", stage, 100 * fraction, message)

    def warn(self, message: str) -> None:
        """Something that the user should know and that does not stop the run."""
        if message not in self.warnings:
            self.warnings.append(message)
            log.info("warning: %s", message)

    def light(self, lighting: str) -> None:
        """The light is written, into the file ``lighting``; what is known of it besides comes later."""
        log.info("light: %s", lighting)

    @contextmanager
    def timed(self, name: str):
        """Times a block."""
        start = time.perf_counter()
        yield
        self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start

    @contextmanager
    def stage(self, name: str):
        """Times a block and announces its start and end."""
        self.progress(name, 0.0)
        with self.timed(name):
            yield
        self.progress(name, 1.0)
