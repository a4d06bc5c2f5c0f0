# SPDX-License-Identifier: GPL-3.0-or-later
"""The buttons that start the engine, and what its commands are given and say."""

import os

import bpy

from . import export, lighting_file, preferences, runs, sun_lamp, world
from .errors import InputError


def chosen(settings) -> list:
    """The entries of the object list that still have an object."""
    return [entry for entry in settings.objects if entry.object is not None]


def fitted(settings) -> dict:
    """Name in the job -> entry of what is fitted: the objects, or the one surface of a depth."""
    if settings.depth is not None:
        return {export.SURFACE: settings.surface}
    return {entry.object.name: entry for entry in chosen(settings)}


def active_entry(settings):
    """The entry that the panel shows: the surface of the depth, or the active object; None where there is none."""
    if settings.depth is not None:
        return settings.surface
    return settings.objects[settings.active_object] if settings.active_object < len(settings.objects) else None


def missing(context) -> str:
    """What the scene lacks for a run, as a sentence for a tooltip; empty when nothing is missing."""
    settings = context.scene.btfsep
    if runs.is_running():
        return "The engine is running: wait or cancel"
    if settings.image is None:
        return "Choose the photo first"
    if (settings.camera or context.scene.camera) is None:
        return "The scene has no camera: add the one that took the photo"
    if not fitted(settings):
        return "Add the objects that the photo shows to the list first"
    return ""


def write_job(context, scene, *, folder=None, image_path=None):
    """Exports the job that the settings of ``scene`` describe; gives its folder. Raises InputError.

    ``image_path`` : a photo instead of the panel's.
    """
    settings = scene.btfsep
    if image_path is None and settings.image is None:
        raise InputError("the photo", "none is chosen", "choose the photo in the BTFsep panel")
    entries = fitted(settings)
    folder = folder or runs.job_folder(scene, preferences.get(context).keep_jobs)
    source = context if context.scene == scene else scene
    path = export.export_job(
        source,
        folder,
        image_path=image_path or settings.image,
        camera=settings.camera or scene.camera,
        objects=[entry.object for entry in entries.values() if settings.depth is None],
        occluders=[] if settings.occluders == "NONE" else None,
        materials={name: entry.material for name, entry in entries.items()},
        masks={name: entry.mask for name, entry in entries.items()},
        depth=settings.depth,
        exposure_ev=settings.exposure_ev,
        mapping=settings.mapping,
        curve=settings.curve,
    )
    return path.parent


def engine_options(context) -> list:
    """The engine's options in the panel and in the preferences that every estimate has."""
    settings = context.scene.btfsep
    given = [] if settings.appearance == "auto" else ["--appearance", settings.appearance]
    return ["--preset", settings.preset, *given, *library_arguments(context)]


def order_of(settings) -> str:
    """The order that the panel asks for, as the engine's option has it."""
    return "auto" if settings.auto_order else str(settings.order)


def library_arguments(context) -> list:
    """The option that names the library of the preferences, if they name one."""
    library = preferences.get(context).library
    return ["--library", bpy.path.abspath(library)] if library else []


def take_materials(scene, objects: list) -> list:
    """Puts the engine's word on each object's material into the list; gives sentences about them."""
    by_name = fitted(scene.btfsep)
    words = []
    for found in objects:
        entry = by_name.get(found.get("name"))
        if entry is None:
            continue
        entry.recognised = str(found.get("material") or "")
        entry.unknown = bool(found.get("unknown"))
        entry.candidates.clear()
        for candidate in found.get("candidates") or []:
            item = entry.candidates.add()
            item.name, item.score = str(candidate["name"]), float(candidate["score"])
        words.append(f"{found['name']}: {entry.recognised}" + (" (unsure)" if entry.unknown else ""))
    return words


def told(result: dict) -> list:
    """What the engine says of an estimate, in sentences: what the photo determines, the error to expect, choices."""
    words = [str(result["determined"])] if result.get("determined") else []
    expected = (result.get("expected_error") or {}).get("order_2")
    if expected:
        median, low, high = (f"{100 * expected[key]:.0f}" for key in ("median", "low", "high"))
        words.append(f"Error to expect up to order 2: {median}% ({low}% to {high}%)")
    words += [str(why) for why in (result.get("choice") or {}).values()]
    # A sentence that begins with a material's name keeps that name as it is.
    return [word[:1].upper() + word[1:] if word.split()[0].isalpha() else word for word in words if word.strip()]


class NeedsScene:
    """Greyed out, with the reason, until there are a photo, a camera and objects."""

    @classmethod
    def poll(cls, context):
        reason = missing(context)
        if reason:
            cls.poll_message_set(reason)
        return not reason


class BTFSEP_OT_recognise(NeedsScene, runs.EngineOperator, bpy.types.Operator):
    """Recognise the material of each object from the photo"""

    bl_idname = "btfsep.recognise"
    bl_label = "Recognise"
    bl_options = {"REGISTER", "UNDO"}
    task = "Recognising"

    def begin(self, context):
        folder = write_job(context, context.scene)
        return ["recognise", folder, *library_arguments(context), "--preset", context.scene.btfsep.preset]

    def finish(self, context, result):
        return ", ".join(take_materials(self.scene(), result.get("objects") or [])) or "Nothing was recognised"


class BTFSEP_OT_estimate(NeedsScene, runs.EngineOperator, bpy.types.Operator):
    """Estimate the light of the photo and make it the World; recognises materials that are not given"""

    bl_idname = "btfsep.estimate"
    bl_label = "Estimate Light"
    bl_options = {"REGISTER", "UNDO"}
    task = "Estimating"

    def begin(self, context):
        settings = context.scene.btfsep
        folder = write_job(context, context.scene)
        run = runs.run_state()
        run.folder, run.report = str(folder), ""
        options = ["--order", order_of(settings), "--out", folder / "result"]
        return ["estimate", folder, *options, *engine_options(context)]

    def finish(self, context, result):
        scene = self.scene()
        lighting = lighting_file.read(result["lighting"])
        words = take_materials(scene, result.get("objects") or [])
        report = os.path.join(result["out"], "report.png")
        runs.run_state().report = report if os.path.isfile(report) else ""
        words += told(result)
        if scene.btfsep.world_mode != "NONE":
            given = scene.btfsep
            world.apply_lighting(scene, lighting, mode=given.world_mode, clamp=given.clamp, lamp=given.sun_lamp)
            beside = sun_lamp.beside(scene)
            words += [f"The World is the rest of the light{beside}"] if beside else []
        return "\n".join(words)


class BTFSEP_OT_doctor(runs.EngineOperator, bpy.types.Operator):
    """Start the engine and test whether it can work on this machine"""

    bl_idname = "btfsep.doctor"
    bl_label = "Test Engine"
    task = "Testing"

    def begin(self, context):
        return ["doctor"]

    def finish(self, context, result):
        return "The engine works"


class BTFSEP_OT_read_library(runs.EngineOperator, bpy.types.Operator):
    """Read the names of the library's materials, to choose from"""

    bl_idname = "btfsep.read_library"
    bl_label = "Read Library"
    task = "Reading the library"

    @classmethod
    def poll(cls, context):
        if runs.is_running():
            cls.poll_message_set("The engine is running: wait or cancel")
            return False
        return True

    def begin(self, context):
        return ["library", "list", *library_arguments(context)]

    def finish(self, context, result):
        names = runs.run_state().library
        names.clear()
        for material in result.get("materials") or []:
            names.add().name = str(material["name"])
        return f"{len(names)} materials in the library"


class BTFSEP_OT_cancel(bpy.types.Operator):
    """Stop the engine"""

    bl_idname = "btfsep.cancel"
    bl_label = "Cancel"

    @classmethod
    def poll(cls, context):
        if not runs.is_running():
            cls.poll_message_set("Nothing is running")
            return False
        return True

    def execute(self, context):
        runs.current.cancel()
        runs.run_state().message = "stopping"
        return {"FINISHED"}


CLASSES = (
    BTFSEP_OT_recognise,
    BTFSEP_OT_estimate,
    BTFSEP_OT_doctor,
    BTFSEP_OT_read_library,
    BTFSEP_OT_cancel,
)


def register():
    for cls in CLASSES:
        bpy.utils.register_class(cls)


def unregister():
    runs.stop_now()
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
