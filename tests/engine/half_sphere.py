# SPDX-License-Identifier: GPL-3.0-or-later
"""A sphere seen from one side and a light on it: small fits whose truth is known."""

import numpy as np

from btfsep_engine import sh

ORDER = 4


def half_sphere(rng, pixels=1500, order=ORDER, albedo=(0.7, 0.5, 0.3)):
    """A matte sphere with a little gloss, seen from -y: basis images (p, terms, 3), and patches of it."""
    n = rng.normal(size=(pixels, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    n[:, 1] = -np.abs(n[:, 1])
    eye = np.array([0.0, -1.0, 0.0])
    mirrored = 2 * (n @ eye)[:, None] * n - eye
    l = np.repeat(np.arange(order + 1), 2 * np.arange(order + 1) + 1)
    matte = sh.evaluate(order, n) * sh.cosine_lobe(order)[l] / np.pi
    gloss = 0.3 * sh.evaluate(order, mirrored) * np.exp(-l * (l + 1) * 0.03)
    blocks = np.unique((n[:, 0] // 0.25) * 100 + n[:, 2] // 0.25, return_inverse=True)[1].reshape(-1)
    return np.stack([a * matte + gloss for a in albedo], -1), blocks


def side_light():
    """Light from the camera's upper left, (terms, 3): its brightest pixels are in view."""
    direction = np.array([-0.5, -0.6, 0.62])
    lobe = np.exp(-0.12 * np.arange(ORDER + 1) ** 2)
    l = np.repeat(np.arange(ORDER + 1), 2 * np.arange(ORDER + 1) + 1)
    x = (lobe[l] * sh.evaluate(ORDER, direction[None])[0])[:, None] * [1.0, 0.9, 0.7]
    x[0] += 1.0
    return x


def off(fit, x) -> float:
    """Relative error up to order 2, no free scale."""
    return float(np.linalg.norm(fit.coefficients[:9] - x[:9]) / np.linalg.norm(x[:9]))
