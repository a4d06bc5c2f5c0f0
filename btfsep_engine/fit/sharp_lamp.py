# SPDX-License-Identifier: GPL-3.0-or-later
"""Lamps' own images: what a photograph shows of suns that the basis images are too coarse for.

Light of order 9 is 20 degrees wide. On gloss, and at the edges of shadows, a sun leaves something else than what the
basis images A have of it: with e the image of a beam from d of irradiance 1, made by itself, the photograph is

    b = A x + sum over the lamps of E (e - A Y(d)),    x with each E Y(d) in it,

linear in one more unknown for each. In a search (`fit.search`) its column stands beside the light's coefficients, as
what a beam from d alone gives (`LogField.beside`): it goes with the irradiance of a lamp whose direction is held.
"""

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from btfsep_engine.fit.light_model import OF_LAMP
from btfsep_engine.fit.products import Basis, Photograph

SAME = 1e-9  # of a cosine: a direction and itself


class Sharpened(Photograph):
    """The products of a photograph with lamps' own images beside its basis images.

    Parameters
    ----------
    basis : Basis; radiance : (p, 3), b; how : as of `Photograph`
    directions : (k, 3), d of each; excess : (p, k, 3), e - A Y(d)
    """

    def __init__(self, basis: Basis, radiance, directions, excess, **how):
        super().__init__(basis.with_images(excess), radiance, **how)
        beside = partial(_towards, np.asarray(directions, np.float64))
        self._fields = tuple(replace(field, beside=beside) for field in super().fields)

    @property
    def fields(self):
        """As of `Photograph`."""
        return self._fields


def _towards(own, directions) -> np.ndarray:
    """(…, k), 1 where ``directions`` (…, 3) are one of the lamps' ``own`` (k, 3)."""
    return (np.asarray(directions) @ own.T > 1 - SAME).astype(np.float64)


@dataclass(frozen=True)
class SharpLight:
    """A free sky and k lamps that were found, of which some have images of their own.

    Attributes
    ----------
    irradiances : (k, 3), the lamps'; x : (terms, 3), all of the light; evidence : its logarithm
    white, v : the unknowns and the noise, as of `fit.search.Solution`
    """

    irradiances: np.ndarray
    x: np.ndarray
    evidence: float
    white: np.ndarray
    v: np.ndarray

    def reordered(self, order) -> "SharpLight":
        """The same with the lamps in another order, (k,) int."""
        k = len(self.irradiances)
        own = self.white[len(self.white) - k * OF_LAMP :].reshape(k, OF_LAMP)[list(order)]
        white = np.concatenate([self.white[: len(self.white) - k * OF_LAMP], own.ravel()])
        return replace(self, irradiances=self.irradiances[list(order)], white=white)
