# SPDX-License-Identifier: GPL-3.0-or-later
"""Live: after an estimate the light follows what is changed, by a draft at once and the preset when all is quiet.

Photo, mask, camera, what has a surface, and what it is made of: Blender tells of changes (`_heard`), a timer asks the
engine (`_step`). The World is changed in place, without a step of undo: what it follows has one. Where data-blocks come
with a light, as a lamp does, that is a step (`between_steps`).
"""

import argparse
import atexit
import json
import time

import bpy
from bpy.app.handlers import persistent

from ..basics import atomic
from ..basics.errors import InputError
from ..engine import engine_process, engine_settings
from ..light import kept_light, sun_lamp
from ..photo import photo
from ..run import answer, between_steps, reasons, request, runs
from ..scene import meshes

INTERVAL = 0.02  # seconds between looks
QUIET = 0.05  # seconds without a change, before a draft
SETTLED = 1.0  # and before the preset
TOLD = 1.0  # within which Blender tells of what an undo has changed
DRAFT, WHOLE = "draft", "whole"


class Place:
    """A scene as a context has it; it is looked up each time, since undo moves all data."""

    def __init__(self, scene):
        self._uid = scene.session_uid

    @property
    def scene(self):
        """None where it is gone."""
        return next((scene for scene in bpy.data.scenes if scene.session_uid == self._uid), None)

    @property
    def view_layer(self):
        """That of the first window which shows the scene."""
        shown = (w.view_layer for w in bpy.context.window_manager.windows if w.scene == self.scene)
        return next(shown, None) or self.scene.view_layers[0]

    def evaluated_depsgraph_get(self):
        """As of a context."""
        return self.view_layer.depsgraph


class Follower:
    """What follows the changes of one scene.

    Attributes
    ----------
    due : what is to be asked next: DRAFT, WHOLE, or "" for nothing
    run : Preparation or process of what is asked now (`asked`), or None
    text : of the light that was given last
    marked : number of the last step of undo that was a light's, and what stood where then (`_placed`)
    """

    def __init__(self):
        self.place, self.due, self.run, self.asked, self._at, self._cancelled = None, "", None, "", 0.0, False
        self.text, self.marked, self._unheard = "", (0, ()), 0.0

    def changed(self, scene) -> None:
        """Something is not as it was: what is asked now is asked in vain."""
        self.place, self._at = Place(scene), time.monotonic()
        self.due = WHOLE if scene.btfsep.preset == DRAFT else DRAFT
        if self.run is not None and not self._cancelled:
            self.run.cancel()
            self._cancelled = True
        if not bpy.app.timers.is_registered(_step):
            bpy.app.timers.register(_step, first_interval=INTERVAL)

    def give_way(self) -> None:
        """Nothing is due any more, and nothing is asked: another run begins, or the file is left."""
        self.due = ""
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
        return bool(self.due) or self.run is not None

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
        folder = yield from request.job_slices(self.place)
        scene = self.place.scene
        if asked == WHOLE:
            return request.engine_arguments("estimate", folder, scene, "--out", folder / "result")
        _recognised(scene, folder)
        # what takes longest, and comes with the preset a moment later
        given = ("--out", folder / "draft", "--no-report", "--align", "never", "--departures", "never")
        return request.engine_arguments("estimate", folder, scene, *given, options=argparse.Namespace(preset=DRAFT))

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
                self._give(scene, answer.take_light, message.lighting)
                if self.asked == DRAFT:
                    self._cancelled, self._at = True, time.monotonic()
                    self.run.cancel()  # what else it would say is not asked
                runs.redraw(at_once=True)
            elif isinstance(message, engine_process.Failed) and not self._cancelled:
                raise InputError(message.message, "", "")
            elif isinstance(message, engine_process.Done) and not self._cancelled:
                own = [warning.name for warning in runs.run_state().warnings]
                self._give(scene, answer.take_estimate, message.result, self._ids, own=own)
        if self.run.over:
            self._over()

    def _give(self, scene, take, *found, **more) -> None:
        """Has ``take`` put what was found into the scene."""
        with between_steps.writing():
            take(scene, *found, **more)
        self.text = scene.btfsep.light.text
        if between_steps.is_open():
            number = scene.btfsep.live_step = scene.btfsep.live_step + 1
            self.marked = number, _placed(scene)
            between_steps.close("Live")

    def undone(self) -> None:
        """Whether the light is older now than what it followed, and is to come anew; not where it alone was undone."""
        scene = self.place and self.place.scene
        if scene is None or not scene.btfsep.live or not kept_light.kept(scene):
            return
        number, stood = self.marked
        self.marked = scene.btfsep.live_step, stood
        if scene.btfsep.live_step == number - 1:  # where things stand is not known yet
            self._unheard = time.monotonic() + TOLD
        elif self.text and scene.btfsep.light.text != self.text:
            self.changed(scene)

    def is_to_hear(self, scene) -> bool:
        """Whether what Blender tells is more than that a light alone was undone, which it tells once."""
        until, self._unheard = self._unheard, 0.0
        return time.monotonic() > until or _placed(scene) != self.marked[1]

    def _over(self) -> None:
        self.run, self.asked = None, ""
        runs.run_state().following = self.due
        runs.redraw(at_once=True)


_follower = Follower()
atexit.register(_follower.kill)
_known: dict = {}  # session id of a scene -> what of its settings was seen last


def _recognised(scene, folder) -> None:
    """Has the draft of the job in ``folder`` take what was recognised before for known."""
    job = json.loads((folder / "job.json").read_text())
    entries = request.fitted(scene.btfsep)
    for thing in job["objects"]:
        entry = entries.get(thing["name"])
        if entry and entry.source == "RECOGNISE" and not entry.recognised.startswith("surface/"):
            thing["material"] = entry.recognised or None
    atomic.write_bytes(folder / "job.json", json.dumps(job, indent=1).encode())


def _step():
    return INTERVAL if _follower.step() else None


def _facing(scene, sun) -> list:
    """To a known sun, so that its being written again is no change."""
    return [round(float(part), 4) for part in sun_lamp.known_direction(scene, sun)]


def _told(scene) -> tuple:
    """What of a scene's own settings an estimate depends on."""
    s, r = scene.btfsep, scene.render
    pictures = [
        image and (image.session_uid, image.filepath_raw, image.colorspace_settings.name)
        for image in (s.image, s.depth, *(entry.mask for entry in request.fitted(s).values()))
    ]
    made = [
        (thing and thing.session_uid, e.source, e.material, tuple(e.colour), e.roughness, e.metallic)
        for e in request.fitted(s).values()
        for thing in [e.object]
    ]
    camera = s.camera or scene.camera
    pictures.append(s.image and str(photo.file_at(s.image, camera, scene.frame_current)))
    shape = [getattr(r, name) for name in SHAPE]
    suns = [(sun.session_uid, *_facing(scene, sun)) for sun in sun_lamp.known_suns(scene)]
    shift = tuple(s.depth_shift)
    own = (suns, s.occluders, _beside(scene), s.mapping, s.exposure_ev, s.curve, shift)
    own += (camera and camera.session_uid,)
    return (*own, pictures, made, shape, engine_settings.engine_options(engine_settings.COMMANDS["estimate"], s))


def _placed(scene) -> tuple:
    """What an undo of a light alone leaves as it is."""
    things = [scene.btfsep.camera or scene.camera, *(entry.object for entry in request.listed(scene.btfsep))]
    return _told(scene), [thing and [round(part, 6) for row in thing.matrix_world for part in row] for thing in things]


def _beside(scene) -> list:
    """What casts shadows beside the objects, and whether it is evidence: no update tells of an object that is gone."""
    if scene.btfsep.occluders == "NONE":
        return []
    fitted = [entry.object for entry in request.listed(scene.btfsep)]
    shown = meshes.rendered_objects(Place(scene).view_layer).difference(fitted)
    found = (thing for thing in shown if thing.visible_shadow and meshes.has_surface(thing))
    return sorted((thing.session_uid, thing.btfsep_evidence) for thing in found)


SHAPE = (
    *("resolution_x", "resolution_y", "resolution_percentage", "pixel_aspect_x", "pixel_aspect_y", "use_border"),
    *("use_crop_to_border", "border_min_x", "border_max_x", "border_min_y", "border_max_y"),
)


def _matters(update, scene) -> bool:
    """Whether a change that Blender tells of may change the light."""
    thing, settings = update.id.original, scene.btfsep
    others = settings.occluders == "OTHERS"
    entries = request.fitted(settings).values()
    match thing:
        case bpy.types.Object():
            if not (update.is_updated_transform or update.is_updated_geometry):
                return False
            if thing in sun_lamp.known_suns(scene):
                return _differs(scene)
            if thing in ((settings.camera or scene.camera), *(entry.object for entry in entries)):
                return True
            # what another object instances is in no scene
            return meshes.has_surface(thing) and (others or thing.name not in scene.objects)
        case bpy.types.Image():
            return thing in (settings.image, settings.depth, *(entry.mask for entry in entries))
        case bpy.types.Material():
            return others or any(entry.source == "BLENDER" for entry in entries)
        case bpy.types.Scene():
            return _differs(thing)
    return False


def _differs(scene) -> bool:
    """Whether what of a scene's settings matters is not what was seen last, which it becomes."""
    before, now = _known.get(scene.session_uid), _told(scene)
    _known[scene.session_uid] = now
    return before is not None and before != now


@persistent
def _heard(scene, depsgraph):
    """Blender has changed something."""
    if not scene.btfsep.live or meshes.is_as_rendered() or depsgraph.mode != "VIEWPORT":
        return
    if depsgraph.view_layer.name != Place(scene).view_layer.name:
        return  # of another window: it is told of the same later, also of what the export did
    if any(_matters(update, scene) for update in depsgraph.updates):
        _known[scene.session_uid] = _told(scene)  # what is told a second time is no second change
        if _follower.is_to_hear(scene) and kept_light.kept(scene):
            _follower.changed(scene)


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
    _known.clear()
    _known.update({scene.session_uid: _told(scene) for scene in bpy.data.scenes if scene.btfsep.live})


def switched(settings) -> None:
    """Live is switched on or off."""
    scene = settings.id_data
    _known[scene.session_uid] = _told(scene)
    if not settings.live:
        _follower.give_way()


HANDLERS = (
    *(("depsgraph_update_post", _heard), ("undo_post", _undone), ("redo_post", _undone)),
    *(("load_pre", _left), ("load_post", _come)),
)


def register():
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
