# SPDX-License-Identifier: GPL-3.0-or-later
"""What an election leaves behind (`fit.election`): the model that stands, at its light, and what may ask it on."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from btfsep_engine.fit.election import onward
from btfsep_engine.fit.products import Photograph
from btfsep_engine.fit.search import Solution
from btfsep_engine.threads import one_thread


@dataclass(frozen=True, eq=False)
class Election:
    """Which model was elected, of which photo.

    ``solution``; ``known_rival``, as of `election.decided`, or None; the ``photo`` (its products); the ``unit`` (3,) of
    its light; ``is_open`` : whether the rival is that of an earlier photograph, or basis, from whose light the search
    goes on when it is first asked for: most fits of a search are compared, and nothing is stated of them.
    """

    solution: Solution
    known_rival: Solution | None
    photo: Photograph
    unit: np.ndarray
    is_open: bool = False

    @cached_property
    def rival(self) -> Solution | None:
        """The model that nearly stood, or that might, at its most probable light."""
        if not self.is_open or self.known_rival is None:
            return self.known_rival
        with one_thread():
            return onward(self.photo, self.known_rival)

    @property
    def latest_rival(self) -> Solution | None:
        """The same as far as it is known: where it has not been asked for, of an earlier photograph."""
        return vars(self).get("rival", self.known_rival)

    @property
    def sky(self) -> np.ndarray:
        """(terms, 3), coefficients of the field alone, without lamps."""
        return self.solution.model.sky(self.solution.white).T[: self.photo.basis.terms] * self.unit

    @property
    def found(self) -> range:
        """The numbers of those of its lamps whose direction was not given."""
        model = self.solution.model
        return range(len(model.given), len(model.lamps))

    @property
    def lamps(self) -> list:
        """Direction (3,) and irradiance (3,) of each lamp of the model, in the colour that the object gives it."""
        model = self.solution.model
        found = [model.lamp(i, q) for i, q in enumerate(model.parts(self.solution.white)[1])]
        return [(direction, irradiance * self.photo.level) for direction, irradiance in found]

    @property
    def evidence_of_photo(self) -> float:
        """The evidence's logarithm, comparable between photographs that differ by something known."""
        photo = self.photo
        return self.solution.evidence - float((photo.count * np.log(photo.level)).sum()) / photo.coarsening

    def radiance(self, directions) -> np.ndarray:
        """The field's radiance in ``directions : (m, 3)``, without lamps: (m, 3), positive."""
        return self.solution.model.radiance(self.solution.white, np.asarray(directions)) * self.unit
