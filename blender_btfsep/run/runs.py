# SPDX-License-Identifier: GPL-3.0-or-later
"""A run of the engine as an operator: one body, two drivers.

``invoke`` (a button) is modal: a timer polls the child process, Blender stays usable; ESC over the panel or the Cancel
button stops it. ``execute`` (a script, the command line) blocks until it is over.
"""

import atexit
import functools
import inspect
import sys
import time

import bpy

from ..basics.drawing import draw_when_due, over_panel, redraw
from ..basics.errors import InputError
from ..engine import checkup, durations, engine_process, preferences, resident
from ..light import card, sun_lamp
from ..photo import photo

INTERVAL = 0.05  # seconds between polls
STATUS = 1.0  # seconds between changes of the status bar, which is not ours alone
CANCELLED = "cancelled"
RUNNING = "The engine is running: wait or cancel"

give_way = None
"""What a run that begins ends first, where something asks the engine by itself (`live`)."""

current = None
"""The Preparation or the EngineProcess that runs now, if any: one at a time."""

adopted = None
"""What an operator that is begun goes on with: what another one knew, whose window was closed."""


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


class Preparation:
    """What comes before the engine, a slice at a time: as much of an EngineProcess as a run needs."""

    def __init__(self, slices):
        self._slices, self.over, self.cancelled, self.arguments = slices, False, False, None

    def step(self) -> bool:
        """Does the next slice; gives whether that was the last, and ``arguments`` are the engine's."""
        try:
            next(self._slices)
        except StopIteration as end:
            self.arguments, self.over = end.value, True
        return self.over

    def cancel(self) -> None:
        """No further slice."""
        self.cancelled = True

    def kill(self) -> None:
        """The end, at once; what was begun is cleaned up."""
        self._slices.close()
        self.over = True


def start_engine(arguments, engine: str = "", *, stays: bool = True) -> engine_process.EngineProcess:
    """Starts a run of the engine, ``engine`` or the preferences'. Raises InputError.

    ``stays`` : whether it may be the one that stays as long as Blender; else it has a process of its own.
    """
    found = engine_process.find_engine(bpy.path.abspath(engine or preferences.get().engine))
    return resident.start(found, arguments) if stays else engine_process.EngineProcess(found, arguments)


class EngineOperator:
    """What the operators that start the engine share. Subclasses give what they do:

    - ``task``, in words
    - ``begin(context)`` reads the scene and gives the engine's arguments; where that may take long it is a generator,
      whose slices are done one by one while Blender stays usable; raises InputError
    - ``finish(context, result)`` puts the engine's result (dict) into the scene and gives lines for the user; raises
      InputError
    - ``outlives``: whether what the engine finds is of use where the file was left meanwhile
    """

    outlives = False

    def meanwhile(self) -> None:
        """What can be done for the answer while the engine works, a little at a time."""

    @classmethod
    def description(cls, context, properties):
        """The tooltip, with the seconds that the last run took."""
        about = (inspect.getdoc(cls) or "").strip()
        seconds = durations.in_words(cls.kind(context.scene))
        return f"{about}. {seconds}" if seconds else about

    @classmethod
    def kind(cls, scene) -> str:
        """What takes about as long: the command, and the preset for what has one."""
        return f"{cls.__name__} {scene.btfsep.preset}"

    # ------------------------------------------------------------------ the two drivers

    def execute(self, context):
        return self._wait(context) if self._start(context) else {"CANCELLED"}

    def _wait(self, context):
        try:
            if isinstance(current, Preparation) and not self._prepared(whole=True):
                return {"CANCELLED"}
            last = current.wait(self._heard)
        except KeyboardInterrupt:
            current.kill()
            last = engine_process.Cancelled()
        except Exception:
            self._give_up()
            raise
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
        try:
            return self._went_on(context, event)
        except Exception:
            self._no_timer(context)
            self._give_up()
            raise

    def _went_on(self, context, event):
        if event.type == "ESC" and event.value == "PRESS" and over_panel(context.window, event.mouse_x, event.mouse_y):
            current.cancel()
            run_state().message = "stopping"
            redraw()
            return {"RUNNING_MODAL"}
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        last = None
        if isinstance(current, Preparation):
            if current.cancelled:
                current.kill()
                last = engine_process.Cancelled()
            elif not self._prepared():
                self._no_timer(context)
                return {"CANCELLED"}
        elif not self._waits():
            for message in current.poll():
                if current.over and isinstance(message, engine_process.LAST):
                    last = message
                else:
                    self._heard(message)
            if last is None:
                self.meanwhile()
        if last is not None:
            self._no_timer(context)
            return self._end(context, last)
        run_state().fraction = self._clock.fraction()
        draw_when_due()
        self._status(context)
        return {"PASS_THROUGH"}

    def cancel(self, context):
        """Blender gives the operator up: its window is closed, another file is opened, or it quits."""
        self._no_timer(context)
        run_state().running = False
        go_on = functools.partial(given_up, type(self), current, dict(vars(self)), self.as_keywords())
        bpy.app.timers.register(go_on, persistent=True)  # by then it is known which

    def _give_up(self) -> None:
        """A bug: nothing runs any more, or all buttons would wait for its end."""
        global current
        if current is not None:
            current.kill()
            current = None
        run_state().running = False
        run_state().error = f"{self.task} was stopped by a bug in BTFsep; the console says where; please report it"
        redraw(at_once=True)

    def _waits(self) -> bool:
        """Whether what the engine says has to wait for the user."""
        scene = next((each for each in bpy.data.scenes if each.session_uid == self._scene), None)
        return scene is not None and sun_lamp.are_moved(scene)

    def _no_timer(self, context) -> None:
        if self._timer is not None:
            context.window_manager.event_timer_remove(self._timer)
            self._timer = None
        if context.workspace is not None:
            context.workspace.status_text_set(None)

    def _status(self, context) -> None:
        """How far it is, in the status bar."""
        now = time.monotonic()
        if context.workspace is None or now - self._told < STATUS:
            return
        self._told = now
        state, left = run_state(), self._clock.left()
        soon = "" if left is None else f", about {durations.rounded(left)} left"
        what = f"{self.task}: {state.stage}" if state.stage else self.task
        text = f"BTFsep  {what}  {100 * state.fraction:.0f} %{soon}   (Esc over its panel stops it)"
        context.workspace.status_text_set(text)

    # ------------------------------------------------------------------ the body

    def _start(self, context) -> bool:
        global current, adopted
        state = run_state()
        if adopted is not None:
            vars(self).update(adopted)
            adopted, state.running = None, True
            return True
        if is_running():
            self.report({"ERROR"}, "the engine is running already; wait for it or cancel it")
            return False
        if give_way is not None:
            give_way()
        self._scene, self._scene_name = (
            context.scene.session_uid,
            context.scene.name,
        )  # the id survives undo and renaming
        self._clock, self._told = durations.Clock(self.kind(context.scene)), 0.0
        state.error = state.summary = state.message = state.stage = ""
        state.fraction = 0.0
        state.warnings.clear()
        try:
            begun = self.begin(context)
            current = Preparation(begun) if inspect.isgenerator(begun) else start_engine(begun)
        except InputError as error:
            self._fail(str(error))
            return False
        state.running, state.task = True, self.task
        if isinstance(current, Preparation):
            state.stage = "Writing the job"
        redraw()
        return True

    def _prepared(self, *, whole: bool = False) -> bool:
        """Does a slice of the preparation, or all of it, and starts the engine after the last; gives whether it can."""
        global current
        try:
            while not current.step():
                if not whole:
                    return True
                time.sleep(INTERVAL)
            current = start_engine(current.arguments)
        except InputError as error:
            current = None
            run_state().running = False
            self._fail(str(error))
            return False
        run_state().stage = ""
        return True

    def _heard(self, message) -> None:
        state = run_state()
        if isinstance(message, engine_process.Progress):
            self._clock.heard(message.whole)
            state.stage, state.message, state.fraction = message.title, message.message, self._clock.fraction()
        elif isinstance(message, engine_process.Notice):
            scene = next((each for each in bpy.data.scenes if each.session_uid == self._scene), None)
            (sentence,) = photo.named(scene and scene.btfsep.image, [message.message])
            state.warnings.add().name = sentence
            self.report({"WARNING"}, card.plain(sentence))
        redraw()

    def _end(self, context, last):
        global current
        current = None
        state = run_state()
        state.running = False
        state.stage = state.message = ""
        redraw(at_once=True)
        if isinstance(last, engine_process.Cancelled):
            state.summary = f"{self.task}: {CANCELLED}"
            self.report({"WARNING"}, state.summary)
            return {"CANCELLED"}
        if isinstance(last, engine_process.Failed):
            if last.details:
                sys.stderr.write(last.details + "\n")  # the traceback, for the one who reports the bug
            self._fail(last.message)
            return {"CANCELLED"}
        self._clock.keep()
        checkup.measure()
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
        redraw(at_once=True)

    def scene(self):
        """The scene that the run was started for; it may have been deleted meanwhile. Raises InputError."""
        scene = next((each for each in bpy.data.scenes if each.session_uid == self._scene), None)
        if scene is None:
            raise InputError(f"scene '{self._scene_name}'", "it is gone", "run it again in the scene you want")
        return scene


def forget() -> None:
    """What the last run said is of a file that is left, or of another light than there is now: the panel drops it."""
    state = run_state()
    state.error = state.summary = ""
    state.warnings.clear()


def warn(sentence: str) -> None:
    """A warning that is not the engine's: in the panel's box, and on the terminal."""
    run_state().warnings.add().name = sentence
    sys.stderr.write(f"warning: {sentence}\n")


def given_up(operator, process, known: dict, properties: dict) -> None:
    """An operator is no more whose ``process`` goes on: in another window, or for a file that was left.

    ``known`` : the operator's own attributes; ``properties`` : those that it was begun with
    """
    global current, adopted
    if process is None or process is not current:
        return
    windows = bpy.context.window_manager.windows
    there = any(scene.session_uid == known["_scene"] for scene in bpy.data.scenes)
    if isinstance(process, Preparation) or not (there or operator.outlives):
        process.kill()
        current = None
    if there and windows:
        adopted = known if current is not None else None  # else it is begun anew
        try:
            with bpy.context.temp_override(window=windows[0]):
                getattr(bpy.ops.btfsep, operator.bl_idname.partition(".")[2])("INVOKE_DEFAULT", **properties)
        finally:
            adopted = None
    elif current is not None:
        leave(current, operator.task, known["_scene_name"])


def leave(process, task: str, scene: str):
    """The file that ``process`` works for is left: it goes on, and the next file's panel says where its light is."""

    def look():
        global current
        if process is not current:
            return None  # stopped meanwhile
        for message in process.poll():
            if process.over and isinstance(message, engine_process.LAST):
                current = None
                said = ""
                if isinstance(message, engine_process.Done):
                    where = message.result.get("lighting") or message.result.get("out")
                    said = f"The light of scene '{scene}', of the file that was left, is in {where}"
                elif isinstance(message, engine_process.Failed):
                    said = f"{task} for the file that was left: {message.message}"
                run_state().summary = said
                redraw(at_once=True)
                return None
        return INTERVAL

    bpy.app.timers.register(look, first_interval=INTERVAL, persistent=True)
    return look
