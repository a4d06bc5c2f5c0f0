# SPDX-License-Identifier: GPL-3.0-or-later
"""Faces that are turned over beside their neighbours, as in many a mesh that was put together by hand.

Which side of a single surface is its outer one, the camera says: whoever looks takes the side that he sees. But where
neighbours turn opposite ways, smooth normals between them are no mean of theirs: n1 - n2, of any direction. Neighbours
that run along their common edge in the same direction disagree; a face's side follows from those around it, all over
what hangs together, unless it has one side only (Moebius): then nothing is turned.
"""

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

OWN = np.cos(np.radians(1.0))  # cosine between normals that are the same: a flat face's and its corners', two faces'
ALIKE = 1e-3  # normals of corners that belong together


def places_of(vertices) -> np.ndarray:
    """(v,) int of vertices (v, 3) float64: those at the same place have the same number."""
    return np.unique(np.ascontiguousarray(vertices + 0.0).view("V24").ravel(), return_inverse=True)[1]


def neighbours(corners, count: int) -> tuple[np.ndarray, np.ndarray]:
    """The two half-edges of every edge of exactly two faces: (n,) int each, number 3 f + k.

    The half-edge k of a face f goes from its corner k to its corner k + 1.

    Parameters
    ----------
    corners : (f, 3) int, the place of each corner; count : of places
    """
    a, b = corners, np.roll(corners, -1, 1)
    key = (np.minimum(a, b) * np.int64(count) + np.maximum(a, b)).ravel()
    order = np.argsort(key, kind="stable")
    same = key[order][1:] == key[order][:-1]
    alone = np.concatenate([[True], ~same, [True]])
    pair = np.flatnonzero(same & alone[:-2] & alone[2:])
    return order[pair], order[pair + 1]


def disagree(corner_normals, normals) -> bool:
    """Whether corner normals (f, 3, 3) lie on their faces' (f, 3) own side here and on the other there.

    Where smooth normals are those of faces that are turned opposite ways, some do.
    """
    own = np.einsum("fki,fi->fk", corner_normals, normals)
    return bool((own > 0).any() and (own < 0).any())


def turned_over(corners, count: int, normals) -> np.ndarray:
    """Which faces are to be turned so that all neighbours agree: (f,) bool, the fewer of what hangs together.

    Faces that lie upon each other, as those of a copy at the same place do, are no neighbours that disagree, though
    they run along an outer edge of theirs in the same direction.

    Parameters
    ----------
    corners : (f, 3) int, the place of each corner; count : of places
    normals : (f, 3), unit, of the faces
    """
    one, two = neighbours(corners, count)
    flat, faces = corners.ravel(), len(corners)
    upon = np.einsum("ni,ni->n", normals[one // 3], normals[two // 3]) > OWN
    against = (flat[one] == flat[two]) & ~upon
    out = np.zeros(faces, bool)
    if not against.any():
        return out
    one, two = one // 3, two // 3
    # every face twice, as it is (f) and turned (f + faces): edges join those of the two that agree
    left = np.concatenate([one, one + faces])
    right = np.concatenate([np.where(against, two + faces, two), np.where(against, two, two + faces)])
    joined = coo_matrix((np.ones(len(left), bool), (left, right)), shape=(2 * faces, 2 * faces))
    side = connected_components(joined, directed=False)[1]
    as_it_is, turned = side[:faces], side[faces:]
    sided = as_it_is != turned
    sizes = np.bincount(as_it_is, minlength=side.max() + 1)
    # of the two ways in which a part may be turned, the one of which more faces are as they were
    out[sided] = sizes[as_it_is[sided]] < sizes[turned[sided]]
    even = sided & (sizes[as_it_is] == sizes[turned])
    out[even] = as_it_is[even] > turned[even]
    return out


def mended_normals(corner_normals, normals, vertices, corners, turned) -> np.ndarray:
    """Corner normals (f, 3, 3) where faces were turned over beside others that were not: those of the faces around.

    Elsewhere those of turned faces are turned. Faces that are shaded flat keep theirs; corners at one place that had
    the same normal share the new one.

    Parameters
    ----------
    corner_normals : (f, 3, 3), unit, as they were, in the order of the corners as they are now
    normals : (f, 3), unit, of the faces as they are now
    vertices : (f, 3, 3), of their corners
    corners : (f, 3) int, their places; turned : (f,) bool
    """
    place, count = corners.ravel(), int(corners.max()) + 1
    seam = np.bincount(corners[turned].ravel(), minlength=count).astype(bool)
    seam &= np.bincount(corners[~turned].ravel(), minlength=count).astype(bool)
    flat_shaded = (np.abs(np.einsum("fki,fi->fk", corner_normals, normals)) > OWN).all(1)
    wrong = np.flatnonzero(seam[place] & ~np.repeat(flat_shaded, 3))
    key = np.round(corner_normals.reshape(-1, 3)[wrong] / ALIKE).astype(np.int64)  # those that were one normal
    key = np.concatenate([place[wrong, None], key], 1)
    group = np.unique(key, axis=0, return_inverse=True)[1].reshape(-1)
    weighted = np.repeat(normals, 3, 0)[wrong] * corner_angles(vertices).ravel()[wrong, None]
    total = np.stack([np.bincount(group, weighted[:, i]) for i in range(3)], -1)[group]
    length = np.linalg.norm(total, axis=1, keepdims=True)
    flat = np.where(turned[:, None, None], -corner_normals, corner_normals).reshape(-1, 3)
    flat[wrong] = np.where(length > 1e-9, total / np.maximum(length, 1e-9), np.repeat(normals, 3, 0)[wrong])
    return flat.reshape(corner_normals.shape)


def corner_angles(vertices) -> np.ndarray:
    """(f, 3) radians, of triangles (f, 3, 3)."""
    forward = np.roll(vertices, -1, 1) - vertices
    forward /= np.sqrt(np.einsum("fki,fki->fk", forward, forward))[..., None]
    backward = -np.roll(forward, 1, 1)
    return np.arccos(np.clip(np.einsum("fki,fki->fk", forward, backward), -1, 1))
