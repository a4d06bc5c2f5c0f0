# SPDX-License-Identifier: GPL-3.0-or-later
"""Where the texels of an image lie on the mesh that it is laid on."""

from dataclasses import dataclass

import numpy as np

from btfsep_engine.job.model import TriangleMesh
from btfsep_engine.render.tracer import Tracer

OVERLAP = 1.1  # times the area of the texels that a map covers, what its faces have together: some lie on others
BEYOND = 1e-3  # of the image, outside of it


@dataclass(frozen=True)
class Texels:
    """The m texels of an image of ``side`` x ``side``, row 0 at the top, in whose middle a face lies.

    Attributes
    ----------
    number : (m,) int, row times ``side`` and column
    position, normal, flat_normal : (m, 3) float64, world; shading normal and that of the face, unit
    """

    side: int
    number: np.ndarray
    position: np.ndarray
    normal: np.ndarray
    flat_normal: np.ndarray


def texels_on(mesh: TriangleMesh, side: int) -> Texels | None:
    """The texels of an image laid by the mesh's own UVs; None where one lies in several places, or it is repeated."""
    uv = np.asarray(mesh.corner_uv, np.float64)
    if not np.isfinite(uv).all() or uv.min() < -BEYOND or uv.max() > 1 + BEYOND:
        return None
    edges = uv[:, 1:] - uv[:, :1]
    area = np.abs(edges[:, 0, 0] * edges[:, 1, 1] - edges[:, 0, 1] * edges[:, 1, 0]).sum() / 2
    corners = np.concatenate([uv, np.zeros((*uv.shape[:2], 1))], 2).reshape(-1, 3)
    laid_out = TriangleMesh(corners, np.arange(len(corners), dtype=np.int32).reshape(-1, 3), mesh.corner_normals)
    row, column = np.divmod(np.arange(side * side), side)
    above = np.stack([(column + 0.5) / side, 1 - (row + 0.5) / side, np.ones(side * side)], 1)
    hits = Tracer([laid_out]).nearest(above, np.tile([0.0, 0.0, -1.0], (len(above), 1)))
    number = np.flatnonzero(hits.mesh >= 0)
    if not len(number) or area > OVERLAP * len(number) / side**2:
        return None
    face, weight = hits.face[number], hits.barycentric[number].astype(np.float64)
    weight /= weight.sum(1, keepdims=True)  # rounded to single precision: far from the origin that moves places
    corners = mesh.vertices[mesh.faces[face]]
    flat = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal = np.einsum("mk,mkc->mc", weight, mesh.corner_normals[face])
    return Texels(side, number, np.einsum("mk,mkc->mc", weight, corners), _unit(normal), _unit(flat))


def _unit(vectors) -> np.ndarray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-300)
