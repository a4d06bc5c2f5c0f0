# SPDX-License-Identifier: GPL-3.0-or-later
"""What stands behind an object in a photograph: things with edges of their own, of which no job knows."""

import cv2
import numpy as np
from scipy.ndimage import distance_transform_edt

THINGS = 40  # in a picture
SIZES = (0.05, 0.4)  # of the picture's longer edge: half of a thing's width, and of its height
BRIGHTNESS, TINT = 0.9, 0.25  # standard deviations of logarithms: of a thing beside the object, of its channels
STRIPED, STRIPES = 0.3, (3, 9)  # share of things that are rows of books, blinds, tiles; how many stripes they have
FINER = 4  # pixels of the drawing for one of the picture, to a side: edges are as smooth as a camera has them
BARE = 1e-3  # of a pixel: so little of the object is none


def drawn_things(shape, level: float, random) -> np.ndarray:
    """(h, w, 3) float32: things one before the other, as bright as an object of mean radiance ``level``, or not."""
    h, w = (FINER * size for size in shape)
    picture = np.full((h, w, 3), level, np.float32)
    for _ in range(THINGS):
        middle, half = random.uniform((0, 0), (w, h)), max(h, w) * np.exp(random.uniform(*np.log(SIZES), 2))
        turn = random.choice([random.uniform(0, 180), 0.0])  # what people make stands upright
        colours = level * np.exp(BRIGHTNESS * random.standard_normal((2, 1)) + TINT * random.standard_normal((2, 3)))
        if random.random() < 0.5:
            cv2.ellipse(picture, (tuple(middle), tuple(2 * half), turn), colours[0].tolist(), -1)
            continue
        count = int(random.integers(*STRIPES)) if random.random() < STRIPED else 1
        c, s = np.cos(np.radians(turn)), np.sin(np.radians(turn))
        for k in range(count):
            left, right = half[0] * (2 * np.array([k, k + 1]) / count - 1)
            corners = np.array([[left, -half[1]], [right, -half[1]], [right, half[1]], [left, half[1]]])
            corners = corners @ np.array([[c, s], [-s, c]]) + middle
            cv2.fillPoly(picture, [corners.round().astype(np.int32)], colours[k % 2].tolist())
    return cv2.resize(picture, shape[::-1], interpolation=cv2.INTER_AREA)


def cluttered(radiance, coverage, random) -> np.ndarray:
    """A photograph (h, w, 3) with other things behind its object; ``coverage`` (h, w) : how much of a pixel shows it.

    Where a pixel shows both, the background was that of the nearest pixel that shows nothing else.
    """
    bare = coverage < BARE
    nearest = distance_transform_edt(~bare, return_distances=False, return_indices=True)
    behind = radiance[tuple(nearest)]
    things = drawn_things(coverage.shape, float(radiance[coverage > 1 - BARE].mean()), random)
    return (radiance + (1 - coverage[..., None]) * (things - behind)).astype(np.float32)
