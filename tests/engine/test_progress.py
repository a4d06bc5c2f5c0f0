# SPDX-License-Identifier: GPL-3.0-or-later
"""How far a run is: one number that never falls, from each stage's share."""

import json

import pytest

from btfsep_engine.cli.output import JsonReporter
from btfsep_engine.progress import RUNS, Reporter


@pytest.mark.parametrize("command", RUNS)
def test_a_run_goes_from_0_to_1_by_its_stages(command):
    reporter, seen = Reporter(command=command), []
    for stage in RUNS[command]:
        seen += [reporter.advance(stage, 0.0), reporter.advance(stage, 0.5), reporter.advance(stage, 1.0)]
    assert seen[0] == 0 and seen[-1] == pytest.approx(1)
    assert all(a < b for a, b in zip(seen[0::3], seen[1::3], strict=True))
    assert seen[2:-1:3] == seen[3::3]  # one stage ends where the next begins


def test_a_stage_that_comes_again_or_is_not_known_moves_nothing():
    reporter = Reporter(command="estimate")
    reached = reporter.advance("fit", 1.0)
    assert 0 < reached < 1
    for stage, fraction in (("transport", 0.2), ("fit", 0.0), ("photos", 1.0), ("a stage of tomorrow", 1.0)):
        assert reporter.advance(stage, fraction) == reached
    assert Reporter().advance("fit", 1.0) == 0


def test_programs_are_told_with_every_stage(capsys):
    reporter = JsonReporter(command="measure")
    with reporter.stage("maps"):
        pass
    reporter.progress("a stage of tomorrow", 0.5, "cloth")
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [(m["stage"], m["title"], m["fraction"], m["whole"]) for m in lines] == [
        ("maps", "Reading the maps", 0, 0),
        ("maps", "Reading the maps", 1, 0.02),
        ("a stage of tomorrow", "A stage of tomorrow", 0.5, 0.02),
    ]
    assert reporter.seconds.keys() == {"maps"}
