# SPDX-License-Identifier: GPL-3.0-or-later
"""What a command's progress lines have to be like."""

from itertools import pairwise

from btfsep_engine.progress import RUNS

WHOLES = {"training"}  # stages that are made of others


def assert_whole_run(lines, command: str) -> None:
    """``lines`` : dicts. Every stage has its share, the run never falls, and is over when the last stage is."""
    progress = [line for line in lines if line["type"] == "progress"]
    stages = [line["stage"] for line in progress]
    assert set(stages) <= {*RUNS[command], *WHOLES}
    wholes = [line["whole"] for line in progress]
    assert all(a <= b for a, b in pairwise(wholes)) and wholes[-1] == 1
    last = list(RUNS[command])[-1]
    assert all(whole < 1 for stage, whole in zip(stages, wholes, strict=True) if stage != last)
