# SPDX-License-Identifier: GPL-3.0-or-later
"""A scene as a job folder: photo, camera, meshes, and job.json, which is written last (``docs/formats.md``)."""

import json
import re
from pathlib import Path

import bpy
import numpy as np

from ..basics import atomic
from ..basics.errors import InputError
from ..light import sun_lamp
from ..photo import camera as pinhole
from ..photo import photo
from . import meshes, own_surface, ply, surroundings, unwrap

JOB_FILE = "job.json"
SURFACE = "Surface"  # the name of what a depth shows
FROM_THE_PHOTO = "its colour is taken from the photo where it is seen there, else a grey"
NEAR = 0.1  # of its distance from the objects: a camera that moves less has the same things around it


def export_job(
    context_or_scene,
    folder,
    *,
    image_path,
    camera=None,
    objects,
    occluders=None,
    materials=None,
    surfaces=None,
    masks=None,
    depth=None,
    depth_shift=(0.0, 0.0),
    exposure_ev=0.0,
    mapping="CHARTS",
    curve="auto",
    known_suns=None,
    warn=lambda sentence: None,
) -> Path:
    """Writes a job.

    Parameters
    ----------
    context_or_scene : bpy.types.Context or Scene
    folder : the job's folder; made if need be; an earlier job there is replaced
    image_path : path of the photo, or a bpy.types.Image
    camera : camera object, None for the scene's
    objects : list of objects to fit; empty with ``depth``
    occluders : list of objects that cast shadows and reflect; None for all others that the render shows. Of what their
        materials say the job has the mean colour, roughness and metal
    materials : dict, object name (of `meshes.names_of`) -> name in the library; what is absent is to be recognised
    surfaces : dict, object name -> "surface" of the job, or `own_surface.BLENDER`: as the object's own material says
    masks : dict, object name -> bpy.types.Image of the photo's size, not black where the object may be used
    depth : path of an EXR of z-depth, or its bpy.types.Image, instead of objects; its surface is named `SURFACE`
    depth_shift : pixels to the right and down by which the photo shows what depth and camera show elsewhere
    exposure_ev : the photo's exposure in stops
    mapping : how materials lie on the objects: "CHARTS" (computed by the engine), "UNWRAP" (Blender's angle-based
        unwrap, of a copy) or "OWN" (each object's UV map that is active for rendering)
    known_suns : Sun lamps whose direction is known; None for those that the scene names
    curve : the photo's tone curve, one of `properties.CURVES`; a photo of floats is linear anyway
    warn : called with a sentence for each thing of the occluders or the lens that the job does not have

    Returns
    -------
    Path of ``job.json``.

    Raises InputError.
    """
    scene = context_or_scene if isinstance(context_or_scene, bpy.types.Scene) else context_or_scene.scene
    view_layer = getattr(context_or_scene, "view_layer", None) or scene.view_layers[0]
    camera, objects = camera or scene.camera, list(objects)
    _check(camera, objects, depth)
    folder = _prepare(folder)
    for sentence in meshes.not_as_rendered({*objects, *(scene.objects if occluders is None else occluders)}):
        warn(sentence)
    touched = set(objects) | {o for o in scene.objects if occluders is None or o in occluders}
    with meshes.as_rendered(view_layer, touched, chosen={*objects, *(occluders or ())}):
        view_layer.update()
        depsgraph = view_layer.depsgraph
        view = _view(scene, depsgraph, folder, image_path=image_path, camera=camera, curve=curve, warn=warn)
        lens = view["camera"]
        size = lens["width"], lens["height"]
        suns = sun_lamp.known_suns(scene) if known_suns is None else known_suns
        suns = [{"direction": sun_lamp.known_direction(scene, sun, depsgraph).tolist()} for sun in suns]
        shadowing = meshes.render_occluders(view_layer, depsgraph, objects) if occluders is None else list(occluders)
        shadowing = [thing for thing in shadowing if thing not in objects]
        gathered = meshes.gather(depsgraph, objects + shadowing)
        others = meshes.rendered_objects(view_layer) if occluders is None else set(occluders)
        bare = meshes.without_faces(depsgraph, objects, others)
        called = dict(zip(meshes.names_of(objects), objects, strict=True))
        baked = own_surface.bakes(called, gathered, surfaces, depsgraph)

    names, parts, fitted, aside = _FileNames(), {SURFACE: None}, [], []
    if depth is None:
        parts = {name: _mapped(gathered.get(thing.name_full), mapping, name) for name, thing in called.items()}
    for name, part in parts.items():
        file, mask = names.of(name), (masks or {}).get(name)
        told = {"mapping": mapping, "baked": baked.get(name), "warn": warn}
        surface, uv = own_surface.surface_of(name, part, surfaces, folder, **told)
        part = part if uv is None else {**part, "uv": uv}
        if (surfaces or {}).get(name) == own_surface.BLENDER:  # else it is all of what the user says
            part, clear = _told_apart(name, part)
            aside += [] if clear is None else [_dark(_write(folder, names.of(f"{name} aside"), clear))]
        left = [bare.pop(called[name])] if called.get(name) in bare else []
        left += ["displacement"] if part and surroundings.displaced(part["areas"]) else []
        surface = _without(name, surface, left, warn)
        fitted.append(
            {
                "name": name,
                "mesh": part and _write(folder, file, part),
                "to_world": None,
                "mask": None if mask is None else photo.put_mask(mask, folder, f"mask_{Path(file).stem}.png", size),
                "material": (materials or {}).get(name) or None,
                "surface": surface,
                "uv": "xatlas" if mapping == "CHARTS" or part is None else "mesh",
            }
        )
    corners = [gathered[thing.name_full]["positions"] for thing in objects if thing.name_full in gathered]
    around = [np.array(lens["to_world"])[:3, 3], *([np.concatenate(corners).mean((0, 1))] if corners else [])]
    shadowing = {thing: gathered[thing.name_full] for thing in shadowing if thing.name_full in gathered}
    for thing, words in bare.items():
        warn(f"left out, as it has no faces: the {words} of '{thing.name}'")
    units = scene.unit_settings
    job = {
        "format": "btfsep-job",
        "version": 1,
        **view,
        "exposure_ev": float(exposure_ev),
        "objects": fitted,
        "occluders": [*_occluders(shadowing, folder, names, around=around, warn=warn), *aside],
        "depth": None if depth is None else photo.put_depth(depth, folder),
        **({} if depth is None or not any(depth_shift) else {"depth_shift": [float(s) for s in depth_shift]}),
        "metres_per_unit": 1.0 if units.system == "NONE" else units.scale_length,
        **({"known_lamps": suns} if suns else {}),
    }
    atomic.write_bytes(folder / JOB_FILE, json.dumps(job, indent=1).encode())
    return folder / JOB_FILE


def renewed(job: dict, context, folder, *, image_path, camera=None, objects, curve="auto") -> dict | None:
    """A job that :func:`export_job` has written, with the photo and the camera as they are now.

    Gives None where that is not all that the scene would be written with: where the photo has another size, something
    else places the camera, it is hidden, or it went so far that other things may stand around it.
    Parameters are as of `export_job`. Raises InputError.
    """
    scene, depsgraph = context.scene, context.view_layer.depsgraph
    camera, before = camera or scene.camera, job["camera"]
    _check(camera, objects, job["depth"])
    held = camera.parent or camera.constraints or camera.animation_data or camera.data.animation_data
    known = camera.visible_get(view_layer=context.view_layer)  # of what is hidden Blender need not know the place
    if held or not known:
        return None
    view = _view(scene, depsgraph, Path(folder), image_path=image_path, camera=camera, curve=curve)
    after = view["camera"]
    if (after["width"], after["height"]) != (before["width"], before["height"]):
        return None
    old, new = (np.array(each["to_world"])[:3, 3] for each in (before, after))
    away = [np.linalg.norm(old - np.array(thing.matrix_world.translation)) for thing in objects]
    if job["occluders"] and np.linalg.norm(new - old) > NEAR * min(away, default=0.0):
        return None
    return {name: each for name, each in job.items() if name != "image_primaries"} | view


def _view(scene, depsgraph, folder, *, image_path, camera, curve, warn=lambda sentence: None) -> dict:
    """Puts the photo into the job's folder; gives what the job says of photo and camera."""
    shown = isinstance(image_path, bpy.types.Image) and photo.file_at(image_path, camera, scene.frame_current)
    file_name, colorspace, size, primaries = photo.put_into_job(image_path, folder, file=shown or None)
    if curve != "auto" and not photo.is_linear(Path(folder) / file_name):
        colorspace = curve
    evaluated = camera.evaluated_get(depsgraph)
    lens = pinhole.for_photo(scene, evaluated, size)
    lens |= pinhole.distortion(scene, evaluated, lens, warn=warn)
    lens["to_world"] = pinhole.to_world(evaluated).tolist()
    return {
        "image": file_name,
        "image_colorspace": colorspace,
        **({} if primaries == "auto" else {"image_primaries": primaries}),
        "camera": lens,
    }


def _check(camera, objects, depth) -> None:
    """Raises InputError where there is no camera, or nothing that it could show."""
    if camera is None or camera.type != "CAMERA":
        raise InputError("the camera", "the scene has none", "add the camera that took the photo")
    if depth is not None and objects:
        raise InputError("the objects", "there is a depth, too", "take the depth or the objects away")
    if depth is None and not objects:
        raise InputError("the objects", "none is chosen", "choose the objects that the photo shows")
    for thing in objects:
        if not meshes.has_surface(thing):
            got = "it has no surface, nor has what it instances"
            raise InputError(f"object '{thing.name}'", got, "choose objects with a surface")


def _told_apart(name: str, part: dict) -> tuple:
    """An object's triangles without those that the photo shows otherwise than lit, and these (or None).

    What light goes through, and what shines, tells nothing of the light by how bright it is, and yet hides what is
    behind it. Raises InputError where nothing else is left.
    """
    kept, gone = part, list(surroundings.left_out(part["areas"]))
    for material in gone:
        kept = meshes.without(kept, material)
    if kept is None:
        raise InputError(f"object '{name}'", "all of it shines", "choose an object that is lit, or say its colour")
    if not gone:
        return part, None
    for material in kept["areas"]:
        part = meshes.without(part, material)
    return kept, part


def _dark(mesh: str) -> dict:
    """An occluder that sends no light; a metal, so that nobody asks the photo for its colour."""
    return {"mesh": mesh, "to_world": None, "surface": surroundings.BLACK | {"metallic": 1.0}}


def _without(name: str, surface: dict | None, left: list, warn) -> dict | None:
    """The ``surface`` of an object that is exported without what ``left`` says; where it has none, that is said."""
    if surface is not None and left:
        return {**surface, "left_out": [*surface.get("left_out", ()), *(f"its {what}" for what in left)]}
    for what in left:
        warn(f"object '{name}': its {what} is left out")
    return surface


def _occluders(parts: dict, folder: Path, names, *, around, warn) -> list:
    """The job's occluders, of {Blender's object: its triangles}, those left out that stand ``around`` places (3,)."""
    out = []
    for thing, part in parts.items():
        what = f"occluder '{thing.name}'"
        if surroundings.encloses(part["positions"], *around):
            found = "the light found is the one inside it; hide it from renders, or it keeps the World's light out"
            warn(f"{what} is left out, as it stands around objects and camera like a sky or a room: {found}")
            continue
        for material, why in surroundings.left_out(part["areas"]).items():
            part = meshes.without(part, material)
            warn(f"{what if part is None else f'part of {what}'} is left out, as {why}")
        if part is None:
            continue
        if thing.is_shadow_catcher and set(part["areas"]) == {None}:
            surface = None  # it stands for what the photo shows
        else:
            surface = surroundings.surface_of(
                part["areas"], lambda text, what=what: warn(f"{what}: {text}"), otherwise=FROM_THE_PHOTO
            )
        given = {} if surface is None else {"surface": surface}
        if getattr(thing, "btfsep_evidence", False):  # an export alone knows no panel
            given["evidence"] = True
        out.append({"mesh": _write(folder, names.of(thing.name), part), "to_world": None, "name": thing.name, **given})
    return out


def _prepare(folder) -> Path:
    """Makes the folder and takes an older job.json away, so that no half of a job can be taken for one."""
    folder = Path(bpy.path.abspath(str(folder))).resolve()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / JOB_FILE).unlink(missing_ok=True)
    except OSError as error:
        cure = "choose a folder that can be written, or do not keep jobs beside the .blend (preferences)"
        raise InputError(f"the folder {folder}", error.strerror or error, cure) from error
    return folder


def _mapped(part: dict | None, mapping: str, name: str) -> dict:
    """The triangles with the texture coordinates that ``mapping`` names. Raises InputError where there are none."""
    if part is None:
        got, do = "it has no faces, or the view layer excludes it", "include its collection, or choose another"
        raise InputError(f"object '{name}'", got, do)
    if not part["areas"]:
        got = "it has no area: its scale is zero, or there are no numbers in its mesh"
        raise InputError(f"object '{name}'", got, "set that right, or take it off the list")
    if mapping == "UNWRAP":
        return {**part, "uv": unwrap.angle_based(part["positions"], part["vertex"], name)}
    if mapping == "OWN" and part["uv"] is None:
        raise InputError(f"object '{name}'", "it has no UV map", "unwrap it, or take another material mapping")
    return part


class _FileNames:
    """Names of files that any system can hold, each once."""

    def __init__(self):
        self.taken = set()

    def of(self, name: str) -> str:
        stem = re.sub(r"[^A-Za-z0-9_-]+", "_", name).strip("_")[:60] or "mesh"
        unique, count = stem, 1
        while unique.lower() in self.taken:
            count += 1
            unique = f"{stem}_{count}"
        self.taken.add(unique.lower())
        return f"{unique}.ply"


def _write(folder: Path, name: str, part: dict) -> str:
    ply.write(folder / name, part["positions"], part["normals"], part["vertex"], corner_uv=part["uv"])
    return name
