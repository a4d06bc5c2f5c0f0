# SPDX-License-Identifier: GPL-3.0-or-later
"""A lamp's own image: what a photograph shows of a sun that the basis images are too coarse for.

Light of order 9 is 20 degrees wide. On gloss, and at the edges of shadows, a sun leaves something else than what the
basis images A have of it: with e the image of a beam from d of irradiance 1, made by itself, the photograph is

    b = A x + E (e - A Y(d)),    x with E Y(d) in it,

linear in one more unknown. In a search (`fit.search`) its column stands beside the light's coefficients, as what a beam
from d alone gives (`LogField.beside`): it goes with the irradiance of a lamp whose direction is held.
"""

from dataclasses import replace
from functools import partial

import numpy as np

from btfsep_engine.fit.products import Basis, Photograph
from btfsep_engine.light.log_field import even_field, natural_field

SAME = 1e-9  # of a cosine: a direction and itself


class Sharpened(Photograph):
    """The products of a photograph with lamps' own images beside its basis images.

    Parameters
    ----------
    basis : Basis; radiance : (p, 3), b; how : as of `Photograph`
    direction : (3,), d; excess : (p, 3), e - A Y(d)
    """

    def __init__(self, basis: Basis, radiance, direction, excess, **how):
        super().__init__(basis.with_image(excess), radiance, **how)
        beside = partial(_towards, np.asarray(direction, np.float64))
        self._fields = tuple(replace(field, beside=beside) for field in (natural_field(), even_field()))

    @property
    def fields(self):
        """As of `Photograph`."""
        return self._fields


def _towards(direction, directions) -> np.ndarray:
    """(…, 1), 1 where ``directions`` (…, 3) are ``direction``."""
    return (np.asarray(directions) @ direction > 1 - SAME).astype(np.float64)[..., None]
