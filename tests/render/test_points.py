# SPDX-License-Identifier: GPL-3.0-or-later
"""Which pixels enter a fit: shared by what is seen of each object, saturated ones where they count as bounds."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh

from btfsep_engine.job.model import Photo
from btfsep_engine.pipeline.points import chosen_points, names_of, photographed_regions
from btfsep_engine.pipeline.settings import choose
from tests.render.scenes import as_mesh, job_of, looking_down, scene_of


def plate(width, x):
    box = trimesh.creation.box((width, 0.8, 0.02))
    box.apply_translation([x, 0.0, 0.0])
    return as_mesh(box, flat=True)


@pytest.fixture(scope="module")
def job():
    """Two plates, of which one has three times the pixels of the other."""
    return job_of([plate(0.3, -0.6), plate(0.9, 0.3)], looking_down())


def scene_with(job, *, clipped, usable):
    """A scene whose photo has (h, w) bool pixels with a clipped red, and usable ones."""
    channels = clipped[..., None] & np.array([True, False, False])
    return scene_of(replace(job, photo=Photo(job.photo.radiance, usable, 0, clipped=channels)))


def test_pixels_are_shared_by_what_is_seen_of_each_object(job):
    scene, settings = scene_of(job), choose("draft", pixels=800)
    small, large = (len(p) for p in chosen_points(scene, settings, regions=scene.regions, textured=False))
    assert [small, large] == pytest.approx([200, 600], abs=15)
    every = chosen_points(scene, choose("paper", pixels=0), regions=scene.regions, textured=False)
    for points, region in zip(every, scene.regions, strict=True):
        assert len(points) == region.sum() and region[tuple(points.pixels.T)].all()
    assert names_of(scene) == "objects 'object 0' and 'object 1'"


@pytest.mark.parametrize(("estimator", "bounds"), [("map", True), ("least-squares", False)])
def test_saturated_pixels_are_bounds_with_a_prior_and_left_out_without(job, estimator, bounds):
    _, region = scene_of(job).regions
    rows = np.arange(96)[:, None]
    clipped, transparent = region & (rows < 45), region & (rows > 60)
    scene = scene_with(job, clipped=clipped, usable=~clipped & ~transparent)
    small, large = photographed_regions(scene, choose("draft", estimator=estimator))
    np.testing.assert_array_equal(small, scene.regions[0])
    np.testing.assert_array_equal(large, region & ~transparent & (bounds | ~clipped))
    (said,) = scene.reporter.warnings
    assert "object 'object 1'" in said and ("at least as bright" in said) == bounds
    assert int(said.split(" %")[0]) == pytest.approx(100 * (clipped | transparent).sum() / region.sum(), abs=0.5)


def test_of_a_mirror_it_is_said_that_its_lamps_are_clipped(job):
    _, region = scene_of(job).regions
    clipped = region & (np.arange(96)[:, None] < 60)
    scene = scene_with(job, clipped=clipped, usable=~clipped)
    scene.mirrors = (SimpleNamespace(index=1),)
    photographed_regions(scene, choose("draft"))
    (said,) = scene.reporter.warnings
    assert said.startswith("lamps are clipped in what mirrors") and "object 'object 1'" in said


def test_of_what_is_transparent_alone_no_bound_is_said(job):
    _, region = scene_of(job).regions
    scene = scene_with(job, clipped=np.zeros_like(region), usable=~(region & (np.arange(96)[:, None] > 60)))
    photographed_regions(scene, choose("draft"))
    assert "were left out" in scene.reporter.warnings[0]
