# SPDX-License-Identifier: GPL-3.0-or-later
"""The panels of the photo and of the objects, in the tab "BTFsep" of the 3D view's sidebar."""

import bpy

from ..basics import labels
from ..photo import camera as pinhole
from ..photo import photo, upright
from ..run import request, runs
from ..window import outlines, sequence_run, use_photo
from . import made_of, sidebar


class BTFSEP_UL_objects(bpy.types.UIList):
    def draw_item(self, context, layout, data, item, icon, active_data, active_propname):
        if item.object is None:
            layout.label(text="(deleted)", icon="ERROR")
            return
        narrow = sidebar.is_narrow(context)  # then the name has what room there is
        row = layout.split(factor=0.6 if narrow else 0.48, align=True)
        row.prop(item.object, "name", text="", emboss=False, icon="NONE" if narrow else "OBJECT_DATA")
        open_ = item.source == "RECOGNISE"
        known = {"COLOUR": "colour", "BLENDER": "as in Blender", "LIBRARY": item.material or "choose"}.get(
            item.source, item.recognised or "to recognise"
        )
        sub = row.row()
        sub.active = not open_
        if item.source == "COLOUR":
            sub.prop(item, "colour", text="")
        else:
            sub.label(text=known.rsplit("/", 1)[-1], icon="QUESTION" if item.unknown and open_ else "NONE")


class BTFSEP_PT_photo(sidebar.Sidebar, bpy.types.Panel):
    bl_label = "Photo"
    bl_order = 1  # below the light's

    def draw(self, context):
        layout = self.layout
        scene, settings = context.scene, context.scene.btfsep
        layout.enabled = not runs.is_running()
        if settings.image is None:
            layout.operator("btfsep.open_example", icon="SCENE_DATA")
        layout.template_ID(settings, "image", open="image.open")
        camera, image = settings.camera or scene.camera, settings.image
        column = sidebar.fields(layout)
        column.prop(settings, "camera", placeholder=scene.camera.name if scene.camera else "None")
        there = image is not None and image.size[0]
        if there:
            floats = photo.of_floats(image)
            row = column.row()
            row.enabled = not floats
            row.prop(settings, "curve", text="Read As")
            if settings.curve == "auto" or floats:
                read = use_photo.read_as(image, "auto")
                labels.wrapped(context, layout, read[:1].upper() + read[1:], icon="INFO")
        if sequence_run.is_sequence(image):
            shown = photo.file_at(image, camera, scene.frame_current)
            labels.wrapped(context, layout, f"At this frame: {shown.name if shown else ''}", icon="SEQUENCE")
        if upright.orientation_of(image) != 1:
            labels.wrapped(context, layout, "The photo's file asks for it to be turned", icon="INFO")
            layout.operator("btfsep.turn_upright", icon="LOOP_FORWARDS")
        behind = use_photo.is_behind(scene)
        if behind and there and pinhole.shown(scene, image.size) is None:
            box = layout.box()
            box.alert = True
            labels.wrapped(
                context,
                box,
                f"The photo is {image.size[0]} x {image.size[1]}; the scene renders another shape.",
                icon="ERROR",
            )
            box.operator("btfsep.use_photo")
        elif not behind:
            found = use_photo.background(camera) if image is None else None
            words = f"Use '{found.name}' of the Camera" if found else "Use Photo"
            layout.operator("btfsep.use_photo", text=words, icon="CAMERA_DATA")
        if request.listed(settings):
            column = layout.column(align=True)
            column.label(text="Over the Photo", icon="OVERLAY")
            if sidebar.is_narrow(context):  # four words in a row would be cut off
                column.prop(runs.run_state(), "overlay", text="")
            else:
                column.row(align=True).prop(runs.run_state(), "overlay", expand=True)
            if runs.run_state().overlay != "OFF" and outlines.too_fine(scene):
                labels.wrapped(context, layout, "A mesh has too many faces to be drawn over the photo", icon="INFO")
            sidebar.refine_alignment(layout, settings)


class BTFSEP_PT_objects(sidebar.Sidebar, bpy.types.Panel):
    bl_label = "Objects and Materials"
    bl_order = 2

    def draw(self, context):
        layout = self.layout
        settings = context.scene.btfsep
        layout.enabled = not runs.is_running()
        if settings.depth is None:
            row = layout.row()
            row.template_list("BTFSEP_UL_objects", "", settings, "objects", settings, "active_object", rows=2)
            column = row.column(align=True)
            column.operator("btfsep.add_objects", text="", icon="ADD")
            column.operator("btfsep.remove_object", text="", icon="REMOVE")
        else:
            layout.label(text=f"Surface of {settings.depth.name}", icon="SURFACE_DATA")

        entry = request.active_entry(settings)
        if entry is not None:
            made_of.source(context, layout, entry)
        split = sidebar.fields(layout)
        if entry is not None:
            row = split.row(align=True)
            row.prop(entry, "mask")
            if entry.mask is not None:
                row.operator("btfsep.paint_mask", text="", icon="BRUSH_DATA")
            elif entry.object is not None:
                row.operator("btfsep.new_mask", text="", icon="ADD")
            row.operator("btfsep.open_picture", text="", icon="FILE_FOLDER").target = "mask"
        split.prop(settings, "occluders")
        thing = context.object
        if settings.occluders == "OTHERS" and request.may_be_evidence(settings, thing):
            place = layout if sidebar.is_narrow(context) else split
            place.prop(thing, "btfsep_evidence", text=f"'{thing.name}' as Evidence")


register, unregister = bpy.utils.register_classes_factory((BTFSEP_UL_objects, BTFSEP_PT_photo, BTFSEP_PT_objects))
