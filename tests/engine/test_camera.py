# SPDX-License-Identifier: GPL-3.0-or-later
"""One model of the camera: its rays, and back its image positions, against OpenCV's."""

import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from btfsep_engine.job.camera import Camera
from btfsep_engine.job.schema import CameraSchema

LENSES = {
    "none": (0.0, 0.0, 0.0, 0.0),
    "barrel": (-0.28, 0.07, 0.0, 0.0),
    "pincushion": (0.2, 0.05, 0.0, 0.0),
    "off its axis": (-0.15, 0.02, 0.004, -0.006),
}


@pytest.fixture(params=LENSES)
def camera(request):
    to_world = np.eye(4)
    to_world[:3, :3] = Rotation.from_euler("xyz", [60, 15, 130], degrees=True).as_matrix()
    to_world[:3, 3] = [3, -2, 1.5]
    return Camera(640, 480, 500.0, 480.0, 350.0, 215.0, to_world, LENSES[request.param])


def opencv(camera):
    """The camera's matrix and distortion, and the turn and the shift from the world to OpenCV's axes."""
    matrix = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
    turn = np.diag([1.0, -1, -1]) @ camera.to_world[:3, :3].T
    shift = -turn @ camera.to_world[:3, 3]
    return matrix, np.array(camera.distortion), cv2.Rodrigues(turn)[0], shift


def everywhere(camera, rng, n=500):
    """Image positions all over the picture, x and y."""
    return rng.uniform(0, camera.width, n), rng.uniform(0, camera.height, n)


def test_points_are_seen_where_opencv_says(camera, rng):
    origins, rays = camera.rays(*everywhere(camera, rng))
    points = origins + rng.uniform(1, 9, (500, 1)) * rays
    matrix, distortion, turn, shift = opencv(camera)
    expected = cv2.projectPoints(points, turn, shift, matrix, distortion)[0][:, 0]
    np.testing.assert_allclose(camera.project(points), expected, atol=1e-8)


def test_rays_are_those_of_opencv(camera, rng):
    x, y = everywhere(camera, rng)
    matrix, distortion, _, _ = opencv(camera)
    ends = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 500, 1e-13)
    expected = cv2.undistortPointsIter(np.stack([x, y], -1), matrix, distortion, None, None, ends)[:, 0]
    local = camera.rays(x, y)[1] @ camera.to_world[:3, :3]
    np.testing.assert_allclose(local[:, :2] / -local[:, 2:] * [1, -1], expected, atol=1e-9)


def test_rays_go_back_to_where_they_came_from(camera, rng):
    for one in (camera, replace(camera, orthographic=True, fx=90.0, fy=80.0)):
        x, y = everywhere(one, rng)
        origins, rays = one.rays(x, y)
        np.testing.assert_allclose(one.project(origins + 3.3 * rays), np.stack([x, y], -1), atol=1e-8)
        np.testing.assert_allclose(np.linalg.norm(rays, axis=1), 1)


def test_an_orthographic_camera(rng):
    camera = Camera(64, 48, 20.0, 10.0, 32.0, 24.0, np.eye(4), orthographic=True)
    origins, rays = camera.rays([32.0, 42.0], [24.0, 44.0])
    np.testing.assert_allclose(origins, [[0, 0, 0], [0.5, -2, 0]])
    np.testing.assert_allclose(rays, [[0, 0, -1]] * 2)
    towards, pixel = camera.seen_from(rng.normal(size=(5, 3)))
    np.testing.assert_allclose(towards, [[0, 0, 1]] * 5)
    np.testing.assert_allclose(pixel, 1 / np.sqrt(20 * 10))


def test_a_part_of_a_picture_has_the_same_rays(camera, rng):
    part = replace(camera, width=100, height=90, cx=camera.cx - 400, cy=camera.cy - 30)
    x, y = everywhere(part, rng)
    for one, other in zip(part.rays(x, y), camera.rays(x + 400, y + 30), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-12)


def test_what_a_lens_does_not_show_does_not_come_back_into_the_picture():
    """A polynomial turns round: OpenCV shows what lies far aside in the middle of the picture."""
    camera = Camera(640, 480, 500.0, 500.0, 320.0, 240.0, np.eye(4), (-0.3, 0.0, 0.0, 0.0))
    aside = np.array([[1.8, 0.0, -1.0]])
    matrix, distortion, turn, shift = opencv(camera)
    wrong = cv2.projectPoints(aside, turn, shift, matrix, distortion)[0][0, 0]
    assert 0 < wrong[0] < 640
    assert camera.project(aside)[0, 0] > 640
    out = camera.project(np.linspace([0.1, 0.05, -1.0], [9, 4.5, -1.0], 200))
    assert (np.diff(out, axis=0) * [1, -1] > 0).all()


@pytest.mark.parametrize("name", LENSES)
def test_usual_lenses_do_not_fold_the_picture_over(name):
    camera = Camera(640, 480, 500.0, 500.0, 320.0, 240.0, np.eye(4), LENSES[name])
    assert not camera.folded


@pytest.mark.parametrize("lens", [(-0.9, 0, 0, 0), (0.1, -0.9, 0, 0), (0, 0, 0.9, 0)])
def test_a_lens_that_folds_the_picture_over_is_known(lens):
    assert Camera(640, 480, 500.0, 500.0, 320.0, 240.0, np.eye(4), lens).folded


def test_a_camera_of_opencv_is_converted_as_the_docs_say(rng):
    text = (Path(__file__).parents[2] / "docs" / "conventions.md").read_text(encoding="utf-8")
    recipe = re.search(r"```python\n(.*?)```", text, re.DOTALL)[1]
    matrix = np.array([[500.0, 0, 319.5], [0, 480, 229.5], [0, 0, 1]])
    turn, shift = Rotation.from_euler("xyz", [160, 10, 40], degrees=True).as_matrix(), np.array([0.2, -0.1, 6.0])
    given = {"np": np, "K": matrix, "R": turn, "t": shift, "width": 640, "height": 460}
    exec(recipe, given)
    camera = CameraSchema(**given["camera"])
    to_world = np.array(camera.to_world)
    own = Camera(camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy, to_world)
    points = rng.uniform(-1, 1, (50, 3))
    expected = cv2.projectPoints(points, cv2.Rodrigues(turn)[0], shift, matrix, None)[0][:, 0]
    np.testing.assert_allclose(own.project(points), expected + 0.5, atol=1e-9)
