# SPDX-License-Identifier: GPL-3.0-or-later
"""The key light of a lighting as a Sun lamp, beside a World of the rest.

A lamp made here carries LAMP_TAG. Only such lamps are ever removed; each scene has at most one.

Blender's Sun: the strength is the irradiance on a surface that faces it, so that a white matte surface shows the
strength over pi (a test renders it); the angle is the disc's whole width.
"""

import math

import bpy
from mathutils import Vector

LAMP_NAME = "BTFsep Sun"
LAMP_TAG = "btfsep_sun"
DISTANCE = 5.0  # from the world's origin, in the view; a Sun's place makes no difference to its light


def lamps(scene) -> list:
    """The lamps of ``scene`` that BTFsep made and may change."""
    return [thing for thing in scene.objects if LAMP_TAG in thing and thing.library is None]


def put(scene, sun: dict | None):
    """Makes ``sun`` the lamp of ``scene``, in place of an earlier one of ours; None: only takes that away.

    Parameters
    ----------
    scene : bpy.types.Scene
    sun : "sun" of what lighting_file.read returns

    Returns
    -------
    The lamp, or None.
    """
    for old in lamps(scene):
        _remove(scene, old)
    if sun is None or max(sun["irradiance"]) <= 0:
        return None
    data = bpy.data.lights.new(LAMP_NAME, "SUN")
    lamp = bpy.data.objects.new(LAMP_NAME, data)
    lamp[LAMP_TAG] = True
    data.energy = max(sun["irradiance"])
    data.color = [value / data.energy for value in sun["irradiance"]]
    data.angle = math.radians(sun["size_degrees"])
    direction = Vector(sun["direction"])
    lamp.location = DISTANCE * direction
    lamp.rotation_euler = direction.to_track_quat("Z", "Y").to_euler()
    scene.collection.objects.link(lamp)
    return lamp


def _remove(scene, lamp) -> None:
    """Takes a lamp out of ``scene``, and out of the file where no other scene has it."""
    data = lamp.data
    if len(lamp.users_scene) > 1:
        for collection in (scene.collection, *scene.collection.children_recursive):
            if lamp.name in collection.objects:
                collection.objects.unlink(lamp)
        return
    bpy.data.objects.remove(lamp)
    if data is not None and data.users == 0:
        bpy.data.lights.remove(data)
