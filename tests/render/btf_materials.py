# SPDX-License-Identifier: GPL-3.0-or-later
"""Small tabulated materials that the tests of the renderer make."""

import numpy as np

from btfsep_engine.btf.directions import ubo2003_directions
from btfsep_engine.btf.model import Tabulated

LIST = ubo2003_directions()


def lobe(omega_i, omega_o, *, across: float, along: float, strength: float, base: float):
    """A coloured anisotropic Gaussian lobe about the half vector on a diffuse base; reciprocal, (..., 3) in 1/sr."""
    half = omega_i + omega_o
    half = half / np.linalg.norm(half, axis=-1, keepdims=True)
    slope2 = (half[..., 0] / across) ** 2 + (half[..., 1] / along) ** 2
    gloss = strength * np.exp(-slope2 / np.maximum(half[..., 2], 1e-3) ** 2)
    return np.stack([base + gloss, 0.7 * base + 0.8 * gloss, 0.4 * base + 0.6 * gloss], -1)


def table(**shape) -> np.ndarray:
    """``lobe`` at the 81 directions of UBO2003: (views, lights, 3)."""
    return lobe(LIST[None, :, :], LIST[:, None, :], **shape).astype(np.float32)


def matte() -> Tabulated:
    """Nearly diffuse, one texel."""
    flat = table(across=1.0, along=1.0, strength=0.04, base=0.2)
    return Tabulated("test/matte", "test", np.ones((1, 1, 1), np.float32), flat[..., None], LIST, LIST, 1.0)


def glossy() -> Tabulated:
    """Bright highlights, stretched along one axis, one texel."""
    flat = table(across=0.15, along=0.4, strength=1.2, base=0.03)
    return Tabulated("test/glossy", "test", np.ones((1, 1, 1), np.float32), flat[..., None], LIST, LIST, 1.0)


def textured(texel_mm: float = 5.0) -> Tabulated:
    """Anisotropic, and anything but constant from texel to texel: 24 x 32 texels, five components, some negative."""
    rng = np.random.default_rng(5)
    angular = np.stack(
        [
            table(across=0.2, along=0.7, strength=0.5, base=0.15),
            table(across=0.7, along=0.2, strength=0.3, base=0.02),
            *(0.1 * rng.normal(size=(3, len(LIST), len(LIST), 3))),
        ],
        -1,
    )
    texels = np.concatenate([np.ones((24, 32, 1)), 0.8 * rng.uniform(-0.4, 1, (24, 32, 4))], -1)
    return Tabulated(
        "test/textured", "test", texels.astype(np.float32), angular.astype(np.float32), LIST, LIST, texel_mm
    )


def diffuse(albedo: float) -> Tabulated:
    """A perfectly diffuse table."""
    flat = np.full((len(LIST), len(LIST), 3, 1), albedo / np.pi, np.float32)
    return Tabulated("test/diffuse", "test", np.ones((1, 1, 1), np.float32), flat, LIST, LIST, 1.0)
