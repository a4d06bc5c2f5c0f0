# SPDX-License-Identifier: GPL-3.0-or-later
"""Large photographs: fewer pixels are looked at, evenly; the report's smaller picture is one of the same scene."""

from dataclasses import replace

import numpy as np
import pytest

from btfsep_engine.job.model import Photo
from btfsep_engine.render.sampling import thinned
from tests.render.scenes import job_of, looking_down, scene_of


def test_a_region_is_thinned_evenly_and_to_size():
    rows, columns = np.mgrid[:600, :800]
    region = (rows - 300) ** 2 + (columns - 500) ** 2 < 250**2
    most = 4000
    kept = np.mean([thinned(region, most, seed=s).sum() for s in range(20)])
    assert 0.9 * most < kept < 1.6 * most  # of whole pixels: the edge of a square is rounded down
    chance = np.mean([thinned(region, most, seed=s) for s in range(400)], 0)
    assert (chance[~region] == 0).all()
    # every pixel has the same chance: by quarters of the region, and by odd and even pixels
    left = columns < 500
    parts = [region & half & (rows % 2 == i) for half in (left, ~left) for i in (0, 1)]
    quarters = [chance[part].mean() for part in parts]
    assert np.ptp(quarters) < 0.05 * np.mean(quarters)


def test_a_small_region_is_left_alone_and_a_thin_one_is_not_lost():
    region = np.zeros((50, 60), bool)
    region[10, 5:40] = True
    assert thinned(region, 35) is region
    for seed in range(50):
        some = thinned(region, 1, seed=seed)
        assert some.any() and not (some & ~region).any()


@pytest.mark.parametrize(("size", "side"), [(96, 32), (96, 50), (95, 32)])
def test_the_smaller_scene_is_what_a_smaller_camera_sees(sphere, size, side):
    camera = looking_down(size, 2.0 * size)
    job = job_of([sphere], camera)
    random = np.random.default_rng(0)
    photo = Photo(random.random((size, size, 3), np.float32), random.random((size, size)) < 0.9, 0)
    scene = scene_of(replace(job, photo=photo))
    small = scene.at_most(side)
    edge = -(-size // side)
    camera = small.job.camera
    assert camera.width == camera.height == size // edge <= side
    traced = scene_of(small.job)
    assert (traced.view.mesh == small.view.mesh).mean() > 0.995  # a silhouette may fall between
    both = (traced.view.mesh == 0) & (small.view.mesh == 0)
    one, other = (s.points(0, region=both, textured=False) for s in (traced, small))
    # in pixels: where the surface is steep a pixel may show what is `surface.BESIDE` its centre
    image = [p.position[:, :2] / (4 - p.position[:, 2:]) * camera.fx for p in (one, other)]
    assert np.abs(image[0] - image[1]).max() < 0.06
    assert np.median(np.abs(image[0] - image[1])) < 1e-4
    assert np.median(one.footprint / other.footprint) == pytest.approx(1, abs=1e-4)
    block = photo.radiance[edge : 2 * edge, 2 * edge : 3 * edge]
    assert small.job.photo.radiance[1, 2] == pytest.approx(block.mean((0, 1)))
    assert small.job.photo.usable[1, 2] == photo.usable[edge : 2 * edge, 2 * edge : 3 * edge].all()


def test_a_small_scene_is_its_own(sphere):
    scene = scene_of(job_of([sphere], looking_down()))
    assert scene.at_most(96) is scene
