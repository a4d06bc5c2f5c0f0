# SPDX-License-Identifier: GPL-3.0-or-later
"""Surfaces from depth: shapes whose depth, points and normals are known in closed form."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import binary_erosion
from scipy.spatial.transform import Rotation

from btfsep_engine.job.depth import closing_mesh, mesh_from_depth
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


@pytest.fixture
def parallel(camera):
    return replace(camera, fx=30.0, fy=28.0, orthographic=True)


def unit(v):
    return np.asarray(v, float) / np.linalg.norm(v)


@pytest.mark.parametrize("normal", [(0, 0, 1), (0.3, 0.2, 1), (-1.2, 0.1, 0.5)])
def test_a_plane_before_an_orthographic_camera(parallel, normal):
    normal, flat = unit(normal), parallel.local_points(np.arange(96) + 0.5, np.arange(72)[:, None] + 0.5, 0.0)
    depth = (6.0 + flat @ normal) / normal[2]
    depth[depth < 0] = 0
    mesh = mesh_from_depth(depth, parallel)
    world = parallel.to_world[:3, :3] @ normal
    np.testing.assert_allclose((mesh.vertices - parallel.to_world[:3, 3]) @ world, -6.0, atol=1e-5)
    np.testing.assert_allclose(mesh.corner_normals, np.broadcast_to(world, mesh.corner_normals.shape), atol=1e-4)
    np.testing.assert_allclose(geometric_normals(mesh) @ world, 1, atol=1e-6)
    at = parallel.project(mesh.vertices) - 0.5
    np.testing.assert_allclose(at, np.round(at), atol=1e-3)


@pytest.mark.parametrize("noise", [0.0, 0.3])
def test_a_ball_before_an_orthographic_camera(parallel, noise):
    """The shape, the normals and the noise are those of the depth, in footprints of a pixel of 1/30."""
    flat = parallel.local_points(np.arange(96) + 0.5, np.arange(72)[:, None] + 0.5, 0.0)
    inside = 1 - (flat[..., :2] ** 2).sum(-1)
    rough = np.random.default_rng(0).standard_normal(inside.shape) * noise / parallel.focal
    mesh = mesh_from_depth(np.where(inside > 0, 5 - np.sqrt(np.maximum(inside, 0)) + rough, 0), parallel)
    local = (mesh.vertices - parallel.to_world[:3, 3]) @ parallel.to_world[:3, :3] + [0, 0, 5]
    off = np.linalg.norm(local, axis=1) - 1
    middle = local[:, 2] > 0.6
    assert np.sqrt(np.mean(off[middle] ** 2)) < (0.6 * noise / parallel.focal if noise else 1e-5)
    normals = mesh.corner_normals.reshape(-1, 3) @ parallel.to_world[:3, :3]
    at = local[mesh.faces].reshape(-1, 3)
    cosine = (normals * at).sum(1)[at[:, 2] > 0.6]
    assert np.degrees(np.arccos(np.clip(np.median(cosine), -1, 1))) < (10 if noise else 2)


def test_a_closed_ball_before_an_orthographic_camera_hides_nothing(parallel):
    flat = parallel.local_points(np.arange(96) + 0.5, np.arange(72)[:, None] + 0.5, 0.0)
    inside = 1 - (flat[..., :2] ** 2).sum(-1)
    depth = np.where(inside > 0, 5 - np.sqrt(np.maximum(inside, 0)), 0)
    closing = closing_mesh(depth, parallel)
    rows, columns = np.nonzero(binary_erosion(depth > 0))
    origins, ways = parallel.rays(columns + 0.5, rows + 0.5)
    reached = met(closing, origins, ways)
    assert (reached > depth[rows, columns] + 1e-6).all()
    assert np.isfinite(reached).mean() > 0.99


@pytest.mark.parametrize("normal", [(0, 0, 1), (0.3, 0.2, 1), (-1.2, 0.1, 0.5)])
def test_a_plane_behind_a_lens(camera, normal):
    lens = replace(camera, distortion=(-0.3, 0.05, 0.002, -0.003))
    seen = lens.local_points(np.arange(96) + 0.5, np.arange(72)[:, None] + 0.5)
    normal = unit(normal)
    depth = -3.0 / (seen @ normal)
    depth[(depth < 0) | (depth > 60)] = 0
    mesh = mesh_from_depth(depth, lens)
    world = lens.to_world[:3, :3] @ normal
    np.testing.assert_allclose((mesh.vertices - lens.to_world[:3, 3]) @ world, -3.0, atol=1e-9)
    off = np.degrees(np.arccos(np.clip(mesh.corner_normals @ world.astype(np.float32), -1, 1)))
    assert np.median(off) < 0.1
    assert off.max() < 1  # at the picture's edge, from one side


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


def met(mesh, origins, directions):
    """Distance along rays (n, 3) to the nearest triangle, infinite where none; by Moeller and Trumbore.

    Triangles that a ray lies in are not met.
    """
    a, b, c = mesh.vertices[mesh.faces].transpose(1, 0, 2)
    first, second = b - a, c - a
    out = []
    for origin, direction in zip(origins, directions, strict=True):
        p = np.cross(direction, second)
        slant = (first * p).sum(1) / np.linalg.norm(first, axis=1) / np.linalg.norm(second, axis=1)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            scale = np.where(np.abs(slant) < 1e-9, np.nan, 1 / (first * p).sum(1))
            u = ((origin - a) * p).sum(1) * scale
            q = np.cross(origin - a, first)
            v = (q @ direction) * scale
            t = (second * q).sum(1) * scale
        hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 1e-9)
        out.append(t[hit].min(initial=np.inf))
    return np.array(out)


def steps(camera):
    """A ball before a wall that fills the picture: steps, no outline inside the picture."""
    sphere = sphere_depth(camera, np.array([0.1, -0.1, -3.0]), 0.7)
    return np.where(sphere > 0, sphere, plane_depth(camera, (0, 0, 1), 6.0))


def two_balls(camera):
    """One before the other and beyond both nothing: steps, and an outline with two concave corners."""
    near = sphere_depth(camera, np.array([-0.3, 0.0, -3.0]), 0.5)
    far = sphere_depth(camera, np.array([0.3, 0.1, -3.8]), 0.7)
    return np.where(near > 0, near, far)


def punched(camera):
    """A ball with a hole, and pixels missing here and there."""
    depth = sphere_depth(camera, np.array([0.1, -0.1, -3.0]), 0.8)
    depth[30:36, 44:52] = 0
    depth[np.random.default_rng(3).random(depth.shape) < 0.02] = 0
    return depth


@pytest.mark.parametrize("shape", [steps, two_balls, punched])
def test_from_inside_of_a_closed_surface_no_ray_gets_out(camera, rng, shape):
    depth = shape(camera)
    surface, closing = mesh_from_depth(depth, camera), closing_mesh(depth, camera)
    both = replace(
        closing,
        vertices=np.concatenate([surface.vertices, closing.vertices]),
        faces=np.concatenate([surface.faces, closing.faces + len(surface.vertices)]),
    )
    centres = surface.vertices[surface.faces[rng.choice(len(surface.faces), 60)]].mean(1)
    eye = camera.to_world[:3, 3]
    inside = centres + 0.02 * (centres - eye)  # 6 cm behind what is seen
    directions = rng.normal(size=(60, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    assert np.isfinite(met(both, inside, directions)).all()
    assert np.isinf(met(surface, inside, directions)).sum() > 10  # one side alone lets many out


@pytest.mark.parametrize("shape", [steps, two_balls, punched])
def test_what_closes_a_surface_hides_nothing_from_the_camera(camera, shape):
    depth = shape(camera)
    closing = closing_mesh(depth, camera)
    rows, columns = np.nonzero(depth)
    some = np.random.default_rng(1).choice(len(rows), 150)
    rows, columns = rows[some], columns[some]
    distance = met(closing, *camera.rays(columns + 0.5, rows + 0.5))
    assert (distance > np.linalg.norm(rays(camera)[rows, columns], axis=1) * depth[rows, columns]).all()
    assert len(closing.faces) < 0.5 * len(mesh_from_depth(depth, camera).faces)  # no second copy of the surface


def test_a_surface_without_steps_is_closed_behind_by_half_its_size(camera):
    depth = np.zeros((72, 96))
    depth[20:61, 30:71] = 4.0
    closing = closing_mesh(depth, camera)
    local = (closing.vertices - camera.to_world[:3, 3]) @ camera.to_world[:3, :3]
    edge = 40 * 4.0 / camera.fx
    assert -local[:, 2].min() == pytest.approx(4.0 + 0.5 * edge / np.sqrt(2))
    normal = closing.corner_normals[:, 0] @ camera.to_world[:3, :3].astype(np.float32)
    rim = np.abs(normal[:, 2]) < 0.5  # the walls, and the plane behind: all face outwards
    middle = local[closing.faces].mean(1) - local.mean(0)
    assert rim.sum() == 2 * 160 and ((normal * middle).sum(1) > 0).all()


def test_nothing_to_close(camera):
    assert closing_mesh(np.zeros((72, 96)), camera) is None


def test_a_hole_is_no_opening(camera):
    """Where a depth is missing inside the outline, no light comes through from behind."""
    depth = punched(camera)
    rows, columns = np.mgrid[31:35, 45:51].reshape(2, -1)
    assert not depth[rows, columns].any()
    way = camera.rays(columns + 0.7, rows + 0.6)
    assert np.isfinite(met(closing_mesh(depth, camera), *way)).all()
    assert np.isinf(met(mesh_from_depth(depth, camera), *way)).all()


@pytest.mark.parametrize(("footprints", "degrees"), [(0.15, 3), (0.6, 10), (1.8, 10)])
def test_a_noisy_depth_is_smoothed_and_a_clean_one_is_not(camera, rng, footprints, degrees):
    """Rough triangles would shade each other: their own normals, not only those for shading, have to be right."""
    centre, radius = np.array([0.0, 0.0, -4.0]), 1.3
    depth = sphere_depth(camera, centre, radius)
    clean = mesh_from_depth(depth, camera)
    local = (clean.vertices - camera.to_world[:3, 3]) @ camera.to_world[:3, :3]
    np.testing.assert_allclose(np.linalg.norm(local - centre, axis=1), radius, atol=1e-6)  # where the depth says

    mesh = mesh_from_depth(depth * (1 + footprints / camera.fx * rng.standard_normal(depth.shape)), camera)
    local = (mesh.vertices - camera.to_world[:3, 3]) @ camera.to_world[:3, :3]
    off = np.linalg.norm(local - centre, axis=1) - radius
    facing = (local[:, 2] - centre[2]) / radius > 0.6
    assert np.sqrt(np.mean(off[facing] ** 2)) < 0.5 * footprints * 4 / camera.fx
    middle = local[mesh.faces].mean(1) - centre
    middle /= np.linalg.norm(middle, axis=1, keepdims=True)
    cosine = ((geometric_normals(mesh) @ camera.to_world[:3, :3]) * middle).sum(1)[middle[:, 2] > 0.6]
    assert np.degrees(np.arccos(np.median(cosine))) < degrees


def test_smoothing_leaves_a_slope_where_it_is(camera, rng):
    """Edges of the picture and of the surface, too: means are over opposite pairs only."""
    normal = unit((1.0, 0.3, 1))
    depth = plane_depth(camera, normal, 3.0)
    depth[(depth < 0) | (depth > 12)] = 0
    noise = 1 + 1.0 / camera.fx * rng.standard_normal((40, *depth.shape))
    found = [mesh_from_depth(depth * n, camera) for n in noise]
    local = [(m.vertices - camera.to_world[:3, 3]) @ camera.to_world[:3, :3] @ normal + 3.0 for m in found]
    assert abs(np.mean(np.concatenate(local))) < 0.002
