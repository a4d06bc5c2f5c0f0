# SPDX-License-Identifier: GPL-3.0-or-later
"""The last pixel of a pose: edges of a photo beside known outlines."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from btfsep_engine.fit.settling import Edges, Settled

MIDDLE, RADIUS = np.array([48.0, 46.0]), 25.0
ANGLES = np.linspace(0, 2 * np.pi, 90, endpoint=False)
OUTWARDS = np.stack([np.cos(ANGLES), np.sin(ANGLES)], 1)
ON_IT = MIDDLE + RADIUS * OUTWARDS


def disc(*, middle=MIDDLE, radius=RADIUS, inside=(0.5, 0.3, 0.2), outside=(0.1, 0.1, 0.3), fine=16):
    """A picture (96, 96, 3) of a disc, each pixel the mean of ``fine`` x ``fine`` points of it."""
    at = (np.arange(96 * fine) + 0.5) / fine
    within = np.hypot(at - middle[0], at[:, None] - middle[1]) < radius
    share = within.reshape(96, fine, 96, fine).mean((1, 3))[..., None]
    return share * np.array(inside) + (1 - share) * np.array(outside)


def edges_of(picture, usable=None) -> Edges:
    about = np.hypot(*(np.mgrid[:96, :96] + 0.5 - MIDDLE[::-1, None, None])) < RADIUS + 8
    return Edges(picture, np.ones((96, 96), bool) if usable is None else usable, about)


@pytest.mark.parametrize("blur", [0.0, 0.8])
@pytest.mark.parametrize("outside", [(0.1, 0.1, 0.3), (2.0, 1.5, 1.0), (0.01, 0.01, 0.01)])
def test_an_edge_is_found_to_a_fraction_of_a_pixel(blur, outside):
    """However bright what is behind it is: the slope of logarithms would lie up to half a pixel on its darker side."""
    way = np.array([0.7, -0.4])
    picture = gaussian_filter(disc(middle=MIDDLE + way, outside=outside), (blur, blur, 0))
    outwards, deviation = edges_of(picture).beside(ON_IT, -OUTWARDS)
    assert (np.abs(outwards - OUTWARDS @ way) < 0.07 + 0.15 * blur * np.abs(OUTWARDS @ way)).all()
    assert np.abs((outwards - OUTWARDS @ way).mean()) < 0.03
    assert deviation.max() < 0.4


def test_where_there_is_no_edge_none_is_believed():
    """Nothing changes there; beyond the frame; what is unknown; an edge farther off than is looked."""
    even = np.full((96, 96, 3), 0.3)
    assert edges_of(even).beside(ON_IT, -OUTWARDS)[1].min() > 10
    unknown = np.ones((96, 96), bool)
    unknown[:, :40] = False
    deviation = edges_of(disc(), unknown).beside(ON_IT, -OUTWARDS)[1]
    left = ON_IT[:, 0] < 38
    assert np.isinf(deviation[left]).all() and np.isfinite(deviation[ON_IT[:, 0] > 46]).all()
    outside = edges_of(disc()).beside(ON_IT + np.array([60.0, 0]), -OUTWARDS)[1]
    assert np.isinf(outside[ON_IT[:, 0] > MIDDLE[0]]).all()
    far = edges_of(disc(radius=RADIUS + 6)).beside(ON_IT, -OUTWARDS)[1]
    assert (far > 0.5).all()


def test_an_uneven_background_makes_an_edge_less_sure():
    busy = disc()
    spots = np.random.default_rng(3).uniform(0.02, 0.5, (96, 96, 1))
    beyond = np.hypot(*(np.mgrid[:96, :96] + 0.5 - MIDDLE[::-1, None, None])) > RADIUS + 1
    busy[beyond] = np.broadcast_to(spots, busy.shape)[beyond]
    calm = edges_of(disc()).beside(ON_IT, -OUTWARDS)[1]
    assert np.median(edges_of(busy).beside(ON_IT, -OUTWARDS)[1]) > 2 * np.median(calm)


def test_what_edges_need_not_be_beside():
    assert Settled(np.zeros(7), 0.5, 0.3, 9.0).excess == pytest.approx(0.4)
    assert Settled(np.zeros(7), 0.3, 0.5, 9.0).excess == 0
