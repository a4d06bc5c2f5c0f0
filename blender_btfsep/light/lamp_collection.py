# SPDX-License-Identifier: GPL-3.0-or-later
"""The collection of the lamps of a light: one for each scene, in its root, to be hidden, renamed or moved as any other.

A lamp is put there when it is made, and never again: where the user moves it, it stays.
"""

import bpy

NAME = "BTFsep Light"
TAG = "btfsep_lamps"
COLOUR = "COLOR_03"  # yellow in the outliner


def add_lamp(scene, lamp) -> None:
    """Puts a new lamp into the collection, which is made where ``scene`` has none."""
    own = next(iter(_tagged(scene)), None)
    if own is None:
        own = bpy.data.collections.new(NAME)
        own[TAG], own.color_tag = True, COLOUR
        scene.collection.children.link(own)
    own.objects.link(lamp)


def leave_shared(scene) -> None:
    """Takes one that another scene has, too, as after a linked copy, out of ``scene``: its lamps are that one's."""
    others = [other for other in bpy.data.scenes if other != scene]
    for own in _tagged(scene):
        shared = any(own in other.collection.children_recursive for other in others)
        if shared and own.name in scene.collection.children:
            scene.collection.children.unlink(own)


def tidy(scene) -> None:
    """Removes one that is empty, and as it was made."""
    for own in _tagged(scene):
        as_made = own.name.partition(".")[0] == NAME and own.name in scene.collection.children
        if as_made and not own.objects and not own.children and own.users == 1:
            bpy.data.collections.remove(own)


def _tagged(scene) -> list:
    return [each for each in scene.collection.children_recursive if TAG in each and each.library is None]
