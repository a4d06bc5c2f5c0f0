# SPDX-License-Identifier: GPL-3.0-or-later
"""The light to look at: its map, a grey ball that it lights, and the photo's object beside it."""

import math

import bpy
import numpy as np
from bpy_extras.object_utils import world_to_camera_view
from mathutils import Vector

from ..basics import harmonics, pixels
from ..basics.scratch import scratch
from ..photo import photo
from .light_words import irradiance

HALF = 128  # pixels of the ball and of the map's height
GREY = 0.5  # albedo of the ball
WHITE = 0.85  # what the brightest percent of the ball becomes
SUN = 4.0  # degrees: no key light is drawn narrower in the map
LARGEST = 1024  # pixels: a larger photo is made smaller before it is looked at


def picture_of(scene, lighting: dict, to_world=None, *, map_file=None) -> np.ndarray:
    """(256, 256, 3) in 0 to 1, sRGB-coded: the map above, below it the photo's object and the ball.

    The ball has the light's own colours and is seen from the camera (``to_world``; None: from -Y). ``map_file`` : the
    engine's own map, which knows more of the sky than its series.
    """
    suns = lighting["suns"]
    sky = np.array(suns["sky"] if suns else lighting["coefficients"])
    lamps = suns["lamps"] if suns else []
    ball, on = _ball(sky, lamps, to_world)
    factor = WHITE / max(float(np.percentile(ball[on], 99)), 1e-9)
    above = _map_of(map_file) if map_file else _map(sky, lamps)
    below = [_object(scene), np.where(on[..., None], coded(ball * factor), 0.1)]
    middle = max(float(np.percentile(above @ harmonics.LUMINANCE, 70)), 1e-9)
    # a shoulder instead of an edge: sky and sun are both to be seen
    return np.concatenate([coded(1 - np.exp(-0.4 * above / middle)), np.concatenate(below, 1)])


def coded(linear) -> np.ndarray:
    v = np.clip(linear, 0, 1)
    return np.where(v <= 0.0031308, 12.92 * v, 1.055 * v ** (1 / 2.4) - 0.055)


def _ball(sky, lamps, to_world) -> tuple[np.ndarray, np.ndarray]:
    """Radiance (HALF, HALF, 3) of a matte ball and where it is."""
    axes = np.array(to_world)[:3, :3] if to_world is not None else np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]], float)
    x = ((np.arange(HALF) + 0.5) / HALF * 2 - 1) * 1.06
    px, py = np.meshgrid(x, -x)
    squared = px**2 + py**2
    on = squared < 1
    normals = np.stack([px, py, np.sqrt(np.maximum(1 - squared, 0))], -1) @ axes.T
    lit = irradiance(sky, normals)
    for lamp in lamps:
        lit = lit + np.maximum(normals @ lamp["direction"], 0)[..., None] * lamp["irradiance"]
    return GREY / math.pi * lit, on


def _map_of(file) -> np.ndarray:
    """(HALF, 2 HALF, 3) of a map in a file, averaged."""
    with scratch() as own:
        image = own(bpy.data.images.load(str(file), check_existing=False))
        image.scale(2 * HALF, HALF)
        return np.maximum(pixels.colours(image)[::-1], 0).astype(float)


def _map(sky, lamps) -> np.ndarray:
    """(HALF, 2 HALF, 3): the environment map, each key light a disc of its irradiance."""
    out = harmonics.positive_map(sky, HALF, 2 * HALF)
    d = harmonics.map_directions(HALF, 2 * HALF)
    for lamp in lamps:
        edge = math.cos(math.radians(max(lamp["size_degrees"], SUN) / 2))
        disc = d @ np.array(lamp["direction"]) > edge
        out[disc] += np.array(lamp["irradiance"]) / (2 * math.pi * (1 - edge))
    return out


def _object(scene) -> np.ndarray:
    """(HALF, HALF, 3) of the photo around the objects, sRGB-coded; dark where there is no photo."""
    dark = np.full((HALF, HALF, 3), 0.1)
    image, camera = scene.btfsep.image, scene.btfsep.camera or scene.camera
    if image is None or not (image.size[0] and image.size[1]):
        return dark
    shown = small(image, photo.file_at(image, camera, scene.frame_current))
    if shown is None:
        return dark
    height, width = shown.shape[:2]
    u, v, radius = _middle(scene, camera)
    side = min(radius * 2 * width, width, height)
    # Blender's rows begin below
    left = int(np.clip(u * width - side / 2, 0, width - side))
    low = int(np.clip(v * height - side / 2, 0, height - side))
    part = shown[low : low + max(int(side), 1), left : left + max(int(side), 1)][::-1]
    rows, columns = ((np.arange(HALF) * n // HALF).clip(0, n - 1) for n in part.shape[:2])
    part = part[rows][:, columns]
    if image.is_float:
        part = part * WHITE / max(float(np.nanpercentile(part, 99)), 1e-9)
    return coded(part) if image.is_float else np.clip(part, 0, 1)


_last: tuple = (None, None)


def small(image, file=None):
    """(h, w, 3) of an image, not larger than LARGEST, its lowest row first; None where it has no pixels.

    ``file`` : of a sequence the one that is meant, None for the one that was opened

    The last one is remembered: decoding 24 megapixels takes half a second, which the end of a run must not.
    """
    global _last
    file = file if image.source == "SEQUENCE" else None
    place = image.session_uid, image.filepath_raw, str(file), photo.stamp_of(image)
    key = (*place, tuple(image.size), image.colorspace_settings.name)
    if image.is_dirty or key != _last[0]:
        _last = (key, _read_small(image, file))
    return _last[1]


def _read_small(image, file):
    if image.is_dirty or image.source == "GENERATED":
        found, step = _pixels(image), -(-max(image.size) // LARGEST)  # a copy would not have what was painted
        return None if found is None else found[::step, ::step]
    copy = image.copy()
    try:
        if copy.source == "SEQUENCE":
            copy.source = "FILE"
            copy.filepath = str(file or copy.filepath)
        shrink = LARGEST / max(*copy.size, 1)
        if shrink < 1:
            copy.scale(*(max(int(side * shrink), 1) for side in copy.size))
        return _pixels(copy)
    finally:
        bpy.data.images.remove(copy)


def _pixels(image):
    """(h, w, 3) of an image, its lowest row first; None where it has none."""
    return pixels.colours(image) if all(image.size) and image.channels else None


def _middle(scene, camera) -> tuple[float, float, float]:
    """Where the objects are in the picture: u, v (0 to 1, up) of their middle, and the half width of a square, of the
    picture's width."""
    things = [entry.object for entry in scene.btfsep.objects if entry.object is not None]
    if not things or camera is None:
        return 0.5, 0.5, 0.5
    corners = [thing.matrix_world @ Vector(corner) for thing in things for corner in thing.bound_box]
    seen = np.array([world_to_camera_view(scene, camera, corner) for corner in corners])
    low, high = np.clip(seen[:, :2].min(0), 0, 1), np.clip(seen[:, :2].max(0), 0, 1)
    render = scene.render
    tall = render.resolution_y * render.pixel_aspect_y / max(render.resolution_x * render.pixel_aspect_x, 1e-9)
    half = max((high[0] - low[0]) / 2, (high[1] - low[1]) / 2 * tall) * 1.1
    return float((low[0] + high[0]) / 2), float((low[1] + high[1]) / 2), float(max(half, 0.02))
