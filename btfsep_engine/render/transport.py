# SPDX-License-Identifier: GPL-3.0-or-later
"""The light-transport kernel: radiance of chosen pixels under M lightings at once.

Light is linear (the paper's eq. 10), so the image-based relighting integral (eq. 1)

    L_r(x, omega_o) = int BTF(x, omega_i, omega_o) V(x, omega_i) cos(theta_i) L_i(omega_i) d omega_i

is one matrix product: the pixels' weights W = BTF V cos d_omega over a set of directions, shared by all
pixels, times the lightings' radiance in these directions. A ray is traced once, whatever the material and
however many the lightings. The shared set keeps the error of the quadrature smooth from pixel to pixel,
which the fit forgives; independent random directions would be noise in its matrix (errors in variables).
"""

from functools import cached_property

import numpy as np

from btfsep_engine.btf.model import Material
from btfsep_engine.conventions import fibonacci_sphere
from btfsep_engine.linear_algebra import product
from btfsep_engine.render.surface import SurfacePoints
from btfsep_engine.render.tracer import Tracer
from btfsep_engine.render.weights import Weights
from btfsep_engine.storage import kept
from btfsep_engine.threads import one_thread

LANES = 1 << 21  # weights computed at once: 25 MB a channel triple
KEPT = 1 << 28  # rays whose answers are kept for the next material; more are traced anew


class Transport:
    """Transport to one object's surface points; the rays are traced once, when they are first needed.

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
        self._seen = {}
        self._lit = (), []

    @cached_property
    def visible(self) -> np.ndarray:
        """(points, directions) bool: which directions each point sees the sky in."""
        parts = [np.array(self._visible(part)) for part in self._parts()]
        return np.concatenate([*parts, np.zeros(0, bool)]).reshape(len(self.points), len(self.directions))

    def _parts(self):
        """Slices of the points whose weights are computed at once."""
        step = max(1, LANES // len(self.directions))
        return [slice(start, min(len(self.points), start + step)) for start in range(0, len(self.points), step)]

    def _visible(self, part: slice):
        """Mitsuba Bool, a lane for each direction of each point of the part."""
        if part.start in self._seen:
            return self._seen[part.start]
        points = self.points.take(part)
        parts = [self.tracer.key, points.position, points.flat_normal, len(self.directions)]

        def traced():
            return self.tracer.visible_lanes(points.position, points.flat_normal, self.directions)

        seen = kept.recalled("rays", parts, traced, size=len(points) * len(self.directions))
        if len(self.points) * len(self.directions) <= KEPT:
            self._seen[part.start] = seen
        return seen

    def _lights(self, lightings: tuple) -> list:
        """Each in the shared directions, 1 or 3 channels of (n, M) float32; kept for the next material."""
        known, lights = self._lit
        if len(known) != len(lightings) or any(a is not b for a, b in zip(known, lightings, strict=True)):
            averages = [np.moveaxis(each.cell_averages(self.directions), 2, 0) for each in lightings]
            lights = [np.ascontiguousarray(each, np.float32) for each in averages]
            self._lit = lightings, lights
        return lights

    def radiance(self, material: Material, lightings) -> np.ndarray:
        """Radiance towards the camera by the light that comes straight from outside the scene.

        Parameters
        ----------
        material : Material
        lightings : light.lightings.Lightings, M of them

        Returns
        -------
        (p, M, 3) float32, the channels outermost in memory; of a basis it is kept for the next photo, and not writable
        """
        return self.radiances(material, lightings)[0]

    def radiances(self, material: Material, *lightings) -> list[np.ndarray]:
        """`radiance` of each of several lightings: what the material makes of the shared directions is found once."""
        found: list = []

        def made(number: int) -> np.ndarray:
            if not found:
                found.extend(self._radiances(material, lightings))
            return found[number]

        return [
            kept.recalled("basis", [self.key, material, each], lambda number=number: made(number))
            if each.returns
            else made(number)
            for number, each in enumerate(lightings)
        ]

    @cached_property
    def key(self) -> str:
        """Of rays and points, whatever the material (`kept.content`)."""
        return kept.content([self.tracer.key, self.points, len(self.directions), float(self.millimetres_per_unit)])

    @one_thread()  # as `LightTables.tables_at`
    def _radiances(self, material: Material, lightings: tuple) -> list[np.ndarray]:
        if material.mirror_reflectance is not None:
            return [self._mirror(material, each) for each in lightings]
        lights = self._lights(lightings)
        weights = self.weights(material)
        outs = [np.empty((3, len(self.points), light.shape[2]), np.float32) for light in lights]
        for part in self._parts():
            channels = weights.of_all(self.points.take(part), self._visible(part))
            for light, out in zip(lights, outs, strict=True):
                for c in range(3):
                    if c and len(channels) == len(light) == 1:
                        out[c, part] = out[0, part]
                    else:
                        product(channels[min(c, len(channels) - 1)], light[min(c, len(light) - 1)], out=out[c, part])
        for out in outs:
            if (weights.colour != 1).any():
                out *= weights.colour[:, None, None]
        return [out.transpose(1, 2, 0) for out in outs]

    def weights(self, material: Material) -> Weights:
        """What the material makes of light from the shared directions."""
        return Weights(material, self.directions, millimetres_per_unit=self.millimetres_per_unit)

    def reflected_directions(self) -> np.ndarray:
        """The mirror directions of the points' view directions: (p, 3) float64, unit."""
        normal, eye = self.points.normal, self.points.to_eye
        return 2 * (normal * eye).sum(1, keepdims=True) * normal - eye

    def mirrored(self, lightings) -> np.ndarray:
        """What a perfect mirror shows of lightings at the points: (p, M, 3) float32; black where it shows the scene."""
        reflected = self.reflected_directions()
        seen = self.tracer.sees_sky(self.points.position, self.points.flat_normal, reflected)
        light = np.asarray(lightings.radiance(reflected), np.float32)
        return np.where(seen[:, None, None], np.broadcast_to(light, (*light.shape[:2], 3)), np.float32(0))

    def _mirror(self, material: Material, lightings) -> np.ndarray:
        return self.mirrored(lightings) * material.mirror_reflectance.astype(np.float32)
