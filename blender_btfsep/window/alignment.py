# SPDX-License-Identifier: GPL-3.0-or-later
"""The button that brings camera and objects into line with the photo, by the engine's ``align``."""

import json
import re
from pathlib import Path

import bpy
import numpy as np
from bpy.props import EnumProperty
from mathutils import Matrix

from ..basics.errors import InputError
from ..light import kept_light
from ..run import request, runs
from ..scene import export
from . import operators

MOVES = (
    ("CAMERA", "Move the Camera", "The camera goes to where it was, seen from the objects", "CAMERA_DATA", 0),
    ("OBJECTS", "Move the Objects", "The objects go to where they were, seen from the camera", "OBJECT_DATA", 1),
)
HELD = 1e-3  # of the camera's distance: what is left of a move where something else places the object
WHY = re.compile(r"(?:moved: |left as it is: )?(.*?)(?:, by [\d.]+ deviations.*| \(.*)?$")  # of what the engine says
OLDER = "The light below is of how things stood before: estimate it again"


def camera_of(folder) -> dict:
    """The camera of the job in ``folder``."""
    return json.loads((Path(folder) / export.JOB_FILE).read_text(encoding="utf-8"))["camera"]


def apply_pose(scene, before: dict, after: dict, *, camera, objects=None) -> None:
    """Moves a camera, or ``objects`` instead, from where one job's camera is to where another's is.

    Parameters
    ----------
    before, after : the cameras of the two jobs
    camera : its focal length, or orthographic scale, changes in either case
    objects : what moves instead; those that hang on one another move once

    Raises InputError where constraints, keyframes or drivers hold what is to be moved; nothing is changed then.
    """
    move = np.array(after["to_world"]) @ np.linalg.inv(before["to_world"])
    things = [camera]
    if objects is not None:
        move = np.linalg.inv(move)
        things = [thing for thing in objects if not set(_above(thing)) & set(objects)]
    data = camera.data
    earlier, lens = [thing.matrix_world.copy() for thing in things], (data.lens, data.ortho_scale)
    wanted = [move @ np.array(matrix) for matrix in earlier]
    for thing, matrix in zip(things, wanted, strict=True):
        thing.matrix_world = Matrix(matrix)
    zoom = after["fx"] / before["fx"]
    data.lens, data.ortho_scale = lens[0] * zoom, lens[1] / zoom
    view_layer = scene.view_layers[0]
    view_layer.update()
    depsgraph = view_layer.depsgraph
    room = HELD * (np.linalg.norm(np.array(before["to_world"])[:3, 3]) + 1)
    for thing, matrix in zip(things, wanted, strict=True):
        there = np.array(thing.evaluated_get(depsgraph).matrix_world)
        if np.abs(there - matrix).max() > room:
            for each, back in zip(things, earlier, strict=True):
                each.matrix_world = back
            data.lens, data.ortho_scale = lens
            got = "constraints, keyframes or a driver hold it in its place"
            raise InputError(f"object '{thing.name}'", got, "take them off, or move what is not held")


def _above(thing):
    while thing.parent is not None:
        thing = thing.parent
        yield thing


def in_words(result: dict, moved: str) -> str:
    """What an alignment did, in sentences."""
    if not result["aligned"]:
        return f"Nothing was moved; {_plain(result['why'])}"
    if result.get("depth_shift"):
        right, down = result["depth_shift"]
        how = f"{right:+.1f} pixels to the right, {down:+.1f} down"
        return f"The photo was shifted against the depth: {how}\n{_sentence(result['why'])}"
    zoom = f", focal length {result['focal_percent']:+.1f}%" if abs(result["focal_percent"]) >= 0.05 else ""
    how = f"{result['moved_px']:.1f} pixels in the photo, a turn of {result['degrees']:.1f}°{zoom}"
    return f"{moved} moved: {how}\n{_sentence(result['why'])}"


def _plain(why: str) -> str:
    """The engine's reason without its numbers: the outlines over the photo show what they tell."""
    return WHY.match(why)[1]


def _sentence(why: str) -> str:
    return _plain(why)[:1].upper() + _plain(why)[1:]


class BTFSEP_OT_refine_alignment(operators.NeedsScene, runs.EngineOperator, bpy.types.Operator):
    """Bring the geometry into line with the photo, by outlines and shading; nothing moves without a clear gain"""

    bl_idname = "btfsep.refine_alignment"
    bl_label = "Refine Alignment"
    bl_options = {"REGISTER", "UNDO"}
    task = "Aligning"
    moves: EnumProperty(name="Moves", items=MOVES, options={"SKIP_SAVE"})

    def begin(self, context):
        self._camera = (context.scene.btfsep.camera or context.scene.camera).session_uid
        self._ids = set(request.ids_of(context.scene.btfsep).values())
        folder = yield from request.job_slices(context)
        self._before = camera_of(folder)
        return ["align", folder, "--out", folder / "aligned"]

    def finish(self, context, result):
        scene = self.scene()
        things = {thing.session_uid: thing for thing in bpy.data.objects}
        camera = things.get(self._camera)
        if camera is None or not self._ids <= set(things):
            raise InputError("the camera or an object", "it was deleted meanwhile", "align again")
        if result["aligned"] and result.get("depth_shift"):
            job = json.loads((Path(result["out"]) / export.JOB_FILE).read_text(encoding="utf-8"))
            scene.btfsep.depth_shift = job["depth_shift"]
        elif result["aligned"]:
            objects = [things[number] for number in self._ids] if self.moves == "OBJECTS" else None
            apply_pose(scene, self._before, camera_of(result["out"]), camera=camera, objects=objects)
        said = in_words(result, "The objects were" if self.moves == "OBJECTS" else "The camera was")
        older = result["aligned"] and not scene.btfsep.live and kept_light.kept(scene) is not None
        return f"{said}\n{OLDER}" if older else said


register, unregister = bpy.utils.register_classes_factory((BTFSEP_OT_refine_alignment,))
