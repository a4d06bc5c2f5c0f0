# SPDX-License-Identifier: GPL-3.0-or-later
"""Smoothing of lights over time: what it may mix, what it adds up to, what is stated of it."""

import numpy as np
import pytest

from btfsep_engine import sh
from btfsep_engine.fit.over_time import Frame, differ, shares, smoothed, windows
from btfsep_engine.light.files import Lighting
from btfsep_engine.light.sun import Sun


def light(x, spread=0.1, suns=()) -> Lighting:
    x = np.asarray(x, np.float64)
    stddev = np.full_like(x, spread)
    ranges = np.stack([x - 0.2, x + 0.3]), np.stack([x - 0.1, x, x + 0.1, x + 0.2])
    return Lighting(sh.order_of(len(x)), x, stddev, np.ones(len(x), bool), 0.0, suns, *ranges)


@pytest.fixture
def base(rng):
    x = 0.2 * rng.normal(size=(16, 3))
    x[0] = 2.0
    return x


@pytest.mark.parametrize("reach", [0, 1, 3, 9])
def test_windows_hold_no_more_than_they_need(reach):
    read, seen = [], []

    def items():
        for i in range(7):
            read.append(i)
            yield i

    for held, at in windows(items(), reach):
        seen.append(held[at])
        assert held == list(range(max(held[at] - reach, 0), min(held[at] + reach, 6) + 1))
        assert len(read) <= held[at] + reach + 1
    assert seen == list(range(7))


def test_lights_within_what_they_state_are_mixed_and_others_are_not(base, rng):
    still = [light(base + 0.02 * rng.normal(size=base.shape)) for _ in range(5)]
    jumped = base.copy()
    jumped[1] += 0.5  # the second order of three: the whole is hardly another
    frames = [*still[:3], *(light(jumped + 0.02 * rng.normal(size=base.shape)) for _ in range(2))]
    assert not any(differ(still[0], other) for other in still) and differ(frames[2], frames[3])
    assert sorted(shares(still, 2, 4)) == [0, 1, 2, 3, 4] and sorted(shares(still, 0, 2)) == [0, 1, 2]
    assert [sorted(shares(frames, i, 4)) for i in (2, 3)] == [[0, 1, 2], [3, 4]]
    flash = [*still[:2], light(jumped), *still[2:4]]
    assert [sorted(shares(flash, i, 4)) for i in (1, 2, 3)] == [[0, 1], [2], [3, 4]]  # nor past it
    darker = light(0.5 * base, 0.05)
    assert differ(still[0], darker) and shares([still[0], darker], 0, 1) == {0: 1.0}


def test_nearer_and_better_known_lights_count_more(base):
    share = shares([light(base), light(base), light(base, 0.05), light(base), light(base)], 0, 4)
    assert sum(share.values()) == pytest.approx(1)
    assert share[0] > share[1] > share[3] > share[4] and share[2] == pytest.approx(share[1] * 4 * 0.6 / 0.8)


def test_what_is_stated_does_not_shrink_with_the_number_of_frames(base, rng):
    frames = [Frame(light(base + 0.02 * rng.normal(size=base.shape))) for _ in range(9)]
    mean, count = smoothed(frames, 4, 4)
    assert count == 9 and np.allclose(mean.lighting.stddev, 0.1)
    assert np.allclose(np.ptp(mean.lighting.interval, axis=0), 0.5)
    assert np.allclose(np.ptp(mean.lighting.pattern, axis=0), 0.3)
    off = [np.abs(f.lighting.coefficients - base).mean() for f in (mean, frames[4])]
    assert off[0] < 0.6 * off[1]
    assert smoothed(frames, 4, 0) == (frames[4], 1)


def test_lamps_and_sky_stay_the_light(base):
    """A mean of lights, whichever frames tell a lamp apart: series and map have all of it, and no more."""
    here, near, other = (np.array(d) / np.linalg.norm(d) for d in ([0, 0.6, 0.8], [0.05, 0.6, 0.8], [0.9, 0, 0.4]))
    suns = [[Sun(here, [3, 3, 2], [0.3] * 3)], [Sun(other, [1, 1, 1], [0.1] * 3), Sun(near, [2, 2, 2], [0.2] * 3)], []]
    frames = [Frame(light(base + 0.01 * i, 0.2, s), np.full((64, 128, 3), 1.0 + i)) for i, s in enumerate(suns)]
    mean, count = smoothed(frames, 0, 4)
    share = shares([f.lighting for f in frames], 0, 4)
    assert count == 3
    np.testing.assert_allclose(
        mean.lighting.coefficients, sum(w * frames[i].lighting.coefficients for i, w in share.items())
    )
    (sun,) = mean.lighting.suns
    np.testing.assert_allclose(sun.irradiance, share[0] * np.array([3, 3, 2]) + share[1] * np.array([2, 2, 2]))
    assert here @ near < sun.direction @ here < 1 and np.linalg.norm(sun.direction) == pytest.approx(1)
    whole = sum(w * (frames[i].sky + sum(s.to_map(64, 128) for s in suns[i])) for i, w in share.items())
    drawn = mean.sky + sun.to_map(64, 128)
    np.testing.assert_allclose(sh.project_map(drawn, 1), sh.project_map(whole, 1), atol=0.02)
