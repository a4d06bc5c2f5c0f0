# SPDX-License-Identifier: GPL-3.0-or-later
"""Unshadowed spheres seen from one side, and lights on them: small fits whose truth is known."""

import numpy as np

from btfsep_engine import sh
from btfsep_engine.conventions import fibonacci_sphere

ORDER = 9  # of a fit under the prior
SUN = np.array([-0.5, -0.6, 0.62]) / np.linalg.norm([-0.5, -0.6, 0.62])  # upper left of the camera, and in front
FILL = np.array([0.8, -0.5, -0.33]) / np.linalg.norm([0.8, -0.5, -0.33])


def half_sphere(rng, pixels=1500, albedo=(0.7, 0.5, 0.3), gloss=0.3):
    """A matte sphere with a little gloss, seen from -y: basis images (p, 100, 3), normals, and patches of it."""
    n = rng.normal(size=(pixels, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    n[:, 1] = -np.abs(n[:, 1])
    eye = np.array([0.0, -1.0, 0.0])
    mirrored = 2 * (n @ eye)[:, None] * n - eye
    l = sh.degrees(ORDER)
    matte = sh.evaluate(ORDER, n) * sh.cosine_lobe(ORDER)[l] / np.pi
    shine = gloss * sh.evaluate(ORDER, mirrored) * np.exp(-l * (l + 1) * 0.03)
    blocks = np.unique((n[:, 0] // 0.25) * 100 + n[:, 2] // 0.25, return_inverse=True)[1].reshape(-1)
    return np.stack([a * matte + shine for a in albedo], -1), n, blocks


def project(radiance):
    """The coefficients (100, 3) of a function of directions (m, 3) to radiance (m, 3)."""
    d = fibonacci_sphere(4000)
    return sh.evaluate(ORDER, d).T @ radiance(d) * (4 * np.pi / len(d))


def lamp(direction, irradiance):
    """The coefficients (100, 3) of a point of that irradiance."""
    return sh.evaluate(ORDER, np.asarray(direction)[None])[0][:, None] * np.asarray(irradiance)


def even(radiance=(1.0, 1.0, 1.0)):
    """The coefficients (100, 3) of light that is the same from everywhere."""
    x = np.zeros((100, 3))
    x[0] = np.sqrt(4 * np.pi) * np.asarray(radiance)
    return x


def side_light():
    """A broad light from the camera's upper left, (100, 3): its brightest pixels are in view."""
    tint = np.array([1.0, 0.95, 0.85])
    return project(lambda d: (0.3 + 2 * np.exp(3 * (d @ SUN - 1)))[:, None] * tint)


def shown(basis, x, rng=None, noise=0.0):
    """The photograph (p, 3) of a light, each value off by a part ``noise``."""
    b = np.einsum("pmc,mc->pc", basis, x)
    return b if rng is None else b * (1 + noise * rng.normal(size=b.shape))


def off(fit, x) -> float:
    """Relative error up to order 2, no free scale."""
    return float(np.linalg.norm(fit.all_coefficients[:9] - x[:9]) / np.linalg.norm(x[:9]))
