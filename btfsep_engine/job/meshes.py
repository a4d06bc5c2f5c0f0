# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes from files: triangles in world space with normals and uv at their corners."""

import re
from pathlib import Path

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from btfsep_engine.errors import InputError
from btfsep_engine.job.model import TriangleMesh
from btfsep_engine.job.polygons import Polygons, read_obj, read_ply, triangulate
from btfsep_engine.job.winding import corner_angles, disagree, mended_normals, neighbours, places_of, turned_over
from btfsep_engine.storage import atomic, kept

SMOOTH_DEGREES = 30.0  # Blender's default of Shade Smooth by Angle
_AGAIN = "export it again as PLY or OBJ"


def load_mesh(path, *, to_world=None, name: str | None = None) -> tuple[TriangleMesh, int]:
    """Reads a PLY or OBJ. What it points to (materials, textures) is never followed.

    Parameters
    ----------
    path : file
    to_world : (4, 4) float, affine, invertible, or None; a mirroring one turns the faces' winding around
    name : what to call the mesh in an error; its file name if None

    Returns
    -------
    mesh : TriangleMesh, corner normals those of the file, else smoothed where faces meet under 30 degrees
    dropped : number of triangles without area that were left out

    Raises InputError: unreadable, damaged, no faces, vertices that are not finite, faces that name vertices that are
    not there.
    """
    name = name or Path(path).name
    data = atomic.read_bytes(path, name)
    return kept.recalled("mesh", [data, to_world], lambda: assemble(name, parse(name, data), to_world=to_world))


def parse(name: str, data: bytes) -> Polygons:
    """Polygons of the bytes of a PLY or OBJ, told apart by what is in them. Raises InputError of others."""
    if data[:3] == b"ply" and data[3:4] in (b"\n", b"\r"):
        return read_ply(name, data)
    if b"\0" in data[: 2**20] or not re.search(rb"(?:^|[\r\n])[ \t]*v[ \t]", data):
        raise InputError(name, "this is neither a PLY nor an OBJ", "export the mesh as PLY or OBJ")
    return read_obj(name, data)


def assemble(name: str, polygons: Polygons, *, to_world=None) -> tuple[TriangleMesh, int]:
    """Checks, moves to the world and triangulates. Parameters, returns and errors as :func:`load_mesh`."""
    vertices, corners = polygons.vertices, polygons.corners
    if not np.isfinite(vertices).all():
        bad = np.flatnonzero(~np.isfinite(vertices).all(-1))
        raise InputError(name, f"{len(bad)} vertices are NaN or infinite, first number {bad[0]}", "repair the mesh")
    if not len(corners) or not (polygons.sizes >= 3).any():
        raise InputError(name, "the mesh has no faces", "export a surface, not points or edges")
    outside = (corners < 0) | (corners >= len(vertices))
    if outside.any():
        first = int(np.searchsorted(np.cumsum(polygons.sizes), np.flatnonzero(outside)[0], side="right"))
        got = f"face {first} names vertex {int(corners[outside][0])}, and there are {len(vertices)}"
        raise InputError(name, got, _AGAIN)
    triangles = triangulate(polygons)
    linear = np.eye(3)
    with np.errstate(over="ignore", invalid="ignore"):
        if to_world is not None:
            to_world = np.asarray(to_world, np.float64)
            linear = to_world[:3, :3]
            vertices = vertices @ linear.T + to_world[:3, 3]
        largest = np.abs(vertices).max()
    if not largest < 1e15:
        raise InputError(name, f"it reaches as far as {largest:g} world units", "check its scale and to_world")
    if np.linalg.det(linear) < 0:
        triangles = triangles[:, ::-1]
    faces = corners[triangles]
    p = vertices[faces]
    cross = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    edges = [p[:, a] - p[:, b] for a, b in ((0, 1), (1, 2), (2, 0))]
    longest = np.maximum.reduce([_dot(e, e) for e in edges])
    area = np.sqrt(_dot(cross, cross))
    kept = area > 1e-12 * longest
    dropped = int((~kept).sum())
    if dropped == len(kept):
        raise InputError(name, "no face of the mesh has an area", "check its scale and to_world")
    faces, triangles = faces[kept], triangles[kept]
    normals = cross[kept] / area[kept, None]
    corner_normals, missing = None, None
    if polygons.normals is not None:
        corner_normals = _corner_values(polygons.normals, polygons.normal_corners, triangles)
        size = np.abs(corner_normals).max(-1, keepdims=True)  # they may be of any length but none
        there = (size > 0) & np.isfinite(size)
        corner_normals = np.where(there, corner_normals, 0) / np.where(there, size, 1)
        corner_normals = corner_normals @ np.linalg.inv(linear)  # by the inverse transpose, as rows
        length = np.linalg.norm(corner_normals, axis=-1, keepdims=True)
        missing = ~(length[..., 0] > 0)
        corner_normals /= np.where(missing[..., None], 1, length)
    if corner_normals is None or missing.any() or disagree(corner_normals, normals):
        place = places_of(vertices)
        turned = turned_over(place[faces], len(vertices), normals)
        if turned.any():
            faces, triangles = (np.where(turned[:, None], each[:, ::-1], each) for each in (faces, triangles))
            normals = np.where(turned[:, None], -normals, normals)
        if corner_normals is None:
            corner_normals = smooth_normals(vertices, faces, normals, place=place)
        else:
            corner_normals, missing = (
                np.where(turned.reshape(-1, *[1] * (each.ndim - 1)), each[:, ::-1], each)
                for each in (corner_normals, missing)
            )
            if missing.any():
                corner_normals[missing] = smooth_normals(vertices, faces, normals, place=place)[missing]
            if turned.any():
                corner_normals = mended_normals(corner_normals, normals, vertices[faces], place[faces], turned)
    corner_uv = None
    if polygons.uv is not None:
        corner_uv = _corner_values(polygons.uv, polygons.uv_corners, triangles).astype(np.float32)
        if not np.isfinite(corner_uv).all():
            corner_uv = None  # as good as none: the charts are then computed
    return TriangleMesh(vertices, faces.astype(np.int32), corner_normals.astype(np.float32), corner_uv), dropped


def _dot(a, b) -> np.ndarray:
    """(...,) dot products over the last axis; einsum is several times quicker than a sum over three."""
    return np.einsum("...i,...i->...", a, b)


def _corner_values(values: np.ndarray, index: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """(t, 3, n): the value of each corner of each triangle, NaN where the file has none."""
    index = np.asarray(index)[triangles]
    there = (index >= 0) & (index < len(values))
    out = values[np.where(there, index, 0)]
    out[~there] = np.nan
    return out


def smooth_normals(vertices, faces, normals, *, place=None) -> np.ndarray:
    """Corner normals, averaged by corner angle over the faces that edges under SMOOTH_DEGREES connect.

    Parameters
    ----------
    vertices : (v, 3) float64; vertices at the same place count as one
    faces : (f, 3) int
    normals : (f, 3) float64, unit, of the faces
    place : (v,) int, of `winding.places_of`; None: made

    Returns
    -------
    (f, 3, 3) float64, unit
    """
    corner_place = (places_of(vertices) if place is None else place)[faces]
    count = len(faces)
    one, two = neighbours(corner_place, len(vertices))
    smooth = _dot(normals[one // 3], normals[two // 3]) > np.cos(np.radians(SMOOTH_DEGREES))
    one, two = one[smooth], two[smooth]
    s1, s2 = one, two  # corners where the two half-edges start, and where they end
    e1, e2 = (s // 3 * 3 + (s % 3 + 1) % 3 for s in (one, two))
    flat = corner_place.ravel()
    across = flat[s1] == flat[e2]  # the usual case: neighbours run along their edge in opposite directions
    left = np.concatenate([s1, e1])
    right = np.concatenate([np.where(across, e2, s2), np.where(across, s2, e2)])
    graph = coo_matrix((np.ones(len(left), bool), (left, right)), shape=(3 * count, 3 * count))
    _, group = connected_components(graph, directed=False)
    weighted = np.repeat(normals, 3, 0) * corner_angles(vertices[faces]).reshape(-1, 1)
    total = np.stack([np.bincount(group, weighted[:, i]) for i in range(3)], -1)
    out = total[group]
    length = np.sqrt(_dot(out, out))[:, None]
    return np.where(length > 1e-9, out / np.maximum(length, 1e-9), np.repeat(normals, 3, 0)).reshape(count, 3, 3)
