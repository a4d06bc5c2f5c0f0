# SPDX-License-Identifier: GPL-3.0-or-later
"""How large the coefficients of natural light are, from the shipped training lights."""

from functools import lru_cache

import numpy as np

from btfsep_engine import sh
from btfsep_engine.light.maps import training_lights


@lru_cache(maxsize=10)
def natural_amplitude(order: int) -> np.ndarray:
    """Typical size of each coefficient of natural light, relative to the first.

    The root mean square over the shipped training lights, all channels and each band's terms; a band's terms
    share one value, as if light could be turned about any axis.

    Returns
    -------
    ((order + 1)^2,) float64, the first is 1
    """
    x = np.moveaxis(training_lights().coefficients(order), 1, 0)
    relative = x / x[0].mean(-1, keepdims=True)
    out = np.ones(sh.term_count(order))
    for l in range(1, order + 1):
        band = slice(l * l, (l + 1) ** 2)
        out[band] = np.sqrt((relative[band] ** 2).mean())
    return out
