# SPDX-License-Identifier: GPL-3.0-or-later
"""What studies put behind the objects of photographs."""

import numpy as np

from scripts.studies.clutter import cluttered


def test_things_stand_behind_the_object_alone():
    """Over a background of one colour: the object's part of a pixel stays, the rest is of something else."""
    y, x = np.mgrid[:60, :80]
    coverage = np.clip(20.5 - np.hypot(y - 30, x - 40), 0, 1)
    own, behind = np.array([0.5, 0.3, 0.2]), np.array([0.1, 0.4, 0.2])
    photo = coverage[..., None] * own + (1 - coverage[..., None]) * behind
    out = cluttered(photo, coverage, np.random.default_rng(3))
    assert np.allclose(out[coverage == 1], own)
    assert np.abs(out[coverage == 0] - behind).max(1).min() > 0.01
    mixed = (coverage > 0.2) & (coverage < 0.8)
    rest = (out - coverage[..., None] * own)[mixed] / (1 - coverage[mixed])[:, None]
    assert mixed.sum() > 20 and rest.min() > 0 and np.ptp(rest[:, 1]) > 0.1  # of several things
    assert np.array_equal(out, cluttered(photo, coverage, np.random.default_rng(3)))
