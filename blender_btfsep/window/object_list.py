# SPDX-License-Identifier: GPL-3.0-or-later
"""The buttons of the object list: what the photo shows, its masks, its materials."""

import bpy
from bpy.props import BoolProperty, EnumProperty, IntProperty, StringProperty

from ..basics.errors import InputError
from ..run.buttons import AtOnce, Greyed
from ..run.request import active_entry
from ..scene.meshes import has_surface
from .use_photo import show_outlines


class BTFSEP_OT_add_objects(Greyed, AtOnce, bpy.types.Operator):
    """Add the selected objects to the list of those that the photo shows"""

    bl_idname = "btfsep.add_objects"
    bl_label = "Add Selected"
    bl_options = {"REGISTER", "UNDO"}

    @staticmethod
    def reason(context) -> str:
        chosen = any(has_surface(thing) for thing in context.selected_objects)
        return "" if chosen else "Select objects with a surface first"

    def do(self, context):
        settings = context.scene.btfsep
        present = {entry.object for entry in settings.objects}
        for thing in context.selected_objects:
            if has_surface(thing) and thing not in present:
                settings.objects.add().object = thing
        settings.active_object = len(settings.objects) - 1
        if not present:
            show_outlines(context.scene)


class BTFSEP_OT_remove_object(Greyed, AtOnce, bpy.types.Operator):
    """Take the object off the list"""

    bl_idname = "btfsep.remove_object"
    bl_label = "Remove"
    bl_options = {"REGISTER", "UNDO"}
    index: IntProperty(default=-1, options={"HIDDEN", "SKIP_SAVE"})

    @staticmethod
    def reason(context) -> str:
        return "" if context.scene.btfsep.objects else "The list is empty"

    def do(self, context):
        settings = context.scene.btfsep
        settings.objects.remove(settings.active_object if self.index < 0 else self.index)
        settings.active_object = min(settings.active_object, max(len(settings.objects) - 1, 0))


class BTFSEP_OT_open_picture(AtOnce, bpy.types.Operator):
    """Open a picture from a file: the mask of the object, or the depth"""

    bl_idname = "btfsep.open_picture"
    bl_label = "Open Picture"
    bl_options = {"REGISTER", "UNDO"}
    filepath: StringProperty(subtype="FILE_PATH", options={"SKIP_SAVE"})
    filter_image: BoolProperty(default=True, options={"HIDDEN", "SKIP_SAVE"})
    filter_folder: BoolProperty(default=True, options={"HIDDEN", "SKIP_SAVE"})
    target: EnumProperty(items=(("mask", "Mask", ""), ("depth", "Depth", "")), options={"HIDDEN", "SKIP_SAVE"})

    def invoke(self, context, event):
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def do(self, context):
        settings = context.scene.btfsep
        owner = settings if self.target == "depth" else active_entry(settings)
        if owner is None:
            raise InputError("the list of objects", "it is empty", "add the object that the mask is for")
        try:
            setattr(owner, self.target, bpy.data.images.load(self.filepath, check_existing=True))
        except RuntimeError as error:
            raise InputError("the picture", error, "choose one that can be read") from None


class BTFSEP_OT_use_candidate(AtOnce, bpy.types.Operator):
    """Take this for the object's material, instead of recognising it"""

    bl_idname = "btfsep.use_candidate"
    bl_label = "Use"
    bl_options = {"REGISTER", "UNDO"}
    material: StringProperty(options={"SKIP_SAVE"})

    @classmethod
    def poll(cls, context):
        return active_entry(context.scene.btfsep) is not None

    def do(self, context):
        active_entry(context.scene.btfsep).material = self.material


CLASSES = (
    BTFSEP_OT_add_objects,
    BTFSEP_OT_remove_object,
    BTFSEP_OT_open_picture,
    BTFSEP_OT_use_candidate,
)


register, unregister = bpy.utils.register_classes_factory(CLASSES)
