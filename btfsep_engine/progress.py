# SPDX-License-Identifier: GPL-3.0-or-later
"""How the stages tell what they are doing: a Reporter is handed down, nobody prints."""

import logging
import time
from contextlib import contextmanager
from dataclasses import dataclass, field

log = logging.getLogger("btfsep")


@dataclass
class Reporter:
    """Takes progress, warnings and timings of one run. The base class logs; the command line prints.

    Attributes
    ----------
    warnings : list of str, in words, in the order they came; they stand in ``result.json``
    seconds : dict, stage -> wall-clock seconds
    """

    warnings: list = field(default_factory=list)
    seconds: dict = field(default_factory=dict)

    def progress(self, stage: str, fraction: float, message: str = "") -> None:
        """A stage stands at ``fraction`` (0 to 1)."""
        log.debug("%s %.0f%% %s", stage, 100 * fraction, message)

    def warn(self, message: str) -> None:
        """Something that the user should know and that does not stop the run."""
        if message not in self.warnings:
            self.warnings.append(message)
            log.info("warning: %s", message)

    @contextmanager
    def stage(self, name: str):
        """Times a block and announces its start and end."""
        start = time.perf_counter()
        self.progress(name, 0.0)
        yield
        self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start
        self.progress(name, 1.0)
