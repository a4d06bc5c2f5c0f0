# SPDX-License-Identifier: GPL-3.0-or-later
"""File > Import and File > Export of a light; dragging a .btfsep into the 3D view imports it."""

import os
from pathlib import Path

import bpy
from bpy.props import BoolProperty, EnumProperty, IntProperty, StringProperty
from bpy_extras.io_utils import ExportHelper, ImportHelper

from ..basics.errors import InputError
from ..light import light_files, sh_nodes, world
from ..run import buttons, runs
from ..run.answer import apply_light
from .properties import WORLD_MODES

SUFFIXES = (
    (".json", "BTFsep (.json)", "Coefficients and key lights, as the engine reads and writes them"),
    (".btfsep", "BTFsep (.btfsep)", "The same, under a name that can be dragged into the 3D view"),
    (".exr", "OpenEXR map (.exr)", "An environment map, key lights as discs, 32 bit"),
    (".hdr", "Radiance map (.hdr)", "An environment map, key lights as discs"),
    (".txt", "Harmonics as text (.txt)", "As Filament's cmgen writes them: radiance, Y up"),
    (
        ".usda",
        "USD lights (.usda)",
        "A dome light with its map beside it, a distant or sphere light for each key light",
    ),
)


FORMATS = [suffix for suffix, *_ in SUFFIXES]


def _suffixed(path: str, suffix: str) -> str:
    """A path whose name ends with ``suffix`` in the place of another of ours."""
    own = Path(path).suffix
    return (path.removesuffix(own) if own.lower() in FORMATS else path) + suffix


class BTFSEP_OT_import_lighting(buttons.AtOnce, bpy.types.Operator, ImportHelper):
    """Make a light in a file the World of the scene: BTFsep's own, an environment map, or cmgen's harmonics"""

    bl_idname = "btfsep.import_lighting"
    bl_label = "Import Lighting"  # as long as the file browser's button shows
    bl_options = {"REGISTER", "UNDO", "PRESET"}

    filename_ext = ".json"
    filter_glob: StringProperty(default="*.json;*.btfsep;*.exr;*.hdr;*.txt", options={"HIDDEN"})
    mode: EnumProperty(name="World", items=(("AUTO", "As in the File", "A map stays a map"), *WORLD_MODES[:2]))
    order: IntProperty(
        name="Order",
        description="Of the harmonics of a map that becomes nodes",
        default=4,
        min=0,
        max=sh_nodes.MAX_NODE_ORDER,
    )
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

    def do(self, context):
        lighting = light_files.read(bpy.path.abspath(self.filepath), self.order)
        as_in_file = "TEXTURE" if "map" in lighting else "NODES"
        mode = as_in_file if self.mode == "AUTO" else self.mode
        said = apply_light(context.scene, lighting, mode=mode, clamp=self.clamp, lamp=self.lamp)
        runs.forget()  # what went wrong before is of another light
        return said


class BTFSEP_OT_export_lighting(buttons.Greyed, buttons.AtOnce, bpy.types.Operator, ExportHelper):
    """Write the light as World and Sun lamps have it now, with all that was changed of it"""

    bl_idname = "btfsep.export_lighting"
    bl_label = "Export Lighting"
    bl_options = {"REGISTER", "PRESET"}

    filename_ext = ""
    check_extension = None  # the suffix is the format's
    filter_glob: StringProperty(default=";".join(f"*{suffix}" for suffix, *_ in SUFFIXES), options={"HIDDEN"})
    format: EnumProperty(name="Format", items=SUFFIXES, description="The suffix of the file's name, which it changes")
    order: IntProperty(
        name="Order", description="Of harmonics", default=4, min=0, max=sh_nodes.MAX_NODE_ORDER, options={"SKIP_SAVE"}
    )

    @staticmethod
    def reason(context) -> str:
        return "" if world.is_ours(context.scene.world) else "The World is none of BTFsep's"

    def invoke(self, context, event):
        if not self.filepath:
            name = bpy.path.display_name_from_filepath(bpy.data.filepath) or "untitled"
            self.filepath = os.path.join(os.path.dirname(bpy.data.filepath), f"{name} light")
        self._take_order(context)
        self._chosen = self.format
        self.filepath = _suffixed(self.filepath, self.format)
        return super().invoke(context, event)

    def _take_order(self, context) -> None:
        """So that nothing of the light is lost, where none is given."""
        if not self.properties.is_property_set("order"):
            self.order = light_files.order_to_write(context.scene)

    def check(self, context):
        """The name in the file browser has its suffix before Export is pressed: Blender warns of a file that is there.

        A format that is chosen changes the suffix, a suffix that is typed the format.
        """
        before, suffix = (self.filepath, self.format), Path(self.filepath).suffix.lower()
        if self.format == getattr(self, "_chosen", self.format) and suffix in FORMATS:
            self.format = suffix
        self._chosen = self.format
        self.filepath = _suffixed(self.filepath, self.format)
        return before != (self.filepath, self.format)

    def do(self, context):
        path = bpy.path.abspath(self.filepath)
        if Path(path).suffix.lower() not in FORMATS:
            path = _suffixed(path, self.format)
            if Path(path).exists():
                raise InputError(Path(path).name, "it is there already", "give the name with its suffix to replace it")
        image = context.scene.btfsep.image
        if image is not None and image.filepath and Path(bpy.path.abspath(image.filepath)) == Path(path):
            raise InputError(Path(path).name, "it is the photo", "give another name")
        self._take_order(context)
        light_files.write(path, context.scene, self.order)
        return f"wrote {path}"


class BTFSEP_FH_lighting(bpy.types.FileHandler):
    """Blender tells a file handler nothing of a file but its last suffix: only one that is ours alone is claimed."""

    bl_idname = "BTFSEP_FH_lighting"
    bl_label = "BTFsep Lighting"
    bl_import_operator = "btfsep.import_lighting"
    bl_file_extensions = ".btfsep"

    @classmethod
    def poll_drop(cls, context):
        return context.area is not None and context.area.type == "VIEW_3D"


def _import_menu(self, context):
    self.layout.operator(BTFSEP_OT_import_lighting.bl_idname, text="BTFsep Lighting (.json, .exr, .hdr, .txt)")


def _export_menu(self, context):
    self.layout.operator(BTFSEP_OT_export_lighting.bl_idname, text="BTFsep Lighting (.json, .exr, .hdr, .txt, .usda)")


_register, _unregister = bpy.utils.register_classes_factory(
    (BTFSEP_OT_import_lighting, BTFSEP_OT_export_lighting, BTFSEP_FH_lighting)
)


def register():
    _register()
    bpy.types.TOPBAR_MT_file_import.append(_import_menu)
    bpy.types.TOPBAR_MT_file_export.append(_export_menu)


def unregister():
    bpy.types.TOPBAR_MT_file_export.remove(_export_menu)
    bpy.types.TOPBAR_MT_file_import.remove(_import_menu)
    _unregister()
