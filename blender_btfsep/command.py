# SPDX-License-Identifier: GPL-3.0-or-later
"""Without a window: ``blender --background scene.blend --command btfsep estimate …``; also ``main([...])`` in scripts.

Exit status 0: done; 2: the input is at fault, one line ``error: what; what was got; what to do``; 1: a bug.
"""

import argparse
import sys
import traceback
from pathlib import Path

import bpy

from . import engine_settings, export, headless, lighting_file, measure, request, sequence_run
from .answer import apply_light, take_estimate, take_materials
from .engine_process import BUG, INPUT_FAULT
from .errors import InputError
from .headless import say, scene_of
from .properties import CURVES, OCCLUDERS, WORLD_MODES


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
        say(f"error: {error}", sys.stderr)
        return INPUT_FAULT
    except KeyboardInterrupt:
        say("error: stopped", sys.stderr)
        return 130
    except headless.EngineBug as error:
        say(f"{error.details}\nerror: {error}", sys.stderr)
        return BUG
    except Exception:
        traceback.print_exc()
        return BUG
    return 0


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
    occluders = [name.lower() for name, *_ in OCCLUDERS]
    job.add_argument("--occluders", choices=occluders, help="what else casts shadows (default: the panel's)")
    job.add_argument("--depth", metavar="FILE.exr", help="z-depth instead of objects (default: the panel's)")
    job.add_argument("--exposure", type=float, metavar="EV", help="stops applied to the photo (default: the panel's)")
    curves = [name for name, *_ in CURVES]
    job.add_argument("--curve", choices=curves, help="how the photo codes the light (default: the panel's)")
    job.add_argument("--job", help="folder for the job (default: one that is removed afterwards)")

    engine = argparse.ArgumentParser(add_help=False)
    engine.add_argument("--library", help="material library (default: the preferences', then the engine's)")
    engine.add_argument("--engine", help="Python, virtual environment or btfsep program (default: the preferences')")

    save = argparse.ArgumentParser(add_help=False)
    save.add_argument("--save", metavar="FILE.blend", help="save the file with the World")
    save.add_argument("--world", choices=[name.lower() for name, *_ in WORLD_MODES], help="default: the panel's")

    sun = argparse.ArgumentParser(add_help=False)
    sun.add_argument("--sun", choices=("lamp", "world"), help="where key lights go (default: the panel's)")

    fit = argparse.ArgumentParser(add_help=False)
    fit.add_argument("--material", help="the material of all objects, instead of recognition")
    fit.add_argument("--out", help="folder for the results (default: in the job's)")

    estimate = commands.add_parser(
        "estimate", parents=[job, engine, fit, save, sun], help="estimate the light, write the World"
    )
    engine_settings.add_options(estimate, engine_settings.COMMANDS["estimate"], "the panel's")
    estimate.set_defaults(run=_estimate)

    recognise = commands.add_parser("recognise", parents=[job, engine], help="name the material of each object")
    engine_settings.add_options(recognise, engine_settings.COMMANDS["recognise"], "the panel's")
    recognise.set_defaults(run=_recognise)

    exporting = commands.add_parser("export", parents=[job], help="write the job folder only")
    exporting.set_defaults(run=_export)

    apply = commands.add_parser("apply", parents=[save, sun], help="make a lighting.json the World")
    apply.add_argument("lighting")
    apply.add_argument("--scene", help="name of the scene (default: the active one)")
    apply.set_defaults(run=_apply)

    sequence_run.add_command(commands, [job, engine, fit, save])
    measure.add_command(commands)
    return parser


def _estimate(options) -> None:
    scene = scene_of(options)
    folder = headless.write_job(options, scene)
    out = Path(options.out).absolute() if options.out else folder / "result"
    arguments = request.engine_arguments("estimate", folder, scene, "--out", out, options=options)
    result = headless.run_engine(arguments, options.engine)
    for sentence in take_estimate(scene, result, mode=_mode(options), lamp=_lamp(options)):
        say(sentence)
    say(f"wrote {out}")


def _recognise(options) -> None:
    scene = scene_of(options)
    folder = headless.write_job(options, scene)
    arguments = request.engine_arguments("recognise", folder, scene, options=options)
    objects = headless.run_engine(arguments, options.engine).get("objects") or []
    for sentence, found in zip(take_materials(scene, objects), objects, strict=True):
        say(sentence)
        for candidate in (found.get("candidates") or [])[:5]:
            say(f"  {candidate['score']:8.3f}  {candidate['name']}")


def _export(options) -> None:
    say(f"wrote {headless.write_job(options, scene_of(options)) / export.JOB_FILE}")


def _apply(options) -> None:
    scene = scene_of(options)
    if (_mode(options) or scene.btfsep.world_mode) == "NONE":
        raise InputError("the World", "'none' was asked for", "choose nodes or texture")
    say(apply_light(scene, lighting_file.read(options.lighting), mode=_mode(options), lamp=_lamp(options)))


def _mode(options) -> str | None:
    return options.world and options.world.upper()


def _lamp(options) -> bool | None:
    return None if options.sun is None else options.sun == "lamp"


def _save(path: str) -> None:
    target = Path(path).absolute()
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        bpy.ops.wm.save_as_mainfile(filepath=str(target), copy=False, compress=False)
    except (OSError, RuntimeError) as error:
        raise InputError(f"cannot write {target}", str(error).strip(), "choose a folder that can be written") from None
    say(f"saved {target}")


_handle = None


def register():
    global _handle
    _handle = bpy.utils.register_cli_command("btfsep", main)


def unregister():
    global _handle
    bpy.utils.unregister_cli_command(_handle)
    _handle = None
