# SPDX-License-Identifier: GPL-3.0-or-later
"""Measures of texture coordinates, against mappings whose distortion has a closed form."""

import numpy as np
import pytest

from scripts.studies.parametrisation.quality import quality, singular_values


def grid(rows, columns):
    """(2 rows columns, 3) faces over (rows + 1) x (columns + 1) points, row by row."""
    n = np.arange((rows + 1) * (columns + 1)).reshape(rows + 1, columns + 1)
    a, b, c, d = n[:-1, :-1].ravel(), n[:-1, 1:].ravel(), n[1:, :-1].ravel(), n[1:, 1:].ravel()
    return np.concatenate([np.stack([a, b, d], -1), np.stack([a, d, c], -1)])


def points(rows, columns, height, width):
    """((rows + 1) (columns + 1), 2): across, up."""
    up, across = np.meshgrid(np.linspace(*height, rows + 1), np.linspace(*width, columns + 1), indexing="ij")
    return np.stack([across.ravel(), up.ravel()], -1)


def cylinder(columns=256, radius=3.0, height=5.0):
    faces = grid(8, columns)
    p = points(8, columns, (0, height), (0, 2 * np.pi))
    vertices = np.stack([radius * np.cos(p[:, 0]), radius * np.sin(p[:, 0]), p[:, 1]], -1)
    vertices[columns :: columns + 1] = vertices[0 :: columns + 1]  # the seam, to the last bit
    return vertices, faces, (p * [radius, 1.0])[faces]


def test_unrolled_cylinder_keeps_angles_and_areas_and_has_one_seam():
    vertices, faces, uv = cylinder()
    q = quality(vertices, faces, uv)
    assert q.angle == pytest.approx(0, abs=0.01)
    assert q.area == pytest.approx(1, abs=1e-4)
    assert q.charts == 1
    assert q.border == pytest.approx(5 / np.sqrt(2 * np.pi * 3 * 5), rel=1e-3)
    assert q.jump == pytest.approx(0, abs=3)  # of one face's turn: 360 / 256 degrees
    assert q.folded == 0


def test_sheared_plane_has_the_angle_of_its_shear():
    faces = grid(6, 7)
    p = points(6, 7, (0, 2), (0, 3))
    for shear in (0.0, 0.5, 1.0, 2.0):
        q = quality(np.pad(p, ((0, 0), (0, 1))), faces, (p @ np.array([[1, 0], [shear, 1]]))[faces])
        # singular values of a simple shear k: s1 s2 = 1, s1 - s2 = k, s1 + s2 = sqrt(k^2 + 4)
        assert q.angle == pytest.approx(2 * np.degrees(np.arcsin(shear / np.hypot(shear, 2))), abs=1e-4)
        assert q.area == pytest.approx(1, abs=1e-9)
        assert (q.charts, q.border, q.folded) == (1, 0, 0)


def test_stretch_counts_either_way():
    faces = grid(3, 3)
    p = points(3, 3, (0, 1), (0, 1))
    vertices = np.pad(p, ((0, 0), (0, 1)))
    for scale in ((3.0, 0.5), (1 / 3, 2.0)):
        q = quality(vertices, faces, (p * scale)[faces])
        s = np.sort(scale)[::-1]
        assert singular_values(vertices[faces], (p * scale)[faces]) == pytest.approx(np.tile(s, (len(faces), 1)))
        assert q.area == pytest.approx(1.5)
        assert q.angle == pytest.approx(2 * np.degrees(np.arcsin(5 / 7)))


def test_sphere_by_longitude_and_latitude():
    # at latitude t lengths along the parallel grow by 1 / cos t; area within |latitude| < t is sin t of the sphere's
    top = 1.2
    faces = grid(120, 240)
    p = points(120, 240, (-top, top), (0, 2 * np.pi))
    c = np.cos(p[:, 1])
    vertices = np.stack([c * np.cos(p[:, 0]), c * np.sin(p[:, 0]), np.sin(p[:, 1])], -1)
    vertices[240::241] = vertices[0::241]
    q = quality(vertices, faces, p[faces])
    stretch = 1 / np.sqrt(1 - (np.array([0.5, 0.95]) * np.sin(top)) ** 2)
    assert q.area == pytest.approx(stretch, rel=0.03)
    assert q.angle == pytest.approx(2 * np.degrees(np.arcsin((stretch - 1) / (stretch + 1))), rel=0.06)
    assert q.border == pytest.approx(2 * top / np.sqrt(4 * np.pi * np.sin(top)), rel=2e-3)


def test_cut_plane_has_two_charts_their_border_and_the_turn_of_their_grain():
    faces = grid(4, 4)
    p = points(4, 4, (0, 2), (0, 2))
    right = p[faces][..., 0].mean(1) > 1

    def turn(degrees):
        c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
        return np.array([[c, s], [-s, c]])

    uv = p[faces] @ turn(20)  # no side of the border has its grain along or across it
    uv[right] = uv[right] @ turn(50) + 10
    q = quality(np.pad(p, ((0, 0), (0, 1))), faces, uv)
    assert q.charts == 2
    assert q.border == pytest.approx(2 / 2)
    assert q.jump == pytest.approx(50, abs=1e-3)
    assert q.folded == 0


def test_a_face_the_other_way_round_is_folded():
    faces = grid(4, 4)
    p = points(4, 4, (0, 1), (0, 1))
    uv = p.copy()
    uv[12] = uv[12] + [0.9, 0.0]  # the middle, beyond the rim
    assert quality(np.pad(p, ((0, 0), (0, 1))), faces, p[faces]).folded == 0
    assert quality(np.pad(p, ((0, 0), (0, 1))), faces, uv[faces]).folded > 0.05
