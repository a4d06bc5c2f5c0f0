# SPDX-License-Identifier: GPL-3.0-or-later
"""The light as a function of white unknowns: the exponential of a Gaussian field, and lamps beside it.

    x_c = T exp(u_c) + sum over the lamps of E_c Y(d),    d = (d0 + s (q1 t1 + q2 t2)) / |...|,
    log E_c = log(2 pi) + `BRIGHTNESS` q3 + V[c] (`TINT` q4, `GREEN` q5)

with u of `light.log_field`, in units of the photo's own level (even light of radiance 1 has the irradiance pi). All
unknowns are N(0, 1) before the photo is looked at; d0 is where a lamp was first seen, t1 and t2 lie across it.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from btfsep_engine import sh
from btfsep_engine.light.log_field import CHROMA, LARGEST_LOG, LogField

OF_LAMP = 5  # unknowns
DIRECTION = np.radians(10)  # s
BRIGHTNESS, TINT, GREEN = 2.0, 0.3, 0.1
STEP = 1e-3  # of a numerical derivative by the direction


def across(direction) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors across a unit direction (3,) and each other."""
    first = np.cross(direction, np.eye(3)[np.abs(direction).argmin()])
    first /= np.linalg.norm(first)
    return first, np.cross(direction, first)


@dataclass(frozen=True, eq=False)
class LightModel:
    """A field and lamps first seen at ``lamps`` (k, 3)."""

    field: LogField
    lamps: tuple = ()

    @property
    def unknowns(self) -> int:
        """Of the field and of all lamps."""
        return self.field.unknowns + OF_LAMP * len(self.lamps)

    @cached_property
    def _across(self) -> list:
        return [across(d) for d in self.lamps]

    def parts(self, white) -> tuple[np.ndarray, np.ndarray]:
        """The field's unknowns (k,), and the lamps' (lamps, 5)."""
        k = self.field.unknowns
        return white[:k], white[k:].reshape(-1, OF_LAMP)

    def lamp(self, i: int, q) -> tuple[np.ndarray, np.ndarray]:
        """Direction (3,) and irradiance (3,) of lamp i with the unknowns q (5,)."""
        first, second = self._across[i]
        d = self.lamps[i] + DIRECTION * (q[0] * first + q[1] * second)
        log = np.log(2 * np.pi) + CHROMA @ np.array([BRIGHTNESS * q[2], TINT * q[3], GREEN * q[4]])
        return d / np.linalg.norm(d), np.exp(np.minimum(log, LARGEST_LOG))

    def light(self, white):
        """Coefficients (3, terms) of all of the light, and the field's radiance (3, n)."""
        of_field, of_lamps = self.parts(white)
        radiance = self.field.radiance(of_field)
        x = self.field.coefficients(radiance)
        if len(of_lamps):
            directions, irradiances = zip(*(self.lamp(i, q) for i, q in enumerate(of_lamps)), strict=True)
            x = x + np.stack(irradiances, 1) @ self._harmonics(directions)
        return x, radiance

    def lights(self, whites) -> np.ndarray:
        """Coefficients (m, 3, terms) of all of the light of many unknowns (m, unknowns)."""
        out = self.field.coefficients(self.field.radiance(whites[:, : self.field.unknowns]))
        for i in range(len(self.lamps)):
            lamps = [self.lamp(i, self.parts(white)[1][i]) for white in whites]
            out += np.stack([e for _, e in lamps])[..., None] * self._harmonics([d for d, _ in lamps])[:, None]
        return out

    def sky(self, white) -> np.ndarray:
        """Coefficients (3, terms) of the field alone."""
        return self.field.coefficients(self.field.radiance(self.parts(white)[0]))

    def _harmonics(self, directions) -> np.ndarray:
        """(directions, terms)."""
        return sh.evaluate(sh.order_of(self.field.terms), np.stack(directions))

    def jacobian(self, white, radiance, rows) -> np.ndarray:
        """Derivatives of R_c x_c by the unknowns: (all rows, unknowns); ``rows`` : R of each channel."""
        columns, of_lamps = [self.field.jacobian(rows, radiance)], self.parts(white)[1]
        steps = STEP * np.eye(OF_LAMP)[:2]
        directions = [self.lamp(i, q + step)[0] for i, q in enumerate(of_lamps) for step in (0, *steps)]
        harmonics = self._harmonics(directions).reshape(len(of_lamps), 3, -1) if directions else ()
        for i, (q, (y, *moved)) in enumerate(zip(of_lamps, harmonics, strict=True)):
            irradiance = self.lamp(i, q)[1]
            for there in moved:
                slope = (there - y) / STEP
                columns.append(np.concatenate([r @ slope * e for r, e in zip(rows, irradiance, strict=True)]))
            parts = [r @ y * e for r, e in zip(rows, irradiance, strict=True)]
            for j, size in enumerate((BRIGHTNESS, TINT, GREEN)):
                columns.append(size * np.concatenate([CHROMA[c, j] * part for c, part in enumerate(parts)]))
        return np.column_stack(columns)
