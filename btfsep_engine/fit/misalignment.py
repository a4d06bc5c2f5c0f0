# SPDX-License-Identifier: GPL-3.0-or-later
"""How far a photograph is shifted against the known geometry: where its edges fall on the rendered silhouettes.

The silhouette of what the camera should see is known to the pixel. Moved over the photo's gradient image, its mean
gradient has a peak where the photo's own outline is. The logarithm of the radiance is used, so that a bright light
outweighs nothing, and gradients are capped, so that one strong edge of the background does not decide.

The outline of a depth may not be the object's: sensors lose what they see at a grazing angle. The photo's own outline
then lies outside on all sides, and on the side that lost most it looks like a shift. So of a depth both sides have to
speak for a shift, the one that it leads to and the one that it leads away from.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from btfsep_engine.conventions import REC709_LUMINANCE

REACH = 8  # pixels, the largest shift looked for
BLUR = 1.0  # pixels, of the gradient
CAP = 95  # percentile of the gradients
DARK = 0.02  # of the object's median luminance: noise in shadows is no edge
OUTWARDS = 3.0  # pixels, of the blur in which an outline's direction is found
FACING = 0.07  # of the blurred outline's slope, half of that of a straight outline across
LEAST_EDGE = 40  # pixels of silhouette; less says nothing


@dataclass(frozen=True)
class Shift:
    """Where the photo's outline lies.

    Attributes
    ----------
    rows, columns : pixels; the photo's outline is so far below and to the right of the rendered one
    gain : mean gradient there over that at no shift, >= 1
    contrast : mean gradient there over the median of all shifts; near 1 the outline cannot be seen
    """

    rows: int
    columns: int
    gain: float
    contrast: float

    @property
    def distance(self) -> float:
        """Pixels."""
        return float(np.hypot(self.rows, self.columns))


def silhouette_shift(photo, seen, *, frayed: bool = False) -> Shift | None:
    """The shift of a photo against the silhouettes of what it should show.

    Parameters
    ----------
    photo : (h, w, 3) float, linear
    seen : (h, w) bool, where the objects stand before all else; holes in it are judged as outlines, so those of a
        depth, which are missing data, have to be filled (rays through them meet `job.depth.closing_mesh`)
    frayed : whether the outline may have lost parts, as a depth's: the gain is that of the side that gains less

    Returns
    -------
    Shift, or None where there is no silhouette inside the picture
    """
    seen = np.asarray(seen, bool)
    edge = seen & ~cv2.erode(seen.astype(np.uint8), np.ones((3, 3), np.uint8), borderValue=0).astype(bool)
    margin = REACH + 1
    inside = np.zeros_like(edge)
    inside[margin:-margin, margin:-margin] = True
    rows, columns = np.nonzero(edge & inside)
    if len(rows) < LEAST_EDGE:
        return None
    luminance = np.maximum(np.asarray(photo, np.float64) @ REC709_LUMINANCE, 0)
    level = np.median(luminance[seen])
    if not level > 0:
        return None
    gradient = np.hypot(*blurred_slopes(np.log(luminance + DARK * level), BLUR))
    gradient = np.minimum(gradient, np.percentile(gradient, CAP))
    shifts = range(-REACH, REACH + 1)
    score = np.array([[gradient[rows + i, columns + j].mean() for j in shifts] for i in shifts])
    i, j = np.unravel_index(score.argmax(), score.shape)
    best = max(float(score[i, j]), 1e-300)
    gain = best / max(float(score[REACH, REACH]), 1e-300)
    down, right = int(i) - REACH, int(j) - REACH
    if frayed and (down or right):
        outwards = [-slope for slope in blurred_slopes(seen.astype(np.float64), OUTWARDS, across=False)]
        along = (down * outwards[0] + right * outwards[1])[rows, columns] / np.hypot(down, right)
        for side in (along > FACING, along < -FACING):
            if side.any():
                r, c = rows[side], columns[side]
                gain = min(gain, gradient[r + down, c + right].mean() / max(gradient[r, c].mean(), 1e-300))
    return Shift(
        down,
        right,
        float(gain),
        best / max(float(np.median(score)), 1e-300),
    )


def blurred_slopes(image, sigma: float, *, across: bool = True) -> list[np.ndarray]:
    """What a Gaussian makes of the slopes of an image (h, w) float64 along its rows and its columns: two of (h, w).

    ``across`` : whether it blurs at right angles to the slope, too
    """
    reach = int(4 * sigma + 0.5)
    x = np.arange(-reach, reach + 1)
    bell = np.exp(-0.5 * (x / sigma) ** 2)
    bell /= bell.sum()
    slope, other = bell * x / sigma**2, bell if across else np.ones(1)
    kernels = (other, slope), (slope, other)  # along columns' numbers and along rows'
    return [cv2.sepFilter2D(image, -1, *each, borderType=cv2.BORDER_REFLECT) for each in kernels]
