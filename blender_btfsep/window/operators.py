# SPDX-License-Identifier: GPL-3.0-or-later
"""The buttons that start the engine."""

import contextlib

import bpy

from ..basics.errors import InputError
from ..engine import checkup, engine_process
from ..light import group_ahead, world
from ..photo import photo
from ..run import between_steps, buttons, request, runs
from ..run.answer import FOUND, take_estimate, take_light, take_materials
from . import library

CAME = "The light had come before that: it is the World, unchecked; undo takes it back"


class NeedsScene(buttons.Greyed):
    """Greyed out until there are a photo, a camera and objects."""

    reason = staticmethod(request.missing)


class BTFSEP_OT_recognise(NeedsScene, runs.EngineOperator, bpy.types.Operator):
    """Recognise the material of each object from the photo"""

    bl_idname = "btfsep.recognise"
    bl_label = "Recognise"
    bl_options = {"REGISTER", "UNDO"}
    task = "Recognising"

    @staticmethod
    def reason(context) -> str:
        return request.missing(context) or request.nothing_to_recognise(context.scene.btfsep)

    def begin(self, context):
        self._ids = request.ids_of(context.scene.btfsep)
        folder = yield from request.job_slices(context)
        return request.engine_arguments("recognise", folder, self.scene())

    def finish(self, context, result):
        return ", ".join(take_materials(self.scene(), result.get("objects"), self._ids)) or "Nothing was recognised"


class BTFSEP_OT_estimate(NeedsScene, runs.EngineOperator, bpy.types.Operator):
    """Estimate the light of the photo and make it the World; recognises materials that are not given"""

    bl_idname = "btfsep.estimate"
    bl_label = "Estimate Light"
    bl_options = {"REGISTER", "UNDO"}
    task = "Estimating"
    outlives = True

    @classmethod
    def kind(cls, scene):
        """As of all runs; recognition takes longer than the light does."""
        recognises = any(e.source == "RECOGNISE" for e in request.fitted(scene.btfsep).values())
        return super().kind(scene) + " and recognising" * recognises

    def begin(self, context):
        self._ids = request.ids_of(context.scene.btfsep)
        folder = yield from request.job_slices(context)
        return request.engine_arguments("estimate", folder, self.scene(), "--out", folder / "result")

    def meanwhile(self):
        """The node group of the light."""
        with contextlib.suppress(InputError):  # the scene is gone: the end says it
            scene = self.scene()
            settings = scene.btfsep
            if settings.world_mode == "NODES" and not settings.auto_order and world.needs_group(scene, settings.order):
                group_ahead.go_on(settings.order)

    def _heard(self, message):
        super()._heard(message)
        if isinstance(message, engine_process.Light):
            # what is wrong is said at the end
            with contextlib.suppress(InputError), between_steps.writing(group_ahead.waiting()):
                take_light(self.scene(), message.lighting)
                self._lit = True

    def _end(self, context, last):
        done = super()._end(context, last)
        if done == {"CANCELLED"} and getattr(self, "_lit", False):
            bpy.ops.ed.undo_push(message=self.bl_label)  # the light that came before the end is a step of its own
            if isinstance(last, engine_process.Cancelled):
                runs.run_state().summary += f"\n{CAME}"
        group_ahead.give_up()
        between_steps.known()
        return done

    def finish(self, context, result):
        scene = self.scene()
        said = photo.named(scene.btfsep.image, result.get("warnings") or [])
        own = [warning.name for warning in runs.run_state().warnings if warning.name not in said]
        sentences = take_estimate(scene, result, self._ids, own=own)
        applied = scene.btfsep.world_mode != "NONE"
        return sentences[sentences.index("") - 1] if applied else FOUND


class BTFSEP_OT_doctor(runs.EngineOperator, bpy.types.Operator):
    """Start the engine and test whether it can work on this machine"""

    bl_idname = "btfsep.doctor"
    bl_label = "Test Engine"
    task = "Testing"

    def begin(self, context):
        return ["doctor"]

    def finish(self, context, result):
        checkup.take(result)
        return "The engine works"

    def _fail(self, message):
        checkup.take_failure(message)
        super()._fail(message)


class BTFSEP_OT_clear_cache(buttons.Greyed, runs.EngineOperator, bpy.types.Operator):
    """Take away what the engine keeps of earlier runs: charts of meshes, recognisers. It is made again where needed"""

    bl_idname = "btfsep.clear_cache"
    bl_label = "Clear Cache"
    task = "Clearing the cache"

    def begin(self, context):
        return ["cache", "--clear"]

    def finish(self, context, result):
        stays = f"; {result['bytes'] / 1e6:.0f} MB stay: in use, or not yours to take away" if result["bytes"] else ""
        return f"{result['freed'] / 1e6:.0f} MB are free now{stays}"


class BTFSEP_OT_read_library(buttons.Greyed, runs.EngineOperator, bpy.types.Operator):
    """Read the library's materials anew"""

    bl_idname = "btfsep.read_library"
    bl_label = "Read Library"
    task = "Reading the library"

    def begin(self, context):
        return library.arguments()

    def finish(self, context, result):
        return f"{library.take(result)} materials in the library"


class BTFSEP_OT_cancel(buttons.Greyed, bpy.types.Operator):
    """Stop the engine"""

    bl_idname = "btfsep.cancel"
    bl_label = "Cancel"

    @staticmethod
    def reason(context) -> str:
        return "" if runs.is_running() else "Nothing is running"

    def execute(self, context):
        runs.current.cancel()
        runs.run_state().message = "stopping"
        return {"FINISHED"}


CLASSES = (
    BTFSEP_OT_recognise,
    BTFSEP_OT_estimate,
    BTFSEP_OT_doctor,
    BTFSEP_OT_clear_cache,
    BTFSEP_OT_read_library,
    BTFSEP_OT_cancel,
)


register, unregister = bpy.utils.register_classes_factory(CLASSES)
