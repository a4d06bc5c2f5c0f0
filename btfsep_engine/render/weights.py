# SPDX-License-Identifier: GPL-3.0-or-later
"""The integrand's weights BTF cos(theta_i) d_omega for pairs of a surface point and a light direction."""

from functools import partial

import numpy as np

from btfsep_engine.btf.model import Material
from btfsep_engine.render.appearance import LightTables
from btfsep_engine.render.arrays import divided, dr, floats, integers, mi, packets
from btfsep_engine.render.surface import SurfacePoints
from btfsep_engine.storage import kept

KEPT = 1 << 23  # bytes of some points' tables: a fit's. Larger ones are made for one look: a training's, a picture's


class Weights:
    """Weights of a material under shared directions.

    A grey material needs one set of numbers for all channels: what is returned has 1 channel or 3, and is yet to be
    multiplied by ``colour``.

    Parameters
    ----------
    material : Material, no mirror
    directions : (n, 3) float, unit, world; each stands for 4 pi / n
    millimetres_per_unit : millimetres in a world unit

    Attributes
    ----------
    colour : (3,) float32
    """

    def __init__(self, material: Material, directions, *, millimetres_per_unit: float):
        self.count, self.millimetres_per_unit = len(directions), millimetres_per_unit
        scale = 4 * np.pi / len(directions)
        if material.matte_albedo is not None:
            self.tables, self.colour = None, material.matte_albedo.astype(np.float32) / np.float32(np.pi)
        else:
            self.tables, self.colour = LightTables(material.table), np.ones(3, np.float32)
        # the solid angle goes with the direction
        self._directions = floats(np.concatenate([directions, np.full((len(directions), 1), scale)], 1))

    def of_all(self, points: SurfacePoints, active) -> list[np.ndarray]:
        """Weights of every direction at every point.

        Parameters
        ----------
        active : mitsuba Bool, a lane for each direction of each point; the others' weights are 0

        Returns
        -------
        1 or 3 arrays (points, directions) float32
        """
        lane = dr.arange(mi.UInt32, len(points) * self.count)
        point = divided(lane, self.count)
        direction = lane - point * dr.opaque(mi.UInt32, self.count)
        return [w.reshape(len(points), self.count) for w in self._of(points, point, direction, active)]

    def _tables_at(self, points: SurfacePoints):
        """`LightTables.tables_at`; those of few points are kept for their other directions."""
        unit = float(self.millimetres_per_unit)
        size = len(points) * self.tables.lights * 16
        if size > KEPT:
            return self.tables.tables_at(points, millimetres_per_unit=unit)
        parts = [self.tables.material, points, unit]
        make = partial(self.tables.tables_at, points, millimetres_per_unit=unit)
        return kept.recalled("tables", parts, make, size=size)

    def of_pairs(self, points: SurfacePoints, point, direction) -> list[np.ndarray]:
        """Weights of pairs, given by numbers of points and directions (t,): 1 or 3 arrays (t,) float32."""
        point, direction = (integers(i) for i in (point, direction))
        return self._of(points, point, direction, dr.full(mi.Bool, True, len(point)))

    def _of(self, points, point, direction, active) -> list[np.ndarray]:
        omega = dr.gather(mi.Vector4f, self._directions, direction)
        if self.tables is None:
            normal = dr.gather(mi.Vector4f, packets(points.normal), point)
            cosine = normal.x * omega.x + normal.y * omega.y + normal.z * omega.z
            values = [dr.select(active & (cosine > 0), cosine * omega.w, 0)]
        else:
            tables = self._tables_at(points)
            frames = floats(np.stack([points.tangent, points.bitangent, points.normal, np.zeros((len(points), 3))], 1))
            a, b, c = (dr.gather(mi.Vector4f, frames, point * 3 + i) for i in range(3))
            local = mi.Vector3f(
                a.x * omega.x + a.y * omega.y + a.z * omega.z,
                a.w * omega.x + b.x * omega.y + b.y * omega.z,
                b.z * omega.x + b.w * omega.y + c.x * omega.z,
            )
            active = active & (local.z > 0)
            value = self.tables.value(tables, point, local, active)
            scale = dr.select(active, local.z * omega.w, 0)
            values = [dr.select(active, value[c] * scale, 0) for c in range(3)]
        dr.eval(values)
        return [v.numpy() for v in values]
