# SPDX-License-Identifier: GPL-3.0-or-later
"""Light of order 2 on a Lambertian object, by the formula of Ramamoorthi and Hanrahan (2001), without shadows.

"An Efficient Representation for Irradiance Environment Maps" (SIGGRAPH 2001): the irradiance is a quadratic polynomial
of the normal whose nine coefficients are the light's times pi, 2 pi / 3 and pi / 4. The albedo is unknown: its colour
is taken to be the photograph's (the light's mean is grey), its level ALBEDO.
"""

import numpy as np

from btfsep_engine import sh

ALBEDO = 0.5
ORDER = 2


def fit(normals, radiance) -> np.ndarray:
    """SH coefficients (9, 3) of the light that explains ``radiance : (p, 3)`` at ``normals : (p, 3)``."""
    per_term = np.repeat(sh.cosine_lobe(ORDER), 2 * np.arange(ORDER + 1) + 1)
    basis = sh.evaluate(ORDER, normals) * (ALBEDO / np.pi * per_term)
    x = np.linalg.lstsq(basis, np.asarray(radiance, np.float64), rcond=None)[0]
    return x * (x[0].mean() / np.where(np.abs(x[0]) > 1e-9 * np.abs(x).max(), x[0], np.inf))
