# SPDX-License-Identifier: GPL-3.0-or-later
"""The buttons for the light that was found: apply it, put the earlier World back."""

import bpy
from bpy.props import EnumProperty

from ..light import kept_light, world
from ..run import buttons, runs
from ..run.answer import apply_light
from .properties import WORLD_MODES


class BTFSEP_OT_apply(buttons.Greyed, buttons.AtOnce, bpy.types.Operator):
    """Make the light that the card describes the World again, as the settings above say"""

    bl_idname = "btfsep.apply"
    bl_label = "Apply to World"
    bl_options = {"REGISTER", "UNDO"}
    mode: EnumProperty(name="World", items=WORLD_MODES[:2], options={"SKIP_SAVE"})

    @staticmethod
    def reason(context) -> str:
        there = kept_light.kept(context.scene) is not None
        return "" if there else "Estimate the light first, or import a lighting (File > Import)"

    def do(self, context):
        told = self.properties.is_property_set("mode") or context.scene.btfsep.world_mode == "NONE"
        mode = self.mode if told else None
        said = apply_light(context.scene, kept_light.lighting_of(kept_light.kept(context.scene)), mode=mode)
        runs.forget()  # what went wrong before is of another light
        return said


class BTFSEP_OT_restore_world(buttons.Greyed, buttons.AtOnce, bpy.types.Operator):
    """Put the World back that the scene had before BTFsep, without the Sun lamps of BTFsep"""

    bl_idname = "btfsep.restore_world"
    bl_label = "Restore Previous World"
    bl_options = {"REGISTER", "UNDO"}

    @staticmethod
    def reason(context) -> str:
        return "" if world.is_ours(context.scene.world) else "The World was not made by BTFsep"

    def do(self, context):
        world.restore_previous(context.scene)
        runs.forget()


register, unregister = bpy.utils.register_classes_factory((BTFSEP_OT_apply, BTFSEP_OT_restore_world))
