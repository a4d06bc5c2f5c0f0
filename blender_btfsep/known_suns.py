# SPDX-License-Identifier: GPL-3.0-or-later
"""The buttons of suns whose direction the user knows (`sun_lamp.known`): the next estimate leaves them there."""

import bpy
from bpy.props import StringProperty

from . import runs
from .sun_lamp import known

MOST = 8  # that a job may name


class _OfSun(runs.Greyed):
    """What the buttons of a sun share."""

    bl_options = {"REGISTER", "UNDO"}
    name: StringProperty(name="Sun", description="A Sun lamp; empty: the active object", options={"SKIP_SAVE"})

    @staticmethod
    def reason(context) -> str:
        return runs.RUNNING if runs.is_running() else ""

    def sun(self, context):
        """The lamp that is meant, or None, which is said."""
        lamp = context.scene.objects.get(self.name) if self.name else context.object
        if lamp is None or lamp.type != "LIGHT" or lamp.data.type != "SUN":
            self.report({"ERROR"}, f"'{self.name}'; it is no Sun lamp of the scene; choose one")
            return None
        return lamp


class BTFSEP_OT_freeze_sun(_OfSun, bpy.types.Operator):
    """Take this sun's direction, as it stands now, for known: the next estimate leaves it there"""

    bl_idname = "btfsep.freeze_sun"
    bl_label = "Freeze Sun"

    def execute(self, context):
        lamp, scene = self.sun(context), context.scene
        if lamp is None:
            return {"CANCELLED"}
        if lamp in known(scene):
            return {"FINISHED"}
        if len(known(scene)) == MOST:
            self.report({"ERROR"}, f"the known suns; there are {MOST}; free one of them first")
            return {"CANCELLED"}
        scene.btfsep.known_suns.add().object = lamp
        return {"FINISHED"}


class BTFSEP_OT_free_sun(_OfSun, bpy.types.Operator):
    """Let the next estimate find this sun's direction again"""

    bl_idname = "btfsep.free_sun"
    bl_label = "Free Sun"

    def execute(self, context):
        lamp, entries = self.sun(context), context.scene.btfsep.known_suns
        if lamp is None:
            return {"CANCELLED"}
        for number in reversed(range(len(entries))):
            if entries[number].object in (lamp, None):
                entries.remove(number)
        return {"FINISHED"}


CLASSES = (BTFSEP_OT_freeze_sun, BTFSEP_OT_free_sun)


register, unregister = bpy.utils.register_classes_factory(CLASSES)
