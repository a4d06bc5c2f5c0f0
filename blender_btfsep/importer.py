# SPDX-License-Identifier: GPL-3.0-or-later
"""File > Import > BTFsep Lighting, and the same by dragging a .json into the 3D view."""

import bpy
from bpy.props import BoolProperty, EnumProperty, StringProperty
from bpy_extras.io_utils import ImportHelper

from . import lighting_file
from .answer import apply_light
from .errors import InputError
from .properties import WORLD_MODES


class BTFSEP_OT_import_lighting(bpy.types.Operator, ImportHelper):
    """Make an estimated lighting the World of the scene"""

    bl_idname = "btfsep.import_lighting"
    bl_label = "Import BTFsep Lighting"
    bl_options = {"REGISTER", "UNDO", "PRESET"}

    filename_ext = ".json"
    filter_glob: StringProperty(default="*.json", options={"HIDDEN"})
    mode: EnumProperty(name="World", items=WORLD_MODES[:2])
    clamp: BoolProperty(
        name="Clamp Negative", description="Black where the sum of the harmonics is negative", default=True
    )

    lamp: BoolProperty(
        name="Sun Lamps", description="Key lights in the file become Sun lamps beside the World", default=True
    )

    def invoke(self, context, event):
        if self.properties.is_property_set("filepath") and self.filepath:  # dropped into the view
            return self.execute(context)
        return super().invoke(context, event)

    def execute(self, context):
        try:
            lighting = lighting_file.read(bpy.path.abspath(self.filepath))
            sentence = apply_light(context.scene, lighting, mode=self.mode, clamp=self.clamp, lamp=self.lamp)
        except InputError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        self.report({"INFO"}, sentence)
        return {"FINISHED"}


class BTFSEP_FH_lighting(bpy.types.FileHandler):
    bl_idname = "BTFSEP_FH_lighting"
    bl_label = "BTFsep Lighting"
    bl_import_operator = "btfsep.import_lighting"
    bl_file_extensions = ".json"

    @classmethod
    def poll_drop(cls, context):
        return context.area is not None and context.area.type == "VIEW_3D"


def _menu(self, context):
    self.layout.operator(BTFSEP_OT_import_lighting.bl_idname, text="BTFsep Lighting (.json)")


def register():
    bpy.utils.register_class(BTFSEP_OT_import_lighting)
    bpy.utils.register_class(BTFSEP_FH_lighting)
    bpy.types.TOPBAR_MT_file_import.append(_menu)


def unregister():
    bpy.types.TOPBAR_MT_file_import.remove(_menu)
    bpy.utils.unregister_class(BTFSEP_FH_lighting)
    bpy.utils.unregister_class(BTFSEP_OT_import_lighting)
