# SPDX-License-Identifier: GPL-3.0-or-later
"""The key lights of a lighting as Sun lamps, beside a World of the rest.

A lamp made here carries LAMP_TAG. Only such lamps are ever removed, all of a scene's together.

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


def beside(scene) -> str:
    """What is to be said of them after "the World is the light": how many there are; of none, nothing."""
    count = len(lamps(scene))
    return {0: "", 1: ", with one Sun lamp beside it"}.get(count, f", with {count} Sun lamps beside it")


def put(scene, suns) -> None:
    """Makes ``suns`` the lamps of ``scene``, in place of all earlier ones of ours; of none, only takes those away.

    Parameters
    ----------
    scene : bpy.types.Scene
    suns : list of "lamps" of what lighting_file.read returns; one without light gives no lamp
    """
    for old in lamps(scene):
        _remove(scene, old)
    for sun in suns:
        if max(sun["irradiance"]) > 0:
            _make(scene, sun)


def _make(scene, sun: dict) -> None:
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
