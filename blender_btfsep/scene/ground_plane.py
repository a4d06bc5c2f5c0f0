# SPDX-License-Identifier: GPL-3.0-or-later
"""The ground that a photo shows under its objects and the scene has not: a plane that catches their shadows."""

import bpy
import numpy as np

from ..basics.errors import InputError
from . import meshes

NAME = "Ground"
REACH = 4.0  # half an edge, in the longest edge of the box around the objects: the engine's own guess


def there(scene):
    """The plane that was put into the scene already; None where there is none."""
    return next((o for o in scene.objects if o.name.split(".")[0] == NAME and o.is_shadow_catcher), None)


def add(context, objects) -> bpy.types.Object:
    """A level plane under the lowest point of objects as a render shows them, without a material: the photo tells it.

    Raises InputError where none of them has faces, or the scene has such a plane.
    """
    if found := there(context.scene):
        raise InputError("the ground", f"'{found.name}' is in the scene already", "put it in its place, or delete it")
    view_layer, objects = context.view_layer, list(objects)
    with meshes.as_rendered(view_layer, set(objects), chosen=set(objects)):
        view_layer.update()
        gathered = meshes.gather(view_layer.depsgraph, objects)
    if not gathered:
        raise InputError("the objects of the photo", "none of them has faces", "add what the photo shows to the list")
    places = np.concatenate([part["positions"].reshape(-1, 3) for part in gathered.values()])
    low, high = places.min(0), places.max(0)
    half, (x, y, _) = REACH * float((high - low).max()), (low + high) / 2
    mesh = bpy.data.meshes.new(NAME)
    corners = [(x - half, y - half), (x + half, y - half), (x + half, y + half), (x - half, y + half)]
    mesh.from_pydata([(*corner, float(low[2])) for corner in corners], [], [(0, 1, 2, 3)])
    ground = bpy.data.objects.new(NAME, mesh)
    ground.is_shadow_catcher = True
    context.scene.collection.objects.link(ground)
    return ground
