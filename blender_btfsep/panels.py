# SPDX-License-Identifier: GPL-3.0-or-later
"""The tab "BTFsep" in the sidebar of the 3D view."""

import blf
import bpy

from . import (
    answer,
    durations,
    engine_settings,
    icons,
    kept_light,
    library,
    mending,
    operators,
    outlines,
    own_surface,
    photo,
    preferences,
    reasons,
    request,
    runs,
    sequence_run,
    sun_lamp,
    upright,
    use_photo,
    world,
)
from . import camera as pinhole
from .card import capitalised

FONT_SIZE = 11  # of Blender's labels, in points, at scale 1
SHOWN = 3  # candidates, or lamps, in the panel
PREFIX = "BTFsep "  # of our lamps: their numbers at the end are what tells them apart
PICTURE = 5  # units, the height of a material's picture
MARGIN = 105  # pixels of the sidebar's width that a label with an icon in a box cannot have, at scale 1


class BTFSEP_UL_objects(bpy.types.UIList):
    def draw_item(self, context, layout, data, item, icon, active_data, active_propname):
        if item.object is None:
            layout.label(text="(deleted)", icon="ERROR")
            return
        row = layout.split(factor=0.48, align=True)
        row.prop(item.object, "name", text="", emboss=False, icon="OBJECT_DATA")
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
        if settings.image is None:
            layout.operator("btfsep.open_example", icon="SCENE_DATA")
        layout.template_ID(settings, "image", open="image.open")
        camera, image = settings.camera or scene.camera, settings.image
        column = _fields(layout)
        column.prop(settings, "camera", placeholder=scene.camera.name if scene.camera else "None")
        there = image is not None and image.size[0]
        if there:
            floats = photo.of_floats(image)
            row = column.row()
            row.enabled = not floats
            row.prop(settings, "curve", text="Read As")
            if settings.curve == "auto" or floats:
                read = use_photo.read_as(image, "auto")
                _wrapped(context, layout, read[:1].upper() + read[1:], icon="INFO")
        if sequence_run.is_sequence(image):
            shown = photo.file_at(image, camera, scene.frame_current)
            _wrapped(context, layout, f"At this frame: {shown.name if shown else ''}", icon="SEQUENCE")
        if upright.asked(image) != 1:
            _wrapped(context, layout, "The photo's file asks for it to be turned", icon="INFO")
            layout.operator("btfsep.turn_upright", icon="LOOP_FORWARDS")
        behind = use_photo.is_behind(scene)
        if behind and there and pinhole.shown(scene, image.size) is None:
            box = layout.box()
            box.alert = True
            _wrapped(
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
            column.row(align=True).prop(runs.run_state(), "overlay", expand=True)
            if runs.run_state().overlay != "OFF" and outlines.too_fine(scene):
                _wrapped(context, layout, "A mesh has too many faces to be drawn over the photo", icon="INFO")
            _refine_alignment(layout, settings)


class BTFSEP_PT_objects(_Sidebar, bpy.types.Panel):
    bl_label = "Objects and Materials"

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
            self._made_of(context, layout, entry)
        split = _fields(layout)
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
            split.prop(thing, "btfsep_evidence", text=f"'{thing.name}' as Evidence")

    def _made_of(self, context, layout, entry):
        split = _fields(layout)
        split.prop(entry, "source")
        if entry.source == "COLOUR":
            split.prop(entry, "colour")
            split.prop(entry, "roughness")
            split.prop(entry, "metallic")
        elif entry.source == "BLENDER":
            _wrapped(context, layout, own_surface.words(entry.object), icon="MATERIAL")
        elif entry.source == "LIBRARY":
            self._library(context, layout, entry)
        elif entry.candidates:
            self._candidates(context, layout, entry)

    def _library(self, context, layout, entry):
        library.ensure()
        run = runs.run_state()
        row = layout.row(align=True)
        if run.library:
            row.prop(run, "library_class", text="")
            row.operator("btfsep.library_assets", text="", icon="ASSET_MANAGER")
            row.operator("btfsep.read_library", text="", icon="FILE_REFRESH")
            layout.template_icon_view(entry, "browse", show_labels=True, scale=PICTURE, scale_popup=4.5)
            layout.prop_search(entry, "material", run, "library", text="", icon="MATERIAL")
        elif run.library_error:
            layout.prop(entry, "material", text="", icon="MATERIAL")  # a search would show any name as wrong
            for number, part in enumerate(run.library_error.split("; ")):
                _wrapped(context, layout, part[:1].upper() + part[1:], icon="BLANK1" if number else "ERROR")
            layout.operator("btfsep.read_library", icon="FILE_REFRESH")
        else:  # as high as what comes, or all below would jump away from the mouse
            layout.label(text="Reading the library …", icon="SORTTIME")
            room = layout.box()
            room.scale_y = PICTURE
            room.label()
            layout.prop(entry, "material", text="", icon="MATERIAL")
        chosen = preferences.get(context)
        if isinstance(chosen, bpy.types.AddonPreferences):
            layout.prop(chosen, "library", text="", placeholder="The library that comes with it")
        layout.operator("btfsep.measure_material", icon="NODE_MATERIAL")

    def _candidates(self, context, layout, entry):
        box = layout.box()
        if entry.unknown:
            _wrapped(context, box, "It looks like no material of the library; the nearest are:", icon="QUESTION")
        column = box.column(align=True)
        library.ensure()  # for the thumbnails
        pictures = {material.name: material.thumbnail for material in runs.run_state().library}
        for candidate in entry.candidates[:SHOWN]:
            row = column.split(factor=0.7, align=True)
            row.active = candidate.name == entry.recognised
            name, picture = candidate.name, pictures.get(candidate.name)
            own = name.rsplit("/", 1)[-1]
            shown = icons.of_file(picture) if picture else 0
            row.operator("btfsep.use_candidate", text=own, icon_value=shown, emboss=False).material = name
            row.progress(factor=candidate.score, type="BAR", text=f"{100 * candidate.score:.0f} %")


class BTFSEP_PT_light(_Sidebar, bpy.types.Panel):
    bl_label = "Light"

    def draw(self, context):
        layout = self.layout
        settings, run = context.scene.btfsep, runs.run_state()
        column = _fields(layout)
        column.enabled = not runs.is_running()
        _engine_rows(column, settings, "light")
        column.prop(settings, "world_mode")
        if settings.world_mode != "NONE":
            column.prop(settings, "sun_lamp")
        self._suns(context, layout)

        row = layout.row(align=True)
        row.scale_y = 1.4
        if runs.is_running():
            # In the buttons' place stands a property: what is under the mouse when the engine ends must not be taken by
            # Blender for a label or button that comes then, which would look like it until the mouse moves.
            row.enabled = False
            row.prop(run, "running", text=f"{run.task} …", toggle=True)
            row = layout.row(align=True)
            row.progress(factor=run.fraction, type="BAR", text=f"{100 * run.fraction:.0f}%  {run.stage}")
            row.operator("btfsep.cancel", text="", icon="X")
            if run.message:
                layout.label(text=run.message)
        else:
            row.operator("btfsep.recognise", icon="VIEWZOOM")
            row.operator("btfsep.estimate", icon="LIGHT_SUN")
            if sequence_run.is_sequence(settings.image):
                layout.operator("btfsep.estimate_sequence", icon="SEQUENCE")
            lacking = request.missing(context)
            if lacking:
                _wrapped(context, layout, lacking, icon="INFO")
            else:
                unseen = reasons.unseen(context.scene, settings, request.fitted(settings))
                if unseen:
                    _wrapped(context, layout, unseen, icon="ERROR")
                self._beside(context, layout, run)
        self._outcome(context, layout, run)
        light = kept_light.kept(context.scene)
        if light is not None:
            self._card(context, layout, run, light)
        layout.operator("btfsep.apply", icon="WORLD")
        if world.is_ours(context.scene.world):
            layout.operator("btfsep.restore_world", icon="LOOP_BACK")

    def _suns(self, context, layout):
        """The Sun lamps: those of the estimate, those that are known, and the active one, each with its button."""
        scene, known, active = context.scene, sun_lamp.known(context.scene), context.object
        chosen = [active] if active is not None and active.type == "LIGHT" else []
        shown = dict.fromkeys((*known, *sun_lamp.lamps(scene), *chosen))
        column = layout.column(align=True)
        for lamp in (lamp for lamp in shown if lamp.data.type == "SUN"):
            row = column.row(align=True)
            held = lamp in known
            row.label(text=lamp.name.removeprefix(PREFIX), icon="LIGHT_SUN")
            words, icon = ("Free", "UNLOCKED") if held else ("Freeze Sun", "LOCKED")
            row.operator(f"btfsep.{'free' if held else 'freeze'}_sun", text=words, icon=icon).name = lamp.name

    def _beside(self, context, layout, run):
        """How long an estimate takes, and the switch that spares asking for one."""
        settings = context.scene.btfsep
        seconds = durations.expected(operators.BTFSEP_OT_estimate.kind(context.scene))
        there = kept_light.kept(context.scene) is not None
        row = layout.split(factor=0.6) if there else layout
        if seconds is not None:
            row.label(text=f"About {durations.rounded(seconds)}", icon="TIME")
        elif there:
            row.label()
        if there:
            row.prop(settings, "live", toggle=True, icon="FILE_REFRESH" if run.following else "PLAY")

    def _outcome(self, context, layout, run):
        """What the last run said, but for what is in the card."""
        if run.error:
            box = layout.box()
            box.alert = True
            for number, part in enumerate(run.error.split("; ")):
                _wrapped(context, box, part[:1].upper() + part[1:], icon="BLANK1" if number else "ERROR")
        elif run.summary and not run.summary.startswith(
            (answer.APPLIED, answer.FOUND)
        ):  # the card says it, and follows undo
            box = layout.box()
            done = "X" if run.summary.endswith(runs.CANCELLED) else "CHECKMARK"
            for number, part in enumerate(run.summary.splitlines()):
                _wrapped(context, box, part, icon="BLANK1" if number else done)
        if run.warnings and (run.error or run.task != "Estimating"):
            box = layout.box()
            for warning in capitalised(each.name for each in run.warnings):
                _wrapped(context, box, warning, icon="ERROR")

    def _card(self, context, layout, run, light):
        card = kept_light.card(light)
        box = layout.box()
        if light.picture is not None:
            units = context.region.width / context.preferences.system.ui_scale / 20
            box.template_icon(icons.of_image(light.picture), scale=max(4, min(units - 3.5, 9)))
        row = box.row(align=True)
        row.operator("btfsep.rendered_view", text="Rendered", icon="SHADING_RENDERED")
        row.operator("btfsep.show_report", text="Report", icon="IMAGE_DATA")
        column = box.column(align=True)
        for label, words in card.get("lines") or ():
            if label == "Trust":
                checked = (runs.is_running() or run.following) and card["trust"] == "NONE"
                words = "Being checked …" if checked else words
                _wrapped(context, column, words, icon_value=icons.light(card["trust"]))
                continue
            row = column.split(factor=0.3)
            name = row.column()
            name.active, name.scale_y = False, 0.8
            name.label(text=label)
            _wrapped(context, row.column(), words, share=0.7)
        others = [f"'{lamp.name}'" for lamp in sun_lamp.others(context.scene)]
        if others:
            shine = f"{', '.join(others[:SHOWN])}{' …' * (len(others) > SHOWN)} shine{'s' * (len(others) == 1)}"
            _wrapped(context, box, f"{shine} beside this light: hide in renders what should not", icon="INFO")
        for warning in card.get("warnings") or ():
            _wrapped(context, box, warning["short"], icon="ERROR")
            mend, about = warning["mend"], next((w for n, w, _ in mending.MENDS if n == warning["mend"]), "")
            if mend == "ALIGN":
                _refine_alignment(box, context.scene.btfsep)
            elif mend == "UPRIGHT":
                box.operator("btfsep.turn_upright", icon="LOOP_FORWARDS")
            elif mend == "FREEZE":
                self._suns(context, box)
            elif mend:
                button = box.operator("btfsep.mend", text=about)
                button.how, button.object = mend, warning["object"]
        if card.get("details"):
            row = box.row()
            row.alignment = "LEFT"
            row.prop(run, "show_details", icon="TRIA_DOWN" if run.show_details else "TRIA_RIGHT", emboss=False)
            for part in card["details"] if run.show_details else ():
                _wrapped(context, box, part, icon="DOT")


class BTFSEP_PT_advanced(_Sidebar, bpy.types.Panel):
    bl_label = "Advanced"
    bl_parent_id = "BTFSEP_PT_light"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context):
        settings = context.scene.btfsep
        column = _fields(self.layout)
        column.enabled = not runs.is_running()
        column.prop(settings, "exposure_ev", text="Photo Exposure")
        row = column.row(align=True)
        row.prop(settings, "depth")
        row.operator("btfsep.open_picture", text="", icon="FILE_FOLDER").target = "depth"
        if settings.depth is not None:
            column.prop(settings, "depth_shift")
        _engine_rows(column, settings, "advanced")
        column.prop(settings, "mapping")
        if settings.world_mode != "NONE":
            column.prop(settings, "clamp")
        if sequence_run.is_sequence(settings.image):
            column.prop(settings, "interpolation")


def _fields(layout):
    """A column whose names stand beside their fields."""
    column = layout.column()
    column.use_property_split, column.use_property_decorate = True, False
    return column


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


def _refine_alignment(layout, settings) -> None:
    """The button; of a depth only the photo can be shifted."""
    if settings.depth is None:
        layout.operator_menu_enum("btfsep.refine_alignment", "moves", icon="CON_CAMERASOLVER")
    else:
        layout.operator("btfsep.refine_alignment", icon="CON_CAMERASOLVER")


def _wrapped(context, layout, text: str, *, icon: str = "NONE", icon_value: int = 0, share: float = 1.0) -> None:
    """A label over as many lines as the sidebar's width needs: Blender's own labels are cut off.

    ``share`` : of the width that there is
    """
    scale = context.preferences.system.ui_scale
    blf.size(0, FONT_SIZE * scale)
    has_icon = icon != "NONE" or icon_value
    margin = MARGIN if has_icon else MARGIN - 20
    room = max((context.region.width - margin * scale) * share, 60 * scale)
    column = layout.column(align=True)
    column.scale_y = 0.8
    line, given = "", {"icon_value": icon_value} if icon_value else {"icon": icon}
    for word in text.split():
        if line and blf.dimensions(0, f"{line} {word}")[0] > room:
            column.label(text=line, **given)
            line, given = "", {"icon": "BLANK1" if has_icon else "NONE"}
        line = f"{line} {word}".strip()
    column.label(text=line, **given)


CLASSES = (BTFSEP_UL_objects, BTFSEP_PT_photo, BTFSEP_PT_objects, BTFSEP_PT_light, BTFSEP_PT_advanced)


register, unregister = bpy.utils.register_classes_factory(CLASSES)
