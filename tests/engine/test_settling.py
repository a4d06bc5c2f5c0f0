# SPDX-License-Identifier: GPL-3.0-or-later
"""The last pixel of a pose: edges of a photo beside known outlines."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from btfsep_engine.fit.pose import Frame, Marks, Misfit, Picture
from btfsep_engine.fit.settling import Edges, Settled, settled
from btfsep_engine.job.camera import Camera

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
    left = ON_IT[:, 0] < 40  # of some the far side alone is unknown
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


SHIFTS = np.array([False] * 3 + [True] * 2 + [False] * 2)
SIZE = np.array([False] * 5 + [True, False])
FARTHER = np.array([0.0, 0, 0, 0.6, 0, 0, 0])


def on_the_disc(picture, *, free=SHIFTS, hold=10.0, about=None) -> Settled:
    """Where a flat disc settles on a picture of one, of what is ``free``: seen straight on, a pixel a unit."""
    to_world = np.diag([1.0, -1, -1, 1])  # the camera looks along +z, and y is down
    to_world[:2, 3], to_world[2, 3] = MIDDLE, -1000.0
    camera = Camera(96, 96, 1000.0, 1000.0, *MIDDLE, to_world)
    flat = [np.concatenate([at, np.zeros((len(at), 1))], 1) for at in (ON_IT, MIDDLE + 0.5 * RADIUS * OUTWARDS)]
    np.testing.assert_allclose(camera.project(flat[0]), ON_IT, atol=1e-9)
    about_it = np.hypot(*(np.mgrid[:96, :96] + 0.5 - MIDDLE[::-1, None, None])) < RADIUS + 8
    look = Picture(picture, np.ones((96, 96), bool), about_it, blur=1.0)
    misfit = Misfit(look, Marks(flat[0], -OUTWARDS, flat[1], np.ones((len(ON_IT), 1))), camera, shading=1.0)
    frame = Frame(camera, np.array([*MIDDLE, 0.0]), RADIUS)
    return settled(misfit, edges_of(picture), frame, np.zeros(7), about=about, free=free, tile=8.0, hold=hold)


def test_a_pose_settles_where_the_edges_are():
    way = np.array([0.7, -0.4])
    found = on_the_disc(disc(middle=MIDDLE + way))
    np.testing.assert_allclose(found.q, [0, 0, 0, *way, 0, 0], atol=0.03)
    assert found.beside == pytest.approx(np.linalg.norm(way) / np.sqrt(2), abs=0.05) and found.left < 0.08
    tiles = len(np.unique((ON_IT / 8).astype(int), axis=0))
    assert 0.6 * tiles < found.edges <= tiles
    still = on_the_disc(disc())
    assert np.abs(still.q).max() < 0.02 and still.beside < 0.08 and still.excess < 0.05


def test_the_prior_holds_what_is_asked_to_be_held():
    picture = disc(middle=MIDDLE + np.array([0.7, -0.4]))
    # far below what the edges say, a pose gives way as the square of the prior's deviation, and lies at its middle
    firm, firmer = (on_the_disc(picture, hold=hold).q[3:5] for hold in (4e-4, 2e-4))
    assert 0 < firm[0] < 0.05 and firm[0] / firmer[0] == pytest.approx(4, rel=0.05)
    np.testing.assert_allclose(on_the_disc(picture, hold=1e-5, about=FARTHER).q, FARTHER, atol=1e-3)


def test_a_disc_that_is_a_little_larger_is_no_move_but_a_rim():
    """All edges together farther out: that is a number of its own, unless a size is free that is easier to believe."""
    picture = disc(radius=RADIUS + 0.4)
    found = on_the_disc(picture)
    assert np.abs(found.q).max() < 0.03 and found.beside < 0.1 and found.left < 0.1
    grown = on_the_disc(picture, free=SIZE).q[5]
    assert 0.2 < grown < 0.41
    assert on_the_disc(picture, free=SIZE, hold=1e-3).q[5] < 0.05


def test_edges_of_something_else_count_for_less():
    """A fifth of the outline has an edge 1.5 pixels farther out: by least squares the disc would follow it."""
    wide, usual = disc(radius=RADIUS + 1.5), disc()
    beyond = np.mgrid[:96, :96][1] + 0.5 > MIDDLE[0] + 0.8 * RADIUS
    found = on_the_disc(np.where(beyond[..., None], wide, usual))
    share = (ON_IT[:, 0] > MIDDLE[0] + 0.8 * RADIUS).mean()
    followed = np.linalg.lstsq(
        np.concatenate([OUTWARDS, np.ones((90, 1))], 1), 1.5 * (ON_IT[:, 0] > MIDDLE[0] + 0.8 * RADIUS), rcond=None
    )[0]
    assert 0.15 < share < 0.25 and followed[0] > 0.4
    assert np.abs(found.q).max() < 0.4 * followed[0]
