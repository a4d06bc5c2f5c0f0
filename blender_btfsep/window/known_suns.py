# SPDX-License-Identifier: GPL-3.0-or-later
"""The buttons of suns whose direction the user knows (`sun_lamp.known_suns`): the next estimate leaves them there."""

import bpy
from bpy.props import StringProperty

from ..basics.errors import InputError
from ..light.sun_lamp import known_suns
from ..run import buttons

MOST = 8  # that a job may name


class _OfSun(buttons.Greyed, buttons.AtOnce):
    """What the buttons of a sun share."""

    bl_options = {"REGISTER", "UNDO"}
    name: StringProperty(name="Sun", description="A Sun lamp; empty: the active object", options={"SKIP_SAVE"})

    def sun(self, context):
        """The lamp that is meant. Raises InputError."""
        lamp = context.scene.objects.get(self.name) if self.name else context.object
        if lamp is None or lamp.type != "LIGHT" or lamp.data.type != "SUN":
            what = f"'{self.name}'" if self.name else "the active object"
            raise InputError(what, "it is no Sun lamp of the scene", "choose one")
        return lamp


class BTFSEP_OT_freeze_sun(_OfSun, bpy.types.Operator):
    """Take this sun's direction, as it stands now, for known: the next estimate leaves it there"""

    bl_idname = "btfsep.freeze_sun"
    bl_label = "Freeze Sun"

    def do(self, context):
        lamp, scene = self.sun(context), context.scene
        if lamp in known_suns(scene):
            return
        if len(known_suns(scene)) == MOST:
            raise InputError("the known suns", f"there are {MOST}", "free one of them first")
        scene.btfsep.known_suns.add().object = lamp


class BTFSEP_OT_free_sun(_OfSun, bpy.types.Operator):
    """Let the next estimate find this sun's direction again"""

    bl_idname = "btfsep.free_sun"
    bl_label = "Free Sun"

    def do(self, context):
        lamp, entries = self.sun(context), context.scene.btfsep.known_suns
        for number in reversed(range(len(entries))):
            if entries[number].object in (lamp, None):
                entries.remove(number)


register, unregister = bpy.utils.register_classes_factory((BTFSEP_OT_freeze_sun, BTFSEP_OT_free_sun))
