# SPDX-License-Identifier: GPL-3.0-or-later
"""The tab "BTFsep" in the sidebar of the 3D view."""

import blf
import bpy

from . import camera as pinhole
from . import engine_settings, preferences, request, runs, sequence_run, world

FONT_SIZE = 11  # of Blender's labels, in points, at scale 1
MARGIN = 105  # pixels of the sidebar's width that a label with an icon in a box cannot have, at scale 1


class BTFSEP_UL_objects(bpy.types.UIList):
    def draw_item(self, context, layout, data, item, icon, active_data, active_propname):
        if item.object is None:
            layout.label(text="(deleted)", icon="ERROR")
            return
        row = layout.split(factor=0.48, align=True)
        row.prop(item.object, "name", text="", emboss=False, icon="OBJECT_DATA")
        known = (item.material or item.recognised).rsplit("/", 1)[-1]
        sub = row.row()
        sub.active = bool(item.material)
        sub.label(text=known or "to recognise", icon="QUESTION" if item.unknown and not item.material else "NONE")


class _Sidebar:
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "BTFsep"


class BTFSEP_PT_photo(_Sidebar, bpy.types.Panel):
    bl_label = "Photo"

    def draw(self, context):
        layout = self.layout
        scene, settings = context.scene, context.scene.btfsep
        layout.enabled = not runs.is_running()
        layout.template_ID(settings, "image", open="image.open")
        column = layout.column()
        column.use_property_split = True
        column.use_property_decorate = False
        column.prop(settings, "camera", placeholder=scene.camera.name if scene.camera else "None")
        layout.operator_menu_enum("btfsep.refine_alignment", "moves", icon="CON_CAMERASOLVER")
        image = settings.image
        if image is not None and image.size[0] and pinhole.shown(scene, image.size) is None:
            box = layout.box()
            box.alert = True
            _wrapped(
                context,
                box,
                f"The photo is {image.size[0]} x {image.size[1]}; the scene renders another shape. "
                "Set the scene's resolution to the photo's.",
                icon="ERROR",
            )


class BTFSEP_PT_objects(_Sidebar, bpy.types.Panel):
    bl_label = "Objects and Materials"

    def draw(self, context):
        layout = self.layout
        settings, run = context.scene.btfsep, runs.run_state()
        layout.enabled = not runs.is_running()
        if settings.depth is None:
            row = layout.row()
            row.template_list("BTFSEP_UL_objects", "", settings, "objects", settings, "active_object", rows=3)
            column = row.column(align=True)
            column.operator("btfsep.add_objects", text="", icon="ADD")
            column.operator("btfsep.remove_object", text="", icon="REMOVE")
        else:
            layout.label(text=f"Surface of {settings.depth.name}", icon="SURFACE_DATA")

        entry = request.active_entry(settings)
        split = layout.column()
        split.use_property_split = True
        split.use_property_decorate = False
        if entry is not None:
            row = split.row(align=True)
            if run.library:
                row.prop_search(entry, "material", run, "library", text="Material", icon="MATERIAL")
            else:  # names not read yet: a search would show any name as wrong
                row.prop(entry, "material", text="Material", icon="MATERIAL")
            row.operator("btfsep.read_library", text="", icon="FILE_REFRESH")
            row = split.row(align=True)
            row.prop(entry, "mask")
            row.operator("btfsep.open_picture", text="", icon="FILE_FOLDER").target = "mask"
        split.prop(settings, "occluders")
        chosen = preferences.get(context)
        if isinstance(chosen, bpy.types.AddonPreferences):
            split.prop(chosen, "library", text="Library")
        layout.operator("btfsep.measure_material", icon="NODE_MATERIAL")
        if entry is not None and entry.candidates:
            self._candidates(context, layout, entry)

    def _candidates(self, context, layout, entry):
        box = layout.box()
        if entry.unknown:
            _wrapped(context, box, "It looks like no material of the library; the nearest are:", icon="QUESTION")
        else:
            box.label(text="Candidates", icon="VIEWZOOM")
        column = box.column(align=True)
        for candidate in entry.candidates[:5]:
            row = column.row(align=True)
            row.active = candidate.name == entry.recognised
            row.operator("btfsep.use_candidate", text=candidate.name, emboss=False).material = candidate.name
            score = row.row()
            score.alignment = "RIGHT"
            score.label(text=f"{candidate.score:.2f}")


class BTFSEP_PT_light(_Sidebar, bpy.types.Panel):
    bl_label = "Light"

    def draw(self, context):
        layout = self.layout
        settings, run = context.scene.btfsep, runs.run_state()
        column = layout.column()
        column.use_property_split = True
        column.use_property_decorate = False
        column.enabled = not runs.is_running()
        _engine_rows(column, settings, "light")
        column.prop(settings, "world_mode")
        if settings.world_mode != "NONE":
            column.prop(settings, "sun_lamp")

        if runs.is_running():
            row = layout.row(align=True)
            row.progress(factor=run.fraction, type="BAR", text=f"{run.stage or run.task}  {100 * run.fraction:.0f} %")
            row.operator("btfsep.cancel", text="", icon="X")
            if run.message:
                layout.label(text=run.message)
        else:
            row = layout.row(align=True)
            row.scale_y = 1.4
            row.operator("btfsep.recognise", icon="VIEWZOOM")
            row.operator("btfsep.estimate", icon="LIGHT_SUN")
            if sequence_run.is_sequence(settings.image):
                layout.operator("btfsep.estimate_sequence", icon="SEQUENCE")
        self._outcome(context, layout, run)
        row = layout.row(align=True)
        row.operator("btfsep.apply", icon="WORLD")
        row.operator("btfsep.show_report", text="", icon="IMAGE_DATA")
        if world.is_ours(context.scene.world):
            layout.operator("btfsep.restore_world", icon="LOOP_BACK")

    def _outcome(self, context, layout, run):
        if run.error:
            box = layout.box()
            box.alert = True
            for number, part in enumerate(run.error.split("; ")):
                _wrapped(context, box, part, icon="BLANK1" if number else "ERROR")
        elif run.summary:
            box = layout.box()
            first, _, details = run.summary.partition("\n\n")
            for number, part in enumerate(first.splitlines()):
                _wrapped(context, box, part, icon="BLANK1" if number else "CHECKMARK")
            if details:
                box.prop(run, "show_details", icon="TRIA_DOWN" if run.show_details else "TRIA_RIGHT", emboss=False)
                for part in details.splitlines() if run.show_details else ():
                    _wrapped(context, box, part, icon="BLANK1")
        if run.warnings:
            box = layout.box()
            for warning in run.warnings:
                _wrapped(context, box, warning.name, icon="ERROR")


class BTFSEP_PT_advanced(_Sidebar, bpy.types.Panel):
    bl_label = "Advanced"
    bl_parent_id = "BTFSEP_PT_light"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context):
        settings = context.scene.btfsep
        column = self.layout.column()
        column.use_property_split = True
        column.use_property_decorate = False
        column.enabled = not runs.is_running()
        column.prop(settings, "exposure_ev", text="Photo Exposure")
        column.prop(settings, "curve")
        row = column.row(align=True)
        row.prop(settings, "depth")
        row.operator("btfsep.open_picture", text="", icon="FILE_FOLDER").target = "depth"
        _engine_rows(column, settings, "advanced")
        column.prop(settings, "mapping")
        if settings.world_mode != "NONE":
            column.prop(settings, "clamp")
        if sequence_run.is_sequence(settings.image):
            column.prop(settings, "interpolation")


def _engine_rows(column, settings, part: str) -> None:
    """The engine's settings that stand in ``part`` of the panel."""
    for s in engine_settings.PANEL:
        if s.panel == part:
            row = column.row(align=True)
            value = row.row(align=True)
            value.prop(settings, s.name)
            if s.auto:
                value.active = not getattr(settings, f"auto_{s.name}")
                row.prop(settings, f"auto_{s.name}", text="Auto", toggle=True)


def _wrapped(context, layout, text: str, *, icon: str = "NONE") -> None:
    """A label over as many lines as the sidebar's width needs: Blender's own labels are cut off."""
    scale = context.preferences.system.ui_scale
    blf.size(0, FONT_SIZE * scale)
    room = max(context.region.width - MARGIN * scale, 80 * scale)
    column = layout.column(align=True)
    column.scale_y = 0.8
    line = ""
    for word in text.split():
        if line and blf.dimensions(0, f"{line} {word}")[0] > room:
            column.label(text=line, icon=icon)
            line, icon = "", "BLANK1" if icon != "NONE" else "NONE"
        line = f"{line} {word}".strip()
    column.label(text=line, icon=icon)


CLASSES = (BTFSEP_UL_objects, BTFSEP_PT_photo, BTFSEP_PT_objects, BTFSEP_PT_light, BTFSEP_PT_advanced)


register, unregister = bpy.utils.register_classes_factory(CLASSES)
