# SPDX-License-Identifier: GPL-3.0-or-later
"""What an object's several materials reflect as images of a job's surface, and texture coordinates into these.

A surface of the job has one image of each kind; an object of several materials gets one with a field for each, and
every triangle a small place within its own. The places have little area in all, so that a pixel's footprint never
leaves a field.
"""

import math

import numpy as np

FIELD = 8  # texels along an edge: filtering does not reach the middle from beside
AREA = 0.01  # of the image: all triangles together
MOST = 0.2  # of a field's edge: a triangle's


def laid(values, numbers) -> tuple[np.ndarray, np.ndarray]:
    """An image of fields, and where the triangles lie in it.

    Parameters
    ----------
    values : (k, c), what each material has
    numbers : (f,) int, of each triangle's material

    Returns
    -------
    image : (n, n, c) float32, the lowest row first
    uv : (f, 3, 2) float32
    """
    values = np.asarray(values, np.float32)
    edge = math.ceil(math.sqrt(len(values)))
    fields = np.resize(values, (edge * edge, values.shape[1]))
    image = np.repeat(np.repeat(fields.reshape(edge, edge, -1), FIELD, 0), FIELD, 1)
    leg = min(math.sqrt(2 * AREA / len(numbers)), MOST / edge)
    middle = (np.stack([numbers % edge, numbers // edge], -1) + 0.5) / edge
    corners = leg * (np.array([[0, 0], [1, 0], [0, 1]]) - 1 / 3)
    return image, (middle[:, None] + corners).astype(np.float32)
