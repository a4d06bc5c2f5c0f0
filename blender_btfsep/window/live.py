# SPDX-License-Identifier: GPL-3.0-or-later
"""Live: after an estimate the light follows what is changed, by a draft at once and the preset when all is quiet.

Photo, mask, camera, what has a surface, and what it is made of: Blender tells of changes (`_heard`), a timer asks the
engine (`_step`). The World is changed in place, without a step of undo: what it follows has one. Where data-blocks come
with a light, as a lamp does, that is a step (`live_steps`).
"""

import argparse
import atexit
import json
import time

import bpy
from bpy.app.handlers import persistent

from ..basics import atomic
from ..basics.errors import InputError
from ..engine import engine_process
from ..light import kept_light, lighting_file, sun_lamp
from ..run import answer, between_steps, buttons, reasons, request, runs
from ..scene import meshes
from ..scene.export import JOB_FILE
from . import live_changes, live_steps

INTERVAL = 0.02  # seconds between looks
QUIET = 0.05  # seconds without a change, before a draft
SETTLED = 1.0  # and before the preset
DRAFT, WHOLE = "draft", "whole"


class Follower:
    """What follows the changes of one scene.

    Attributes
    ----------
    due : what is to be asked next: DRAFT, WHOLE, or "" for nothing
    run : Preparation or process of what is asked now (`asked`), or None
    text : of the light that was given last
    held : what puts the light that waits into the scene, or None
    job : what was written of the scene (folder, its job.json, warnings), or None where it has changed since
    view : the job.json with photo and camera as they are, or None where they have changed since
    """

    def __init__(self):
        self.place, self.due, self.run, self.asked, self._at, self._cancelled = None, "", None, "", 0.0, False
        self.text, self.held, self.job, self.view = "", None, None, None

    def changed(self, scene, what=(live_changes.ALL,)) -> None:
        """Something is not as it was (``what``, of `live_changes`): what is asked now is asked in vain."""
        if self.place is None or self.place.scene != scene or live_changes.ALL in what:
            self.job = None
        if live_changes.OPTIONS not in what or len(what) > 1:
            self.view = None
        self.place, self._at, self.held = live_changes.Place(scene), time.monotonic(), None
        self.due = WHOLE if scene.btfsep.preset == DRAFT else DRAFT
        if self.run is not None and not self._cancelled:
            self.run.cancel()
            self._cancelled = True
        if not bpy.app.timers.is_registered(_step):
            bpy.app.timers.register(_step, first_interval=INTERVAL)

    def give_way(self) -> None:
        """Nothing is due any more, and nothing is asked: another run begins, or the file is left."""
        self.due, self.held, self.job, self.view = "", None, None, None
        self.kill()
        self._over()

    def kill(self) -> None:
        """The end of what is asked now; nothing here needs a Blender that is still there."""
        if self.run is not None:
            self.run.kill()

    def step(self) -> bool:
        """Does what is to be done now; gives whether there may be more."""
        scene = self.place and self.place.scene
        if scene is None or not scene.btfsep.live:
            self.give_way()
            return False
        if bpy.app.is_job_running("RENDER"):
            return True  # a light that changes between two frames is of no use
        try:
            if self.run is not None:
                self._go_on(scene)
            elif self.due and not runs.is_running():
                # a preset that is a draft itself need not wait for more quiet
                after = QUIET if self.due == DRAFT or scene.btfsep.preset == DRAFT else SETTLED
                if time.monotonic() - self._at >= after:
                    self._begin(scene)
        except InputError as error:
            self.give_way()
            runs.run_state().error = str(error)
            runs.redraw(at_once=True)
        if self.held is not None and not self._has_to_wait():
            self.put()
        return bool(self.due) or self.run is not None or (self.held is not None and not live_steps.may_redo())

    def _begin(self, scene) -> None:
        settings, state = scene.btfsep, runs.run_state()
        asked, self.due = self.due, ""
        if reasons.against_run(scene, self.place.view_layer, settings, request.fitted(settings)):
            return  # the panel says it
        self.due = WHOLE if asked == DRAFT else ""
        state.error = state.summary = ""
        state.warnings.clear()
        self.asked, self._ids, self._cancelled = asked, request.ids_of(settings), False
        self.run = runs.Preparation(self._slices(asked))
        self._go_on(scene)

    def _slices(self, asked: str):
        """The engine's arguments, as a generator."""
        folder = yield from self._written()
        scene = self.place.scene
        if asked == WHOLE:
            return request.engine_arguments("estimate", folder, scene, "--out", folder / "result")
        _recognised(scene, folder)
        # what the photo may ask for beside comes with the preset a moment later
        given = ("--out", folder / "draft", "--no-report", "--align", "never", "--refine", "least")
        return request.engine_arguments("estimate", folder, scene, *given, options=argparse.Namespace(preset=DRAFT))

    def _written(self):
        """The folder with the job of the scene as it is, as a generator; what has not changed is not written anew.

        A large scene takes longer to be written than the light to be found. Raises InputError.
        """
        if self.job is not None and (self.job[0] / JOB_FILE).is_file():
            folder, job, said = self.job
            self.view = self.view or request.renewed(self.place, json.loads(job), folder)
            if self.view is not None:
                for sentence in said:
                    runs.run_state().warnings.add().name = sentence
                atomic.write_bytes(folder / JOB_FILE, json.dumps(self.view, indent=1).encode())  # the draft has its own
                return folder
        folder = yield from request.job_slices(self.place)
        with meshes.unheard():  # pictures that were read for the job: Blender would tell of them in a moment
            self.place.view_layer.update()
        job = (folder / JOB_FILE).read_bytes()
        self.job, self.view = (folder, job, [w.name for w in runs.run_state().warnings]), json.loads(job)
        return folder

    def _go_on(self, scene) -> None:
        if isinstance(self.run, runs.Preparation):
            if self._cancelled:
                self.run.kill()
                self._over()
            elif self.run.step():
                self.run = runs.start_engine(self.run.arguments)
                runs.run_state().following = self.asked
                if self.asked == WHOLE:  # a draft is there as soon as it is said
                    runs.redraw(at_once=True)
            return
        if sun_lamp.are_moved(scene):
            return  # what the engine says waits
        for message in self.run.poll():
            if isinstance(message, engine_process.Light) and not self._cancelled:
                self._give(scene, lighting_file.read(message.lighting), answer.take_light, message.lighting)
                if self.asked == DRAFT:
                    self._cancelled, self._at = True, time.monotonic()
                    self.run.cancel()  # what else it would say is not asked
                runs.redraw(at_once=True)
            elif isinstance(message, engine_process.Failed) and not self._cancelled:
                raise InputError(message.message, "", "")
            elif isinstance(message, engine_process.Done) and not self._cancelled:
                own = [warning.name for warning in runs.run_state().warnings]
                found = lighting_file.read(message.result["lighting"])
                self._give(scene, found, answer.take_estimate, message.result, self._ids, own=own)
        if self.run.over:
            self._over()

    def _give(self, scene, lighting: dict, take, *found, **more) -> None:
        """Has ``take`` put what was found into the scene, or keeps it until that can be (:meth:`_has_to_wait`)."""
        self.held = lambda scene: take(scene, *found, **more)
        if answer.fits(scene, lighting) or not self._has_to_wait():
            self.put()

    def _has_to_wait(self) -> bool:
        """Whether lamps and nodes of a new light would be in the way of what the user is at, or may redo."""
        return live_steps.may_redo() or sun_lamp.in_hand()

    def put(self, *, asked: bool = False) -> None:
        """Puts the light that is held into the scene; ``asked``: the user has, so that it is a step like any other."""
        scene, take, self.held = self.place.scene, self.held, None
        with between_steps.writing():
            take(scene)
        self.text = scene.btfsep.light.text
        live_steps.close(scene, follows=not asked)

    def undone(self) -> None:
        """Whether the light is older now than what it followed, and is to come anew."""
        scene = self.place and self.place.scene
        if scene is None or not scene.btfsep.live or not kept_light.kept(scene):
            return
        self.held = None
        if self.text and scene.btfsep.light.text != self.text:
            self.changed(scene)

    def _over(self) -> None:
        self.run, self.asked = None, ""
        runs.run_state().following = self.due
        runs.redraw(at_once=True)


_follower = Follower()
atexit.register(_follower.kill)


def _recognised(scene, folder) -> None:
    """Has the draft of the job in ``folder`` take what was recognised before for known."""
    job = json.loads((folder / JOB_FILE).read_text())
    entries = request.fitted(scene.btfsep)
    for thing in job["objects"]:
        entry = entries.get(thing["name"])
        if entry and entry.source == "RECOGNISE" and not entry.recognised.startswith("surface/"):
            thing["material"] = entry.recognised or None
    atomic.write_bytes(folder / JOB_FILE, json.dumps(job, indent=1).encode())


def _step():
    return INTERVAL if _follower.step() else None


@persistent
def _heard(scene, depsgraph):
    """Blender has changed something."""
    if not scene.btfsep.live or meshes.is_as_rendered() or depsgraph.mode != "VIEWPORT":
        return
    if depsgraph.view_layer.name != live_changes.Place(scene).view_layer.name:
        return  # of another window: it is told of the same later, also of what the export did
    what = set().union(*(live_changes.matters(update, scene) for update in depsgraph.updates))
    if what:
        live_changes.remember(scene)  # what is told a second time is no second change
        if kept_light.kept(scene):
            _follower.changed(scene, what)


@persistent
def _undone(*_):
    _follower.undone()


@persistent
def _left(*_):
    """Another file comes."""
    _follower.give_way()
    runs.forget()


@persistent
def _come(*_):
    """Another file is there."""
    live_changes.known.clear()
    for scene in bpy.data.scenes:
        if scene.btfsep.live:
            live_changes.remember(scene)


def switched(settings) -> None:
    """Live is switched on or off."""
    scene = settings.id_data
    live_changes.remember(scene)
    if not settings.live:
        _follower.give_way()


def waits(scene) -> bool:
    """Whether a light waits for the user, since it would end what may be redone: the last that comes, no draft."""
    at_rest = _follower.held is not None and not _follower.due and _follower.run is None
    return at_rest and live_steps.may_redo() and _follower.place.scene == scene


class BTFSEP_OT_take_light(buttons.Greyed, buttons.AtOnce, bpy.types.Operator):
    """Put the light that waits into the scene. It brings other lamps or nodes: what was undone cannot be redone then"""

    bl_idname = "btfsep.take_light"
    bl_label = "Take the New Light"

    @staticmethod
    def reason(context) -> str:
        return "" if waits(context.scene) else "No light waits"

    def do(self, context):
        _follower.put(asked=True)
        runs.redraw(at_once=True)


HANDLERS = (
    *(("depsgraph_update_post", _heard), ("undo_post", _undone), ("redo_post", _undone)),
    *(("load_pre", _left), ("load_post", _come)),
)


def register():
    bpy.utils.register_class(BTFSEP_OT_take_light)
    runs.give_way = _follower.give_way
    for when, handler in HANDLERS:
        getattr(bpy.app.handlers, when).append(handler)


def unregister():
    _follower.give_way()
    runs.give_way = None
    if bpy.app.timers.is_registered(_step):
        bpy.app.timers.unregister(_step)
    for when, handler in HANDLERS:
        getattr(bpy.app.handlers, when).remove(handler)
    bpy.utils.unregister_class(BTFSEP_OT_take_light)
