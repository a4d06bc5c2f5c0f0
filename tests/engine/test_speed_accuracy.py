# SPDX-License-Identifier: GPL-3.0-or-later
"""How the study of speed and accuracy sums photographs up."""

import numpy as np
import pytest

from scripts.studies.speed_accuracy import at_equal_error, equal_words, summed_up


def photo(ways: dict) -> list:
    """{(axis, name): (seconds, error)} as one photograph's rows."""
    return [
        {"axis": axis, "name": name, "seconds": seconds, "error": error, "direction": 3.0}
        for (axis, name), (seconds, error) in ways.items()
    ]


def photographs(rng, count: int = 30) -> list:
    found = []
    for number in range(count):
        hard, busy = rng.lognormal(0, 1), rng.lognormal(0, 0.5)  # of the photo, and of the machine at that time
        ways = {
            ("preset", "balanced"): (1.0, 0.1),
            ("pixels", "fewer"): (0.5, 0.12),
            ("pixels", "more"): (2.0, 0.1 * rng.lognormal(0, 0.2)),
            ("order", "worse"): (1.5, 0.15),
        }
        ways = {k: (s * busy * rng.lognormal(0, 0.01), e * hard) for k, (s, e) in ways.items()}
        if number < 3:
            ways["paper", "traced"] = 80 * busy, 0.2 * hard
        found.append(photo(ways))
    return found


def test_ratios_are_of_the_same_photo_and_what_was_tried_on_few_stands_beside_all(rng):
    found = photographs(rng)
    points = {p.name: p for p in summed_up(found)}
    assert points["worse"].ratio == pytest.approx(1.5) and points["worse"].spread < 1e-9
    assert points["traced"].ratio == pytest.approx(2) and points["balanced"].ratio == 1
    assert points["traced"].error == pytest.approx(2 * points["balanced"].error)
    assert points["traced"].seconds == pytest.approx(80 * points["balanced"].seconds, rel=0.05)
    assert points["balanced"].paper_ratio == pytest.approx(80, rel=0.05) and points["traced"].paper_ratio == 1
    errors = [rows[0]["error"] for rows in found]
    assert points["balanced"].error == pytest.approx(np.exp(np.mean(np.log(errors))))
    assert points["balanced"].worst == max(errors) and points["balanced"].direction == 3


def test_beaten_is_what_another_beats_by_more_than_chance(rng):
    points = {p.name: p for p in summed_up(photographs(rng))}
    assert points["balanced"].front and points["fewer"].front
    assert points["worse"].beaten and points["traced"].beaten
    assert not (points["balanced"].beaten or points["fewer"].beaten)
    # twice the time, and an error that differs by chance alone
    assert points["more"].spread > 0.02 and not points["more"].beaten


def test_without_the_papers_way_there_is_no_ratio_to_it(rng):
    found = [[row for row in rows if row["axis"] != "paper"] for rows in photographs(rng)]
    assert all(p.paper_ratio is None for p in summed_up(found))


def test_equal_error_is_reached_by_the_first_number_of_paths_that_errs_no_more(rng):
    traced = {8: (4.0, 3.0), 16: (8.0, 1.4), 32: (16.0, 1.0), 64: (32.0, 0.99)}  # seconds and error over the kernel's
    found = []
    for _ in range(20):
        hard, busy = rng.lognormal(0, 1), rng.lognormal(0, 0.5)
        ways = {("preset", "balanced"): (0.5, 0.03), ("preset", "paper"): (1.0, 0.1)}
        ways |= {("paper", f"{n} samples"): (s, 0.1 * e) for n, (s, e) in traced.items()}
        found.append(photo({k: (s * busy, e * hard * rng.lognormal(0, 0.02)) for k, (s, e) in ways.items()}))
    found.append(photo({("preset", "balanced"): (0.5, 0.03), ("preset", "paper"): (1.0, 0.1)}))  # not tried there
    rows = at_equal_error(found)
    assert [r["same"][3] for r in rows] == [False, False, True, True] and not any(r["balanced"][3] for r in rows)
    assert rows[2]["same"][2] == pytest.approx(16) and rows[2]["balanced"][2] == pytest.approx(32)
    assert rows[0]["same"][0] == pytest.approx(3, rel=0.05)
    assert "reached by 32 samples, in 16 times the time; none reaches the light of `balanced`" in equal_words(rows)
