# SPDX-License-Identifier: GPL-3.0-or-later
"""The library's materials as assets: to be dragged onto objects, which are then known to be made of them."""

import bpy

from ..run import buttons, runs
from ..scene.own_surface import NAME
from . import icons

ROUGHNESS = 0.6  # what it looks like in Blender is a stand-in only
AUTHOR = "BTFsep"


def make(item):
    """The asset of a material of the library (`properties.BTFSEP_PG_material`); made anew, or brought up to date."""
    asset = next((m for m in bpy.data.materials if m.get(NAME) == item.name and m.library is None), None)
    asset = asset or bpy.data.materials.new(item.name.partition("/")[2].replace("-", " ").capitalize() or item.name)
    asset[NAME] = item.name
    if asset.node_tree is None:  # Blender 4: materials start without nodes; in 5 they always have them
        asset.use_nodes = True
    shader = next(node for node in asset.node_tree.nodes if node.type == "BSDF_PRINCIPLED")
    shader.inputs["Base Color"].default_value = asset.diffuse_color = (*item.colour, 1.0)
    shader.inputs["Roughness"].default_value = ROUGHNESS
    asset.asset_mark()
    data = asset.asset_data
    data.author, data.description = AUTHOR, f"{item.name} of BTFsep's material library"
    if item.kind not in data.tags:
        data.tags.new(item.kind)
    shown = icons.preview_of_file(item.thumbnail) if item.thumbnail else None
    if shown is not None:
        preview = asset.preview_ensure()
        preview.image_size = shown.image_size
        preview.image_pixels_float = shown.image_pixels_float[:]
    return asset


class BTFSEP_OT_library_assets(buttons.Greyed, buttons.AtOnce, bpy.types.Operator):
    """Add the library's materials to this file as assets; an object that has one and is as in Blender is made of it"""

    bl_idname = "btfsep.library_assets"
    bl_label = "Materials as Assets"
    bl_options = {"REGISTER", "UNDO"}

    @staticmethod
    def reason(context) -> str:
        return "" if runs.run_state().library else "Read the library first"

    def do(self, context):
        for item in runs.run_state().library:
            make(item)
        return f"{len(runs.run_state().library)} materials are in the Asset Browser, Current File"


register, unregister = bpy.utils.register_classes_factory((BTFSEP_OT_library_assets,))
