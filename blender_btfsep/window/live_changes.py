# SPDX-License-Identifier: GPL-3.0-or-later
"""Which changes of a scene may change its light: what `live` follows, and what it leaves alone."""

import bpy

from ..engine import engine_settings
from ..light import sun_lamp
from ..photo import photo
from ..run import request
from ..scene import meshes

VIEW, OPTIONS, ALL = "view", "options", "all"
"""What has changed: photo or camera; what the engine is told beside the job; more than that."""

known: dict = {}
"""Session id of a scene -> what of its settings was seen last (:func:`told`)."""


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


def _facing(scene, sun) -> list:
    """To a known sun, so that its being written again is no change."""
    return [round(float(part), 4) for part in sun_lamp.known_direction(scene, sun)]


def told(scene) -> dict:
    """What of a scene's own settings an estimate depends on: known suns, the view, the engine's options, the rest."""
    s, r = scene.btfsep, scene.render
    photographed, *others = [
        image and (image.session_uid, image.filepath_raw, image.colorspace_settings.name)
        for image in (s.image, s.depth, *(entry.mask for entry in request.fitted(s).values()))
    ]
    made = [
        (thing and thing.session_uid, e.source, e.material, tuple(e.colour), e.roughness, e.metallic)
        for e in request.fitted(s).values()
        for thing in [e.object]
    ]
    camera = s.camera or scene.camera
    file = s.image and str(photo.file_at(s.image, camera, scene.frame_current))
    units = scene.unit_settings
    return {
        "suns": [(sun.session_uid, *_facing(scene, sun)) for sun in sun_lamp.known_suns(scene)],
        VIEW: (photographed, file, s.curve, camera and camera.session_uid),
        OPTIONS: engine_settings.engine_options(engine_settings.COMMANDS["estimate"], s),
        "rest": (
            *(s.occluders, _beside(scene), s.mapping, s.exposure_ev, tuple(s.depth_shift), others, made),
            *([getattr(r, name) for name in SHAPE], units.system, units.scale_length),
        ),
    }


def placed(scene) -> tuple:
    """What is quickly told of what an estimate depends on, also right after an undo, when nothing is evaluated yet."""
    things = [scene.btfsep.camera or scene.camera, *(entry.object for entry in request.listed(scene.btfsep))]
    chains = [chain for thing in filter(None, things) for chain in _with_parents(thing)]
    settings = {name: each for name, each in told(scene).items() if name != "suns"}  # of which not even the direction
    return settings, [[round(part, 6) for row in thing.matrix_basis for part in row] for thing in chains]


def _with_parents(thing) -> list:
    return [thing, *(_with_parents(thing.parent) if thing.parent else ())]


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


def remember(scene) -> None:
    """What of a scene's settings matters is as it was seen last."""
    known[scene.session_uid] = told(scene)


def matters(update, scene) -> set:
    """What a change that Blender tells of may change the light by: VIEW, OPTIONS, ALL; nothing where it may not."""
    thing, settings = update.id.original, scene.btfsep
    others = settings.occluders == "OTHERS"
    entries = request.fitted(settings).values()
    found = ""
    match thing:
        case bpy.types.Object():
            if not (update.is_updated_transform or update.is_updated_geometry):
                return set()
            if thing in sun_lamp.known_suns(scene):
                return differs(scene)
            if thing == (settings.camera or scene.camera):
                return {VIEW}
            # what another object instances is in no scene
            beside = meshes.has_surface(thing) and (others or thing.name not in scene.objects)
            found = beside or thing in [entry.object for entry in entries]
        case bpy.types.Image():
            if thing == settings.image:
                return {VIEW}
            found = thing in (settings.depth, *(entry.mask for entry in entries))
        case bpy.types.Material():
            found = others or any(entry.source == "BLENDER" for entry in entries)
        case bpy.types.Scene():
            return differs(thing)
    return {ALL} if found else set()


def differs(scene) -> set:
    """As :func:`matters`, of the scene's settings beside those that were seen last, which they become."""
    before, now = known.get(scene.session_uid), told(scene)
    known[scene.session_uid] = now
    names = {name for name in now if before is not None and before[name] != now[name]}
    return names if names <= {VIEW, OPTIONS} else {ALL}
