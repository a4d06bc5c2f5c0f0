# SPDX-License-Identifier: GPL-3.0-or-later
"""What stands beside an object and no job knows: walls, other things; and the light around it where they stand."""

import math
from pathlib import Path

import bpy
import numpy as np
from mathutils import Vector

from scripts.cycles import materials, studio

SIZE, SAMPLES = (256, 128), 256  # pixels of the map of what is around; a pixel


def add(middle, quads, colour) -> bpy.types.Object:
    """A matte thing of four-cornered faces (n, 4, 3), metres from ``middle`` (3,)."""
    quads = np.asarray(quads, float) + np.asarray(middle)
    mesh = bpy.data.meshes.new("neighbour")
    faces = np.arange(4 * len(quads)).reshape(-1, 4)
    mesh.from_pydata(quads.reshape(-1, 3).tolist(), [], faces.tolist())
    thing = bpy.data.objects.new("neighbour", mesh)
    bpy.context.collection.objects.link(thing)
    mesh.materials.append(materials.white(colour))
    return thing


def photograph_around(scene: bpy.types.Scene, middle, hidden, path: Path) -> np.ndarray:
    """The map (128, 256, 3) of all that is seen from ``middle`` but for lamps, and for the ``hidden`` objects.

    What is hidden still lights and shades the rest. The scene's camera and its picture are as before.
    """
    data = bpy.data.cameras.new("around")
    data.type, data.clip_start = "PANO", 1e-4
    (data if hasattr(data, "panorama_type") else data.cycles).panorama_type = "EQUIRECTANGULAR"
    eye = bpy.data.objects.new("around", data)
    scene.collection.objects.link(eye)
    eye.location, eye.rotation_euler = Vector(middle), (math.pi / 2, 0, -math.pi / 2)  # +X in the middle, +Z up
    render, camera, seen = scene.render, scene.camera, [thing.visible_camera for thing in hidden]
    kept = render.resolution_x, render.resolution_y
    for thing in hidden:
        thing.visible_camera = False
    scene.camera, (render.resolution_x, render.resolution_y) = eye, SIZE
    try:
        return studio.render_photo(scene, path, SAMPLES)
    finally:
        scene.camera, (render.resolution_x, render.resolution_y) = camera, kept
        for thing, was in zip(hidden, seen, strict=True):
            thing.visible_camera = was
        bpy.data.objects.remove(eye)
