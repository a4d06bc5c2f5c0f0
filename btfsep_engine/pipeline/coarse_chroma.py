# SPDX-License-Identifier: GPL-3.0-or-later
"""What a photo's pixels near outlines are worth whose file has colours at half the resolution, as most JPEGs have.

Such a file keeps the brightness of every pixel and one colour for four of them; a reader blurs these. So an object's
pixels within three of an outline have the colour of what lies behind it in part. Brightness stays, which is worst for a
strong colour: a red object's green and blue are a tenth of its brightness, and what bleeds into them is as large.
With chroma C' - Y' in codes, kappa what comes from beyond an outline at a distance, and c the code of a channel there,

    an error of 2.2 kappa |chroma inside - chroma outside| / c    of the channel's value

is laid against the model's own (`MISFIT`). And the two pixels next to an outline count for `BESIDE`: what is coded like
this blurs and rings at edges, and was seldom photographed by a camera that is known to a pixel.
"""

import cv2
import numpy as np

from btfsep_engine.imaging.srgb import linear_to_srgb

LUMA = np.array([0.299, 0.587, 0.114])  # of codes: ITU-R BT.601, as JPEG has it
KAPPA = np.array([0.5, 0.35, 0.2, 0.1])  # at 0 to 3 pixels from an outline
CERTAIN = 2.0  # how many of such errors are reckoned with
MISFIT = 0.1  # of a channel's value: the noise of a usual fit
NEXT, BESIDE = 2, 0.3  # pixels from an outline; how much they count
SPREADS = (3, 6, 12, 24)  # cells: over which what is inside and outside is averaged, the least that finds any
MARGIN = 12  # cells beside the objects that are looked at
ENOUGH = 1e-2  # of such a neighbourhood
DARKEST = 1 / 255


def chroma_weights(problem) -> np.ndarray | None:
    """(p, 3) in (0, 1], how much the channels of a problem's points count; None: all alike."""
    scene = problem.scene
    photo = scene.job.photo
    if not photo.coarse_chroma:
        return None
    away = problem.rings * scene.outlines.edge  # pixels, at least
    weights = np.where(away < NEXT, BESIDE, 1.0)[:, None] * np.ones(3)
    near = away < len(KAPPA)
    if not near.any():
        return weights
    cells = Cells(scene)
    at = cells.of(problem.pixels[near])
    inside, outside = (cells.around(cells.chroma, where, at) for where in (cells.inside, cells.outside))
    own = np.maximum(cells.around(cells.codes, cells.inside, at), DARKEST)
    error = 2.2 * KAPPA[away[near]][:, None] * np.abs(inside - outside) / own
    weights[near] /= 1 + np.square(CERTAIN * error / MISFIT)
    return weights


class Cells:
    """The part of a photo that shows the objects, and a little more, in the cells of their outlines.

    Attributes
    ----------
    codes, chroma : (h, w, 3) float32; inside, outside : (h, w) bool, what shows objects or does not, off outlines
    """

    def __init__(self, scene):
        outlines, mesh, photo = scene.outlines, scene.view.mesh, scene.job.photo.radiance
        self._edge = edge = outlines.edge
        more = MARGIN * edge
        self._corner = np.array([outlines.top % edge, outlines.left % edge])
        self._corner += np.maximum((np.array([outlines.top, outlines.left]) - more) // edge, 0) * edge
        ends = np.array([outlines.top, outlines.left]) + edge * np.array(outlines.rings.shape) + more
        rows, columns = (
            np.minimum(np.arange(a, min(b, n), edge) + edge // 2, n - 1)
            for a, b, n in zip(self._corner, ends, mesh.shape, strict=True)
        )
        place = np.ix_(rows, columns)
        pixels = np.stack(np.broadcast_arrays(*place), -1).reshape(-1, 2)
        away = (outlines.rings_at(pixels) * edge).reshape(len(rows), len(columns))
        shown = (mesh[place] >= 0) & (mesh[place] < len(scene.job.objects))
        apart = away >= len(KAPPA) - 1
        self.inside, self.outside = shown & apart, ~shown & (apart | self._beyond(outlines, pixels, apart.shape))
        self.codes = linear_to_srgb(np.clip(photo[place], 0, 1)).astype(np.float32)
        self.chroma = self.codes - (self.codes @ LUMA.astype(np.float32))[..., None]

    @staticmethod
    def _beyond(outlines, pixels, shape) -> np.ndarray:
        """What lies outside the cells of which rings are known."""
        cells = (pixels - (outlines.top, outlines.left)) // outlines.edge
        return ((cells < -1) | (cells > np.array(outlines.rings.shape))).any(1).reshape(shape)

    def of(self, pixels) -> tuple:
        """Row and column (n,) of the cells of pixels (n, 2)."""
        cells = (pixels - self._corner) // self._edge
        return tuple(np.clip(cells, 0, np.array(self.inside.shape) - 1).T)

    def around(self, values, where, at) -> np.ndarray:
        """Mean of values (h, w, 3) over what is ``where`` (h, w) bool near the cells ``at``: (n, 3)."""
        out, todo = np.zeros((len(at[0]), 3)), np.ones(len(at[0]), bool)
        for spread in SPREADS:
            if not todo.any():
                break
            share = cv2.GaussianBlur(where.astype(np.float32), (0, 0), spread)[at]
            found = todo & (share > ENOUGH)
            mean = cv2.GaussianBlur(values * where[..., None], (0, 0), spread)[at]
            out[found] = mean[found] / share[found, None]
            todo &= ~found
        return out
