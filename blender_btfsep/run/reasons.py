# SPDX-License-Identifier: GPL-3.0-or-later
"""Why a run cannot be begun, in sentences for tooltips: told by looks alone, before a click. Nothing here is slow."""

from pathlib import Path

from mathutils import Vector

from ..photo import camera as pinhole
from ..photo import photo, upright
from ..scene import meshes, own_surface
from . import runs


def against_run(scene, view_layer, settings, entries: dict) -> str:
    """The first thing that the scene lacks for a run, as a sentence; empty when nothing is missing.

    ``entries`` : name -> entry of what is fitted.
    """
    return (
        of_picture(scene, settings)
        or next(filter(None, (_of_entry(name, e, view_layer, settings) for name, e in entries.items())), "")
        or ("" if entries else "Add the objects that the photo shows to the list first")
    )


def of_picture(scene, settings) -> str:
    """Why photo and camera cannot be used; empty where they can."""
    camera = settings.camera or scene.camera
    return (
        _of_photo(settings.image, camera, scene.frame_current) or of_camera(camera) or _of_shape(scene, settings.image)
    )


def _of_photo(image, camera, frame: int) -> str:
    if image is None:
        return "Choose the photo first"
    if image.source in ("MOVIE", "TILED"):
        return no_single_picture(image)
    if image.type == "RENDER_RESULT":  # in a window it has a size, and still no pixels
        return f"The photo '{image.name}' {photo.RENDERED}"
    path = photo.file_at(image, camera, frame)
    kept = image.packed_file is not None or image.source not in {"FILE", "SEQUENCE"} or image.is_dirty
    if not kept and (path is None or not path.is_file()):
        return f"The photo's file {path.name if path else ''} is not there: choose the photo again"
    return ""


def no_single_picture(image) -> str:
    """Why an image, which is a movie or made of tiles, is no photo; empty of others."""
    if image.source == "MOVIE":
        return f"'{image.name}' is a movie: {photo.MOVIE}"
    return f"'{image.name}' is made of tiles (UDIM): {photo.SINGLE}" if image.source == "TILED" else ""


def of_camera(camera) -> str:
    """Why a camera (or None) cannot be used; empty where it can."""
    if camera is None:
        return "The scene has no camera: add the one that took the photo"
    if camera.type != "CAMERA":
        return f"'{camera.name}' is no camera: choose the one that took the photo"
    if camera.data.type not in pinhole.TYPES:
        return f"Camera '{camera.name}' is panoramic: choose a perspective or orthographic one"
    if camera.matrix_world.determinant() <= 0:
        return f"The scale of camera '{camera.name}' is negative or zero: apply it"
    return ""


def _of_shape(scene, image) -> str:
    width, height = image.size
    if not (width and height):
        if image.source == "SEQUENCE":
            return ""  # it has pixels only at the frames where the scene has it: the export looks at its file
        return f"The photo '{image.name}' {photo.lacks_pixels(image)}"
    if pinhole.shown(scene, (width, height)) is not None:
        return ""
    wide, high = pinhole.render_region(scene)[2:]
    button = "Turn Upright" if upright.orientation_of(image) > 4 else "Use Photo"
    return f"The photo is {width} x {height}, the scene renders {wide} x {high}: press {button}"


def unseen(scene, settings, entries: dict) -> str:
    """That an object stands outside of the camera's picture; empty where it may be in it.

    By its box alone, and as the scene was drawn last: it is said, and stops nothing.
    """
    camera = settings.camera or scene.camera
    if settings.depth is not None or camera is None or of_camera(camera):
        return ""
    for name, entry in entries.items():
        thing = entry.object
        if thing.type == "EMPTY" or thing.is_instancer or any(m.type == "NODES" for m in thing.modifiers):
            continue  # its box is not that of what it shows
        to_camera = camera.matrix_world.inverted_safe() @ thing.matrix_world
        corners = [to_camera @ Vector(corner) for corner in thing.bound_box]
        if _is_outside(camera.data.view_frame(scene=scene), camera.data.type, corners):
            return f"'{name}' stands outside of the camera's picture"
    return ""


def _is_outside(frame, kind: str, corners) -> bool:
    """Whether all ``corners`` lie beyond one side of the picture, or behind the camera; in the camera's axes."""
    if all(corner.z >= 0 for corner in corners):
        return True
    middle = sum(frame, Vector()) / len(frame)
    for one, other in zip(frame, [*frame[1:], frame[0]], strict=True):
        along = Vector((0, 0, -1)) if kind == "ORTHO" else one
        inward = along.cross(other - one)
        inward *= 1 if inward.dot(middle - one) > 0 else -1
        at = one if kind == "ORTHO" else Vector()
        if all(inward.dot(corner - at) < 0 for corner in corners):
            return True
    return False


def _of_entry(name: str, entry, view_layer, settings) -> str:
    thing = entry.object
    if thing is not None and settings.depth is None:
        if thing.library is not None and thing.is_missing:
            return f"'{name}' is linked from {Path(thing.library.filepath).name}, which is not there or has it no more"
        if not meshes.has_surface(thing):
            return f"'{name}' has no surface: take it off the list"
        if not thing.users_collection:
            return f"'{name}' was deleted: take it off the list"
        if thing.name not in view_layer.objects:
            return f"'{name}' is in no collection of this view layer: include its collection, or take it off the list"
        if settings.mapping == "OWN" and thing.type == "MESH" and not thing.data.uv_layers and not thing.modifiers:
            return f"'{name}' has no UV map: unwrap it, or take another Mapping (Advanced)"
    if entry.source == "LIBRARY":
        if not entry.material:
            return f"Choose the material of '{name}', or have it recognised"
        known = [material.name for material in runs.run_state().library]
        if known and entry.material not in known:
            return f"The library has no material '{entry.material}', which '{name}' is to be of"
    if own_surface.chosen(entry) == own_surface.BLENDER:
        gone = own_surface.missing_image(thing)
        if gone is not None:
            cure = "find it (File > External Data), or give the object's Colour"
            return f"The file of image '{gone.name}', of which '{name}' is made, is not there: {cure}"
    mask = entry.mask
    if mask is not None and all(settings.image.size) and tuple(mask.size) != tuple(settings.image.size):
        return f"The mask of '{name}' has another size than the photo: take it away, and press + in its place"
    return ""
