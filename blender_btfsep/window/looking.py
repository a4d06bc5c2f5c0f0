# SPDX-License-Identifier: GPL-3.0-or-later
"""The buttons to look at what was found: the report in an Image Editor, the scene in its light."""

import bpy

from ..basics.errors import InputError
from ..light import kept_light, world
from ..run import buttons, runs
from . import blender_views, camera_look, use_photo

STANDARD = {"view_transform": "Standard", "look": "None", "exposure": 0.0, "gamma": 1.0}


class BTFSEP_OT_show_report(buttons.Greyed, buttons.AtOnce, bpy.types.Operator):
    """Show photo, material, light, re-rendering and difference in an Image Editor"""

    bl_idname = "btfsep.show_report"
    bl_label = "Show Report"

    @staticmethod
    def reason(context) -> str:
        light = kept_light.kept(context.scene)
        return "" if light and light.report else "Estimate the light first: the report comes with it"

    def do(self, context):
        if show(context, kept_light.kept(context.scene).report) is None:
            raise InputError("the report", "no window has room for an Image Editor", "open one, and press again")


def show(context, image):
    """Shows all of an image; gives the area that does, as :func:`image_editor`."""
    area = image_editor(context)
    if area is None:
        return None
    area.spaces.active.image = image
    region = next((region for region in area.regions if region.type == "WINDOW"), None)
    window = next((w for w in context.window_manager.windows if area in w.screen.areas[:]), None)
    if window is not None and region is not None and not bpy.app.background:
        with context.temp_override(window=window, area=area, region=region):
            bpy.ops.image.view_all(fit_view=True)
    return area


def image_editor(context):
    """An area that shows images: one that is open, else that of a new window; None where there can be none."""
    windows = context.window_manager.windows
    there = [area for window in windows for area in window.screen.areas if area.type == "IMAGE_EDITOR"]
    if there:
        return max(there, key=lambda area: area.width * area.height)
    if bpy.app.background:
        return None
    bpy.ops.wm.window_new()
    area = windows[-1].screen.areas[0]
    area.type = "IMAGE_EDITOR"
    return area


def look_of(scene) -> dict:
    """What of the scene's colour management must change, so that a render shows colours as the photo does.

    A file of whole numbers that is shown in sRGB has been through no view transform but Standard, unless it is read as
    a render saved with another (`blender_views`), and no curves but a camera's (`camera_look`), where it is read by
    these. A linear photo has no look of its own: Standard shows it as the background image is shown.
    """
    view, saved_by = scene.view_settings, blender_views.of_photo(scene)
    wanted = STANDARD | ({"view_transform": saved_by.transform, "look": saved_by.look} if saved_by else {})
    return {name: value for name, value in wanted.items() if getattr(view, name) != value}


def curves(scene) -> list[str]:
    """Gives colour management the camera's curve where the photo has one, else takes its curves off; says so."""
    view = scene.view_settings
    if camera_look.is_wanted(scene):
        if camera_look.is_set(view):
            return []
        camera_look.set_curve(view)
        return ["RGB curves: a camera's, as the photo's"]
    if not view.use_curve_mapping:
        return []
    view.use_curve_mapping = False
    return ["RGB curves: off, were on"]


class BTFSEP_OT_rendered_view(buttons.Greyed, buttons.AtOnce, bpy.types.Operator):
    """Look through the camera at the scene in the light that was found, in the colours of the photo"""

    bl_idname = "btfsep.rendered_view"
    bl_label = "Rendered View"
    bl_options = {"REGISTER", "UNDO"}

    @staticmethod
    def reason(context) -> str:
        lit = kept_light.kept(context.scene) or world.is_ours(context.scene.world)  # that of a sequence has no card
        return "" if lit else "Estimate the light first, or import a lighting"

    def do(self, context):
        scene, view = context.scene, context.scene.view_settings
        words = []
        for name, value in look_of(scene).items():
            old = getattr(view, name)
            try:
                setattr(view, name, value)
            except TypeError:  # another colour configuration, without Standard
                words.append(f"'{value}' is not there: {name.replace('_', ' ')} stays {old}")
                continue
            shown = (f"{old:g}", f"{value:g}") if isinstance(value, float) else (old, value)
            words.append(f"{name.replace('_', ' ').capitalize()}: {shown[1]}, was {shown[0]}")
        words += curves(scene)
        if use_photo.is_behind(scene) and not scene.render.film_transparent:
            scene.render.film_transparent = True  # else the World hides the photo behind the objects
            words.append("Film: transparent, so that the photo stays behind")
        state = runs.run_state()
        if state.overlay != "OFF":
            state.overlay = "OFF"
            words.append("Over the Photo: off, or the photo would lie over the render")
        for space in use_photo.views(context):
            space.shading.type = "RENDERED"
            use_photo.through(space, scene.btfsep.camera or scene.camera)
        return "; ".join(words) or "Colour management is as the photo's already"


register, unregister = bpy.utils.register_classes_factory((BTFSEP_OT_show_report, BTFSEP_OT_rendered_view))
