# SPDX-License-Identifier: GPL-3.0-or-later
"""Where surfaces end in the picture: silhouettes, and steps from one part of an object to another behind it.

A pixel there mixes two surfaces, and where the camera is a pixel off it shows the other one. Along the outer outline
such pixels are left out of a region anyway (`surface.object_region`); a knee before a belly is no better.
"""

from dataclasses import dataclass

import numpy as np

from btfsep_engine.job.model import Job
from btfsep_engine.render.surface import View

FINEST = 512  # cells along the longer edge of what is looked at: large photographs are off by more pixels, too
FARTHEST = 8  # rings are counted up to it
STEP = 4.0  # cells' edges by which a neighbour lies off the plane of a face: a smooth surface bends by less
NEIGHBOURS = ((0, 1), (1, 0), (1, 1), (1, -1))  # each pair once


@dataclass(frozen=True)
class Outlines:
    """How far each pixel lies from the next outline.

    Attributes
    ----------
    top, left, edge : of the cells, pixels: place of the first, and size
    rings : (h, w) int, of each cell: 0 beside an outline, 1 the next, up to `FARTHEST`
    """

    top: int
    left: int
    edge: int
    rings: np.ndarray

    def rings_at(self, pixels) -> np.ndarray:
        """The ring (n,) of each of ``pixels : (n, 2)``, row and column."""
        cells = (np.asarray(pixels) - (self.top, self.left)) // self.edge
        return self.rings[tuple(np.clip(cells, 0, np.array(self.rings.shape) - 1).T)]

    def beside(self, shape) -> np.ndarray:
        """The pixels beside an outline, as an image of ``shape``, bool."""
        out = np.zeros(shape, bool)
        cells = (self.rings == 0).repeat(self.edge, 0).repeat(self.edge, 1)
        place = out[self.top : self.top + len(cells), self.left : self.left + cells.shape[1]]
        place[:] = cells[: place.shape[0], : place.shape[1]]
        return out


def outlines(view: View, job: Job) -> Outlines:
    """Of all objects of a job that a camera sees; what lies outside the picture is no outline."""
    shown = (view.mesh >= 0) & (view.mesh < len(job.objects))
    rows, columns = (np.flatnonzero(shown.any(axis)) for axis in (1, 0))
    edge = -(-max(np.ptp(rows) + 1, np.ptp(columns) + 1) // FINEST)
    # and what lies around
    top, left = max(rows[0] - edge, 0), max(columns[0] - edge, 0)
    bottom, right = min(rows[-1] + edge + 1, shown.shape[0]), min(columns[-1] + edge + 1, shown.shape[1])
    place = np.ix_(*(np.minimum(np.arange(a, b, edge) + edge // 2, b - 1) for a, b in ((top, bottom), (left, right))))
    steps = _steps(*(image[place] for image in (view.mesh, view.face, view.distance)), place, edge, job)
    rings = np.full(steps.shape, FARTHEST)
    for ring in range(FARTHEST):
        rings[steps & (rings > ring)] = ring
        steps = _and_around(steps)
    return Outlines(int(top), int(left), int(edge), rings)


def _and_around(image) -> np.ndarray:
    """An image, bool, with the eight neighbours of all that is in it."""
    padded = np.pad(image, 1)
    rows = padded[:-2] | padded[1:-1] | padded[2:]
    return rows[:, :-2] | rows[:, 1:-1] | rows[:, 2:]


def _steps(mesh, face, distance, place, edge: int, job: Job) -> np.ndarray:
    """Which of the cells (h, w) have a step beside them."""
    rows, columns = np.broadcast_arrays(*place)
    origins, directions = job.camera.rays(columns.ravel() + 0.5, rows.ravel() + 0.5)
    seen = mesh >= 0
    position = origins + directions * np.where(seen, distance, 1.0).reshape(-1, 1)
    across = (job.camera.seen_from(position)[1] * edge).reshape(mesh.shape)
    position, normal = position.reshape(*mesh.shape, 3), np.zeros((*mesh.shape, 3))
    for index, part in enumerate(job.objects):  # within an occluder nobody asks
        here = mesh == index
        triangles = part.mesh.vertices[part.mesh.faces[face[here]]]
        n = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
        normal[here] = n / np.maximum(np.linalg.norm(n, axis=1, keepdims=True), 1e-300)
    out, (h, w) = np.zeros(mesh.shape, bool), mesh.shape
    for down, right in NEIGHBOURS:
        one = slice(0, h - down), slice(max(0, -right), w - max(0, right))
        other = slice(down, h), slice(max(0, right), w + min(0, right))
        way = position[other] - position[one]
        off = np.maximum(*(np.abs((normal[i] * way).sum(-1)) for i in (one, other)))
        step = (mesh[one] != mesh[other]) | seen[one] & (off > STEP * np.minimum(across[one], across[other]))
        out[one] |= step
        out[other] |= step
    return out
