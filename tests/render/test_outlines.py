# SPDX-License-Identifier: GPL-3.0-or-later
"""Pixels beside outlines: where they lie, and that no fit uses them."""

import numpy as np
import pytest
import trimesh

from btfsep_engine.btf.library import open_library
from btfsep_engine.pipeline.model import view_problem
from btfsep_engine.pipeline.settings import choose
from btfsep_engine.render.outlines import FARTHEST, STEP, outlines
from btfsep_engine.render.surface import camera_view
from btfsep_engine.render.tracer import Tracer
from tests.render.scenes import as_mesh, job_of, looking_down, scene_of


def seen(shape, camera):
    job = job_of([as_mesh(shape, flat=True)], camera)
    view = camera_view(Tracer([job.objects[0].mesh]), job)
    return view, outlines(view, job)


def slab(z, *, half=0.5, at=(0.0, 0.0)):
    box = trimesh.creation.box((2 * half, 2 * half, 0.02))
    box.apply_translation([*at, z - 0.01])
    return box


def has_another_beside(image):
    """Which pixels have one of another value among the eight around, in the picture."""
    padded = np.pad(image, 1, mode="edge")
    h, w = image.shape
    around = [padded[i : i + h, j : j + w] for i in range(3) for j in range(3)]
    return np.any([each != image for each in around], 0)


def heights(view, camera):
    """(h, w) of what is seen above z = 0; -1: nothing."""
    rows, columns = np.nonzero(view.mesh >= 0)
    out = np.full(view.mesh.shape, -1.0)
    down = camera.rays(columns + 0.5, rows + 0.5)[1][:, 2]
    out[rows, columns] = np.round(4.0 + down * view.distance[rows, columns], 3) + 0.0
    return out


def test_one_part_of_an_object_before_another_has_an_outline():
    low, high = slab(0.0, half=0.4, at=(-0.45, 0.2)), slab(0.4, half=0.15, at=(-0.35, 0.15))  # not in the middle
    view, found = seen(trimesh.util.concatenate([low, high]), looking_down())
    above = heights(view, looking_down())
    assert set(np.unique(above)) == {-1.0, 0.0, 0.4}
    expected = has_another_beside(above) & (above >= 0)
    np.testing.assert_array_equal(found.beside(view.mesh.shape) & (view.mesh >= 0), expected)
    assert set(np.unique(found.rings_at(np.argwhere(expected)))) == {0}
    next_ones = has_another_beside(expected) & ~expected & (above >= 0)
    assert set(np.unique(found.rings_at(np.argwhere(next_ones)))) == {1}


@pytest.mark.parametrize("degrees", [0, 40, 60])
def test_a_slanted_plane_and_a_ball_have_no_outline_within(degrees):
    plane = slab(0.0, half=3.0 if degrees < 50 else 4.4)
    plane.apply_transform(trimesh.transformations.rotation_matrix(np.radians(degrees), [1, 0.3, 0]))
    view, found = seen(plane, looking_down())
    assert (view.mesh == 0).all() and not found.beside(view.mesh.shape).any()
    view, found = seen(trimesh.creation.icosphere(5, 0.7), looking_down())
    inside = ~has_another_beside(view.mesh)
    assert not (found.beside(view.mesh.shape) & inside & (view.mesh == 0)).any()


def test_a_large_photo_is_looked_at_in_cells():
    shape = trimesh.util.concatenate([slab(0.0), slab(0.4, half=0.2)])
    view, found = seen(shape, looking_down(size=1200, focal=2500.0))
    assert found.edge == 2 and max(found.rings.shape) <= 514
    steps = has_another_beside(view.distance < 3.8) & (view.mesh == 0)
    assert (found.rings_at(np.argwhere(steps)) <= 1).all()
    beside = found.beside(view.mesh.shape)
    assert 0.9 < beside[steps].mean() and beside.sum() < 5 * has_another_beside(view.mesh + (view.distance < 3.8)).sum()


@pytest.mark.parametrize(("cells", "is_outline"), [(0.6, False), (1.6, True)])
@pytest.mark.parametrize("size", [96, 1200])
def test_a_step_is_an_outline_from_a_few_edges_of_its_own_cells_on(size, cells, is_outline):
    """As large as a pixel shows on the surface, times the pixels of a cell, times `STEP`."""
    camera = looking_down(size=size, focal=2.1 * size)
    edge = seen(slab(0.0), camera)[1].edge
    assert edge == (2 if size == 1200 else 1)
    height = cells * STEP * edge * 4.0 / (2.1 * size)
    view, found = seen(trimesh.util.concatenate([slab(0.0), slab(height, half=0.2)]), camera)
    above = heights(view, camera) > height / 2
    step = has_another_beside(above)
    assert above.mean() == pytest.approx((0.4 * 2.1 / 4) ** 2, rel=0.1) and (view.mesh[step] == 0).all()
    assert step.sum() > size / 4 and (found.rings_at(np.argwhere(step)).min() == 0) == is_outline


def test_objects_that_touch_have_an_outline_between_them_and_only_objects_count():
    """Two halves of a plate, flush, on a table that the whole picture shows."""
    parts = [as_mesh(slab(0.0, half=0.25, at=(x, 0.0)), flat=True) for x in (-0.25, 0.25)]
    table = as_mesh(slab(-0.3, half=3.0), flat=True)
    camera = looking_down(size=1200, focal=2500.0)
    job = job_of(parts, camera, occluders=[table])
    view = camera_view(Tracer([*parts, table], [2]), job)
    found = outlines(view, job)
    assert set(np.unique(view.mesh)) == {0, 1, 2} and found.edge == 2  # cells are those of the plates, not the table's
    column = int(np.flatnonzero(view.mesh[600] == 1).min())  # where the second begins
    away = np.arange(-20, 20)
    rings = found.rings_at(np.stack([np.full(40, 600), column + away], 1))
    expected = np.minimum(np.where(away < 0, -1 - away, away) // found.edge, FARTHEST)
    assert np.abs(rings - expected).max() <= 1 and rings[19] == rings[20] == 0 and rings.max() == FARTHEST


def test_no_fit_uses_what_lies_beside_an_outline():
    shape = trimesh.util.concatenate([slab(0.0), slab(0.4, half=0.2)])
    scene = scene_of(job_of([as_mesh(shape, flat=True)], looking_down()))
    white = open_library(None).load("reference/white-diffuse")
    assert view_problem(scene, [white], choose("draft", pixels=0)).rings.min() == 1
    everywhere = view_problem(scene, [white], choose("draft", pixels=0, estimator="least-squares", order=2))
    assert everywhere.rings.min() == 0  # the paper's fit is as it was
    thin = trimesh.creation.box((1.0, 0.05, 0.05))  # three pixels wide
    few = scene_of(job_of([as_mesh(thin, flat=True)], looking_down()))
    assert len(view_problem(few, [white], choose("draft", pixels=0)).pixels) > 50
