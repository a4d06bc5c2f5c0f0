# SPDX-License-Identifier: GPL-3.0-or-later
"""Benchmarks time work that is done, not what was kept of it, and steps that are there."""

import numpy as np
import pytest

from btfsep_engine.storage import kept
from scripts.studies.bench_transport import rates
from scripts.studies.measures import seconds_of, timed


@pytest.mark.parametrize(("afresh", "made"), [(False, 1), (True, 4)])
def test_what_is_timed_afresh_is_made_anew(afresh, made):
    calls = []

    def work():
        return kept.recalled("timed", [afresh, made], lambda: calls.append(1) or np.zeros(3))

    work()
    for _ in range(2):
        timed(work, afresh=afresh)
    seconds_of(work, 1, afresh=afresh)
    assert len(calls) == made


def test_the_steps_that_are_watched_are_there():
    assert all(callable(getattr(cls, name)) for _, cls, name in rates.STEPS)
