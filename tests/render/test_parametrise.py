# SPDX-License-Identifier: GPL-3.0-or-later
"""Charts: each to scale, none mirrored, frames that agree across their borders; views traced in bands."""

import dataclasses

import numpy as np
import pytest
import trimesh

from btfsep_engine.render import parametrise, surface
from btfsep_engine.render.tracer import Tracer
from tests.render.scenes import as_mesh, job_of, looking_down

pytestmark = pytest.mark.usefixtures("own_cache")


def signed_areas(uv):
    a, b = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    return (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / 2


def frames(mesh, uv):
    return parametrise.tangent_frames(mesh.vertices[mesh.faces], uv, mesh.corner_normals[:, 0])[0]


def two_charts():
    """A box's faces as charts of wrong sizes, some mirrored, each turned by a random angle."""
    shape = trimesh.creation.box([1.0, 2.0, 3.0])
    mesh = as_mesh(shape, flat=True)
    chart = np.unique(np.round(shape.face_normals), axis=0, return_inverse=True)[1].ravel()
    random = np.random.default_rng(3)
    uv = parametrise._projected_charts(mesh)
    size, angle = random.uniform(0.2, 4, 6)[chart], random.uniform(0, 6, 6)[chart]
    uv = np.where((chart % 2 == 0)[:, None, None], uv[..., ::-1], uv)
    turned = (uv[..., 0] + 1j * uv[..., 1]) * (size * np.exp(1j * angle))[:, None]
    return shape, mesh, np.stack([turned.real, turned.imag], -1), chart


def test_every_chart_gets_the_size_of_its_own_surface_and_is_not_mirrored():
    shape, mesh, uv, chart = two_charts()
    assert (signed_areas(uv) < 0).any()
    out = parametrise._physical_charts(mesh, uv, chart)
    assert signed_areas(out) == pytest.approx(shape.area_faces)


def test_u_runs_around_z_on_walls_and_along_x_on_floors():
    shape, mesh, uv, chart = two_charts()
    tangent = frames(mesh, parametrise._physical_charts(mesh, uv, chart))
    normal = shape.face_normals
    expected = np.where(np.abs(normal[:, 2:]) > 0.5, [1.0, 0, 0], np.cross([0, 0, 1.0], normal))
    assert tangent == pytest.approx(expected, abs=1e-6)


def test_projected_charts_have_the_same_frames():
    shape, mesh, _, _ = two_charts()
    uv = parametrise._projected_charts(mesh)
    normal = shape.face_normals
    assert signed_areas(uv) == pytest.approx(shape.area_faces)  # of faces along the axes: exact, none mirrored
    walls = np.abs(normal[:, 2]) < 0.5
    assert frames(mesh, uv)[walls] == pytest.approx(np.cross([0, 0, 1.0], normal[walls]), abs=1e-6)


@pytest.mark.parametrize("shape", [trimesh.creation.icosphere(4), trimesh.creation.torus(1.0, 0.4, 96, 48)])
def test_meshes_too_fine_for_xatlas_keep_their_physical_size(shape, monkeypatch):
    monkeypatch.setattr(parametrise, "XATLAS_FACES", 100)
    mesh = as_mesh(shape)
    uv = parametrise.physical_uv(mesh, "xatlas", millimetres_per_unit=1000.0).astype(np.float64)
    corners = 1000.0 * mesh.vertices[mesh.faces]
    ratio = np.linalg.norm(uv - np.roll(uv, 1, 1), axis=2) / np.linalg.norm(corners - np.roll(corners, 1, 1), axis=2)
    assert np.median(ratio) == pytest.approx(1, abs=0.02)
    assert np.percentile(ratio, 5) > 0.9 and np.percentile(ratio, 95) < 1.06
    assert signed_areas(uv).min() > 0
    assert signed_areas(uv).sum() == pytest.approx(1e6 * shape.area, rel=1e-3)


def test_projected_charts_do_not_break_where_a_file_splits_its_vertices():
    mesh = as_mesh(trimesh.creation.icosphere(3))
    split = dataclasses.replace(
        mesh, vertices=mesh.vertices[mesh.faces].reshape(-1, 3), faces=np.arange(mesh.faces.size).reshape(-1, 3)
    )
    assert parametrise._projected_charts(split) == pytest.approx(parametrise._projected_charts(mesh), abs=1e-9)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_visibility_in_few_directions(sphere, count):
    directions = np.array([[0, 0, 1.0], [0, 0, -1.0], [0, 0.6, 0.8]])[:count]
    up = np.array([[0, 0, 1.0]])
    top = sphere.vertices[[sphere.vertices[:, 2].argmax()]]
    seen = Tracer([sphere]).visible(np.repeat(top, 2, 0), np.repeat(up, 2, 0), directions)
    assert seen.tolist() == [[True, False, True][:count]] * 2


@pytest.mark.parametrize("shape", [trimesh.creation.icosphere(4), trimesh.creation.torus(1.0, 0.4)])
def test_turning_the_charts_makes_the_jump_at_their_borders_smaller(shape, monkeypatch, tmp_path):
    mesh = as_mesh(shape)
    pairs = shape.face_adjacency

    def jump():
        """Mean angle in degrees between the tangents of neighbouring faces, and the share beyond 60 degrees."""
        tangent = frames(mesh, parametrise._xatlas_uv(mesh))
        angle = np.degrees(np.arccos(np.clip((tangent[pairs[:, 0]] * tangent[pairs[:, 1]]).sum(1), -1, 1)))
        return angle.mean(), (angle > 60).mean()

    turned = jump()
    monkeypatch.setenv("BTFSEP_CACHE", str(tmp_path / "other"))
    monkeypatch.setattr(parametrise, "_physical_charts", lambda mesh, uv, chart: uv)
    plain = jump()
    assert turned[0] < 0.9 * plain[0] and turned[1] < plain[1]


@pytest.mark.parametrize("rays", [1, 500, 96 * 96 - 1])
def test_a_view_in_bands_is_the_view_at_once(sphere, monkeypatch, rays):
    job, tracer = job_of([sphere], looking_down()), Tracer([sphere])
    whole = surface.camera_view(tracer, job)
    monkeypatch.setattr(surface, "RAYS_AT_ONCE", rays)
    bands = surface.camera_view(tracer, job)
    assert (whole.mesh >= 0).any()
    same = (whole.mesh == bands.mesh) & (whole.face == bands.face)
    assert same.mean() > 0.999  # on an edge between two faces rounding decides
    hit = same & (whole.mesh >= 0)
    assert np.allclose(whole.distance[hit], bands.distance[hit], rtol=1e-5)
    assert np.allclose(whole.barycentric[hit], bands.barycentric[hit], atol=1e-3)
    assert np.isinf(bands.distance[same & ~hit]).all()
