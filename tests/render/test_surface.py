# SPDX-License-Identifier: GPL-3.0-or-later
"""Rays, the camera's view, charts and frames, against closed forms of simple shapes."""

import numpy as np
import pytest
import trimesh

from btfsep_engine.errors import InputError
from btfsep_engine.job.model import JobObject, TriangleMesh
from btfsep_engine.render import parametrise
from btfsep_engine.render.sampling import spread
from btfsep_engine.render.surface import camera_view, object_region, surface_points, with_texture
from btfsep_engine.render.tracer import Tracer
from btfsep_engine.storage.kept import STORE
from tests.render.scenes import as_mesh, job_of, looking_down


def moved(mesh, by) -> TriangleMesh:
    return TriangleMesh(mesh.vertices + np.asarray(by, np.float64), mesh.faces, mesh.corner_normals, mesh.corner_uv)


def test_hits_of_two_spheres_are_where_they_must_be(sphere):
    small = moved(as_mesh(trimesh.creation.icosphere(5, 0.5)), [3, 0, 0])
    tracer = Tracer([sphere, small])
    hits = tracer.nearest(
        [[0, 0, 5], [3, 0, 5], [9, 9, 9], [-5, 0, 0]], [[0, 0, -1], [0, 0, -1], [0, 0, -1], [1, 0, 0]]
    )
    assert hits.mesh.tolist() == [0, 1, -1, 0]
    assert hits.distance == pytest.approx([4, 4.5, np.inf, 4], abs=2e-3)
    assert hits.barycentric[:2].sum(1) == pytest.approx(1, abs=1e-5)


@pytest.mark.parametrize("scale", [1e-4, 1.0, 1e5])
def test_scenes_of_any_size_and_place_are_traced_alike(sphere, scale):
    mesh = TriangleMesh(sphere.vertices * scale + [70 * scale, 0, 0], sphere.faces, sphere.corner_normals)
    tracer = Tracer([mesh])
    points, normals = mesh.vertices[:500], sphere.vertices[:500]
    directions = np.array([[0, 0, 1.0], [0, 0, -1.0], [1, 0, 0]])
    seen = tracer.visible(points, normals, directions)
    expected = normals @ directions.T > 0
    clear = np.abs(normals @ directions.T) > 0.1  # flat triangles differ from the sphere at its horizon
    assert (seen == expected)[clear].all()


def test_the_camera_sees_the_sphere_where_geometry_says(sphere):
    camera = looking_down()
    job = job_of([sphere], camera)
    points = surface_points(camera_view(Tracer([sphere]), job), job, 0)
    assert np.linalg.norm(points.position, axis=1) == pytest.approx(1, abs=2e-3)
    row, column = points.pixels.T
    depth = 4 - points.position[:, 2]
    assert points.position[:, 0] == pytest.approx((column + 0.5 - 48) / 200 * depth, abs=1e-3)
    assert points.position[:, 1] == pytest.approx(-(row + 0.5 - 48) / 200 * depth, abs=1e-3)
    assert (points.normal * points.position).sum(1) == pytest.approx(1, abs=1e-2)
    assert (points.normal * points.to_eye).sum(1).min() > 0
    # a pixel's patch of surface: 1 / focal length at unit distance, face on
    middle = np.argmax(points.position[:, 2])
    assert points.footprint[middle] == pytest.approx(3 / 200, rel=0.01)


def test_edges_and_masks_are_left_out(sphere):
    camera = looking_down()
    job = job_of([sphere], camera)
    view = camera_view(Tracer([sphere]), job)
    region = object_region(view, job, 0)
    assert region.sum() < (view.mesh == 0).sum()
    assert not (region & (view.mesh != 0)).any()
    mask = np.zeros_like(region)
    mask[:, :48] = True
    masked = type(job)(**{**vars(job), "objects": (JobObject("o", sphere, mask),)})
    assert not object_region(view, masked, 0)[:, 47:].any()


def test_what_the_camera_cannot_see_is_told(sphere):
    camera = looking_down()
    away = type(camera)(**{**vars(camera), "to_world": camera.to_world @ np.diag([1, -1, -1, 1])})
    job = job_of([sphere], away)
    with pytest.raises(InputError, match="object 'object 0'; the camera does not see it \\(no ray"):
        object_region(camera_view(Tracer([sphere]), job), job, 0)
    hidden = moved(as_mesh(trimesh.creation.icosphere(3, 0.2)), [0, 0, -2])
    job = job_of([hidden, sphere], camera)
    with pytest.raises(InputError, match="other geometry is in front"):
        object_region(camera_view(Tracer([hidden, sphere]), job), job, 0)
    job = job_of([sphere], camera)
    empty = type(job)(**{**vars(job), "objects": (JobObject("o", sphere, np.zeros((96, 96), bool)),)})
    with pytest.raises(InputError, match="its mask leaves none of the"):
        object_region(camera_view(Tracer([sphere]), empty), empty, 0)


@pytest.mark.parametrize("shape", [trimesh.creation.icosphere(4), trimesh.creation.torus(1.0, 0.4)])
def test_charts_have_the_size_of_the_surface(shape, tmp_path, monkeypatch):
    monkeypatch.setenv("BTFSEP_CACHE", str(tmp_path))
    mesh = as_mesh(shape)
    uv = parametrise.physical_uv(mesh, "xatlas", millimetres_per_unit=50.0)
    a, b = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    areas = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / 2
    assert areas.sum() == pytest.approx(2500 * shape.area, rel=1e-4)
    # no triangle is stretched much: the charts keep the physical scale everywhere
    stretch = areas / (2500 * shape.area_faces)
    assert 0.4 < np.percentile(stretch, 1) and np.percentile(stretch, 99) < 2.5
    assert np.array_equal(uv, parametrise.physical_uv(mesh, "xatlas", millimetres_per_unit=50.0))  # from the cache


def test_a_damaged_chart_cache_is_made_again(tmp_path, monkeypatch):
    monkeypatch.setenv("BTFSEP_CACHE", str(tmp_path))
    mesh = as_mesh(trimesh.creation.icosphere(2))
    first = parametrise.physical_uv(mesh, "xatlas", millimetres_per_unit=1.0)
    (stored,) = (tmp_path / "charts").iterdir()
    stored.write_bytes(b"damaged")
    assert np.array_equal(first, parametrise.physical_uv(mesh, "xatlas", millimetres_per_unit=1.0))


def test_the_files_own_uv_needs_to_be_there(sphere):
    with pytest.raises(InputError, match="no texture coordinates"):
        parametrise.physical_uv(sphere, "mesh", millimetres_per_unit=1.0)
    flat = TriangleMesh(sphere.vertices, sphere.faces, sphere.corner_normals, np.zeros((len(sphere.faces), 3, 2)))
    with pytest.raises(InputError, match="without area"):
        parametrise.physical_uv(flat, "mesh", millimetres_per_unit=1.0)


def test_frames_follow_the_texture():
    """A plane whose u runs along world y and v along -x; and its mirror image."""
    corners = np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0.0]]])
    normal = np.array([[0, 0, 1.0]])
    tangent, bitangent = parametrise.tangent_frames(corners, np.array([[[0, 0], [0, -1], [1, 0.0]]]), normal)
    assert np.allclose(tangent, [[0, 1, 0]]) and np.allclose(bitangent, [[-1, 0, 0]])
    tangent, bitangent = parametrise.tangent_frames(corners, np.array([[[0, 0], [0, 1], [1, 0.0]]]), normal)
    assert np.allclose(tangent, [[0, 1, 0]]) and np.allclose(bitangent, [[1, 0, 0]])
    # no area in the chart: any frame, but a frame
    tangent, bitangent = parametrise.tangent_frames(corners, np.zeros((1, 3, 2)), normal)
    assert np.allclose([(tangent**2).sum(), (bitangent**2).sum(), (tangent * bitangent).sum()], [1, 1, 0])


def test_frames_on_a_surface_are_orthonormal(sphere):
    camera = looking_down()
    job = job_of([sphere], camera)
    points = with_texture(surface_points(camera_view(Tracer([sphere]), job), job, 0), job, 0)
    frames = np.stack([points.tangent, points.bitangent, points.normal], 1)
    assert np.allclose(frames @ frames.transpose(0, 2, 1), np.eye(3), atol=1e-6)


def test_large_meshes_are_projected_and_say_so(sphere, monkeypatch):
    monkeypatch.setattr(parametrise, "XATLAS_FACES", 100)
    STORE.forget()  # constants of the code are not among what things are called by
    from btfsep_engine.progress import Reporter

    reporter = Reporter()
    uv = parametrise.physical_uv(sphere, "xatlas", millimetres_per_unit=50.0, reporter=reporter)
    assert "projecting patches" in reporter.warnings[0]
    edges = np.linalg.norm(uv[:, 1] - uv[:, 0], axis=1)
    corners = sphere.vertices[sphere.faces] * 50
    true = np.linalg.norm(corners[:, 1] - corners[:, 0], axis=1)
    # each patch is brought to its surface's area: to size in the mean, a little longer and shorter at its ends
    low, middle, high = np.percentile(edges / true, [5, 50, 95])
    assert 0.85 < low and abs(middle - 1) < 0.02 and high < 1.1


def test_chosen_pixels_cover_the_object_evenly(sphere):
    camera = looking_down()
    job = job_of([sphere], camera)
    points = surface_points(camera_view(Tracer([sphere]), job), job, 0)
    chosen = points.pixels[spread(points, 300)]
    assert len(np.unique(chosen, axis=0)) == 300
    everywhere, edges = np.histogramdd(points.pixels.astype(float), bins=4)
    here, _ = np.histogramdd(chosen.astype(float), bins=edges)
    full = everywhere > 200
    assert here[full] / everywhere[full] == pytest.approx(300 / len(points), rel=0.35)
    assert np.array_equal(spread(points, 10**9), np.arange(len(points)))
