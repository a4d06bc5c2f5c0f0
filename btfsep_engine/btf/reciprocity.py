# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether cos(theta_i) is in the data: a BRDF-like value is reciprocal, and with the cosine in it is not.

The mean ABRDF of a flat sample obeys Helmholtz: f(i, o) = f(o, i). The error of that is measured as stored and after
the division by the cosine; where one of the two is clearly smaller, it tells which the data are.
"""

from dataclasses import dataclass

import numpy as np

from btfsep_engine.btf.directions import interpolator

CLEAR = 0.75  # the smaller error is below this share of the larger one
NOISE = 0.02  # errors that are both below this tell nothing


@dataclass(frozen=True)
class Reciprocity:
    """Relative reciprocity errors of the mean ABRDF, 0 (reciprocal) to 1.

    Attributes
    ----------
    as_stored : the values as they are in the file
    divided : the values divided by cos(theta_i)
    """

    as_stored: float
    divided: float

    @property
    def verdict(self) -> str:
        """ "included" (the cosine is in the data), "excluded", or "unclear"."""
        low, high = sorted((self.as_stored, self.divided))
        if high < NOISE or low > CLEAR * high:
            return "unclear"
        return "included" if self.divided < self.as_stored else "excluded"


def reciprocity_error(values, views, lights) -> float:
    """sum |f(o, i) - f(i, o)| / sum (|f(o, i)| + |f(i, o)|), 0 to 1.

    Parameters
    ----------
    values : (views, lights) or (views, lights, c) float, mean ABRDF
    views, lights : (n, 3) and (m, 3), unit; lists that differ are interpolated
    """
    f = np.asarray(values, np.float64)
    f = f if f.ndim == 2 else f.sum(-1)
    swapped = (_resample(lights, views) @ f @ _resample(views, lights).T).T
    return float(np.abs(f - swapped).sum() / max((np.abs(f) + np.abs(swapped)).sum(), 1e-300))


def _resample(wanted, given) -> np.ndarray:
    """(wanted, given): weights that interpolate values at ``given`` to ``wanted``; exact where they coincide."""
    matrix = interpolator(given).hats(wanted).T.toarray()
    near = np.asarray(wanted) @ np.asarray(given).T
    same = near.max(1) > np.cos(1e-4)
    matrix[same] = 0
    matrix[same, near.argmax(1)[same]] = 1
    return matrix


def check(stored, views, lights) -> Reciprocity:
    """The :class:`Reciprocity` of a mean ABRDF (views, lights, 3) as it is stored."""
    divided = np.asarray(stored, np.float64) / np.maximum(lights[:, 2], 1e-3)[None, :, None]
    return Reciprocity(reciprocity_error(stored, views, lights), reciprocity_error(divided, views, lights))
