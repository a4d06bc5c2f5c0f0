# SPDX-License-Identifier: GPL-3.0-or-later
"""Without a window: ``blender --background scene.blend --command btfsep estimate …``; also ``main([...])`` in scripts.

Exit status 0: done; 2: the input is at fault, one line ``error: what; what was got; what to do``; 1: a bug.
"""

import argparse
import sys
import traceback
from pathlib import Path

import bpy

from . import engine_process, export, lighting_file, measure, preferences, runs, sequence_run, sun_lamp, world
from .errors import InputError
from .operators import chosen, order_of, take_materials, told
from .properties import APPEARANCES, CURVES, PRESETS

INPUT_FAULT, BUG = 2, 1


def main(arguments) -> int:
    """Runs a command; ``arguments`` as on the command line after ``btfsep``. Returns the exit status."""
    try:
        options = _parser().parse_args(list(arguments))
    except SystemExit as stop:  # argparse has said why
        return int(stop.code or 0)
    try:
        options.run(options)
        if getattr(options, "save", None):
            _save(options.save)
    except InputError as error:
        _say(f"error: {error}", sys.stderr)
        return INPUT_FAULT
    except KeyboardInterrupt:
        _say("error: stopped", sys.stderr)
        return 130
    except _EngineBug as error:
        _say(f"{error.details}\nerror: {error}", sys.stderr)
        return BUG
    except Exception:
        traceback.print_exc()
        return BUG
    return 0


class _EngineBug(Exception):
    def __init__(self, failed):
        super().__init__(failed.message)
        self.details = failed.details


class _StatedByEngine(InputError):
    """The engine's own sentence, as it is."""

    def __init__(self, sentence: str):
        super().__init__(sentence, "", "")


def _say(text: str, stream=None) -> None:
    stream = stream or sys.stdout
    stream.write(text + "\n")
    stream.flush()


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="btfsep", description="The light of a photograph as the scene's World.")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    job = argparse.ArgumentParser(add_help=False)
    job.add_argument("--scene", help="name of the scene (default: the active one)")
    job.add_argument("--image", help="the photo (default: the panel's)")
    job.add_argument("--camera", help="name of the camera object (default: the panel's, then the scene's)")
    job.add_argument(
        "--object", "--objects", dest="objects", nargs="+", metavar="NAME", help="objects to fit (default: the panel's)"
    )
    job.add_argument("--occluders", choices=("others", "none"), help="what else casts shadows (default: the panel's)")
    job.add_argument("--depth", metavar="FILE.exr", help="z-depth instead of objects (default: the panel's)")
    job.add_argument("--exposure", type=float, metavar="EV", help="stops applied to the photo (default: the panel's)")
    curves = [name for name, *_ in CURVES]
    job.add_argument("--curve", choices=curves, help="how the photo codes the light (default: the panel's)")
    job.add_argument("--job", help="folder for the job (default: one that is removed afterwards)")

    engine = argparse.ArgumentParser(add_help=False)
    engine.add_argument("--library", help="material library (default: the preferences', then the engine's)")
    engine.add_argument("--preset", choices=[name for name, *_ in PRESETS], help="default: the panel's")
    engine.add_argument("--engine", help="Python, virtual environment or btfsep program (default: the preferences')")

    save = argparse.ArgumentParser(add_help=False)
    save.add_argument("--save", metavar="FILE.blend", help="save the file with the World")
    save.add_argument("--world", choices=("nodes", "texture", "none"), help="default: the panel's")

    sun = argparse.ArgumentParser(add_help=False)
    sun.add_argument("--sun", choices=("lamp", "world"), help="where key lights go (default: the panel's)")

    fit = argparse.ArgumentParser(add_help=False)
    fit.add_argument("--material", help="the material of all objects, instead of recognition")
    textures = [name for name, *_ in APPEARANCES]
    fit.add_argument("--appearance", choices=textures, help="how a material is compared (default: the panel's)")
    fit.add_argument("--out", help="folder for the results (default: in the job's)")

    estimate = commands.add_parser(
        "estimate", parents=[job, engine, fit, save, sun], help="estimate the light, write the World"
    )
    estimate.add_argument(
        "--order", type=_order, metavar="N|auto", help="order of the spherical harmonics (default: the panel's)"
    )
    estimate.set_defaults(run=_estimate)

    recognise = commands.add_parser("recognise", parents=[job, engine], help="name the material of each object")
    recognise.set_defaults(run=_recognise)

    exporting = commands.add_parser("export", parents=[job], help="write the job folder only")
    exporting.set_defaults(run=_export)

    apply = commands.add_parser("apply", parents=[save, sun], help="make a lighting.json the World")
    apply.add_argument("lighting")
    apply.add_argument("--scene", help="name of the scene (default: the active one)")
    apply.set_defaults(run=_apply)

    sequence_run.add_command(
        commands,
        [job, engine, fit, save],
        scene_of=_scene,
        write_job=_write_job,
        settings_of=_settings,
        run_engine=_run_engine,
        say=_say,
    )
    measure.add_command(commands, scene_of=_scene, object_of=_object, run_engine=_run_engine, say=_say)
    return parser


def _order(text: str):
    return text if text == "auto" else int(text)


def _scene(options):
    if not options.scene:
        return bpy.context.scene
    scene = bpy.data.scenes.get(options.scene)
    if scene is None:
        raise InputError(f"scene '{options.scene}'", "there is none of that name", _choices(bpy.data.scenes))
    return scene


def _choices(things) -> str:
    names = [f"'{thing.name}'" for thing in things]
    return f"choose from {', '.join(names[:8])}" if names else "add one"


def _object(scene, name: str):
    found = scene.objects.get(name)
    if found is None:
        raise InputError(f"object '{name}'", f"scene '{scene.name}' has none of that name", _choices(scene.objects))
    return found


def _write_job(options, scene) -> Path:
    settings = scene.btfsep
    image = options.image or settings.image
    if image is None:
        raise InputError("the photo", "none is named, and the file holds none", "give --image FILE")
    depth = options.depth or (None if options.objects else settings.depth)
    if depth and options.objects:
        raise InputError("--depth", "objects are named, too", "give the one or the other")
    entries = {export.SURFACE: settings.surface} if depth else {e.object.name: e for e in chosen(settings)}
    names = list(entries) if depth else options.objects or list(entries)
    if not names:
        raise InputError("the objects", "none is named, and the file holds none", "give --object NAME …")
    occluders = options.occluders or settings.occluders.lower()
    material = getattr(options, "material", None)
    return export.export_job(
        scene,
        options.job or runs.job_folder(scene, preferences.get().keep_jobs),
        image_path=image,
        camera=_object(scene, options.camera) if options.camera else settings.camera,
        objects=[] if depth else [_object(scene, name) for name in names],
        occluders=[] if occluders == "none" else None,
        materials={name: material or (entries[name].material if name in entries else None) for name in names},
        masks={name: entry.mask for name, entry in entries.items()},
        depth=depth,
        exposure_ev=settings.exposure_ev if options.exposure is None else options.exposure,
        mapping=settings.mapping,
        curve=options.curve or settings.curve,
    ).parent


def _run_engine(options, arguments) -> dict:
    library = options.library or preferences.get().library
    if library:
        arguments = [*arguments, "--library", Path(bpy.path.abspath(library)).absolute()]
    engine = engine_process.find_engine(options.engine or bpy.path.abspath(preferences.get().engine))
    process = engine_process.EngineProcess(engine, arguments)
    announced = set()

    def heard(message):
        if isinstance(message, engine_process.Notice):
            _say(f"warning: {message.message}", sys.stderr)
        elif message.stage not in announced:
            announced.add(message.stage)
            _say(f"{message.stage} …", sys.stderr)

    try:
        last = process.wait(heard)
    finally:
        process.kill()
    if isinstance(last, engine_process.Failed):
        raise _StatedByEngine(last.message) if last.exit_code == INPUT_FAULT else _EngineBug(last)
    if isinstance(last, engine_process.Cancelled):
        raise KeyboardInterrupt
    return last.result


def _settings(options, scene) -> list:
    """The engine's options for an estimate that the command line names, else the panel's."""
    appearance = options.appearance or scene.btfsep.appearance.replace("auto", "")  # auto: as the preset has it
    given = ["--appearance", appearance] if appearance else []
    return ["--preset", options.preset or scene.btfsep.preset, *given]


def _estimate(options) -> None:
    scene = _scene(options)
    mode = (options.world or scene.btfsep.world_mode).upper()
    order = order_of(scene.btfsep) if options.order is None else options.order
    folder = _write_job(options, scene)
    out = Path(options.out).absolute() if options.out else folder / "result"
    result = _run_engine(options, ["estimate", folder, "--order", order, "--out", out, *_settings(options, scene)])
    lighting = lighting_file.read(result["lighting"])
    take_materials(scene, result.get("objects") or [])
    for found in result.get("objects") or []:
        _say(_line(found))
    for sentence in told(result):
        _say(sentence)
    if mode != "NONE":
        world.apply_lighting(scene, lighting, mode=mode, clamp=scene.btfsep.clamp, lamp=_lamp(options, scene))
        _say(f"the World of scene '{scene.name}' is now the lighting{sun_lamp.beside(scene)}")
    _say(f"wrote {out}")


def _recognise(options) -> None:
    scene = _scene(options)
    folder = _write_job(options, scene)
    result = _run_engine(options, ["recognise", folder, "--preset", options.preset or scene.btfsep.preset])
    take_materials(scene, result.get("objects") or [])
    for found in result.get("objects") or []:
        _say(_line(found))
        for candidate in (found.get("candidates") or [])[:5]:
            _say(f"  {candidate['score']:8.3f}  {candidate['name']}")


def _line(found: dict) -> str:
    unsure = " (unsure: it looks like no material of the library)" if found.get("unknown") else ""
    return f"{found.get('name')}: {found.get('material')}{unsure}"


def _export(options) -> None:
    _say(f"wrote {_write_job(options, _scene(options)) / export.JOB_FILE}")


def _apply(options) -> None:
    scene = _scene(options)
    mode = (options.world or scene.btfsep.world_mode).upper()
    if mode == "NONE":
        raise InputError("the World", "'none' was asked for", "choose nodes or texture")
    lighting = lighting_file.read(options.lighting)
    world.apply_lighting(scene, lighting, mode=mode, clamp=scene.btfsep.clamp, lamp=_lamp(options, scene))
    _say(f"the World of scene '{scene.name}' is now the lighting{sun_lamp.beside(scene)}")


def _lamp(options, scene) -> bool:
    return scene.btfsep.sun_lamp if options.sun is None else options.sun == "lamp"


def _save(path: str) -> None:
    target = Path(path).absolute()
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        bpy.ops.wm.save_as_mainfile(filepath=str(target), copy=False, compress=False)
    except (OSError, RuntimeError) as error:
        raise InputError(f"cannot write {target}", str(error).strip(), "choose a folder that can be written") from None
    _say(f"saved {target}")


_handle = None


def register():
    global _handle
    _handle = bpy.utils.register_cli_command("btfsep", main)


def unregister():
    global _handle
    bpy.utils.unregister_cli_command(_handle)
    _handle = None
