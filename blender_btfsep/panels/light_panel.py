# SPDX-License-Identifier: GPL-3.0-or-later
"""The panels of the light, in the tab "BTFsep": settings, run, what was found; advanced settings; a World's sliders."""

import bpy

from ..basics import labels
from ..engine import durations
from ..light import kept_light, sun_lamp, world
from ..light.advice import advice
from ..light.card import doubt_of
from ..run import answer, reasons, request, runs
from ..window import icons, live, operators, sequence_run
from . import doubts, sidebar

SHOWN = 3  # lamps in the panel


class BTFSEP_PT_light(sidebar.Sidebar, bpy.types.Panel):
    """The first of the tab: what it answers is seen without scrolling, and its buttons stay where they are, whatever
    comes below them."""

    bl_label = "Light"

    def draw(self, context):
        layout = self.layout
        settings, run = context.scene.btfsep, runs.run_state()
        column = sidebar.fields(layout)
        column.enabled = not runs.is_running()
        sidebar.engine_rows(column, settings, "light")

        row = sidebar.beside(context, layout)
        row.scale_y = 1.4
        if runs.is_running():
            # In the buttons' place stands a property: what is under the mouse when the engine ends must not be taken by
            # Blender for a label or button that comes then, which would look like it until the mouse moves.
            row.enabled, row.scale_y = False, row.scale_y * (2 if sidebar.is_narrow(context) else 1)
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
                labels.wrapped(context, layout, lacking, icon="INFO")
            else:
                unseen = reasons.unseen(context.scene, settings, request.fitted(settings))
                if unseen:
                    labels.wrapped(context, layout, unseen, icon="ERROR")
            self._beside(context, layout, run, lacking)
        if live.waits(context.scene):
            words = "A light with other lamps or nodes is there. It waits: with it, what you undid could not be redone"
            labels.wrapped(context, layout, words, icon="INFO")
            layout.operator("btfsep.take_light", icon="LIGHT_SUN")
        self._outcome(context, layout, run)
        light = kept_light.kept(context.scene)
        ours = world.is_ours(context.scene.world)
        if light is not None:
            self._card(context, layout, run, light)
        elif ours:
            layout.operator("btfsep.rendered_view", text="Rendered", icon="SHADING_RENDERED")
        if "FREEZE" not in {doubt["mend"] for doubt in doubts.of_card(context.scene)}:
            doubts.suns(context, layout)
        if light is not None:
            if not kept_light.is_the_world(context.scene, light):
                labels.wrapped(context, layout, "This light is not the World now", icon="INFO")
            layout.operator("btfsep.apply", icon="WORLD")
        if ours:
            layout.operator("btfsep.restore_world", icon="LOOP_BACK")

    def _beside(self, context, layout, run, lacking):
        """How long an estimate takes, and the switch that spares asking for one, which stays where one cannot be."""
        settings = context.scene.btfsep
        seconds = None if lacking else durations.expected(operators.BTFSEP_OT_estimate.kind(context.scene))
        there = kept_light.kept(context.scene) is not None
        row = layout.split(factor=0.6) if there else layout
        if seconds is not None:
            row.label(text=f"About {durations.rounded(seconds)}", icon="TIME")
        elif there:
            row.label()
        if there:
            icon = "PAUSE" if lacking and settings.live else "FILE_REFRESH" if run.following else "PLAY"
            row.prop(settings, "live", toggle=True, icon=icon)

    def _outcome(self, context, layout, run):
        """What the last run said, but for what is in the card."""
        if run.error:
            box = layout.box()
            box.alert = True
            labels.parted(context, box, run.error)
        elif run.summary and not run.summary.startswith(
            (answer.APPLIED, answer.FOUND)
        ):  # the card says it, and follows undo
            box = layout.box()
            done = "X" if runs.CANCELLED in run.summary else "CHECKMARK"
            for number, part in enumerate(run.summary.splitlines()):
                labels.wrapped(context, box, part, icon="BLANK1" if number else done)
        if run.warnings and (run.error or run.task != "Estimating"):
            said = {found.short: found for found in (advice(each.name) for each in run.warnings) if found.short}
            box = layout.box() if said else None
            for found in said.values():  # all of each is in the Info editor
                doubts.draw(context, box, doubt_of(found))

    def _card(self, context, layout, run, light):
        card = kept_light.card(light)
        box = layout.box()
        lines = card.get("lines") or ()
        for words in (words for label, words in lines if label == "Trust"):  # above all else, however low the window is
            checked = (runs.is_running() or run.following) and card["trust"] == "NONE"
            words = "Being checked …" if checked else words
            labels.wrapped(context, box, words, icon_value=icons.light(card["trust"]))
        if light.picture is not None:
            units = context.region.width / context.preferences.system.ui_scale / 20
            box.template_icon(icons.of_image(light.picture), scale=max(4, min(units - 3.5, 9)))
        row = sidebar.beside(context, box)
        row.operator("btfsep.rendered_view", text="Rendered", icon="SHADING_RENDERED")
        row.operator("btfsep.show_report", text="Report", icon="IMAGE_DATA")
        column = box.column(align=True)
        for label, words in (line for line in lines if line[0] != "Trust"):
            narrow = sidebar.is_narrow(context)  # then what it is stands above, or it would be cut off
            row = column if narrow else column.split(factor=0.3)
            name = row.column()
            name.active, name.scale_y = False, 0.8
            if label or not narrow:
                name.label(text=label)
            labels.wrapped(context, row.column(), words, share=1.0 if narrow else 0.7)
        others = [f"'{lamp.name}'" for lamp in sun_lamp.others(context.scene)]
        if others:
            shine = f"{', '.join(others[:SHOWN])}{' …' * (len(others) > SHOWN)} shine{'s' * (len(others) == 1)}"
            labels.wrapped(context, box, f"{shine} beside this light: hide in renders what should not", icon="INFO")
        for warning in doubts.of_card(context.scene):
            doubts.draw(context, box, warning)
        if card.get("details"):
            row = box.row()
            row.alignment = "LEFT"
            row.prop(run, "show_details", icon="TRIA_DOWN" if run.show_details else "TRIA_RIGHT", emboss=False)
            for part in card["details"] if run.show_details else ():
                labels.wrapped(context, box, part, icon="DOT")


class BTFSEP_PT_advanced(sidebar.Sidebar, bpy.types.Panel):
    bl_label = "Advanced"
    bl_parent_id = "BTFSEP_PT_light"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context):
        settings = context.scene.btfsep
        column = sidebar.fields(self.layout)
        column.enabled = not runs.is_running()
        column.prop(settings, "world_mode")
        if settings.world_mode != "NONE":
            column.prop(settings, "sun_lamp")
        narrow = sidebar.is_narrow(context)  # then shorter words
        column.prop(settings, "exposure_ev", text="Exposure" if narrow else "Photo Exposure")
        row = column.row(align=True)
        row.prop(settings, "depth")
        row.operator("btfsep.open_picture", text="", icon="FILE_FOLDER").target = "depth"
        if settings.depth is not None:
            column.prop(settings, "depth_shift")
        sidebar.engine_rows(column, settings, "advanced")
        column.prop(settings, "mapping")
        if settings.world_mode != "NONE":
            column.prop(settings, "clamp", text="Clamp" if narrow else "Clamp Negative")
        if sequence_run.is_sequence(settings.image):
            column.prop(settings, "interpolation")


class BTFSEP_PT_adjust(sidebar.Sidebar, bpy.types.Panel):
    bl_label = "Adjust"
    bl_order = 10

    @classmethod
    def poll(cls, context):
        return world.is_ours(context.scene.world)

    def draw(self, context):
        column, sliders = sidebar.fields(self.layout), context.scene.world.btfsep
        for name in ("rotation", "key", "fill", "tint", "saturation"):
            row = column.row()
            row.enabled = name != "key" or bool(sun_lamp.lamps(context.scene))
            row.prop(sliders, name, slider=name != "rotation")


register, unregister = bpy.utils.register_classes_factory((BTFSEP_PT_light, BTFSEP_PT_advanced, BTFSEP_PT_adjust))
