# SPDX-License-Identifier: GPL-3.0-or-later
"""The camera: rays through image positions, and back, image positions of points.

Distortion is Brown and Conrady's, with the signs and the order of OpenCV (docs/formats.md has the formula): it takes
normalised coordinates of a pinhole, x to the right and y down, to those of the picture. A lens is taken at its word up
to where it folds the picture over; farther out, where no picture is, it goes on straight.
"""

from dataclasses import dataclass, replace

import numpy as np

STEPS = 30  # of Newton's method, at most; four or five as a rule
CLOSE = 1e-13  # normalised: no larger step is left
NEAREST = 1e-9  # of the largest coordinate: what lies behind a pinhole is taken as just before it, and so far outside


@dataclass(frozen=True)
class Camera:
    """A camera, a pinhole with a lens or orthographic.

    Attributes
    ----------
    width, height : pixels
    fx, fy : focal lengths in pixels; of an orthographic camera, pixels in a world unit
    cx, cy : pixels; pixel (0, 0) has its centre at (0.5, 0.5). Anywhere: the picture may be a part of a larger one
    to_world : (4, 4) float64, camera to world, rigid; the camera looks along its -Z with +Y up
    distortion : k1, k2, p1, p2; zero for an orthographic camera
    orthographic : whether all rays are parallel
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    to_world: np.ndarray
    distortion: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    orthographic: bool = False

    @property
    def focal(self) -> float:
        """The geometric mean of ``fx`` and ``fy``."""
        return float(np.sqrt(self.fx * self.fy))

    def shifted(self, right: float, down: float) -> "Camera":
        """The camera that shows everything, in pixels, so far to the right and down of where this one does."""
        return replace(self, cx=self.cx + right, cy=self.cy + down)

    def local_points(self, x, y, depth=1.0) -> np.ndarray:
        """Camera-space positions (..., 3) that are seen at image positions (pixels), ``depth`` along the view axis."""
        x, y, depth = np.broadcast_arrays(*(np.asarray(a, np.float64) for a in (x, y, depth)))
        right, down = (x - self.cx) / self.fx, (y - self.cy) / self.fy
        if self.orthographic:
            return np.stack([right, -down, -depth], -1)
        right, down = undistorted(right, down, self.distortion)
        return np.stack([right * depth, -down * depth, -depth], -1)

    def rays(self, x, y):
        """World-space rays through image positions.

        Parameters
        ----------
        x, y : (n,) float, pixels; 0.5 is the centre of the first pixel

        Returns
        -------
        origins : (n, 3) float64
        directions : (n, 3) float64, unit
        """
        rotation, place = self.to_world[:3, :3], self.to_world[:3, 3]
        if self.orthographic:
            origins = self.local_points(x, y, 0.0) @ rotation.T + place
            return origins, np.broadcast_to(-rotation[:, 2], origins.shape).copy()
        directions = self.local_points(x, y) @ rotation.T
        directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
        return np.broadcast_to(place, directions.shape).copy(), directions

    def project(self, points) -> np.ndarray:
        """Image positions (n, 2), x and y, of points (n, 3) in the world; those behind a pinhole lie far away."""
        local = (np.asarray(points) - self.to_world[:3, 3]) @ self.to_world[:3, :3]
        at = local[:, :2] * (1.0, -1.0)
        if not self.orthographic:
            at /= np.maximum(-local[:, 2:], NEAREST * np.abs(local).max(initial=1e-300))
            if any(self.distortion):
                at = np.stack(distorted(*at.T, self.distortion), -1)
        at *= (self.fx, self.fy)
        at += (self.cx, self.cy)
        return at

    def seen_from(self, points):
        """From where, and how finely, the camera sees points (n, 3) in the world.

        Returns
        -------
        to_eye : (n, 3) float64, unit
        pixel : (n,) float64, edge in world units of what a pixel covers of a surface that faces the camera there; what
            distortion changes of it is left out
        """
        points = np.asarray(points, np.float64)
        if self.orthographic:
            return np.broadcast_to(self.to_world[:3, 2], points.shape).copy(), np.full(len(points), 1 / self.focal)
        to_eye = self.to_world[:3, 3] - points
        distance = np.linalg.norm(to_eye, axis=1)
        return to_eye / distance[:, None], distance / self.focal

    @property
    def folded(self) -> bool:
        """Whether the lens shows some part of the picture's edge twice, or nothing there, so that no ray is right."""
        if not any(self.distortion):
            return False
        along = np.linspace(0, 1, 33)
        x, y = np.meshgrid(along * self.width, along * self.height)
        x, y = (x - self.cx) / self.fx, (y - self.cy) / self.fy
        right, down = undistorted(x, y, self.distortion)
        again = np.stack(distorted(right, down, self.distortion)) - np.stack([x, y])
        off = np.abs(again).max() * self.focal
        return not off < 1e-3 or bool((right**2 + down**2 >= _fold(self.distortion)).any())


def distorted(x, y, distortion):
    """Normalised coordinates of the picture of those of a pinhole; arrays of one shape."""
    k1, k2, p1, p2 = distortion
    if not any(distortion):
        return x, y
    r2 = x**2 + y**2
    inwards = np.sqrt(np.minimum(_fold(distortion) / np.maximum(r2, 1e-300), 1.0))
    x, y = x * inwards, y * inwards
    r2 = x**2 + y**2
    radial = 1 + r2 * (k1 + k2 * r2)
    right = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2)
    down = y * radial + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y
    return right / inwards, down / inwards


def undistorted(x, y, distortion):
    """The inverse of :func:`distorted`, by Newton's method: with a fixed point's steps, as OpenCV's, the edge of a
    strong lens's picture is not reached."""
    k1, k2, p1, p2 = distortion
    if not any(distortion):
        return x, y
    right, down = np.array(x, np.float64), np.array(y, np.float64)
    for _ in range(STEPS):
        r2 = right**2 + down**2
        radial, slope = 1 + r2 * (k1 + k2 * r2), 2 * (k1 + 2 * k2 * r2)
        a = radial + slope * right**2 + 2 * p1 * down + 6 * p2 * right
        b = slope * right * down + 2 * p1 * right + 2 * p2 * down
        c = radial + slope * down**2 + 6 * p1 * down + 2 * p2 * right
        u, v = distorted(right, down, distortion)
        u, v, determinant = x - u, y - v, np.maximum(a * c - b * b, 1e-3)
        steps = [np.clip(s / determinant, -1, 1) for s in (c * u - b * v, a * v - b * u)]
        right, down = right + steps[0], down + steps[1]
        if np.abs(steps).max(initial=0) < CLOSE:
            break
    return right, down


def _fold(distortion) -> float:
    """The squared radius, before the lens, at which a larger radius stops to give a larger one behind it; infinity."""
    k1, k2 = distortion[:2]
    roots = np.roots([5 * k2, 3 * k1, 1.0])
    real = roots.real[(np.abs(roots.imag) < 1e-12) & (roots.real > 0)]
    return float(real.min(initial=np.inf))
