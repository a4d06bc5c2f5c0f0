# SPDX-License-Identifier: GPL-3.0-or-later
"""``--command btfsep sequence``: the light of every photo of a sequence, as keyframes of the World."""

from pathlib import Path

from ..basics.errors import InputError
from ..engine import engine_settings
from ..light import animation
from ..run.answer import take_materials
from ..window import sequence_run
from . import terminal


def add_command(commands, parents) -> None:
    """Adds ``sequence`` to the commands that Blender runs without a window."""
    parser = commands.add_parser("sequence", parents=parents, help="the light of every photo, as keyframes")
    parser.add_argument("--images", metavar="PATTERN", help="the photos, as 'frames/*.exr' (default: the panel's)")
    engine_settings.add_options(parser, engine_settings.COMMANDS["sequence"], "the panel's")
    parser.add_argument("--frame-start", type=int, help="frame of the first photo (default: its number)")
    choices = [name.lower() for name, *_ in animation.INTERPOLATIONS]
    parser.add_argument("--interpolation", choices=choices, help="between the photos (default: the panel's)")
    parser.set_defaults(run=_run)


def _run(options) -> None:
    scene = terminal.scene_of(options)
    settings = scene.btfsep
    if options.world == "texture":
        raise InputError("--world", "a texture has no keyframes", "choose nodes or none")
    if options.image:
        raise InputError("--image", "a sequence has more than one", "give --images 'frames/*.exr'")
    pattern = str(Path(options.images).absolute()) if options.images else ""
    camera = scene.objects.get(options.camera or "") or settings.camera or scene.camera
    files, start = sequence_run.photos(settings.image, camera, pattern, options.frame_start)
    folder = terminal.write_job(options, scene, image=files[0])
    out = Path(options.out).absolute() if options.out else folder / sequence_run.OUT
    arguments = sequence_run.engine_arguments(folder, scene, files, out, pattern=pattern, options=options)
    result = terminal.run_engine(arguments, options.engine)
    for sentence in take_materials(scene, result.get("objects")):
        terminal.say(sentence)
    apply = (options.world or settings.world_mode).upper() != "NONE"
    interpolation = options.interpolation.upper() if options.interpolation else settings.interpolation
    terminal.say(sequence_run.write_world(scene, result, files, start, apply=apply, interpolation=interpolation))
    terminal.say_wrote(out)
