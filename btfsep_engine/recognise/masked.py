# SPDX-License-Identifier: GPL-3.0-or-later
"""The pixels of a mask that are usable, and means around them: what all images of the same pixels share.

A candidate that is compared with a photograph is an image of exactly its pixels: where patches lie, which pixels are
filled from which and what means are divided by is found once for all of them.
"""

from functools import cached_property

import cv2
import numpy as np

REACHED = 0.02  # share of usable pixels in a mean that is believed
FILLED = (1.5, 6.0, 24.0)  # pixels, of the means that other pixels are filled with


class Masked:
    """The usable pixels of a mask; what is found of them once is there for the next image.

    Parameters
    ----------
    mask : (h, w) bool
    valid : (h, w) bool, pixels of the mask that are usable
    """

    def __init__(self, mask, valid):
        self.mask, self.valid = mask, valid
        self.pixels = np.flatnonzero(valid)
        self._kept: dict = {}

    def once(self, key, make):
        """``make()``, once for each ``key``: for what depends on the pixels alone."""
        if key not in self._kept:
            self._kept[key] = make()
        return self._kept[key]

    @cached_property
    def weight(self) -> np.ndarray:
        """(h, w) float32, 1 where usable."""
        return self.valid.astype(np.float32)

    def values_of(self, image) -> np.ndarray:
        """The usable pixels (n, …) of an image (h, w, …)."""
        return image.reshape(-1, *image.shape[2:])[self.pixels]

    def image(self, values) -> np.ndarray:
        """(h, w, …) float32, of values (n, …) of the usable pixels; 0 elsewhere."""
        out = np.zeros((self.valid.size, *values.shape[1:]), np.float32)
        out[self.pixels] = values
        return out.reshape(*self.valid.shape, *values.shape[1:])

    def around(self, sigma: float) -> np.ndarray:
        """(h, w), the share of usable pixels in a mean by a Gaussian of ``sigma`` pixels."""
        return self.once(("around", sigma), lambda: smoothed(self.weight, sigma))

    def mean(self, image, sigma: float, pixels=None) -> np.ndarray:
        """The mean of usable pixels about each, by a Gaussian of ``sigma`` pixels.

        Parameters
        ----------
        image : (h, w) or (h, w, c) float32, 0 where not usable
        pixels : (m,) int, of the flat image, that are wanted; None: all

        Returns
        -------
        Of the image's shape, or (m,) or (m, c)
        """
        smooth, share = smoothed(image, sigma), np.maximum(self.around(sigma), 1e-3)
        if pixels is not None:
            smooth, share = smooth.reshape(-1, *image.shape[2:])[pixels], share.ravel()[pixels]
        return smooth / (share if image.ndim == 2 else share[..., None])

    def fill(self, image, reach: int) -> None:
        """Other pixels, as far as ``reach`` pixels from the mask, take the mean of usable ones: no edge arises there.

        ``image`` : (h, w) or (h, w, c) float32, contiguous, 0 where not usable
        """
        flat, even = image.reshape(-1, *image.shape[2:]), self.values_of(image).mean(0)
        # all means are those of usable pixels: none is put in before the last is found
        filled = [
            (pixels, even if sigma is None else self.mean(image, sigma, pixels))
            for sigma, pixels in self.once(("open", reach), lambda: self._open(reach))
        ]
        for pixels, values in filled:
            flat[pixels] = values

    def _open(self, reach: int) -> list:
        """(sigma, pixels) of the means that fill pixels near the mask; sigma None: no usable one is near."""
        near = cv2.dilate(self.mask.astype(np.uint8), np.ones((2 * reach + 1,) * 2, np.uint8)) > 0
        open_, out = near & ~self.valid, []
        for sigma in FILLED:
            if not open_.any():
                break
            reached = open_ & (self.around(sigma) > REACHED)
            out.append((sigma, np.flatnonzero(reached)))
            open_ &= ~reached
        return [*out, (None, np.flatnonzero(open_))]


def smoothed(values, sigma: float) -> np.ndarray:
    """Values (h, w) or (h, w, c) float32, blurred by a Gaussian of ``sigma`` pixels; a wide one on fewer pixels."""
    h, w = values.shape[:2]
    coarser = max(1, min(int(sigma / 1.6), h // 4, w // 4))
    if coarser == 1:
        return cv2.GaussianBlur(values, (0, 0), sigma)
    small = cv2.resize(values, (w // coarser, h // coarser), interpolation=cv2.INTER_AREA)
    return cv2.resize(cv2.GaussianBlur(small, (0, 0), sigma / coarser), (w, h), interpolation=cv2.INTER_LINEAR)
