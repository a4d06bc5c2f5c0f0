# SPDX-License-Identifier: GPL-3.0-or-later
"""What a photograph's pixels make of light from the cells of the sphere, for simple reflectances.

The two methods that estimate reflectance and light together share this: the light is constant in 16 x 32 cells of
equal solid angle, and a pixel's radiance is a sum over them, sum_j w_j K_j L, with one matrix K_j for each lobe
(self-shadowing is in it, light between surfaces is not: neither paper has it).
"""

from dataclasses import dataclass

import numpy as np

from btfsep_engine import sh
from btfsep_engine.render.sampling import spread
from scripts.studies.estimates import scene_of

ROWS, COLUMNS = 16, 32
FINE = 2  # directions of a cell, along each side
F0 = 0.04  # of all glossy lobes; their weights can make it anything


def directions(fine: int = FINE) -> np.ndarray:
    """(ROWS * COLUMNS * fine^2, 3) float64: the directions of the cells, those of one cell together."""
    i = (np.arange(ROWS * fine) + 0.5) / (ROWS * fine)
    j = (np.arange(COLUMNS * fine) + 0.5) / (COLUMNS * fine)
    z, azimuth = np.meshgrid(1 - 2 * i, 2 * np.pi * j, indexing="ij")
    r = np.sqrt(1 - z * z)
    d = np.stack([r * np.cos(azimuth), r * np.sin(azimuth), z], -1)
    return d.reshape(ROWS, fine, COLUMNS, fine, 3).transpose(0, 2, 1, 3, 4).reshape(-1, 3)


def to_coefficients(light, order: int) -> np.ndarray:
    """SH coefficients ((order + 1)^2, 3) of a light of (cells, 3)."""
    basis = sh.evaluate(order, directions()).reshape(ROWS * COLUMNS, FINE * FINE, -1).mean(1)
    return basis.T @ np.asarray(light, np.float64) * (4 * np.pi / (ROWS * COLUMNS))


@dataclass(frozen=True)
class Seen:
    """Surface points.

    Attributes
    ----------
    normal, to_eye : (p, 3) float64, unit
    visible : (p, directions) bool, of `directions`
    """

    normal: np.ndarray
    to_eye: np.ndarray
    visible: np.ndarray

    def _to_cells(self, values) -> np.ndarray:
        """Values f cos V (p, directions) as a matrix over cells: (p, cells) float32."""
        summed = (values * self.visible).reshape(len(values), ROWS * COLUMNS, FINE * FINE).mean(2)
        return summed * np.float32(4 * np.pi / (ROWS * COLUMNS))

    def lambert(self) -> np.ndarray:
        """The matrix (p, cells) of f = 1 / pi."""
        cosine = np.maximum(self.normal @ directions().T, 0).astype(np.float32)
        return self._to_cells(cosine / np.float32(np.pi))

    def ggx(self, alpha: float) -> np.ndarray:
        """The matrix (p, cells) of a GGX lobe (Walter et al. 2007), its Fresnel term Schlick's with F0."""
        light = directions()
        nl = np.maximum(self.normal @ light.T, 1e-4).astype(np.float32)
        nv = np.maximum((self.normal * self.to_eye).sum(1, keepdims=True), 1e-3).astype(np.float32)
        vl = (self.to_eye @ light.T).astype(np.float32)
        # |v + l| = sqrt(2 + 2 v.l), so n.h and v.h need no half vector
        length = np.sqrt(np.maximum(2 + 2 * vl, 1e-6))
        nh, vh = np.clip((nl + nv) / length, 0, 1), length / 2
        a2 = np.float32(alpha * alpha)
        d = a2 / (np.float32(np.pi) * ((a2 - 1) * nh * nh + 1) ** 2)
        masked = (nl + np.sqrt(a2 + (1 - a2) * nl * nl)) * (nv + np.sqrt(a2 + (1 - a2) * nv * nv))
        fresnel = F0 + (1 - F0) * (1 - vh) ** 5
        return self._to_cells(d * fresnel / masked * nl * (nl > 1e-4))


def look(folder, *, count: int, shadows: bool = True):
    """What a job's camera sees of its first object (without ``shadows`` every direction counts as visible).

    Returns
    -------
    seen : Seen, of about ``count`` pixels
    radiance : (p, 3) float64, the photograph's
    """
    scene = scene_of(folder)
    points = scene.points(0, textured=False)
    points = points.take(np.flatnonzero(scene.usable(points)))
    points = points.take(spread(points, count))
    visible = scene.tracer.visible(points.position, points.flat_normal, directions()) if shadows else np.ones((1, 1))
    photo = scene.job.photo.radiance[tuple(points.pixels.T)]
    return Seen(points.normal, points.to_eye, visible), photo.astype(np.float64)
