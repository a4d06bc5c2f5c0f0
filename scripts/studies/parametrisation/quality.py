# SPDX-License-Identifier: GPL-3.0-or-later
"""How good texture coordinates are: distortion of angles and areas, charts, borders, and the jump of frames there.

The map from a triangle's plane to its texture coordinates (millimetres) has a 2 x 2 Jacobian with singular values
s1 >= s2. An isometry has both 1. All figures are weighted by the triangles' areas on the surface.
"""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from btfsep_engine.render.parametrise import tangent_frames

SAME = 1e-5  # of the texture's extent: closer coordinates are one


@dataclass(frozen=True)
class Quality:
    """Of one parametrisation of one mesh.

    Attributes
    ----------
    angle : (2,) degrees, median and 95 %: the most by which an angle between two directions changes, Tissot's
        2 omega = 2 asin((s1 - s2) / (s1 + s2)); 0 where the map is conformal
    area : (2,) median and 95 % of max(s1 s2, 1 / (s1 s2)), the areal scale either way; 1 where areas are kept
    charts : number of pieces that hang together
    border : length of the edges between charts (the surface's own rim is none), over the root of the surface's area
    jump : degrees, 0 to 90: mean angle between the u directions on both sides of a border, by length; a grain has no
        sign. 45 if nothing matched
    folded : share of the surface whose triangles lie the other way round than most of their chart or have no area
    """

    angle: np.ndarray
    area: np.ndarray
    charts: int
    border: float
    jump: float
    folded: float


def singular_values(corners, uv) -> np.ndarray:
    """(f, 2) s1 >= s2 of the map from the surface to the texture.

    ``corners`` : (f, 3, 3) float, of triangles with an area; ``uv`` : (f, 3, 2) float, the same unit
    """
    e1, e2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    length = np.linalg.norm(e1, axis=1)
    along = (e1 * e2).sum(1) / length
    across = np.linalg.norm(np.cross(e1, e2), axis=1) / length
    d = np.stack([uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]], -1).astype(np.float64)  # columns: of e1, of e2
    first = d[..., 0] / length[:, None]
    second = (d[..., 1] - first * along[:, None]) / across[:, None]
    return np.linalg.svd(np.stack([first, second], -1), compute_uv=False)


def borders(vertices, faces, uv):
    """Where texture coordinates break.

    Parameters
    ----------
    vertices : (v, 3); those at one place count as one; faces : (f, 3) int; uv : (f, 3, 2)

    Returns
    -------
    edges : (e, 2, 3) ends of the edges between charts; sides : (e, 2) int, the faces beside them
    chart : (f,) int
    """
    place = np.unique(vertices, axis=0, return_inverse=True)[1].reshape(-1)[faces]
    a, b = place.ravel(), np.roll(place, -1, 1).ravel()
    start, end = uv.reshape(-1, 2), np.roll(uv, -1, 1).reshape(-1, 2)
    swapped = (a > b)[:, None]
    ends = np.where(swapped, np.hstack([end, start]), np.hstack([start, end]))
    key = np.minimum(a, b) * np.int64(len(vertices)) + np.maximum(a, b)
    order = np.argsort(key, kind="stable")
    pair = np.flatnonzero(key[order][1:] == key[order][:-1])
    one, two = order[pair], order[pair + 1]
    together = np.abs(ends[one] - ends[two]).max(1) < SAME * np.ptp(uv.reshape(-1, 2), axis=0).max()
    links = (one[together] // 3, two[together] // 3)
    graph = coo_matrix((np.ones(len(links[0]), bool), links), shape=(len(faces),) * 2)
    chart = connected_components(graph, directed=False)[1]
    one, two = one[~together], two[~together]
    p = vertices[faces].reshape(-1, 3)
    edges = np.stack([p[one], np.roll(vertices[faces], -1, 1).reshape(-1, 3)[one]], 1)
    return edges, np.stack([one // 3, two // 3], 1), chart


def quality(vertices, faces, uv) -> Quality:
    """Measures texture coordinates ``uv : (f, 3, 2)``, in the unit of ``vertices``."""
    corners = vertices[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normal, axis=1) / 2
    normal /= 2 * area[:, None]
    s = singular_values(corners, uv)
    signed = np.linalg.det(np.stack([uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]], -1).astype(np.float64))
    edges, sides, chart = borders(vertices, faces, uv)
    most = np.sign(np.bincount(chart, signed))[chart]
    product = np.maximum(s.prod(1), 1e-12)
    omega = 2 * np.degrees(np.arcsin(np.clip((s[:, 0] - s[:, 1]) / np.maximum(s.sum(1), 1e-300), 0, 1)))
    length = np.linalg.norm(edges[:, 1] - edges[:, 0], axis=1)
    tangent, _ = tangent_frames(corners, uv, normal)
    return Quality(
        weighted(omega, area),
        weighted(np.maximum(product, 1 / product), area),
        int(chart.max()) + 1,
        float(length.sum() / np.sqrt(area.sum())),
        float((length * grain_angle(tangent, normal, edges, sides)).sum() / max(length.sum(), 1e-300)),
        float(area[signed * most <= 0].sum() / area.sum()),
    )


def grain_angle(tangent, normal, edges, sides) -> np.ndarray:
    """(e,) degrees, 0 to 90, between the tangents of the faces beside edges, the faces unfolded about the edge."""
    along = edges[:, 1] - edges[:, 0]
    along = along / np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-300)
    angle = []
    for side in sides.T:
        across = np.cross(normal[side], along)
        t = tangent[side]
        angle.append(np.arctan2((t * across).sum(1), (t * along).sum(1)))
    turned = np.abs(np.degrees(angle[0] - angle[1])) % 180
    return np.minimum(turned, 180 - turned)


def weighted(values, weight) -> np.ndarray:
    """Median and 95 % of ``values`` (n,) by ``weight`` (n,)."""
    order = np.argsort(values)
    reached = np.cumsum(weight[order])
    return values[order][np.searchsorted(reached, np.array([0.5, 0.95]) * reached[-1]).clip(0, len(values) - 1)]
