# SPDX-License-Identifier: GPL-3.0-or-later
"""The light as a function of white unknowns: the exponential of a Gaussian field, and lamps beside it.

    x_c = T exp(u_c) + sum over the lamps of E_c Y(d),    d = (d0 + s (q1 t1 + q2 t2)) / |...|,
    log E_c = log(2 pi) + `BRIGHTNESS` q3 + V[c] (`TINT` q4, `GREEN` q5)

with u of `light.log_field`, in units of the photo's own level (even light of radiance 1 has the irradiance pi). All
unknowns are N(0, 1) before the photo is looked at; d0 is where a lamp was first seen, t1 and t2 lie across it. Lamps
beside a field whose colours may be strong have q4 and q5 do `log_field.VIVID` times as much. Of a lamp
whose direction is given, d0 is that and s is 0: the photo says how bright it is, and nothing of where it stands.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from btfsep_engine.conventions import across
from btfsep_engine.light.hidden_light import hidden_share
from btfsep_engine.light.log_field import CHROMA, LARGEST_LOG, VIVID, LogField
from btfsep_engine.linear_algebra import product

OF_LAMP = 5  # unknowns
DIRECTION = np.radians(10)  # s
BRIGHTNESS, TINT, GREEN = 2.0, 0.3, 0.1
BY_CHANNEL = np.array([BRIGHTNESS, TINT, GREEN])[:, None] * CHROMA.T  # (q3 to q5, channels)
OF_VIVID = VIVID[:, None] * BY_CHANNEL
STEP = 1e-3  # of a numerical derivative by the direction


@dataclass(frozen=True, eq=False)
class LightModel:
    """A field and lamps first seen at ``lamps`` (k, 3); ``given`` : s of the first ones, whose direction is given."""

    field: LogField
    lamps: tuple = ()
    given: tuple = ()

    @property
    def found(self) -> int:
        """How many of its lamps nobody has told of."""
        return len(self.lamps) - len(self.given)

    def beside(self, white, degrees: float) -> int:
        """How many of the lamps that were found stand, with unknowns (k,), so near to one whose direction is given."""
        directions = [self.lamp(i, q)[0] for i, q in enumerate(self.parts(white)[1])]
        told, found = directions[: len(self.given)], directions[len(self.given) :]
        return sum(any(d @ t > np.cos(np.radians(degrees)) for t in told) for d in found)

    @property
    def by_channel(self) -> np.ndarray:
        """(3, 3): what q3 to q5 do to the logarithm of each channel."""
        return OF_VIVID if self.field.vivid else BY_CHANNEL

    def towards(self, i: int) -> float:
        """s of lamp i."""
        return self.given[i] if i < len(self.given) else DIRECTION

    @property
    def unknowns(self) -> int:
        """Of the field and of all lamps."""
        return self.field.unknowns + OF_LAMP * len(self.lamps)

    @cached_property
    def _places(self) -> np.ndarray:
        """(k, 3, 3): d0, s t1 and s t2 of each lamp."""
        places = [[d, *(self.towards(i) * across(d))] for i, d in enumerate(self.lamps)]
        return np.array(places).reshape(-1, 3, 3)

    def parts(self, white) -> tuple[np.ndarray, np.ndarray]:
        """The field's unknowns (…, k), and the lamps' (…, lamps, 5)."""
        k = self.field.unknowns
        return white[..., :k], white[..., k:].reshape(*white.shape[:-1], -1, OF_LAMP)

    def lamp(self, i, q) -> tuple[np.ndarray, np.ndarray]:
        """Directions (…, 3) and irradiances (…, 3) of lamp i with unknowns q (…, 5); of a slice, (…, lamps, 5)."""
        place = self._places[i]
        d = place[..., 0, :] + q[..., :1] * place[..., 1, :] + q[..., 1:2] * place[..., 2, :]
        log = np.log(2 * np.pi) + q[..., 2:] @ self.by_channel
        return d / np.sqrt(np.square(d).sum(-1, keepdims=True)), np.exp(np.minimum(log, LARGEST_LOG))

    def light(self, white):
        """Coefficients (…, 3, terms) of all light that reaches what is photographed, and the field's radiance
        (…, 3, n), of unknowns (…, k)."""
        of_field, of_lamps = self.parts(white)
        radiance = self.field.radiance(of_field)
        x = self.field.shown(radiance)
        return (x + self._of_lamps(of_lamps) if self.lamps else x), radiance

    def whole(self, white, off=0.0) -> np.ndarray:
        """Coefficients (…, 3, terms) of all of the light, be it hidden or not, of unknowns (…, k).

        ``off`` : (…), standard deviations by which hidden light is brighter than it usually is
        """
        x, factor, hidden = self._with_hidden(white, off)
        return x if hidden is None else x + (factor - 1)[..., None, None] * hidden

    def radiance(self, white, directions) -> np.ndarray:
        """The field's radiance in directions (…, 3), hidden or not, of unknowns (k,): (…, 3)."""
        out = self.field.at(self.parts(white)[0], directions)
        _, factor, hidden = self._with_hidden(white, 0.0)
        if hidden is None:
            return out
        return out * (1 + (factor - 1) * hidden_share(self.field.hidden, directions)[..., None])

    def _with_hidden(self, white, off):
        """Coefficients of all light as the field has it, and `LogField.hidden_light`."""
        of_field, of_lamps = self.parts(white)
        radiance = self.field.radiance(of_field)
        x = self.field.coefficients(radiance)
        x = x + self._of_lamps(of_lamps) if self.lamps else x
        return x, *((1.0, None) if self.field.hidden is None else self.field.hidden_light(radiance, x, off))

    def _of_lamps(self, q) -> np.ndarray:
        """Coefficients (…, 3, terms) of the lamps alone, of their unknowns (…, lamps, 5)."""
        directions, irradiances = self.lamp(slice(None), q)
        return np.swapaxes(irradiances, -1, -2) @ self.field.of_beam(directions)

    def seen(self, white, rows, by_direction) -> np.ndarray:
        """R_c x_c of unknowns (…, k): (…, all rows), in their precision.

        Parameters
        ----------
        rows : R_c of each channel; by_direction : `LogField.by_direction` of them
        """
        of_field, of_lamps = self.parts(white)
        radiance = self.field.radiance(of_field)
        out = np.concatenate([product(radiance[..., c, :], r.T) for c, r in enumerate(by_direction)], -1)
        if self.lamps:
            x = self._of_lamps(of_lamps).astype(out.dtype)
            out += np.concatenate([x[..., c, :] @ r.astype(out.dtype).T for c, r in enumerate(rows)], -1)
        return out

    def sky(self, white) -> np.ndarray:
        """Coefficients (3, terms) of the field alone."""
        return self.field.coefficients(self.field.radiance(self.parts(white)[0]))

    def jacobian(self, white, radiance, rows, by_direction=None) -> np.ndarray:
        """Derivatives of R_c x_c by the unknowns: (all rows, unknowns).

        Parameters
        ----------
        white : (unknowns,); radiance : (3, n), the field's; rows : R_c of each channel
        by_direction : `LogField.by_direction` of the rows, whose precision is that of the derivatives; None: made
        """
        if by_direction is None:
            by_direction = self.field.by_direction(rows)
        k = self.field.unknowns
        out = self.field.jacobian(by_direction, radiance, beside=len(white) - k)
        start = 0
        for r, columns in zip(rows, self._lamp_slopes(white), strict=True):
            out[start : start + len(r), k:] = product(r, columns.T)
            start += len(r)
        return out

    def gradient(self, white, radiance, rows, by_direction, residual) -> np.ndarray:
        """J^T r, (unknowns,), of `jacobian`'s J without making it; ``residual`` : r of each channel."""
        kind = by_direction[0].dtype
        of_field = self.field.gradient(by_direction, radiance, [r.astype(kind) for r in residual])
        each = zip(self._lamp_slopes(white), residual, rows, strict=True)
        return np.concatenate([of_field, sum(columns @ product(left, of) for columns, left, of in each)])

    def _lamp_slopes(self, white) -> np.ndarray:
        """Derivatives of the lamps' coefficients by their unknowns: (3, unknowns of lamps, terms)."""
        q = self.parts(white)[1]
        if not self.lamps:
            return np.empty((3, 0, len(self.field.to_coefficients)))
        moves = STEP * np.eye(OF_LAMP)[[2, 0, 1]]
        moves[0] = 0
        directions, irradiances = self.lamp(slice(None), q + moves[:, None])
        y, *moved = self.field.of_beam(directions)  # (lamps, terms)
        aside = [(there - y) / STEP for there in moved]
        each = [np.stack([*aside, *(share * y for share in shares)], 1) for shares in self.by_channel.T]
        return (irradiances[0].T[..., None, None] * np.stack(each)).reshape(3, -1, len(self.field.to_coefficients))
