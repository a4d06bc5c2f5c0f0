# SPDX-License-Identifier: GPL-3.0-or-later
"""What is asked of the engine: a scene's job and the command for it; for the buttons and the command line alike."""

import sys
import zlib
from pathlib import Path

import bpy

from ..basics.errors import InputError
from ..engine import engine_process, engine_settings, preferences
from ..photo import photo
from ..scene import export, meshes, own_surface
from . import export_child, reasons, runs


def listed(settings) -> list:
    """The entries of the object list that still have an object."""
    return [entry for entry in settings.objects if entry.object is not None]


def fitted(settings, ids=None) -> dict:
    """Name in the job -> entry of what is fitted: the objects, or the one surface of a depth.

    ``ids`` : of :func:`ids_of` when the job was written: the objects may have other names by now.
    """
    if settings.depth is not None:
        return {export.SURFACE: settings.surface}
    entries = listed(settings)
    now = meshes.names_of([entry.object for entry in entries])
    names = {number: name for name, number in (ids or {}).items()}
    return {names.get(e.object.session_uid, name): e for name, e in zip(now, entries, strict=True)}


def may_be_evidence(settings, thing) -> bool:
    """Whether an object (or None) stands beside what is fitted, and has a surface."""
    things = [entry.object for entry in listed(settings)]
    beside = settings.depth is not None or (bool(things) and thing not in things)
    return beside and thing is not None and meshes.has_surface(thing)


def ids_of(settings) -> dict:
    """Name -> number of the objects that are fitted; unlike its name, an object's number never changes."""
    things = [entry.object for entry in listed(settings)]
    return {name: thing.session_uid for name, thing in zip(meshes.names_of(things), things, strict=True)}


def active_entry(settings):
    """The entry that the panel shows: the surface of the depth, or the active object; None where there is none."""
    if settings.depth is not None:
        return settings.surface
    return settings.objects[settings.active_object] if settings.active_object < len(settings.objects) else None


def missing(context) -> str:
    """What the scene lacks for a run, as a sentence for a tooltip; empty when nothing is missing."""
    settings = context.scene.btfsep
    if runs.is_running():
        return runs.RUNNING
    return reasons.against_run(context.scene, context.view_layer, settings, fitted(settings))


def nothing_to_recognise(settings) -> str:
    """Why there is nothing to recognise, as a sentence for a tooltip; empty where there is something."""
    if any(entry.source == "RECOGNISE" for entry in fitted(settings).values()):
        return ""
    return "Every material is given already: set Made Of to Recognise where one is to be found"


def job_folder(scene) -> Path:
    """Where the job of ``scene`` goes: beside the .blend, or where Blender cleans up when it quits."""
    name = bpy.path.clean_name(scene.name)
    if preferences.get().keep_jobs and bpy.data.filepath:
        blend = Path(bpy.data.filepath)
        return blend.with_name(f"{blend.stem}_btfsep") / name
    # by file: the light of a file that was left is not written over by another's
    file = f"{Path(bpy.data.filepath).stem}-{zlib.crc32(bpy.data.filepath.encode(errors='replace')):08x}"
    return Path(bpy.app.tempdir) / "btfsep" / file / name


def write_job(
    context_or_scene,
    *,
    folder=None,
    image=None,
    camera=None,
    objects=(),
    depth=None,
    material=None,
    masks=None,
    occluders=None,
    mapping=None,
    exposure_ev=None,
    curve=None,
    known_suns=None,
    warn=None,
) -> Path:
    """Exports the job that the panel describes; gives its folder.

    What else is given stands in the place of the panel's: as of `export.export_job`, but ``occluders`` is "OTHERS" or
    "NONE", and ``material`` and ``masks`` have what is given of each object by its name.

    Raises InputError.
    """
    scene = context_or_scene if isinstance(context_or_scene, bpy.types.Scene) else context_or_scene.scene
    settings = scene.btfsep
    if image is None and settings.image is None:
        raise InputError("the photo", "none is chosen", "choose it in the BTFsep panel, or give --image FILE")
    _read_anew(settings)
    if depth and objects:
        raise InputError("--depth", "objects are named, too", "give the one or the other")
    by_object = {entry.object: entry for entry in listed(settings)}
    depth = depth or (None if objects else settings.depth)
    if depth:
        names, entries = [export.SURFACE], {export.SURFACE: settings.surface}
    else:
        objects = objects or list(by_object)
        names = meshes.names_of(objects)
        entries = {name: by_object[thing] for name, thing in zip(names, objects, strict=True) if thing in by_object}
    given = {name: entries[name] for name in names if name in entries and not (material or {}).get(name)}
    path = export.export_job(
        context_or_scene,
        folder or job_folder(scene),
        image_path=image or settings.image,
        camera=camera or settings.camera,
        objects=objects,
        occluders=[] if (occluders or settings.occluders) == "NONE" else None,
        materials={name: (material or {}).get(name) or own_surface.material_of(given.get(name)) for name in names},
        surfaces={name: own_surface.chosen(entry) for name, entry in given.items()},
        masks={name: entry.mask for name, entry in entries.items()} | (masks or {}),
        depth=depth,
        depth_shift=settings.depth_shift if depth == settings.depth else (0.0, 0.0),
        exposure_ev=settings.exposure_ev if exposure_ev is None else exposure_ev,
        mapping=mapping or settings.mapping,
        curve=curve or settings.curve,
        known_suns=known_suns,
        warn=warn or runs.warn,
    )
    return path.parent


def _read_anew(settings) -> None:
    """Photo and masks as their files are now: another program may have written them since they were opened."""
    pictures = [settings.image, *(entry.mask for entry in listed(settings))]
    for image in dict.fromkeys(filter(None, pictures)):
        photo.read_anew(image)


def job_slices(context, **given):
    """As :func:`write_job`, as a generator that gives way while a Blender of its own exports a large scene.

    Gives the folder. Raises InputError.
    """
    if given or not export_child.wanted(context, context.scene.btfsep):
        return write_job(context, **given)
    _read_anew(context.scene.btfsep)
    number, layer, folder = context.scene.session_uid, context.view_layer.name, job_folder(context.scene)
    yield  # the panel says what is going on
    scene = next((each for each in bpy.data.scenes if each.session_uid == number), None)
    if scene is None or layer not in scene.view_layers:
        raise InputError("the scene", "it is gone", "run it again in the scene you want")
    file = folder.with_name(f"{folder.name}-export.blend")
    process = None
    try:
        try:
            file.parent.mkdir(parents=True, exist_ok=True)
            export_child.write(scene, file)
        except (OSError, RuntimeError) as error:
            cure = "free space, or choose another folder for temporary files (Preferences > File Paths)"
            raise InputError(f"cannot write {file}", error, cure) from error
        told = export_child.command(file, scene, scene.view_layers[layer], folder)
        process = engine_process.EngineProcess(engine_process.Engine(told[:1]), told[1:])
        while not process.over:
            for message in process.poll():
                if isinstance(message, engine_process.Notice):
                    runs.warn(message.message)
                elif isinstance(message, engine_process.Failed):
                    raise InputError(message.message, "", "") if message.exit_code == 2 else _export_failed(message)
            yield
    finally:
        if process is not None:
            process.kill()
        file.unlink(missing_ok=True)
    return folder


def renewed(context, job: dict, folder) -> dict | None:
    """The ``job`` in ``folder`` that :func:`write_job` has written of the panel, with photo and camera as they are now.

    None where that is not all, and it has to be written anew. Raises InputError.
    """
    settings = context.scene.btfsep
    _read_anew(settings)
    objects = [] if settings.depth else [entry.object for entry in listed(settings)]
    given = {"image_path": settings.image, "camera": settings.camera, "objects": objects, "curve": settings.curve}
    return export.renewed(job, context, folder, **given)


def _export_failed(failed) -> InputError:
    sys.stderr.write(failed.details + "\n")
    return InputError("the export", "the Blender that was to write the job failed", "see the console; please report it")


def engine_arguments(command: str, folder, scene, *own, options=None) -> list:
    """The engine's command for the job in ``folder``.

    Parameters
    ----------
    command : key of `engine_settings.COMMANDS`
    scene : its panel says the settings
    own : what else this command is told
    options : argparse.Namespace, what the command line says instead of the panel and the preferences
    """
    told = engine_settings.engine_options(engine_settings.COMMANDS[command], scene.btfsep, options)
    alone = (getattr(options, "occluders", None) or scene.btfsep.occluders).upper() == "NONE"
    if alone and command in ("estimate", "sequence") and engine_settings.EVIDENCE.flag not in told:
        told += [engine_settings.EVIDENCE.flag, "job"]  # no ground is to be looked for either
    return [command, folder, *own, *told, *library_arguments(getattr(options, "library", None))]


def library_arguments(folder=None) -> list:
    """The option that names the library, ``folder`` or the preferences', if there is one."""
    library = folder or preferences.get().library
    return ["--library", Path(bpy.path.abspath(str(library))).absolute()] if library else []
