# SPDX-License-Identifier: GPL-3.0-or-later
"""A run of the engine as an operator: one body, two drivers.

``invoke`` (a button) is modal: a timer polls the child process, Blender stays usable, ESC or the Cancel button
stops it. ``execute`` (a script, the command line) blocks until it is over.
"""

import atexit
import sys

import bpy

from . import engine_process, preferences, resident
from .errors import InputError

INTERVAL = 0.15  # seconds between polls
RUNNING = "The engine is running: wait or cancel"

current = None
"""The EngineProcess that runs now, if any: one at a time."""


def run_state():
    """What the panel shows of the run (on the WindowManager)."""
    return bpy.context.window_manager.btfsep


def is_running() -> bool:
    """Whether the engine runs now."""
    return current is not None and not current.over


def stop_now() -> None:
    """Ends a run that is still going (the add-on is switched off, Blender quits)."""
    global current
    if current is not None:
        current.kill()
        current = None
    resident.stop()


atexit.register(stop_now)


def start_engine(arguments, engine: str = "", *, stays: bool = True) -> engine_process.EngineProcess:
    """Starts a run of the engine, ``engine`` or the preferences'. Raises InputError.

    ``stays`` : whether it may be the one that stays as long as Blender; else it has a process of its own.
    """
    found = engine_process.find_engine(bpy.path.abspath(engine or preferences.get().engine))
    return resident.start(found, arguments) if stays else engine_process.EngineProcess(found, arguments)


class Greyed:
    """An operator that is greyed out while ``reason(context)`` says why; the sentence is its tooltip's."""

    @classmethod
    def poll(cls, context):
        reason = cls.reason(context)
        if reason:
            cls.poll_message_set(reason)
        return not reason


class EngineOperator:
    """What the operators that start the engine share. Subclasses give what they do:

    - ``task``, in words
    - ``begin(context)`` reads the scene and gives the engine's arguments; raises InputError
    - ``finish(context, result)`` puts the engine's result (dict) into the scene and gives lines for the user; raises
      InputError
    """

    # ------------------------------------------------------------------ the two drivers

    def execute(self, context):
        if not self._start(context):
            return {"CANCELLED"}
        try:
            last = current.wait(self._heard)
        except KeyboardInterrupt:
            current.kill()
            last = engine_process.Cancelled()
        return self._end(context, last)

    def invoke(self, context, event):
        if bpy.app.background:
            return self.execute(context)
        if not self._start(context):
            return {"CANCELLED"}
        manager = context.window_manager
        self._timer = manager.event_timer_add(INTERVAL, window=context.window)
        manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context, event):
        if event.type == "ESC" and event.value == "PRESS":
            self._process.cancel()
            run_state().message = "stopping"
            redraw()
            return {"RUNNING_MODAL"}
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        for message in self._process.poll():
            if self._process.over and isinstance(
                message, engine_process.Done | engine_process.Failed | engine_process.Cancelled
            ):
                context.window_manager.event_timer_remove(self._timer)
                return self._end(context, message)
            self._heard(message)
        return {"PASS_THROUGH"}

    def cancel(self, context):
        """Blender gives the operator up: another file is opened, or it quits."""
        self._process.kill()
        context.window_manager.event_timer_remove(self._timer)
        run_state().running = False

    # ------------------------------------------------------------------ the body

    def _start(self, context) -> bool:
        global current
        state = run_state()
        if is_running():
            self.report({"ERROR"}, "the engine is running already; wait for it or cancel it")
            return False
        self._scene, self._scene_name = (
            context.scene.session_uid,
            context.scene.name,
        )  # the id survives undo and renaming
        state.error = state.summary = state.message = state.stage = ""
        state.fraction = 0.0
        state.warnings.clear()
        try:
            self._process = current = start_engine(self.begin(context))
        except InputError as error:
            self._fail(str(error))
            return False
        state.running, state.task = True, self.task
        redraw()
        return True

    def _heard(self, message) -> None:
        state = run_state()
        if isinstance(message, engine_process.Progress):
            state.stage, state.message, state.fraction = message.title, message.message, message.whole
        elif isinstance(message, engine_process.Notice):
            state.warnings.add().name = message.message
            self.report({"WARNING"}, message.message)
        redraw()

    def _end(self, context, last):
        global current
        current = None
        state = run_state()
        state.running = False
        state.stage = state.message = ""
        redraw()
        if isinstance(last, engine_process.Cancelled):
            state.summary = f"{self.task}: cancelled"
            self.report({"WARNING"}, state.summary)
            return {"CANCELLED"}
        if isinstance(last, engine_process.Failed):
            if last.details:
                sys.stderr.write(last.details + "\n")  # the traceback, for the one who reports the bug
            self._fail(last.message)
            return {"CANCELLED"}
        try:
            state.summary = self.finish(context, last.result)
        except InputError as error:
            self._fail(str(error))
            return {"CANCELLED"}
        self.report({"INFO"}, state.summary.partition("\n\n")[0].replace("\n", "; "))
        return {"FINISHED"}

    def _fail(self, message: str) -> None:
        run_state().error = message
        self.report({"ERROR"}, message)
        redraw()

    def scene(self):
        """The scene that the run was started for; it may have been deleted meanwhile. Raises InputError."""
        scene = next((each for each in bpy.data.scenes if each.session_uid == self._scene), None)
        if scene is None:
            raise InputError(f"scene '{self._scene_name}'", "it is gone", "run it again in the scene you want")
        return scene


def warn(sentence: str) -> None:
    """A warning that is not the engine's: in the panel's box, and on the terminal."""
    run_state().warnings.add().name = sentence
    sys.stderr.write(f"warning: {sentence}\n")


def redraw() -> None:
    """Has the panels drawn again."""
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type in {"VIEW_3D", "PREFERENCES"}:
                area.tag_redraw()
