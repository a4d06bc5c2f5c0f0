# SPDX-License-Identifier: GPL-3.0-or-later
"""``--command btfsep measure``: the active object's material, measured into a library."""

import shutil
import tempfile
from pathlib import Path

from ..basics.errors import InputError
from ..engine import engine_settings
from ..window import measure
from . import terminal


def add_command(commands, parents=()) -> None:
    """Adds ``measure`` to the commands that Blender runs without a window."""
    parser = commands.add_parser("measure", parents=parents, help="measure an object's material into a library")
    parser.add_argument("--scene", help="name of the scene (default: the active one)")
    parser.add_argument("--object", help="name of the object (default: the active one)")
    parser.add_argument("--material", help="name of its material (default: its active one)")
    parser.add_argument("--name", help="in the library (default: the material's)")
    engine_settings.add_options(parser, engine_settings.MEASURE, "")
    parser.add_argument(
        "--height-mm", type=float, default=0.0, help="lowest to highest (default: as the material says)"
    )
    parser.add_argument("--resolution", type=int, default=measure.RESOLUTION, help="pixels of the baked maps")
    parser.add_argument("--maps", help="folder for the baked maps (default: one that is removed afterwards)")
    parser.add_argument("--library", help="folder to add it to (default: the preferences')")
    parser.add_argument("--engine", help="Python, virtual environment or btfsep program (default: the preferences')")
    parser.set_defaults(run=_run)


def _run(options) -> None:
    scene = terminal.scene_of(options)
    active = scene.view_layers[0].objects.active
    thing = terminal.named(scene.objects, "object", options.object) if options.object else active
    material = measure.material_of(thing)
    if options.material:
        material = next((s.material for s in thing.material_slots if s.name == options.material), None)
        if material is None:
            names = ", ".join(f"'{s.name}'" for s in thing.material_slots)
            raise InputError(
                f"object '{thing.name}'", f"it has no material '{options.material}'", f"choose from {names}"
            )
    if not 0.1 <= options.size_mm <= 10_000 or not 16 <= options.resolution <= 4096:
        raise InputError(
            f"{options.size_mm:g} mm of {options.resolution} pixels",
            "that cannot be measured",
            "give 0.1 to 10000 mm and 16 to 4096 pixels",
        )
    library = measure.library_folder(options.library or "")
    folder = Path(options.maps).absolute() if options.maps else Path(tempfile.mkdtemp(prefix="btfsep-maps-"))
    try:
        size = {"size_mm": options.size_mm, "height_mm": options.height_mm, "resolution": options.resolution}
        baked, warnings = measure.write_maps(scene, thing, material, folder, **size)
        for warning in warnings:
            terminal.say(f"warning: {warning}")
        name = options.name or measure.default_name(material)
        result = terminal.run_engine(
            measure.engine_arguments(folder, name, library, baked, None, options), options.engine
        )
    finally:
        if not options.maps:
            shutil.rmtree(folder, ignore_errors=True)
    terminal.say(f"{result['name']}: {library / result['file']}")
