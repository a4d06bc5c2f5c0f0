# SPDX-License-Identifier: GPL-3.0-or-later
"""What the commands without a window share: scenes and objects by name, a run of the engine, words on the terminal."""

import sys
from pathlib import Path

import bpy

from . import engine_process, request, runs
from .errors import InputError


class EngineBug(Exception):
    """The engine failed by a bug; ``details`` is what it said last."""

    def __init__(self, failed: engine_process.Failed):
        super().__init__(failed.message)
        self.details = failed.details


def say(text: str, stream=None) -> None:
    """A line for the user, at once."""
    stream = stream or sys.stdout
    stream.write(text + "\n")
    stream.flush()


def named(things, kind: str, name: str):
    """What of ``things`` is called ``name``. Raises InputError, with the names that there are."""
    found = things.get(name)
    if found is None:
        names = ", ".join(f"'{thing.name}'" for thing in things[:8])
        raise InputError(
            f"{kind} '{name}'", "there is none of that name", f"choose from {names}" if names else "add one"
        )
    return found


def scene_of(options):
    """The scene of ``--scene``, else the active one."""
    return named(bpy.data.scenes, "scene", options.scene) if options.scene else bpy.context.scene


def write_job(options, scene, *, image=None) -> Path:
    """The job of the scene with what the command line says in the panel's place; gives its folder."""
    return request.write_job(
        scene,
        folder=options.job,
        image=image or options.image,
        camera=named(scene.objects, "object", options.camera) if options.camera else None,
        objects=[named(scene.objects, "object", name) for name in options.objects or ()],
        depth=options.depth,
        material=getattr(options, "material", None),
        occluders=options.occluders and options.occluders.upper(),
        exposure_ev=options.exposure,
        curve=options.curve,
    )


def run_engine(arguments, engine: str | None = None) -> dict:
    """The engine's result; what it says on the way goes to standard error.

    Raises
    ------
    InputError, EngineBug, KeyboardInterrupt
        As the engine ends.
    """
    process = runs.start_engine(arguments, engine or "", stays=False)
    announced = set()

    def heard(message):
        if isinstance(message, engine_process.Notice):
            say(f"warning: {message.message}", sys.stderr)
        elif isinstance(message, engine_process.Progress) and message.stage not in announced:
            announced.add(message.stage)
            say(f"{message.stage} …", sys.stderr)

    try:
        last = process.wait(heard)
    finally:
        process.kill()
    if isinstance(last, engine_process.Failed):
        if last.exit_code == engine_process.INPUT_FAULT:
            raise InputError(last.message, "", "")  # the engine's own sentence, as it is
        raise EngineBug(last)
    if isinstance(last, engine_process.Cancelled):
        raise KeyboardInterrupt
    return last.result
