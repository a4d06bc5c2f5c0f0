# SPDX-License-Identifier: GPL-3.0-or-later
"""Preferences: where the engine and the library are, whether jobs are kept, whether the engine works, its cache."""

from types import SimpleNamespace

import bpy
from bpy.props import BoolProperty, StringProperty

from . import checkup

ADDON = __package__.rpartition(".")[0]  # its name, as Blender knows it


class BTFSEP_AP_preferences(bpy.types.AddonPreferences):
    bl_idname = ADDON

    engine: StringProperty(
        name="Engine",
        description="Python, virtual environment or btfsep program to use. Empty: found by itself",
        subtype="FILE_PATH",
    )
    library: StringProperty(
        name="Material Library",
        description="Folder of digitised materials. Empty: the library that comes with the engine",
        subtype="DIR_PATH",
    )
    keep_jobs: BoolProperty(
        name="Keep Job Folders",
        description="Keep the exported job and its results beside the .blend file, instead of until Blender quits",
        default=False,
    )

    def draw(self, context):
        layout = self.layout
        layout.use_property_split = True
        layout.prop(self, "engine")
        layout.prop(self, "library")
        layout.prop(self, "keep_jobs")
        checkup.draw(context, layout)


def get(context=None):
    """The add-on's preferences; the defaults where it is registered without being installed (scripts, tests)."""
    addon = (context or bpy.context).preferences.addons.get(ADDON)
    if addon is not None and addon.preferences is not None:
        return addon.preferences
    return SimpleNamespace(engine="", library="", keep_jobs=False)


register, unregister = bpy.utils.register_classes_factory((BTFSEP_AP_preferences,))
