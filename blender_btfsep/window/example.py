# SPDX-License-Identifier: GPL-3.0-or-later
"""The example: a photograph and all that an estimate needs, as a scene of its own beside the user's."""

from pathlib import Path

import bpy

from ..basics.errors import InputError
from ..light import light_picture
from ..run import buttons, runs
from . import use_photo

FILE = Path(__file__).parents[1] / "example.blend"  # made by scripts/cycles/example.py
SCENE = "BTFsep Example"


class BTFSEP_OT_open_example(buttons.Greyed, buttons.AtOnce, bpy.types.Operator):
    """Open a photo with its camera, object and material, ready to be estimated, as a new scene of this file"""

    bl_idname = "btfsep.open_example"
    bl_label = "Open Example"
    bl_options = {"REGISTER", "UNDO"}

    @staticmethod
    def reason(context) -> str:
        return runs.RUNNING if runs.is_running() else "" if context.window else "There is no window to open it in"

    def do(self, context):
        try:
            with bpy.data.libraries.load(str(FILE), link=False) as (_, wanted):
                wanted.scenes = [SCENE]
        except OSError as error:
            raise InputError(f"the example {FILE.name}", error, "install the extension again") from None
        scene = context.window.scene = wanted.scenes[0]
        light_picture.small(scene.btfsep.image)
        for space in use_photo.views(context):
            use_photo.through(space, scene.camera)
        return f"Scene '{scene.name}': press Estimate Light. Your own scene is in the list above right"


register, unregister = bpy.utils.register_classes_factory((BTFSEP_OT_open_example,))
