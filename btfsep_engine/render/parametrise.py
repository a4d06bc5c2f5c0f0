# SPDX-License-Identifier: GPL-3.0-or-later
"""Where a material lies on a surface: UV charts in millimetres and tangent frames."""

from contextlib import suppress

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from btfsep_engine.errors import InputError
from btfsep_engine.job.model import TriangleMesh
from btfsep_engine.storage import cache, kept

# xatlas charts 5,000 to 20,000 faces a second; patches of finer meshes are projected onto planes instead, at once
XATLAS_FACES = 40_000
# a chart whose field around z averages to less than this (1: a wall) has no direction around z
HORIZONTAL = 0.1
MARKS = 1 << 27  # of vertices times `DIRECTIONS`: what marking them may take, half a gigabyte
# faces, edges and corners of a cube: no normal is further than 28 degrees from one of them
DIRECTIONS = np.array([d for d in np.ndindex(3, 3, 3) if d != (1, 1, 1)], np.float64) - 1
DIRECTIONS /= np.linalg.norm(DIRECTIONS, axis=1, keepdims=True)


def physical_uv(mesh: TriangleMesh, method: str, *, millimetres_per_unit: float, reporter=None) -> np.ndarray:
    """Texture coordinates whose unit is a millimetre on the surface.

    Parameters
    ----------
    mesh : TriangleMesh
    method : "xatlas" (charts computed here, each to scale, u around the world's z axis as far as it can) or
        "mesh" (the file's own, scaled to its mean texel size)
    millimetres_per_unit : millimetres in a world unit

    Returns
    -------
    (f, 3, 2) float32, millimetres

    Raises InputError when ``method`` is "mesh" and the file has no usable UVs.
    """
    parts = [mesh, method, float(millimetres_per_unit)]
    uv, warning = kept.recalled("uv", parts, lambda: _physical_uv(mesh, method, millimetres_per_unit))
    if warning and reporter is not None:
        reporter.warn(warning)
    return uv


def _physical_uv(mesh: TriangleMesh, method: str, millimetres_per_unit: float):
    """What :func:`physical_uv` returns, and what is to be said of it, or None."""
    if method == "mesh":
        if mesh.corner_uv is None:
            raise InputError(
                "uv 'mesh'", "the mesh file has no texture coordinates", "unwrap it, or set uv to 'xatlas'"
            )
        uv = mesh.corner_uv.astype(np.float64)
    elif len(mesh.faces) > XATLAS_FACES:
        return (_projected_charts(mesh) * millimetres_per_unit).astype(np.float32), (
            f"a mesh of {len(mesh.faces)} faces is mapped by projecting patches onto planes, not by xatlas "
            f"(it is used up to {XATLAS_FACES} faces)"
        )
    else:
        uv = _xatlas_uv(mesh)
        if not (np.isfinite(uv).all() and np.abs(_uv_areas(uv)).sum() > 0):
            said = "xatlas finds no charts on a mesh; it is mapped by projecting patches onto planes"
            return (_projected_charts(mesh) * millimetres_per_unit).astype(np.float32), said
    return (uv * (mean_scale(mesh, uv) * millimetres_per_unit)).astype(np.float32), None


def mean_scale(mesh: TriangleMesh, uv) -> float:
    """World units in a unit of the texture coordinates ``uv : (f, 3, 2)``, over the whole mesh.

    Raises InputError when they have no area.
    """
    surface, chart = _areas(mesh.vertices[mesh.faces]), np.abs(_uv_areas(np.asarray(uv, np.float64)))
    if not np.isfinite(uv).all() or chart.sum() <= 0:
        raise InputError("the UV map", "texture coordinates without area", "unwrap the mesh, or set uv to 'xatlas'")
    return float(np.sqrt(surface.sum() / chart.sum()))


def _areas(triangles):
    return np.linalg.norm(np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1) / 2


def _uv_areas(uv):
    a, b = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    return (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / 2


def _projected_charts(mesh):
    """Connected faces of similar normal, each cluster onto its own mean plane, to the size of its surface.

    u runs around the world's z axis and v up it, seen from outside (u along x where the plane is horizontal). Normals
    of a cluster lie within 28 degrees of one of `DIRECTIONS`, so that lengths are right to a few percent.

    Gives (f, 3, 2) float64, world units.
    """
    corners = mesh.vertices[mesh.faces] - mesh.vertices[mesh.faces[0, 0]]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    chart = _clusters(_welded(mesh.vertices)[mesh.faces], (normal @ DIRECTIONS.T).argmax(1))
    count = int(chart.max()) + 1
    mean = np.stack([np.bincount(chart, normal[:, k], count) for k in range(3)], -1)
    mean /= np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), 1e-300)
    horizontal = np.hypot(mean[:, 0], mean[:, 1])[:, None] < HORIZONTAL
    u = np.where(horizontal, np.cross(np.cross(mean, [1.0, 0.0, 0.0]), mean), np.cross([0.0, 0.0, 1.0], mean))
    u /= np.maximum(np.linalg.norm(u, axis=1, keepdims=True), 1e-300)
    surface = np.bincount(chart, np.linalg.norm(normal, axis=1), count)
    flat = np.bincount(chart, (normal * mean[chart]).sum(1), count)
    scale = np.sqrt(np.where(flat > 0, surface / np.maximum(flat, 1e-300), 1.0))[:, None]
    axes = np.stack([u * scale, np.cross(mean, u) * scale], -1)
    return corners @ axes[chart]


def _welded(vertices):
    """(v,) int: the same number for vertices at the same place, which a file splits at seams; by a hash of 64 bits."""
    bits = np.ascontiguousarray(vertices + 0.0, np.float64).view(np.uint64)  # + 0.0: of -0.0 and 0.0 one
    key = np.zeros(len(bits), np.uint64)
    for column in bits.T:
        key = (key ^ column) * np.uint64(0x9E3779B97F4A7C15)
        key ^= key >> np.uint64(29)
    return np.unique(key, return_inverse=True)[1].reshape(-1)


def _clusters(faces, label):
    """(f,) int from 0: faces of one label that hang together by their vertices."""
    key = faces.astype(np.int64) * len(DIRECTIONS) + label[:, None]
    if key.max() < MARKS:  # numbered in order by marking: many times quicker than by sorting
        marked = np.zeros(int(key.max()) + 1, bool)
        marked[key] = True
        nodes = (np.cumsum(marked, dtype=np.int32) - 1)[key]
    else:
        nodes = np.unique(key, return_inverse=True)[1].reshape(-1, 3)
    links = coo_matrix(
        (np.ones(2 * len(nodes), bool), (nodes[:, :2].ravel(), nodes[:, 1:].ravel())), shape=(int(nodes.max()) + 1,) * 2
    )
    return connected_components(links, directed=False)[1][nodes[:, 0]]


def _physical_charts(mesh, uv, chart):
    """Each chart for itself: to the size of its surface, unmirrored, and turned.

    u follows the horizontal around the world's z axis, area-weighted over the chart, so that frames change little
    from a chart to its neighbours; where that field has no direction (a horizontal chart) u follows x.

    Parameters
    ----------
    mesh : TriangleMesh
    uv : (f, 3, 2) float64
    chart : (f,) int, the chart of each face, from 0

    Returns
    -------
    (f, 3, 2) float64, world units
    """
    corners = mesh.vertices[mesh.faces]
    count = int(chart.max()) + 1
    mirrored = np.bincount(chart, _uv_areas(uv), count) < 0
    uv = uv * np.where(mirrored[chart], -1.0, 1.0)[:, None, None] ** np.array([1, 0])
    surface, flat = _areas(corners), np.abs(_uv_areas(uv))
    surfaces, flats = np.bincount(chart, surface, count), np.bincount(chart, flat, count)
    mean = surfaces.sum() / max(flats.sum(), 1e-300)
    # a chart that collapsed has no scale of its own
    scale = np.sqrt(np.where(flats * mean > 1e-3 * surfaces, surfaces / np.maximum(flats, 1e-300), mean))
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    tangent, bitangent = tangent_frames(corners, uv, normal)
    weight = surface * (flat > 0)

    def towards(field):
        along, across = (weight * (field * axis).sum(1) for axis in (tangent, bitangent))
        return np.bincount(chart, along, count) + 1j * np.bincount(chart, across, count)

    around = towards(np.cross([0.0, 0.0, 1.0], normal))
    lost = np.abs(around) < HORIZONTAL * surfaces
    direction = np.where(lost, towards(np.broadcast_to([1.0, 0.0, 0.0], normal.shape)), around)
    turn = np.exp(-1j * np.angle(direction)) * scale
    turned = (uv[..., 0] + 1j * uv[..., 1]) * turn[chart][:, None]
    return np.stack([turned.real, turned.imag], -1)


def _xatlas_uv(mesh):
    """Charts of xatlas, kept by content: they depend on nothing but the triangles."""
    import xatlas

    key = cache.digest("xatlas2", mesh.vertices, mesh.faces)
    stored = cache.cache_folder() / "charts" / f"{key[:32]}.entry"
    kept = cache.read(stored, {"uv": (len(mesh.faces), 3, 2)})
    if kept is not None:
        return kept["uv"].astype(np.float64)
    # charts must not break where a mesh file splits its vertices (seams of normals or of another UV)
    used, corner = np.unique(mesh.faces, return_inverse=True)  # a vertex of no face may be anywhere
    scaled = mesh.vertices[used] - mesh.vertices[used].mean(0)
    scaled = (scaled / (np.abs(scaled).max() or 1.0)).astype(np.float32)
    welded, inverse = np.unique(scaled, axis=0, return_inverse=True)
    faces = inverse.reshape(-1)[corner].reshape(-1, 3).astype(np.uint32)
    atlas = xatlas.Atlas()
    atlas.add_mesh(np.ascontiguousarray(welded), np.ascontiguousarray(faces))
    pack = xatlas.PackOptions()
    pack.create_image = False
    atlas.generate(xatlas.ChartOptions(), pack)
    _, indices, coordinates = atlas[0]
    indices = np.asarray(indices, np.int64)
    # vertices of the atlas belong to one chart: faces that share one are of the same chart
    links = coo_matrix(
        (np.ones(2 * len(indices), bool), (indices[:, [0, 1]].ravel(), indices[:, [1, 2]].ravel())),
        shape=(len(coordinates),) * 2,
    )
    chart = connected_components(links, directed=False)[1][indices[:, 0]]
    uv = np.asarray(coordinates, np.float64)[indices]
    uv = _physical_charts(mesh, uv, np.unique(chart, return_inverse=True)[1]).astype(np.float32)
    with suppress(InputError):  # a cache that cannot be written only costs time
        cache.write(stored, {"uv": uv})
    return uv.astype(np.float64)


def tangent_frames(triangles, uv, normals):
    """Tangent and bitangent at surface points.

    Parameters
    ----------
    triangles : (n, 3, 3) float, world corners of each point's face
    uv : (n, 3, 2) float, its texture coordinates
    normals : (n, 3) float, unit shading normals

    Returns
    -------
    tangent, bitangent : (n, 3) float64, unit; the tangent follows +u, the bitangent +v (left-handed on mirrored charts)
    """
    normals = np.asarray(normals, np.float64)
    e1, e2 = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    d1, d2 = (uv[:, 1] - uv[:, 0]).astype(np.float64), (uv[:, 2] - uv[:, 0]).astype(np.float64)
    determinant = d1[:, 0] * d2[:, 1] - d2[:, 0] * d1[:, 1]
    along_u = (d2[:, 1:2] * e1 - d1[:, 1:2] * e2) * np.sign(determinant)[:, None]
    tangent = along_u - (along_u * normals).sum(1, keepdims=True) * normals
    length = np.linalg.norm(tangent, axis=1, keepdims=True)
    # where the chart has no area any tangent will do: the one furthest from the normal's largest axis
    fallback = np.cross(normals, np.eye(3)[np.abs(normals).argmin(1)])
    fallback /= np.linalg.norm(fallback, axis=1, keepdims=True)
    good = length[:, 0] > 1e-12 * (np.linalg.norm(e1, axis=1) * np.linalg.norm(d1, axis=1) + 1e-30)
    tangent = np.where(good[:, None], tangent / np.maximum(length, 1e-300), fallback)
    handed = np.where(determinant < 0, -1.0, 1.0)[:, None]
    return tangent, np.cross(normals, tangent) * handed
