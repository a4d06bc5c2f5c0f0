# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures of the three spheres of the published comparisons, integrated instead of path-traced.

The scene is that of ``stylelight/{mirror,matte_silver,diffuse}.py`` in DiffusionLight-evaluation (first StyleLight's):
a sphere at the origin, seen from (0, -16, 2) with 85 mm on a sensor of 36 mm, 960 x 540 pixels, under a World. The
materials are the *Principled BSDF* of Blender 3.6, which newer versions no longer have: GGX without multiple
scattering, and Burley's diffuse lobe with nothing taken off for the gloss above it. The matte silver's node tree there
also mixes in a *Glossy BSDF*, but does not link the mix to the output: the *Principled BSDF* alone is seen.

A sphere is convex and the light is distant, so a pixel is one integral over the map. All but the light is the same all
around the camera's axis: a point is told by its ray's angle of incidence and by its turn around that axis. Left out is
the blur of the lens (f / 0.5), 0.8 pixels to either side in the middle of the sphere and 0.1 at the rim.
"""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import map_coordinates

from btfsep_engine.conventions import direction_to_equirect, pixel_directions, pixel_solid_angles

HEIGHT, WIDTH = 540, 960  # pixels
FOCAL = WIDTH * 85 / 36  # pixels
DISTANCE = np.hypot(16.0, 2.0)
FRAME = np.array([[DISTANCE, 0, 0], [0, 2, 16], [0, -16, 2]]) / DISTANCE  # right, up, to the eye
# The sphere is one of 32 x 16 faces, subdivided once, which draws it in, and at the equator more than at the poles:
# its outline, as Blender renders it, has this mean radius, and is higher and narrower by this share.
RADIUS, STRETCHED = 0.9896, 0.004
ACROSS = 3  # rays over a pixel, each way
BASE = 0.8  # the colour of all three


@dataclass(frozen=True)
class Principled:
    """What is set of a *Principled BSDF*; the rest is as Blender 3.6 makes a new one."""

    metallic: bool
    specular: float
    roughness: float

    def reflectance(self, cosine):
        """Of a facet, at the cosine of the angle to its normal; all colours alike."""
        ior = 2 / (1 - np.sqrt(0.08 * self.specular)) - 1
        at_normal = ((ior - 1) / (ior + 1)) ** 2
        g = np.sqrt(ior**2 - 1 + cosine**2)
        dielectric = ((g - cosine) / (g + cosine)) ** 2 / 2
        dielectric *= 1 + ((cosine * (g + cosine) - 1) / (cosine * (g - cosine) + 1)) ** 2
        facing = BASE if self.metallic else 0.08 * self.specular
        return facing + (1 - facing) * (dielectric - at_normal) / (1 - at_normal)


MATERIALS = {
    "mirror": Principled(metallic=True, specular=0.2, roughness=0.0),
    "matte_silver": Principled(metallic=True, specular=0.0, roughness=0.3271),
    "diffuse": Principled(metallic=False, specular=0.5, roughness=0.364),
}
# Gloss and matte are smooth over the sphere and are integrated at these points only; the last one is the rim.
INCIDENCES = np.linspace(0, np.radians(89.8), 61)
TURNS = 2 * np.pi * np.arange(120) / 120
SAMPLES = 512
SMOOTH_ROWS = 128  # of the map that gloss sees, at most: a pixel is about as large as what a sample stands for,
FINE_ROWS = 512  # and of the same map, enlarged so that the nearest pixel is near enough
MATTE_ROWS = 32  # of the map that the matte lobe is summed over


def blender_spheres(*maps):
    """The three spheres under maps.

    Parameters
    ----------
    maps : (h, w, 3) float each, >= 0: radiance as `btfsep_engine.conventions` says, each of any size

    Returns
    -------
    pictures : {"mirror", "matte_silver", "diffuse": (n, 540, 960, 3) float64, a picture under each map}, premultiplied:
        0 off the sphere, and darker where a pixel is partly on it
    seen : (540, 960) bool, where a pixel has at least a part of it
    """
    incidence, turn, hit = _rays()
    mirrored = _to_world(_plane(2 * incidence - _parallax(incidence)), turn)
    reflectance = MATERIALS["mirror"].reflectance(np.cos(incidence))[:, None]
    smooth = np.concatenate([_smoothed(a) for a in maps], -1)
    gloss = {kind: _gloss(MATERIALS[kind], smooth) for kind in ("matte_silver", "diffuse")}
    gloss["diffuse"] += _matte(MATERIALS["diffuse"].roughness, np.concatenate([_powers(a) for a in maps], -1))
    pictures = {kind: np.zeros((len(maps), HEIGHT, WIDTH, 3)) for kind in MATERIALS}
    for n, light in enumerate(maps):
        values = {"mirror": reflectance * look_up(light, mirrored)}
        for kind, points in gloss.items():
            values[kind] = _between_points(points[..., 3 * n : 3 * n + 3], incidence, turn)
        for kind, found in values.items():
            rays = np.zeros((*hit.shape, 3))
            rays[hit] = found
            pictures[kind][n] = rays.mean((1, 3))
    return pictures, hit.any((1, 3))


def look_up(light, directions) -> np.ndarray:
    """A map (h, w, c) in ``directions : (..., 3)``, bilinear: (..., c)."""
    h, w = light.shape[:2]
    u, v = direction_to_equirect(directions)
    bordered = np.pad(np.pad(light, ((1, 1), (0, 0), (0, 0)), mode="edge"), ((0, 0), (1, 1), (0, 0)), mode="wrap")
    at = [(1 - v) * h + 0.5, u * w + 0.5]  # pixel centres of the bordered map are whole numbers
    return np.stack([map_coordinates(bordered[..., c], at, order=1) for c in range(light.shape[2])], -1)


def averaged(image, height: int, width: int) -> np.ndarray:
    """An image (h, w, c) at another size: each pixel is the mean of the area it covers, float64."""
    a = np.asarray(image, np.float64)
    return np.einsum("ih,hwc,jw->ijc", _overlap(len(a), height), a, _overlap(a.shape[1], width), optimize=True)


def _overlap(given: int, wanted: int) -> np.ndarray:
    """(wanted, given): the share that each of the given cells of a length has in a wanted one; rows sum to 1."""
    first, cell = np.arange(wanted)[:, None] / wanted, np.arange(given) / given
    common = np.minimum(first + 1 / wanted, cell + 1 / given) - np.maximum(first, cell)
    return np.maximum(common, 0) * wanted


def _parallax(incidence):
    """The angle at the camera between its axis and a point."""
    return np.arcsin(RADIUS / DISTANCE * np.sin(incidence))


def _rays():
    """Rays over all pixels. Incidence and turn of the r that meet the sphere: (r,), and which do: (540, 3, 960, 3)."""
    x = (np.arange(WIDTH * ACROSS) + 0.5) / ACROSS - WIDTH / 2
    y = HEIGHT / 2 - (np.arange(HEIGHT * ACROSS) + 0.5) / ACROSS
    off = np.hypot(x, y[:, None]) / FOCAL
    radius = RADIUS * (1 - STRETCHED * np.cos(2 * np.arctan2(y[:, None], x)))
    sine = DISTANCE / radius * off / np.sqrt(1 + off**2)
    row, column = np.nonzero(sine < 1)
    hit = (sine < 1).reshape(HEIGHT, ACROSS, WIDTH, ACROSS)
    return np.arcsin(sine[row, column]), np.arctan2(y[row], x[column]), hit


def _plane(angle):
    """Directions (..., 3) in the plane of axis and point, at an angle to the axis: (outwards, around, to the eye)."""
    return np.stack([np.sin(angle), np.zeros_like(angle), np.cos(angle)], -1)


def _to_world(local, turn):
    """World directions of ``local : (..., 3)``, (outwards, around, to the eye), turned around the axis."""
    out, around, towards = np.moveaxis(local, -1, 0)
    c, s = np.cos(turn), np.sin(turn)
    return np.stack([out * c - around * s, out * s + around * c, towards * np.ones_like(turn)], -1) @ FRAME


def _smoothed(light) -> np.ndarray:
    """A map as gloss looks it up, (2 h^2, 3) float32 in rows: without what is too small to be met by its samples."""
    h = min(len(light), SMOOTH_ROWS)
    fine = look_up(averaged(light, h, 2 * h), pixel_directions(FINE_ROWS, 2 * FINE_ROWS))
    return fine.reshape(-1, 3).astype(np.float32)


def _powers(light) -> np.ndarray:
    """A map's radiance times solid angle, collected into the cells that the matte lobe sums over: (r 2 r, 3)."""
    h, w = light.shape[:2]
    each = averaged(light * pixel_solid_angles(h, w)[:, None, None], MATTE_ROWS, 2 * MATTE_ROWS)
    return each.reshape(-1, 3) * (h * w / (2 * MATTE_ROWS**2))


def _gloss(material: Principled, smooth) -> np.ndarray:
    """What GGX reflects of maps, ``smooth : (cells, c)`` by `_smoothed`, at `INCIDENCES` and `TURNS`: (n, m, c).

    The visible normals are spread over the lobe (Heitz 2018), the same ones for all maps and turns.
    """
    k = np.arange(SAMPLES) + 0.5
    radius, angle = np.sqrt(k / SAMPLES), np.pi * (1 + np.sqrt(5)) * k
    out = np.empty((len(INCIDENCES), len(TURNS), smooth.shape[1]))
    alpha = material.roughness**2
    for row, incidence in enumerate(INCIDENCES):
        eye = np.array([np.sin(incidence), 0, np.cos(incidence)])  # about the normal, which is the third axis
        stretched = eye * [alpha, alpha, 1]
        stretched /= np.linalg.norm(stretched)
        across = np.cross(stretched, [0, 1, 0])
        p, q = radius * np.cos(angle), radius * np.sin(angle)
        share = (1 + stretched[2]) / 2
        q = (1 - share) * np.sqrt(1 - p**2) + share * q
        normal = (
            p[:, None] * [0, 1, 0] + q[:, None] * across + np.sqrt(np.maximum(1 - p**2 - q**2, 0))[:, None] * stretched
        )
        normal *= [alpha, alpha, 1]
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        cosine = normal @ eye
        light = 2 * cosine[:, None] * normal - eye
        up = light[:, 2] > 0
        light, cosine = light[up], cosine[up]
        hidden = 1 + _masked(eye[2], alpha)
        weight = material.reflectance(cosine) * hidden / (hidden + _masked(light[:, 2], alpha)) / SAMPLES
        turned = incidence - _parallax(incidence)  # the angle of the point's normal to the axis
        c, s = np.cos(turned), np.sin(turned)
        local = np.stack([light[:, 2] * s - light[:, 0] * c, light[:, 1], light[:, 2] * c + light[:, 0] * s], -1)
        u, v = direction_to_equirect(_to_world(local, TURNS[:, None]))
        line = np.minimum(((1 - v) * FINE_ROWS).astype(np.int64), FINE_ROWS - 1)
        column = (u * 2 * FINE_ROWS).astype(np.int64) % (2 * FINE_ROWS)
        out[row] = weight @ smooth[line * 2 * FINE_ROWS + column]
    return out


def _masked(cosine, alpha: float):
    """Smith's Lambda of GGX."""
    return (np.sqrt(1 + alpha**2 * (1 / cosine**2 - 1)) - 1) / 2


def _matte(roughness: float, powers) -> np.ndarray:
    """What Burley's lobe (SIGGRAPH 2012) reflects of maps, ``powers : (cells, c)`` by `_powers`; as `_gloss`."""
    sky = pixel_directions(MATTE_ROWS, 2 * MATTE_ROWS).reshape(-1, 3)
    out = np.empty((len(INCIDENCES), len(TURNS), powers.shape[1]))
    for row, incidence in enumerate(INCIDENCES):
        parallax = _parallax(incidence)
        normal = _to_world(_plane(np.full(len(TURNS), incidence - parallax)), TURNS) @ sky.T
        eye = _to_world(_plane(np.full(len(TURNS), -parallax)), TURNS) @ sky.T
        normal = np.maximum(normal, 0)
        to_light, to_eye = (1 - normal) ** 5, (1 - np.cos(incidence)) ** 5
        back = roughness * (1 + eye)
        lobe = (1 - to_light / 2) * (1 - to_eye / 2) + back * (to_light + to_eye + to_light * to_eye * (back - 1))
        out[row] = BASE / np.pi * (lobe * normal) @ powers
    return out


def _between_points(values, incidence, turn) -> np.ndarray:
    """What is known at `INCIDENCES` and `TURNS`, (n, m, 3), for r rays: (r, 3), linear between the points."""
    around = np.concatenate([values, values[:, :1]], 1)
    at = [incidence / INCIDENCES[1], turn % (2 * np.pi) / TURNS[1]]
    return np.stack([map_coordinates(around[..., c], at, order=1, mode="nearest") for c in range(3)], -1)
