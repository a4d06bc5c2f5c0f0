# SPDX-License-Identifier: GPL-3.0-or-later
"""What each stage of an estimate traces: rays, tables of materials, networks, counted where they are made."""

import tempfile
from collections import defaultdict
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from unittest import mock

from btfsep_engine.btf.library import open_library
from btfsep_engine.commands.estimate import run_estimate
from btfsep_engine.pipeline.settings import choose
from btfsep_engine.progress import Reporter
from btfsep_engine.render.appearance import LightTables
from btfsep_engine.render.radiosity import Network
from btfsep_engine.render.tracer import Tracer
from btfsep_engine.storage import kept
from scripts.studies.bench_transport.cold import photograph
from scripts.studies.photos import WHITE
from scripts.studies.stage import MATERIALS
from scripts.studies.tables import table

COUNTED = (  # what, class, method, how many of its arguments (after self)
    ("shadow rays", Tracer, "visible_lanes", lambda positions, normals, directions: len(positions) * len(directions)),
    ("rays to surfaces", Tracer, "nearest", lambda origins, directions: len(origins)),
    ("pixels' tables", LightTables, "tables_at", lambda points, **_: len(points)),
    ("networks", Network, "__init__", lambda *_, **__: 1),
)


@dataclass
class Counting(Reporter):
    """Counts under the name of the innermost stage that is running."""

    counts: dict = field(default_factory=lambda: defaultdict(lambda: dict.fromkeys([c[0] for c in COUNTED], 0)))
    running: list = field(default_factory=lambda: ["before"])

    @contextmanager
    def timed(self, name):
        self.running.append(name)
        self.counts[name]  # a stage that traces nothing is named, too
        try:
            with super().timed(name):
                yield
        finally:
            self.running.pop()


@contextmanager
def counted(reporter: Counting):
    """Inside, whatever is traced is counted."""

    def watched(what, method, number):
        def call(self, *arguments, **named):
            reporter.counts[reporter.running[-1]][what] += number(*arguments, **named)
            return method(self, *arguments, **named)

        return call

    with ExitStack() as stack:
        for what, cls, name, number in COUNTED:
            stack.enter_context(mock.patch.object(cls, name, watched(what, getattr(cls, name), number)))
        yield


def traced(options) -> str:
    """The counts of a white and of a textured object's estimate, in a process that has kept nothing of their scene."""
    library, parts = open_library(None), []
    with tempfile.TemporaryDirectory() as folder:
        for name in (WHITE, MATERIALS[0]):
            job = Path(folder) / name.replace("/", "-")
            photograph(job, library.load(name), directions=options.photo_directions)
            kept.STORE.forget()  # what the photograph has traced
            reporter = Counting(command="estimate")
            with counted(reporter):
                run_estimate(job, library, choose(), material=name, out=job / "result", reporter=reporter)
            rows = [
                (stage, *(f"{count:,}" if count else "–" for count in counts.values()))
                for stage, counts in reporter.counts.items()
            ]
            parts.append(f"{name}:\n\n" + table(("stage", *(c[0] for c in COUNTED)), rows))
    return "\n\n".join(parts)
