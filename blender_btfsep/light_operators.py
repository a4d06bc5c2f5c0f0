# SPDX-License-Identifier: GPL-3.0-or-later
"""The buttons for the light that was found: apply it, put the earlier World back, show the report."""

import os

import bpy
from bpy.props import EnumProperty

from . import lighting_file, runs, world
from .answer import apply_light
from .errors import InputError
from .properties import WORLD_MODES


class BTFSEP_OT_apply(runs.Greyed, bpy.types.Operator):
    """Make the last estimate the World again, as the settings below say"""

    bl_idname = "btfsep.apply"
    bl_label = "Apply to World"
    bl_options = {"REGISTER", "UNDO"}
    mode: EnumProperty(name="World", items=WORLD_MODES[:2], options={"SKIP_SAVE"})

    @staticmethod
    def reason(context) -> str:
        there = os.path.isfile(last_lighting())
        return "" if there else "Estimate the light first, or import a lighting (File > Import)"

    def execute(self, context):
        settings = context.scene.btfsep
        mode = self.mode
        if not self.properties.is_property_set("mode") and settings.world_mode != "NONE":
            mode = settings.world_mode
        try:
            sentence = apply_light(context.scene, lighting_file.read(last_lighting()), mode=mode)
        except InputError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        self.report({"INFO"}, sentence)
        return {"FINISHED"}


def last_lighting() -> str:
    """Where the last estimate of this session left its lighting; it may not be there."""
    folder = runs.run_state().folder
    return os.path.join(folder, "result", "lighting.json") if folder else ""


class BTFSEP_OT_restore_world(runs.Greyed, bpy.types.Operator):
    """Put the World back that the scene had before BTFsep, without the Sun lamps of BTFsep"""

    bl_idname = "btfsep.restore_world"
    bl_label = "Restore Previous World"
    bl_options = {"REGISTER", "UNDO"}

    @staticmethod
    def reason(context) -> str:
        return "" if world.is_ours(context.scene.world) else "The World was not made by BTFsep"

    def execute(self, context):
        world.restore_previous(context.scene)
        return {"FINISHED"}


class BTFSEP_OT_show_report(runs.Greyed, bpy.types.Operator):
    """Open the report: photo, material, estimated light, re-rendering, difference"""

    bl_idname = "btfsep.show_report"
    bl_label = "Show Report"

    @staticmethod
    def reason(context) -> str:
        return "" if os.path.isfile(runs.run_state().report) else "Estimate the light first"

    def execute(self, context):
        bpy.ops.wm.path_open(filepath=runs.run_state().report)
        return {"FINISHED"}


CLASSES = (
    BTFSEP_OT_apply,
    BTFSEP_OT_restore_world,
    BTFSEP_OT_show_report,
)


register, unregister = bpy.utils.register_classes_factory(CLASSES)
