# SPDX-License-Identifier: GPL-3.0-or-later
"""Which changes of a scene may change its light: what `live` follows, and what it leaves alone."""

import bpy

from ..engine import engine_settings
from ..light import sun_lamp
from ..photo import photo
from ..run import request
from ..scene import meshes

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


def told(scene) -> tuple:
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


def placed(scene) -> tuple:
    """What is quickly told of what an estimate depends on, also right after an undo, when nothing is evaluated yet."""
    things = [scene.btfsep.camera or scene.camera, *(entry.object for entry in request.listed(scene.btfsep))]
    chains = [chain for thing in filter(None, things) for chain in _with_parents(thing)]
    _suns, *others = told(scene)
    return others, [[round(part, 6) for row in thing.matrix_basis for part in row] for thing in chains]


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


def matters(update, scene) -> bool:
    """Whether a change that Blender tells of may change the light."""
    thing, settings = update.id.original, scene.btfsep
    others = settings.occluders == "OTHERS"
    entries = request.fitted(settings).values()
    match thing:
        case bpy.types.Object():
            if not (update.is_updated_transform or update.is_updated_geometry):
                return False
            if thing in sun_lamp.known_suns(scene):
                return differs(scene)
            if thing in ((settings.camera or scene.camera), *(entry.object for entry in entries)):
                return True
            # what another object instances is in no scene
            return meshes.has_surface(thing) and (others or thing.name not in scene.objects)
        case bpy.types.Image():
            return thing in (settings.image, settings.depth, *(entry.mask for entry in entries))
        case bpy.types.Material():
            return others or any(entry.source == "BLENDER" for entry in entries)
        case bpy.types.Scene():
            return differs(thing)
    return False


def differs(scene) -> bool:
    """Whether what of a scene's settings matters is not what was seen last, which it becomes."""
    before, now = known.get(scene.session_uid), told(scene)
    known[scene.session_uid] = now
    return before is not None and before != now
