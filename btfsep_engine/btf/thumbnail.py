# SPDX-License-Identifier: GPL-3.0-or-later
"""A small picture of a material: a ball before the flat material, under a studio's three lights."""

import numpy as np

from btfsep_engine.btf.model import Material

LIGHTS = (((-0.62, 0.45, 0.64), 2.6), ((0.75, -0.1, 0.65), 0.5), ((0.0, 0.3, 0.95), 0.4))  # direction, irradiance
PATCH_MM = 80.0  # the picture's width
BALL = 0.78  # of the width
SAMPLES = 2  # along an edge of a pixel


def render(material: Material, side: int = 160) -> np.ndarray:
    """(side, side, 3) float32, linear; the top row first."""
    fine = side * SAMPLES
    c = (np.arange(fine) + 0.5) / fine * 2 - 1
    x, y = (a.ravel() for a in np.meshgrid(c, -c))
    bx, by = x / BALL, y / BALL
    on = bx * bx + by * by < 0.998
    normal = np.zeros((len(x), 3))
    normal[:, 2] = 1
    normal[on, 0], normal[on, 1] = bx[on], by[on]
    normal[on, 2] = np.sqrt(1 - bx[on] ** 2 - by[on] ** 2)
    tangent = np.cross([0.0, 1.0, 0.0], normal)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    frame = np.stack([tangent, np.cross(normal, tangent), normal], 1)  # rows: world to local
    half = PATCH_MM / 2
    position = np.stack([x, y], -1) * half
    angles = np.stack([np.arctan2(normal[:, 0], normal[:, 2]), np.arcsin(np.clip(normal[:, 1], -1, 1))], -1)
    position[on] = angles[on] * (BALL * half)
    image = _shaded(material, position, frame) * np.where(on, 1.0, 0.35)[:, None]  # the ball stands out
    image = image.reshape(side, SAMPLES, side, SAMPLES, 3).mean((1, 3))
    return image.astype(np.float32)


def _shaded(material, position, frame) -> np.ndarray:
    eye = frame @ np.array([0.0, 0.0, 1.0])
    eye[:, 2] = np.maximum(eye[:, 2], 1e-3)
    if material.mirror_reflectance is not None:
        mirrored = 2 * eye[:, 2:] * frame[:, 2] - [0.0, 0.0, 1.0]
        sky = 0.25 + 0.75 * np.clip(mirrored[:, 1:2], 0, 1)
        for direction, strength in LIGHTS:
            d = np.array(direction) / np.linalg.norm(direction)
            sky = sky + strength * (mirrored @ d > 0.97)[:, None]
        return sky * material.mirror_reflectance
    total = np.zeros((len(position), 3))
    for direction, strength in LIGHTS:
        local = frame @ (np.array(direction) / np.linalg.norm(direction))
        cosine = np.maximum(local[:, 2:], 0)
        local[:, 2] = np.maximum(local[:, 2], 1e-3)
        total += material.abrdf(position, local, eye) * (cosine * strength)
    return total
