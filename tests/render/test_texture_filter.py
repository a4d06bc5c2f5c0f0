# SPDX-License-Identifier: GPL-3.0-or-later
"""A pixel's spatial factor is the mean of the finest texels over what the pixel covers, at any slant and size."""

import numpy as np
import pytest

from btfsep_engine.btf.model import Tabulated
from btfsep_engine.render.appearance import pixel_edges, spatial_factors
from btfsep_engine.render.surface import SurfacePoints

TEXEL = 0.25  # millimetres
WIDTH, HEIGHT = 64, 48


@pytest.fixture(scope="module")
def material():
    """Texture with detail at every scale down to single texels, three components."""
    rng = np.random.default_rng(3)
    frequency = np.hypot(np.fft.fftfreq(HEIGHT)[:, None], np.fft.fftfreq(WIDTH)[None])
    spectrum = np.fft.fft2(rng.normal(size=(HEIGHT, WIDTH, 3)), axes=(0, 1)) / (frequency + 0.05)[..., None]
    texels = np.fft.ifft2(spectrum, axes=(0, 1)).real
    texels = 1 + 0.3 * texels / texels.std()

    up = np.array([[0.0, 0.0, 1.0]])
    return Tabulated("t", "test", texels.astype(np.float32), np.ones((1, 1, 3, 3), np.float32), up, up, TEXEL)


def finest(texels, at):
    """Periodic bilinear look-up written apart from the kernel's: separable tents over all texels."""

    def tents(x, size):
        distance = np.abs((x[:, None] - np.arange(size) - 0.5 + size / 2) % size - size / 2)
        return np.maximum(1 - distance, 0)

    rows, columns = tents(at[:, 1] / TEXEL, HEIGHT), tents(at[:, 0] / TEXEL, WIDTH)
    return np.einsum("nr,nc,rck->nk", rows, columns, texels, optimize=True)


@pytest.mark.parametrize("size", [0.3, 1.0, 3.0, 6.0])
@pytest.mark.parametrize("cosine", [1.0, 0.5, 0.25])
def test_factors_are_the_mean_over_the_pixel(material, size, cosine):
    rng = np.random.default_rng(7)
    n, side = 60, 24
    uv = rng.uniform(0, 40, (n, 2))
    turn = rng.uniform(0, 2 * np.pi, n)
    long = np.stack([np.cos(turn), np.sin(turn)], -1)
    edges = np.stack([long / cosine, np.stack([-long[:, 1], long[:, 0]], -1)], 1) * size * TEXEL
    steps = (np.arange(side) + 0.5) / side - 0.5
    places = uv + (steps[:, None, None, None] * edges[:, 0] + steps[None, :, None, None] * edges[:, 1])
    truth = finest(material.texels, places.reshape(-1, 2)).reshape(side * side, n, 3).mean(0)
    error = np.sqrt(((spatial_factors(material, uv, edges) - truth) ** 2).mean() / (truth**2).mean())
    assert error < 0.03


def test_a_pixel_covers_its_projection():
    """The patch's edges against two rays half a pixel to each side, met with the surface's plane."""
    slant, size = 0.3, 0.02
    normal = np.array([[np.sqrt(1 - slant**2), 0, slant]])  # the eye looks along -z: tilted about y
    tangent, bitangent = np.array([[0.0, 1, 0]]), np.cross(normal, [[0.0, 1, 0]])
    points = SurfacePoints(
        np.zeros((1, 2), np.int32),
        np.zeros((1, 3)),
        normal,
        normal,
        np.array([[0.0, 0, 1]]),
        np.zeros(1, np.int32),
        np.full((1, 3), 1 / 3, np.float32),
        np.array([size / np.sqrt(slant)]),
        tangent,
        bitangent,
        np.zeros((1, 2)),
    )
    covered = []
    for step in ([size, 0, 0], [0, size, 0]):
        met = np.array([*step[:2], -(normal[0, :2] @ step[:2]) / slant])
        covered.append([met @ tangent[0], met @ bitangent[0]])
    assert np.allclose(np.abs(pixel_edges(points)[0]), np.abs(covered), atol=1e-9)
