# SPDX-License-Identifier: GPL-3.0-or-later
"""Where texels of an image lie on meshes whose maps are known: a rectangle, a box, a ring; and maps that are none."""

import numpy as np
import pytest
import trimesh

from btfsep_engine.job.model import TriangleMesh
from btfsep_engine.render.texels import texels_on
from tests.render.scanned import outward, ring, surface, texel_uv

CORNERS = np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]])
HALVES = np.array([[0, 1, 2], [0, 2, 3]], np.int32)


def sheet(uv=CORNERS, faces=HALVES) -> TriangleMesh:
    """A rectangle of 2 x 3 in the plane z = 5, whose lower left corner is the origin's."""
    vertices = np.c_[CORNERS * [2, 3], np.full(4, 5.0)]
    normals = np.broadcast_to(np.float32([0, 0, 1]), (*faces.shape, 3))
    return TriangleMesh(vertices, faces, normals, np.asarray(uv, np.float32)[faces])


def test_texels_of_a_rectangle_lie_where_they_should_row_0_at_the_top():
    found = texels_on(sheet(), 8)
    row, column = np.divmod(np.arange(64), 8)
    assert found.side == 8
    np.testing.assert_array_equal(found.number, np.arange(64))
    expected = np.stack([2 * (column + 0.5) / 8, 3 * (1 - (row + 0.5) / 8), np.full(64, 5.0)], 1)
    np.testing.assert_allclose(found.position, expected, atol=1e-5)
    for normal in (found.normal, found.flat_normal):
        np.testing.assert_allclose(normal, np.tile([0, 0, 1.0], (64, 1)), atol=1e-6)


@pytest.mark.parametrize("turned", [HALVES, HALVES[:, ::-1]], ids=["as it is", "wound the other way"])
def test_a_mirrored_map_that_covers_a_part_of_the_image(turned):
    found = texels_on(sheet(np.array([0.75, 0.25]) + CORNERS * [-0.5, 0.5], turned), 16)  # u from 0.75 down to 0.25
    row, column = np.divmod(found.number, 16)
    assert sorted(set(row)) == sorted(set(column)) == list(range(4, 12))
    assert 60 < len(row) <= 64  # a ray may slip between two triangles
    u, v = (column + 0.5) / 16, 1 - (row + 0.5) / 16
    expected = np.stack([2 * (0.75 - u) / 0.5, 3 * (v - 0.25) / 0.5, np.full(len(row), 5.0)], 1)
    np.testing.assert_allclose(found.position, expected, atol=1e-5)
    np.testing.assert_allclose(found.normal, np.tile([0, 0, 1.0], (len(row), 1)), atol=1e-6)
    np.testing.assert_allclose(found.flat_normal[:, 2], 1 if turned is HALVES else -1, atol=1e-6)


def test_each_side_of_a_box_has_its_own_part_of_the_image():
    box, corners, places = trimesh.creation.box([2, 2, 2]), [], []
    for face, normal in zip(box.faces, box.face_normals.round(), strict=True):
        axis = int(np.abs(normal).argmax())
        number = 2 * axis + (normal.sum() > 0)
        flat = np.delete(box.vertices[face], axis, 1) * 0.45 + 0.5  # leaves a rim of its cell
        corners.append((flat + np.array([number % 3, number // 3])) / 3)
        places.append(number)
    mesh = TriangleMesh(
        box.vertices,
        box.faces.astype(np.int32),
        np.repeat(box.face_normals[:, None], 3, 1).astype(np.float32),
        np.array(corners, np.float32),
    )
    found = texels_on(mesh, 60)
    row, column = np.divmod(found.number, 60)
    cell = column // 20 + 3 * ((59 - row) // 20)
    assert set(places) == set(cell) == set(range(6))
    assert 0.99 * 6 * 18 * 18 < len(cell) <= 6 * 18 * 18
    axis = cell // 2
    signed = np.take_along_axis(found.position, axis[:, None], 1)[:, 0]
    np.testing.assert_allclose(signed, 2 * (cell % 2) - 1, atol=1e-5)
    np.testing.assert_allclose(np.take_along_axis(found.normal, axis[:, None], 1)[:, 0], signed, atol=1e-5)
    np.testing.assert_allclose(found.flat_normal, found.normal, atol=1e-6)


@pytest.mark.parametrize("uv", [
    1.01 * CORNERS, 1.01 * CORNERS - 0.01, 3 * CORNERS, np.where(CORNERS > 0, np.nan, 0),
    np.c_[CORNERS[:, 0], np.full(4, 0.5)], np.full((4, 2), 0.5), np.where(CORNERS > 0, np.inf, 0),
], ids=["above", "below", "repeated", "NaN", "a line", "a point", "infinite"])  # fmt: skip
def test_maps_that_are_none_have_no_texels(uv):
    assert texels_on(sheet(uv), 16) is None


def test_a_map_of_which_a_corner_is_no_number_is_none():
    mesh = sheet()
    mesh.corner_uv[1, 2, 0] = np.nan
    assert texels_on(mesh, 16) is None


def test_rounding_at_the_rim_is_not_outside():
    assert len(texels_on(sheet(CORNERS * (1 + 4e-4) - 2e-4), 16).number) == 256


def test_places_that_share_texels_are_none():
    mesh = sheet()
    twice = np.concatenate([HALVES, HALVES + 4])
    vertices = np.concatenate([mesh.vertices, mesh.vertices * [1, 1, 2]])
    normals = np.concatenate([mesh.corner_normals] * 2)
    uv = np.concatenate([mesh.corner_uv] * 2)
    assert texels_on(TriangleMesh(vertices, twice, normals, uv), 16) is None
    apart = np.concatenate([mesh.corner_uv * [0.5, 1], mesh.corner_uv * [0.5, 1] + [0.5, 0]])
    assert len(texels_on(TriangleMesh(vertices, twice, normals, apart), 16).number) == 256


def test_texels_of_a_ring_lie_on_it():
    found, (u, v) = texels_on(ring(), 64), texel_uv(64)
    np.testing.assert_array_equal(found.number, np.arange(64 * 64))
    np.testing.assert_allclose(found.position, surface(u, v).reshape(-1, 3), atol=4e-3)
    np.testing.assert_allclose(found.normal, outward(u, v).reshape(-1, 3), atol=0.05)
    assert ((found.normal * found.flat_normal).sum(1) > 0.98).all()
