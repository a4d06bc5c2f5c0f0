# SPDX-License-Identifier: GPL-3.0-or-later
"""Without a window: ``blender --background scene.blend --command btfsep estimate …``; also ``main([...])`` in scripts.

Exit status 0: done; 2: the input is at fault, one line ``error: what; what was got; what to do``; 1: a bug.
"""

import argparse
import sys
import traceback
from pathlib import Path

import bpy

from .basics import atomic
from .basics.errors import InputError
from .engine import engine_settings
from .engine.engine_process import BUG, INPUT_FAULT
from .headless import batch, measure_command, sequence_command, terminal
from .headless.terminal import say, scene_of
from .light import light_files, sh_nodes
from .run import request, runs
from .run.answer import apply_light, take_estimate, take_materials
from .scene import export
from .window.properties import CURVES, MAPPINGS, OCCLUDERS, WORLD_MODES


def main(arguments) -> int:
    """Runs a command; ``arguments`` as on the command line after ``btfsep``. Returns the exit status."""
    terminal.speech = speech = terminal.Speech()
    try:
        options = _parser().parse_args(list(arguments))
    except SystemExit as stop:  # argparse has said why
        return int(stop.code or 0)
    speech.json = options.json
    runs.run_state().warnings.clear()
    try:
        if getattr(options, "save", None):
            atomic.check_place(options.save)
        result = options.run(options) or {}
        if getattr(options, "save", None):
            result["saved"] = save_file(options.save)
    except InputError as error:
        return speech.failed(str(error), INPUT_FAULT)
    except KeyboardInterrupt:
        return speech.failed("stopped", 130)
    except terminal.EngineBug as error:
        return speech.failed(str(error), BUG, error.details)
    except Exception as error:
        traceback.print_exc()
        return speech.failed(f"a bug in BTFsep: {type(error).__name__}: {error}; please report it", BUG)
    speech.done(result)
    return result.get("exit_code", 0)


def by_blender(arguments) -> int:
    """As :func:`main`, where Blender was to read a file first: it goes on with its default scene if it cannot."""
    before = sys.argv[1 : next((i for i, a in enumerate(sys.argv) if a in ("--command", "-c")), len(sys.argv))]
    files = [argument for argument in before if argument.lower().endswith(".blend") and not argument.startswith("-")]
    if files and (not bpy.data.filepath or Path(files[-1]).resolve() != Path(bpy.data.filepath).resolve()):
        terminal.speech = terminal.Speech()
        terminal.speech.json = "--json" in arguments
        why = "it was not read" if Path(files[-1]).exists() else "there is no such file"
        return terminal.speech.failed(str(InputError(files[-1], why, "check its name, and what Blender says of it")), 2)
    return main(arguments)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="btfsep", description="The light of a photograph as the scene's World.")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    everything = argparse.ArgumentParser(add_help=False)
    everything.add_argument("--json", action="store_true", help="one JSON object a line, for programs")

    job = _job_options(everything)
    one = argparse.ArgumentParser(add_help=False)
    one.add_argument(
        "--upright", action="store_true", help="turn the photo as its file asks for (default: as it is stored)"
    )

    engine = argparse.ArgumentParser(add_help=False)
    engine.add_argument("--library", help="material library (default: the preferences', then the engine's)")
    engine.add_argument("--engine", help="Python, virtual environment or btfsep program (default: the preferences')")

    save = argparse.ArgumentParser(add_help=False)
    save.add_argument("--save", metavar="FILE.blend", help="save the file with the World")
    save.add_argument("--world", choices=[name.lower() for name, *_ in WORLD_MODES], help="default: the panel's")

    sun = argparse.ArgumentParser(add_help=False)
    sun.add_argument("--sun", choices=("lamp", "world"), help="where key lights go (default: the panel's)")

    fit = argparse.ArgumentParser(add_help=False)
    fit.add_argument(
        "--material",
        action="append",
        metavar="[OBJECT=]NAME",
        help="the material of all objects, or of one (may be given for each), instead of recognition",
    )
    fit.add_argument("--out", help="folder for the results (default: in the job's)")

    estimate = commands.add_parser(
        "estimate", parents=[job, one, engine, fit, save, sun], help="estimate the light, write the World"
    )
    engine_settings.add_options(estimate, engine_settings.COMMANDS["estimate"], "the panel's")
    estimate.set_defaults(run=_estimate)

    recognise = commands.add_parser("recognise", parents=[job, one, engine], help="name the material of each object")
    engine_settings.add_options(recognise, engine_settings.COMMANDS["recognise"], "the panel's")
    recognise.set_defaults(run=_recognise)

    exporting = commands.add_parser("export", parents=[job, one], help="write the job folder only")
    exporting.set_defaults(run=_export)

    apply = commands.add_parser("apply", parents=[everything, save, sun], help="make a light in a file the World")
    apply.add_argument("lighting", help="lighting.json, an environment map (.exr, .hdr), or cmgen's text")
    apply.add_argument("--order", type=int, default=4, help="of a map that becomes nodes (default: 4)")
    apply.add_argument("--scene", help="name of the scene (default: the active one)")
    apply.set_defaults(run=_apply)

    light = commands.add_parser("light", parents=[everything], help="write the World's light to a file, as it is now")
    light.add_argument("file", help=".json, .btfsep, .exr, .hdr, .txt or .usda")
    light.add_argument("--order", type=int, help="of harmonics (default: 4, or the World's where that is higher)")
    light.add_argument("--scene", help="name of the scene (default: the active one)")
    light.set_defaults(run=_light)

    sequence_command.add_command(commands, [job, engine, fit, save])
    batch.add_command(commands, [job, one, engine, fit, sun], estimate=estimate_scene, save=save_file)
    measure_command.add_command(commands, [everything])
    return parser


def _job_options(everything) -> argparse.ArgumentParser:
    """What may be said otherwise than the panel has it, for a parent."""
    job = argparse.ArgumentParser(add_help=False, parents=[everything])
    job.add_argument("--frame", type=int, help="frame of the scene (default: the file's)")
    job.add_argument(
        "--mask", action="append", metavar="[OBJECT=]FILE", help="where the object may be used; may be given for each"
    )
    mappings = [name.lower() for name, *_ in MAPPINGS]
    job.add_argument("--mapping", choices=mappings, help="how materials lie on the objects (default: the panel's)")
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
    job.add_argument(
        "--known-sun",
        dest="known_suns",
        nargs="*",
        metavar="NAME",
        help="Sun lamps whose direction is known; none named: none (default: the panel's)",
    )
    job.add_argument("--job", help="folder for the job (default: one that is removed afterwards)")
    return job


def _estimate(options) -> dict:
    return estimate_scene(options, scene_of(options))


def estimate_scene(options, scene, *, image=None, out=None, stays: bool = False) -> dict:
    """Estimates the light of ``scene`` as the command line says; what came of it, for ``--json``."""
    folder = terminal.write_job(options, scene, image=image)
    out = Path(out or options.out).absolute() if out or options.out else folder / "result"
    arguments = request.engine_arguments("estimate", folder, scene, "--out", out, options=options)
    result = terminal.run_engine(arguments, options.engine, stays=stays)
    for sentence in take_estimate(scene, result, mode=_mode(options), lamp=_lamp(options)):
        say(sentence)
    terminal.say_wrote(out)
    return {"out": str(out), "estimate": result}


def _recognise(options) -> dict:
    scene = scene_of(options)
    folder = terminal.write_job(options, scene)
    arguments = request.engine_arguments("recognise", folder, scene, options=options)
    objects = terminal.run_engine(arguments, options.engine).get("objects") or []
    for sentence, found in zip(take_materials(scene, objects), objects, strict=True):
        say(sentence)
        for candidate in (found.get("candidates") or [])[:5]:
            say(f"  {candidate['score']:8.3f}  {candidate['name']}")
    return {"objects": objects}


def _export(options) -> dict:
    job = terminal.write_job(options, scene_of(options)) / export.JOB_FILE
    say(f"wrote {job}")
    return {"job": str(job)}


def _apply(options) -> None:
    scene = scene_of(options)
    if (_mode(options) or scene.btfsep.world_mode) == "NONE":
        raise InputError("the World", "'none' was asked for", "choose nodes or texture")
    lighting = light_files.read(options.lighting, _order(options))
    say(apply_light(scene, lighting, mode=_mode(options), lamp=_lamp(options)))


def _light(options) -> dict:
    scene = scene_of(options)
    order = light_files.order_to_write(scene) if options.order is None else _order(options)
    light_files.write(options.file, scene, order)
    say(f"wrote {options.file}")
    return {"file": str(Path(options.file).absolute())}


def _order(options) -> int:
    if not 0 <= options.order <= sh_nodes.MAX_NODE_ORDER:
        raise InputError("--order", f"{options.order}", f"give 0 to {sh_nodes.MAX_NODE_ORDER}")
    return options.order


def _mode(options) -> str | None:
    return options.world and options.world.upper()


def _lamp(options) -> bool | None:
    return None if options.sun is None else options.sun == "lamp"


def save_file(path: str) -> str:
    """Saves the file, and gives its name. Raises InputError."""
    target = Path(path).absolute()
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        bpy.ops.wm.save_as_mainfile(filepath=str(target), copy=False, compress=False)
    except (OSError, RuntimeError) as error:
        raise InputError(f"cannot write {target}", error, "choose a folder that can be written") from None
    say(f"saved {target}")
    return str(target)


_handle = None


def register():
    global _handle
    _handle = bpy.utils.register_cli_command("btfsep", by_blender)


def unregister():
    global _handle
    bpy.utils.unregister_cli_command(_handle)
    _handle = None
