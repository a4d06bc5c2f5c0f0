# SPDX-License-Identifier: GPL-3.0-or-later
"""What cameras near a scene's own see of its objects."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from btfsep_engine.pipeline import marks
from btfsep_engine.pipeline.marks import Sight, part_about
from tests.render.scenes import as_mesh, egg_and_pebble, job_of, looking_down, scene_of

BLUR, POINTS = 1.0, 400
LENSES = ({}, {"orthographic": True, "fx": 40.0, "fy": 40.0}, {"distortion": (-0.3, 0.1, 0.02, 0.01)})


def aside(camera, right=0.0, down=0.0, turn=0.0):
    """A camera that stands elsewhere and is rolled."""
    c, s = np.cos(turn), np.sin(turn)
    to_world = camera.to_world @ np.array([[c, -s, 0, right], [s, c, 0, down], [0, 0, 1, 0], [0, 0, 0, 1]])
    return replace(camera, to_world=to_world)


def of(scene, camera):
    """A Sight's marks, without those that it has kept."""
    return Sight(scene).marks(camera, blur=BLUR, points=POINTS)


def in_order(points):
    return points[np.lexsort(np.round(points, 4).T)]


@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize("way", [{}, {"right": 0.35, "down": -0.2}, {"turn": 0.4}])
def test_the_part_of_the_picture_that_is_looked_at_shows_all_that_the_whole_does(monkeypatch, lens, way):
    scene = scene_of(job_of([egg_and_pebble()], replace(looking_down(), **lens)))
    camera = aside(scene.job.camera, **way)
    monkeypatch.setattr(marks, "MOST", 10**6)
    part, corner = part_about(camera, [scene.job.objects[0].mesh])
    assert part.width * part.height < 0.9 * camera.width * camera.height or corner == (0, 0)
    found = Sight(scene).marks(camera, blur=BLUR, points=10**6)
    monkeypatch.setattr(marks, "part_about", lambda camera, meshes: (camera, (0, 0)))
    whole = Sight(scene).marks(camera, blur=BLUR, points=10**6)
    assert len(found.outline) > 100 and len(found.surface) > 1000
    for name in ("outline", "surface"):
        assert np.allclose(in_order(getattr(found, name)), in_order(getattr(whole, name)), atol=1e-4)


def test_what_reaches_behind_the_camera_may_be_anywhere():
    camera = looking_down()
    behind = as_mesh(trimesh.creation.box((0.2, 0.2, 2 * camera.to_world[2, 3] + 1)))
    assert part_about(camera, [behind]) == (camera, (0, 0))


def test_points_of_an_outline_lie_where_the_line_of_sight_grazes_a_ball():
    scene = scene_of(job_of([as_mesh(trimesh.creation.icosphere(5))], looking_down()))
    camera = aside(scene.job.camera, right=0.2)
    found = of(scene, camera)
    rays = found.outline - camera.to_world[:3, 3]
    far = np.linalg.norm(camera.to_world[:3, 3])
    aside_of_centre = np.arccos(-rays @ camera.to_world[:3, 3] / np.linalg.norm(rays, axis=1) / far)
    inside = (np.arcsin(1 / far) - aside_of_centre) * camera.fx  # pixels
    assert inside.min() > -0.05 and np.percentile(inside, 75) < 0.15 and inside.max() < 0.6
    assert np.allclose(np.linalg.norm(found.outline, axis=1), 1, atol=0.01)
    out = camera.project(found.outline) - camera.project(np.zeros((1, 3)))
    assert ((out / np.linalg.norm(out, axis=1, keepdims=True) * found.across).sum(1) > 0.95).mean() in (0, 1)


def test_the_outlines_of_what_stands_around_are_left_out_and_do_not_crowd():
    """A grid of cubes behind the ball has many more outlines than it, of which a share only is looked at."""
    cube, places = trimesh.creation.box((0.1, 0.1, 0.1)), 0.2 * np.arange(-5, 6)
    cubes = trimesh.util.concatenate([cube.copy().apply_translation([x, y, -1.5]) for x in places for y in places])
    ball, camera = as_mesh(trimesh.creation.icosphere(4, 0.5)), looking_down()
    alone = of(scene_of(job_of([ball], camera)), camera)
    among = of(scene_of(job_of([ball], camera, occluders=[as_mesh(cubes, flat=True)])), camera)
    assert np.allclose(in_order(among.outline), in_order(alone.outline), atol=1e-4)


def test_there_are_as_many_marks_as_are_asked_for_all_around(monkeypatch):
    scene = scene_of(job_of([egg_and_pebble()], looking_down()))
    monkeypatch.setattr(marks, "MOST", 60)
    found = of(scene, scene.job.camera)
    assert len(found.outline) == 60 and len(found.surface) == POINTS
    angle = np.arctan2(*(found.outline - found.outline.mean(0)).T[:2])
    assert np.histogram(angle, 8, (-np.pi, np.pi))[0].min() >= 2
    view = scene.view.mesh >= 0
    column, row = scene.job.camera.project(found.surface).T.astype(int)
    assert view[row, column].all() and view[row + 2, column].all() and view[row - 2, column].all()
