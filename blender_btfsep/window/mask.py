# SPDX-License-Identifier: GPL-3.0-or-later
"""A new mask of an object: the photo where the camera sees the object, black elsewhere, to be painted on."""

import contextlib
import functools
from pathlib import Path

import bpy
import numpy as np
from mathutils import Vector
from mathutils.bvhtree import BVHTree

from ..basics import pixels
from ..basics.errors import InputError
from ..light import light_picture
from ..photo import camera as pinhole
from ..photo import photo
from ..run import buttons, reasons, request, runs
from ..scene import meshes
from . import looking

COARSE = 256  # cells along the picture that are looked at first; only where neighbours differ is looked more closely
MARGIN = 0.004  # of the picture's longer side: so far from its outline, and two pixels at least, the object is left out
BRUSH = "BTFsep Mask"
DRAWN = 0.3  # seconds in which an editor that was opened is drawn
DARKEST = 0.15  # of the photo in the mask, so that nothing in it is black


def part_seen(scene, view_layer, thing, size) -> np.ndarray:
    """Where the camera sees an object of the list, and nothing else that is known.

    Parameters
    ----------
    thing : bpy.types.Object
    size : (width, height) of the photo

    Returns
    -------
    (height, width) bool, the top row first

    Raises InputError when photo and camera do not go together.
    """
    settings = scene.btfsep
    things = [entry.object for entry in request.listed(settings)]
    with meshes.as_rendered(view_layer, set(scene.objects), chosen={*things}):
        view_layer.update()
        depsgraph = view_layer.depsgraph
        camera = (settings.camera or scene.camera).evaluated_get(depsgraph)
        lens, to_world = pinhole.for_photo(scene, camera, size), pinhole.to_world(camera)
        others = meshes.render_occluders(view_layer, depsgraph, things) if settings.occluders == "OTHERS" else []
        gathered = meshes.gather(depsgraph, [*things, *others])
    own = gathered.pop(thing.name_full, None)
    if own is None:
        raise InputError(f"object '{thing.name}'", "it has no faces", "choose another")
    parts = [own["positions"], *(part["positions"] for part in gathered.values())]
    corners = np.concatenate(parts).reshape(-1, 3)
    tree = BVHTree.FromPolygons(corners.tolist(), np.arange(len(corners)).reshape(-1, 3).tolist(), all_triangles=True)
    last = len(own["positions"])

    def look(x, y):
        return [(hit := tree.ray_cast(*ray)[2]) is not None and hit < last for ray in _rays(lens, to_world, x, y)]

    return refined(look, *size)


def _rays(lens: dict, to_world, x, y):
    """Start and direction (Vectors, world) of what a camera (of `camera.for_photo`) sees at pixels ``x``, ``y``."""
    across, down = (np.asarray(x) - lens["cx"]) / lens["fx"], (np.asarray(y) - lens["cy"]) / lens["fy"]
    local = np.stack([across, -down, -np.ones_like(across)], -1)
    turn, eye = to_world[:3, :3], to_world[:3, 3]
    if "projection" not in lens:
        return ((Vector(eye), Vector(ray)) for ray in local @ turn.T)
    local[:, 2] = 0
    return ((Vector(start), Vector(-turn[:, 2])) for start in eye + local @ turn.T)


def refined(look, width: int, height: int) -> np.ndarray:
    """(height, width) bool of ``look(x, y)``, pixels to a list of bool; what is narrower than a cell may be missed."""
    step = 1
    while max(width, height) > COARSE * step:
        step *= 2
    found, doubtful = None, None
    while step:
        rows, columns = -(-height // step), -(-width // step)
        if found is None:
            found, doubtful = np.zeros((rows, columns), bool), np.ones((rows, columns), bool)
        else:
            found, doubtful = (a.repeat(2, 0).repeat(2, 1)[:rows, :columns] for a in (found, _edges(found)))
        row, column = np.nonzero(doubtful)
        found[row, column] = look((column + 0.5) * step, (row + 0.5) * step)
        step //= 2
    return found


def _edges(flags) -> np.ndarray:
    """Where a cell differs from one of the eight around it."""
    return spread(flags, 1) & spread(~flags, 1)


def spread(flags, by: int) -> np.ndarray:
    """``flags`` : (h, w) bool, true also where one within ``by`` cells (a square) is."""
    for _ in range(2):  # each axis in turn, by running sums
        padded = np.pad(flags, ((by + 1, by), (0, 0))).cumsum(0, dtype=np.int32)
        flags = (padded[2 * by + 1 :] > padded[: -2 * by - 1]).T
    return flags


def paint(image, where, file=None) -> np.ndarray:
    """(height, width, 3) in 0 to 1, the top row first: the photo ``where`` : (height, width) bool, black elsewhere.

    ``file`` : as of `light_picture.small`
    """
    small = light_picture.small(image, file)[::-1]
    rows, columns = (np.arange(n) * m // n for n, m in zip(where.shape, small.shape[:2], strict=True))
    shown = small[rows][:, columns]
    if image.is_float:
        shown = light_picture.coded(shown / max(float(np.nanpercentile(shown[where], 99)), 1e-9))
    return np.where(where[..., None], DARKEST + (1 - DARKEST) * np.clip(np.nan_to_num(shown), 0, 1), 0)


class BTFSEP_OT_new_mask(buttons.Greyed, buttons.AtOnce, bpy.types.Operator):
    """Make a mask that shows the photo where the camera sees the object, and open it: paint what hides it black"""

    bl_idname = "btfsep.new_mask"
    bl_label = "New Mask"
    bl_options = {"REGISTER", "UNDO"}

    @staticmethod
    def reason(context) -> str:
        settings = context.scene.btfsep
        entry = request.active_entry(settings)
        if entry is None or entry.object is None:
            return "Add the object that the mask is for to the list first"
        return runs.RUNNING if runs.is_running() else reasons.of_picture(context.scene, settings)

    def do(self, context):
        scene, settings = context.scene, context.scene.btfsep
        entry = request.active_entry(settings)
        size = photo.size_of(settings.image)
        where = part_seen(scene, context.view_layer, entry.object, size)
        where &= ~spread(~where, max(round(MARGIN * max(size)), 2))
        if not where.any():
            raise InputError("the camera", f"it does not see '{entry.object.name}'", "move the camera, or the object")
        shown = photo.file_at(settings.image, settings.camera or scene.camera, scene.frame_current)
        image = pixels.new(f"Mask of {entry.object.name}", paint(settings.image, where, shown)[::-1], floats=False)
        image.pack()
        entry.mask = image
        return open_for_painting(context, image)


class BTFSEP_OT_paint_mask(buttons.Greyed, buttons.AtOnce, bpy.types.Operator):
    """Open the mask in an Image Editor, to be painted on: what is not black is used"""

    bl_idname = "btfsep.paint_mask"
    bl_label = "Paint Mask"

    @staticmethod
    def reason(context) -> str:
        entry = request.active_entry(context.scene.btfsep)
        return "" if entry and entry.mask else "The object has no mask"

    def do(self, context):
        return open_for_painting(context, request.active_entry(context.scene.btfsep).mask)


def open_for_painting(context, image) -> str:
    """Shows ``image`` in an Image Editor, with a black brush; gives a sentence, all there is without a window."""
    area = looking.show(context, image)
    if area is not None:
        area.spaces.active.ui_mode = "PAINT"
        with contextlib.suppress(AttributeError):  # of Blenders before 4.5
            area.spaces.active.uv_editor.show_uv = False  # Blender 5 draws the object's over what is painted
        paint = context.tool_settings.image_paint
        colours = getattr(paint, "unified_paint_settings", None) or context.tool_settings.unified_paint_settings
        colours.color, colours.secondary_color = (0, 0, 0), (1, 1, 1)
        later = functools.partial(_have_brush, context.scene.session_uid)
        bpy.app.timers.register(later, first_interval=DRAWN)  # the editor, once it is drawn, takes what was chosen away
    return f"'{image.name}': paint black over what is not the object, white where it is (X swaps)"


def _have_brush(number: int) -> None:
    """A brush where Blender has none of its own: they are assets since 4.3, which some distributions leave out.

    ``number`` : session id of the scene
    """
    scene = next((each for each in bpy.data.scenes if each.session_uid == number), None)
    assets = Path(bpy.utils.system_resource("DATAFILES"), "assets", "brushes")
    if scene is not None and scene.tool_settings.image_paint.brush is None and not assets.is_dir():
        brush = bpy.data.brushes.get(BRUSH) or bpy.data.brushes.new(BRUSH, mode="TEXTURE_PAINT")
        with contextlib.suppress(AttributeError):  # of later Blenders, which take assets alone
            brush.curve_preset = "CONSTANT"  # what is painted is black, not dark
            scene.tool_settings.image_paint.brush = brush


register, unregister = bpy.utils.register_classes_factory((BTFSEP_OT_new_mask, BTFSEP_OT_paint_mask))
