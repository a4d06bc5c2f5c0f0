# SPDX-License-Identifier: GPL-3.0-or-later
"""Surfaces from depth: shapes whose depth, points and normals are known in closed form."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from btfsep_engine.job.depth import mesh_from_depth
from btfsep_engine.job.model import Camera


@pytest.fixture
def camera():
    to_world = np.eye(4)
    to_world[:3, :3] = Rotation.from_euler("xyz", [60, 15, 130], degrees=True).as_matrix()
    to_world[:3, 3] = [3, -2, 1.5]
    return Camera(96, 72, 110.0, 110.0, 47.0, 37.5, to_world)


def rays(camera):
    """Camera-space directions through all pixel centres, with z = -1: times the z-depth they are the points."""
    x, y = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    return np.stack([(x - camera.cx) / camera.fx, -(y - camera.cy) / camera.fy, -np.ones_like(x)], -1)


def plane_depth(camera, normal, distance):
    with np.errstate(divide="ignore"):
        return -distance / (rays(camera) @ np.asarray(normal, float))


def sphere_depth(camera, centre, radius):
    d = rays(camera)
    a, b, c = (d * d).sum(-1), d @ centre, centre @ centre - radius**2
    root = b * b - a * c
    return np.where(root > 0, (b - np.sqrt(np.maximum(root, 0))) / a, 0)


def geometric_normals(mesh):
    p = mesh.vertices[mesh.faces]
    n = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    return n / np.linalg.norm(n, axis=-1, keepdims=True)


def unit(v):
    return np.asarray(v, float) / np.linalg.norm(v)


@pytest.mark.parametrize("normal", [(0, 0, 1), (0.3, 0.2, 1), (-1.2, 0.1, 0.5), (0.1, 2.0, 0.4)])
def test_a_plane_is_exact(camera, normal):
    normal = unit(normal)
    depth = plane_depth(camera, normal, 3.0)
    depth[(depth < 0) | (depth > 60)] = 0
    mesh = mesh_from_depth(depth, camera)
    world = camera.to_world[:3, :3] @ normal
    np.testing.assert_allclose(mesh.corner_normals, np.broadcast_to(world, mesh.corner_normals.shape), atol=1e-4)
    np.testing.assert_allclose(geometric_normals(mesh) @ world, 1, atol=1e-9)  # and the winding faces the camera
    np.testing.assert_allclose((mesh.vertices - camera.to_world[:3, 3]) @ world, -3.0, atol=1e-9)


def test_vertices_lie_on_the_rays_of_the_camera(camera):
    mesh = mesh_from_depth(np.full((72, 96), 2.5), camera)
    assert len(mesh.vertices) == 72 * 96 and len(mesh.faces) == 2 * 71 * 95
    x, y = np.meshgrid(np.arange(96) + 0.5, np.arange(72) + 0.5)
    origins, directions = camera.rays(x.ravel(), y.ravel())
    along = mesh.vertices - origins
    np.testing.assert_allclose(np.cross(along, directions), 0, atol=1e-9)
    np.testing.assert_allclose(along @ -camera.to_world[:3, 2], 2.5)


def test_a_sphere_in_front_of_a_wall(camera):
    centre, radius = np.array([0.1, -0.1, -3.0]), 0.7
    sphere = sphere_depth(camera, centre, radius)
    wall = plane_depth(camera, (0, 0, 1), 6.0)
    mesh = mesh_from_depth(np.where(sphere > 0, sphere, wall), camera)
    local = (mesh.vertices - camera.to_world[:3, 3]) @ camera.to_world[:3, :3]
    on_sphere = np.linalg.norm(local - centre, axis=-1) < radius + 1e-6
    kind = on_sphere[mesh.faces].sum(-1)
    assert set(np.unique(kind)) == {0, 3}  # no triangle spans the gap
    assert (kind == 3).sum() > 0.85 * 2 * (sphere > 0).sum()
    n = mesh.corner_normals @ camera.to_world[:3, :3].astype(np.float32)
    ball = kind == 3
    expected = (local[mesh.faces[ball]] - centre) / radius
    facing = -(expected * local[mesh.faces[ball]]).sum(-1) / np.linalg.norm(local[mesh.faces[ball]], axis=-1)
    error = np.degrees(np.arccos(np.clip((n[ball] * expected).sum(-1), -1, 1)))
    assert error[facing > 0.5].max() < 2
    assert np.median(error) < 0.5
    np.testing.assert_allclose(n[~ball], np.broadcast_to([0, 0, 1], n[~ball].shape), atol=1e-4)


def test_a_low_step_is_cut_and_a_steep_slope_is_not(camera):
    depth = np.full((72, 96), 4.0)
    footprint = 4.0 / camera.fx
    depth[:, 48:] += 5 * footprint
    mesh = mesh_from_depth(depth, camera)
    assert len(mesh.faces) == 2 * 71 * 95 - 2 * 71  # the column over the step is missing
    np.testing.assert_allclose(
        mesh.corner_normals @ camera.to_world[:3, 2].astype(np.float32), np.ones(mesh.faces.shape), atol=1e-5
    )
    slope = plane_depth(camera, unit((5.0, 0, 1)), 1.5)  # 79 degrees away from facing the camera
    slope[(slope < 0) | (slope > 40)] = 0
    valid = slope > 0
    whole = valid[1:, 1:] & valid[1:, :-1] & valid[:-1, 1:] & valid[:-1, :-1]
    assert len(mesh_from_depth(slope, camera).faces) >= 2 * whole.sum()


def test_half_float_depth_still_has_smooth_normals(camera):
    normal = unit((0.3, 0.2, 1))
    depth = plane_depth(camera, normal, 3.0).astype(np.float16)
    mesh = mesh_from_depth(depth, camera)
    error = np.degrees(np.arccos(np.clip(mesh.corner_normals @ camera.to_world[:3, :3] @ normal, -1, 1)))
    assert np.median(error) < 1.5
    raw = np.degrees(np.arccos(np.clip(geometric_normals(mesh) @ camera.to_world[:3, :3] @ normal, -1, 1)))
    assert np.median(error) < np.median(raw) / 5


def test_nothing_in_it(camera):
    for nothing in (0.0, 1e10, np.float32(1e10), np.inf):
        assert mesh_from_depth(np.full((72, 96), nothing), camera) is None
    lonely = np.zeros((72, 96))
    lonely[::2, ::2] = 1
    assert mesh_from_depth(lonely, camera) is None


def test_a_step_between_slanted_planes_is_cut(camera):
    """Both sides slope by one footprint a pixel, the step is eight: no slope that goes on, and no cliff."""
    depth = plane_depth(camera, unit((1.0, 0, 1)), 3.0)
    depth[:, 48:] += 8 * depth[:, 48:] / camera.fx
    mesh = mesh_from_depth(depth, camera)
    assert len(mesh.faces) == 2 * 71 * 95 - 2 * 71


def covered(mesh, camera):
    """Area of the triangles between four neighbouring pixel centres, in pixels, one value per square with any."""
    local = (mesh.vertices - camera.to_world[:3, 3]) @ camera.to_world[:3, :3]
    x = local[:, 0] / -local[:, 2] * camera.fx + camera.cx
    y = -local[:, 1] / -local[:, 2] * camera.fy + camera.cy
    image = np.stack([x, y], -1)[mesh.faces]
    square = np.round(image.min(1) - 0.5).astype(int) @ [1, camera.width]
    along, other = image[:, 1] - image[:, 0], image[:, 2] - image[:, 0]
    area = np.abs(along[:, 0] * other[:, 1] - along[:, 1] * other[:, 0]) / 2
    total = np.bincount(square, area)
    return total[total > 0]


@pytest.mark.parametrize("kind", ["holes", "cracks", "cracks from the other side"])
def test_triangles_never_overlap(camera, rng, kind):
    depth = plane_depth(camera, (0.1, 0, 1), 4.0)
    if kind == "holes":
        depth[rng.random(depth.shape) < 0.3] = 0
    else:  # steps that grow from nothing along a line: at its tip one of four edges is cut
        rows, columns = np.mgrid[:72, :96]
        depth += (columns > 48) * np.maximum(rows - 30, 0) * 0.03 + (rows > 36) * np.maximum(columns - 60, 0) * 0.03
    if "other" in kind:
        depth = depth[::-1, ::-1]
    mesh = mesh_from_depth(depth, camera)
    area = covered(mesh, camera)
    np.testing.assert_allclose(np.unique(np.round(area, 6)), [0.5, 1])
    assert (area < 0.75).any() and (area > 0.75).any()
