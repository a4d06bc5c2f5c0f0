# SPDX-License-Identifier: GPL-3.0-or-later
"""The buttons beside a doubt: each goes where what is in doubt can be set right."""

import bpy
from bpy.props import EnumProperty, StringProperty

from . import request, runs
from .errors import InputError

MENDS = (
    ("COLOUR", "Give Its Colour", "Say the object's own colour, so that it is not taken for the light's"),
    ("MATERIAL", "Choose Material", "Choose the object's material in the library"),
    ("AGX", "Read as AgX", "Read the photo as a render that was saved with AgX; estimate again afterwards"),
    ("CAMERA", "Read as a Camera's", "Read the photo by the usual curve of cameras; estimate again afterwards"),
    ("CURVE", "Find the Curve", "Have the photo's tone curve found; estimate again afterwards"),
)
READ_AS = {"AGX": "agx", "CAMERA": "camera", "CURVE": "unknown"}


class BTFSEP_OT_mend(runs.Greyed, runs.AtOnce, bpy.types.Operator):
    """Set right what is in doubt; estimate again afterwards"""

    bl_idname = "btfsep.mend"
    bl_label = "Mend"
    bl_options = {"REGISTER", "UNDO"}
    how: EnumProperty(name="How", items=MENDS, options={"SKIP_SAVE"})
    object: StringProperty(name="Object", description="In the list; empty: the active one", options={"SKIP_SAVE"})

    @classmethod
    def description(cls, context, properties):
        return next(about for name, _, about in MENDS if name == properties.how)

    def do(self, context):
        settings = context.scene.btfsep
        if self.how in READ_AS:
            settings.curve = READ_AS[self.how]
            return
        if settings.depth is None:
            named = (n for n, e in enumerate(settings.objects) if e.object and self.object in ("", e.object.name))
            number = next(named, None)
            if number is None:
                raise InputError(f"object '{self.object}'", "it is not in the list", "add it")
            if self.object:
                settings.active_object = number
        request.active_entry(settings).source = "COLOUR" if self.how == "COLOUR" else "LIBRARY"


register, unregister = bpy.utils.register_classes_factory((BTFSEP_OT_mend,))
