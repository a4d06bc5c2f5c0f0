# SPDX-License-Identifier: GPL-3.0-or-later
"""The curve of sRGB, IEC 61966-2-1."""

import numpy as np


def srgb_to_linear(values) -> np.ndarray:
    """Linear light of ``values`` (any shape, nominally 0 to 1), float64."""
    v = np.asarray(values, np.float64)
    return np.where(v <= 0.04045, v / 12.92, ((np.maximum(v, 0) + 0.055) / 1.055) ** 2.4)


def linear_to_srgb(values) -> np.ndarray:
    """Codes of ``values`` (any shape, linear), float64, not clipped."""
    v = np.asarray(values, np.float64)
    return np.where(v <= 0.0031308, v * 12.92, 1.055 * np.maximum(v, 0.0031308) ** (1 / 2.4) - 0.055)
