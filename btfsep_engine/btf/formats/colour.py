# SPDX-License-Identifier: GPL-3.0-or-later
"""The colour models of ``.btf`` files: how stored channels become linear RGB.

Models 0, 1, 3 and 4 are linear (a matrix and an offset): factors can be kept. The others are not: values have to be
decoded one by one. CIELab (2) is taken relative to D65, the white of Rec.709, and stays linear; no public file with it
is known.
"""

from dataclasses import dataclass

import numpy as np

EPSILON = np.float32(1e-5)  # of the logarithms, as Bonn's writers have it
RGB, YUV, LAB, PCA, YCOCG, LOG_Y_UV, LOG_YUV, LOG_Y_RATIO, LOG_RGB = 0, 1, 2, 3, 4, 9, 10, 11, 12
MODELS = (RGB, YUV, LAB, PCA, YCOCG, LOG_Y_UV, LOG_YUV, LOG_Y_RATIO, LOG_RGB)
YUV_TO_RGB = np.array([[1, 0, 1.13983], [1, -0.39465, -0.5806], [1, 2.03211, 0]], np.float32)
YCOCG_TO_RGB = np.array([[1, 1, -1], [1, 0, 1], [1, -1, -1]], np.float32)
D65 = np.array([0.950456, 1.0, 1.088754])
XYZ_TO_RGB = np.array(
    [[3.240479, -1.53715, -0.498535], [-0.969256, 1.875991, 0.041556], [0.055648, -0.204043, 1.057311]]
)
LAB_TO_FFF = np.array([[1 / 116, 1 / 500, 0], [1 / 116, 0, 0], [1 / 116, 0, -1 / 200]])  # to f(X), f(Y), f(Z)


@dataclass(frozen=True)
class Colour:
    """A colour model: its number, and matrix (3, 3) and mean (3,) of model 3 (row vectors: ``v @ matrix + mean``)."""

    model: int = RGB
    matrix: np.ndarray | None = None
    mean: np.ndarray | None = None

    @property
    def linear(self) -> bool:
        """Whether RGB = stored @ M.T + offset."""
        return self.model in (RGB, YUV, PCA, YCOCG)

    def affine(self):
        """M : (3, 3) float32 and offset : (3,) float32 of a linear model, RGB = M @ stored + offset."""
        offset = np.zeros(3, np.float32)
        if self.model == RGB:
            return np.eye(3, dtype=np.float32), offset
        if self.model == PCA:
            return np.asarray(self.matrix, np.float32).T, np.asarray(self.mean, np.float32)
        return {YUV: YUV_TO_RGB, YCOCG: YCOCG_TO_RGB}[self.model], offset

    def decode(self, stored) -> np.ndarray:
        """Linear RGB (..., 3) float32 of ``stored : (..., 3) float32``, which may be overwritten.

        Values that a logarithm cannot have become inf; the caller looks for them.
        """
        with np.errstate(over="ignore", invalid="ignore"):
            if self.linear:
                if self.model == RGB:
                    return stored
                matrix, offset = self.affine()
                return stored @ matrix.T + offset
            if self.model == LAB:
                return _lab_to_rgb(stored)
            if self.model == LOG_RGB:
                np.exp(stored, out=stored)
                stored -= EPSILON
                return stored
            luma = np.exp(stored[..., 0])
            if self.model == LOG_YUV:
                chroma = np.sign(stored[..., 1:]) * np.exp(np.abs(stored[..., 1:])) * EPSILON
                stored[..., 1:] = chroma
            elif self.model == LOG_Y_RATIO:
                stored[..., 1:] *= luma[..., None]
            stored[..., 0] = luma - EPSILON
            return stored @ YUV_TO_RGB.T


def _lab_to_rgb(lab) -> np.ndarray:
    f = np.asarray(lab, np.float64) @ LAB_TO_FFF.T + 16 / 116
    linear_below = 6 / 29
    xyz = D65 * np.where(f > linear_below, f**3, (f - 16 / 116) * 3 * linear_below**2)
    return (xyz @ XYZ_TO_RGB.T).astype(np.float32)
