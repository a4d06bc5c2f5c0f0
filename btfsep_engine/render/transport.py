# SPDX-License-Identifier: GPL-3.0-or-later
"""The light-transport kernel: radiance of chosen pixels under M lightings at once.

Light is linear (the paper's eq. 10), so the image-based relighting integral (eq. 1)

    L_r(x, omega_o) = int BTF(x, omega_i, omega_o) V(x, omega_i) cos(theta_i) L_i(omega_i) d omega_i

is one matrix product: the pixels' weights W = BTF V cos d_omega over a set of directions, shared by all
pixels, times the lightings' radiance in these directions. A ray is traced once, whatever the material and
however many the lightings. The shared set keeps the error of the quadrature smooth from pixel to pixel,
which the fit forgives; independent random directions would be noise in its matrix (errors in variables).
"""

import numpy as np

from btfsep_engine.btf.directions import GRID, interpolator
from btfsep_engine.btf.model import Lambertian, Material, Mirror, Tabulated
from btfsep_engine.conventions import fibonacci_sphere
from btfsep_engine.render.appearance import light_tables
from btfsep_engine.render.surface import SurfacePoints
from btfsep_engine.render.tracer import Tracer

LANES = 1 << 21  # weights computed at once: 25 MB a channel triple


class Transport:
    """Transport to one object's surface points; the rays are traced here, once.

    Parameters
    ----------
    tracer : Tracer
    points : SurfacePoints, with tangents (`surface.with_texture` or `surface.with_any_tangent`)
    directions : number of shared light directions over the sphere
    millimetres_per_unit : millimetres in a world unit
    """

    def __init__(self, tracer: Tracer, points: SurfacePoints, *, directions: int, millimetres_per_unit: float):
        self.tracer, self.points, self.millimetres_per_unit = tracer, points, millimetres_per_unit
        self.directions = fibonacci_sphere(directions)
        self.solid_angle = 4 * np.pi / directions
        self.visible = tracer.visible(points.position, points.flat_normal, self.directions)

    def radiance(self, material: Material, lightings) -> np.ndarray:
        """Radiance towards the camera by the light that comes straight from outside the scene.

        Parameters
        ----------
        material : Material
        lightings : light.lightings.Lightings, M of them

        Returns
        -------
        (p, M, 3) float32
        """
        if isinstance(material, Mirror):
            return self._mirror(material, lightings)
        light = np.asarray(lightings.cell_averages(self.directions), np.float32)
        p, m = len(self.points), light.shape[1]
        out = np.empty((p, m, 3), np.float32)
        step = max(1, LANES // len(self.directions))
        for start in range(0, p, step):
            part = slice(start, min(p, start + step))
            weights = self.weights(material, part, self.visible[part])
            for c in range(3):
                out[part, :, c] = weights[c] @ light[:, :, min(c, light.shape[2] - 1)]
        return out

    def weights(self, material: Lambertian | Tabulated, part: slice, wanted) -> np.ndarray:
        """BTF cos(theta_i) d_omega.

        Parameters
        ----------
        material : Lambertian or Tabulated
        part : slice of the points
        wanted : (points of the part, directions) bool, which weights to compute; the others are 0

        Returns
        -------
        (3, points of the part, directions) float32
        """
        points = self.points.take(part)
        if isinstance(material, Lambertian):
            cosine = np.maximum(points.normal.astype(np.float32) @ self.directions.T.astype(np.float32), 0)
            cosine *= wanted
            albedo = np.asarray(material.albedo, np.float32)[:, None, None]
            return cosine * (albedo * np.float32(self.solid_angle / np.pi))
        return self._tabulated(material, points, np.flatnonzero(wanted))

    def _tabulated(self, material: Tabulated, points: SurfacePoints, wanted) -> np.ndarray:
        mi, dr = self.tracer.mi, self.tracer.dr
        tables = light_tables(material, points, millimetres_per_unit=self.millimetres_per_unit)
        taps = interpolator(material.lights)
        p, n, lights = len(points), len(self.directions), len(material.lights)
        grid = mi.UInt32(taps.grid.astype(np.uint32).ravel())
        affine = mi.Float(np.ascontiguousarray(taps.affine, np.float32).ravel())
        corners = mi.UInt32(np.ascontiguousarray(taps.triangles, np.uint32).ravel())
        table = mi.Float(tables.ravel())
        axes = [self.tracer.vector(a) for a in (points.tangent, points.bitangent, points.normal)]
        shared = self.tracer.vector(self.directions)

        lane = mi.UInt32(wanted.astype(np.uint32))
        point, direction = lane // dr.opaque(mi.UInt32, n), lane % dr.opaque(mi.UInt32, n)
        omega = dr.gather(mi.Vector3f, shared, direction)
        x, y, z = (dr.dot(dr.gather(mi.Vector3f, axis, point), omega) for axis in axes)
        above = z > 0
        u, v = x / (1 + z), y / (1 + z)  # the parabolic map
        column = mi.UInt32(dr.clip((u + 1) * (GRID / 2), 0, GRID - 1))
        row = mi.UInt32(dr.clip((v + 1) * (GRID / 2), 0, GRID - 1))
        triangle = dr.gather(mi.UInt32, grid, row * GRID + column, above)
        values, total = [mi.Float(0)] * 3, mi.Float(0)
        for corner in range(3):
            a, b, c = (dr.gather(mi.Float, affine, triangle * 9 + corner * 3 + i, above) for i in range(3))
            weight = dr.maximum(a * u + b * v + c, 0)
            total += weight
            tap = dr.gather(mi.UInt32, corners, triangle * 3 + corner, above)
            base = (point * dr.opaque(mi.UInt32, lights) + tap) * 3
            values = [values[c] + weight * dr.gather(mi.Float, table, base + c, above) for c in range(3)]
        scale = dr.select(above, z * dr.opaque(mi.Float, self.solid_angle) / total, 0)
        out = dr.zeros(mi.Float, 3 * p * n)
        for c in range(3):
            dr.scatter(out, values[c] * scale, lane + dr.opaque(mi.UInt32, c * p * n))
        return np.array(out).reshape(3, p, n)

    def reflected_directions(self) -> np.ndarray:
        """The mirror directions of the points' view directions: (p, 3) float64, unit."""
        normal, eye = self.points.normal, self.points.to_eye
        return 2 * (normal * eye).sum(1, keepdims=True) * normal - eye

    def _mirror(self, material: Mirror, lightings) -> np.ndarray:
        reflected = self.reflected_directions()
        seen = self.tracer.sees_sky(self.points.position, self.points.flat_normal, reflected)
        light = np.asarray(lightings.radiance(reflected), np.float32)
        light = np.broadcast_to(light, (*light.shape[:2], 3)) * np.asarray(material.reflectance, np.float32)
        return np.where(seen[:, None, None], light, np.float32(0))
