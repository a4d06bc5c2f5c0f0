# SPDX-License-Identifier: GPL-3.0-or-later
"""Writes triangles with their shading normals and texture coordinates as a binary PLY."""

import numpy as np

from . import atomic


def write(path, corner_positions, corner_normals, corner_vertex, *, corner_uv=None) -> int:
    """Writes a mesh. Corners that agree in vertex, normal and texture coordinate become one vertex of the file.

    Parameters
    ----------
    path : where to
    corner_positions, corner_normals : (f, 3, 3) float, world units; unit
    corner_vertex : (f, 3) int, which corners are the same point of the surface
    corner_uv : (f, 3, 2) float, or None

    Returns
    -------
    Number of vertices in the file.

    Raises
    ------
    InputError
        When the file cannot be written.
    """
    faces = len(corner_vertex)
    positions = np.asarray(corner_positions, np.float32).reshape(-1, 3)
    normals = np.asarray(corner_normals, np.float32).reshape(-1, 3)
    # Normals are compared to 1e-4, so that rounding does not tear a smooth surface apart.
    keys = [np.asarray(corner_vertex, np.int64).reshape(-1, 1), np.round(normals * 1e4).astype(np.int64)]
    columns, names = [positions, normals], ["x", "y", "z", "nx", "ny", "nz"]
    if corner_uv is not None:
        uv = np.asarray(corner_uv, np.float32).reshape(-1, 2)
        keys.append(np.ascontiguousarray(uv).view(np.int32).astype(np.int64))
        columns.append(uv)
        names += ["s", "t"]
    _, first, index = np.unique(np.concatenate(keys, axis=1), axis=0, return_index=True, return_inverse=True)
    table = np.concatenate(columns, axis=1)[first].astype("<f4")
    records = np.empty(faces, [("n", "u1"), ("corners", "<i4", 3)])
    records["n"] = 3
    records["corners"] = index.reshape(-1, 3)
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(table)}"]
    header += [f"property float {name}" for name in names]
    header += [f"element face {faces}", "property list uchar int vertex_indices", "end_header", ""]
    atomic.write_bytes(path, "\n".join(header).encode() + table.tobytes() + records.tobytes())
    return len(table)
