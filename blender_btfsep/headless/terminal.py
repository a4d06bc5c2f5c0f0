# SPDX-License-Identifier: GPL-3.0-or-later
"""What the commands without a window share: scenes and objects by name, a run of the engine, words on the terminal."""

import json
import sys
from dataclasses import asdict
from pathlib import Path

import bpy

from ..basics.errors import InputError
from ..basics.scratch import scratch
from ..engine import engine_process
from ..photo import photo_file, upright
from ..run import request, runs
from ..scene import export


class EngineBug(Exception):
    """The engine failed by a bug; ``details`` is what it said last."""

    def __init__(self, failed: engine_process.Failed):
        super().__init__(failed.message)
        self.details = failed.details


class Speech:
    """How a command speaks: lines for people, or one JSON object a line, as the engine does (``docs/formats.md``)."""

    def __init__(self):
        self.json, self.said = False, []

    def line(self, **fields) -> None:
        """One JSON object."""
        sys.stdout.write(json.dumps(fields) + "\n")
        sys.stdout.flush()

    def done(self, result: dict) -> None:
        """The last line of a command that went well; for people it is all said."""
        if self.json:
            warnings = [warning.name for warning in runs.run_state().warnings]
            self.line(type="done", result={"said": self.said, "warnings": warnings, **result})

    def failed(self, message: str, exit_code: int, details: str = "") -> int:
        """The last line of one that did not; gives ``exit_code``."""
        if self.json:
            self.line(type="failed", message=message, exit_code=exit_code)
        else:
            say(f"{details}\nerror: {message}".strip(), sys.stderr)
        return exit_code


speech = Speech()
"""Of the command that runs now."""


def say(text: str, stream=None) -> None:
    """A line for the user, at once; with ``--json`` it is kept for the last line."""
    if speech.json:
        if stream is None:
            speech.said.append(text)
        return
    stream = stream or sys.stdout
    stream.write(text + "\n")
    stream.flush()


def say_wrote(out: Path) -> None:
    """Where the results are, unless they go when Blender ends."""
    if not out.is_relative_to(bpy.app.tempdir):
        say(f"wrote {out}")


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


def by_object(given, objects, kind: str) -> dict:
    """``OBJECT=VALUE`` of the command line as a dict; a VALUE alone is that of all ``objects`` (names)."""
    out = {}
    for text in given or ():
        name, equals, value = text.rpartition("=")
        if equals and name not in objects:
            raise InputError(f"--{kind} '{text}'", f"no object of the job is called '{name}'", f"name one of {objects}")
        out |= {name: value} if equals else dict.fromkeys(objects, value)
    return out


def write_job(options, scene, *, image=None) -> Path:
    """The job of the scene with what the command line says in the panel's place; gives its folder."""
    if getattr(options, "frame", None) is not None:
        scene.frame_set(options.frame)
    objects = [named(scene.objects, "object", name) for name in options.objects or ()]
    depth = options.depth or (scene.btfsep.depth and not objects)
    names = [thing.name for thing in objects] or list(request.fitted(scene.btfsep))
    names = [export.SURFACE] if depth else names
    with scratch() as own:
        return request.write_job(
            scene,
            folder=options.job,
            image=_photo(options, scene, image, own),
            camera=named(scene.objects, "object", options.camera) if options.camera else None,
            objects=objects,
            depth=options.depth,
            material=by_object(getattr(options, "material", None), names, "material"),
            masks={name: _image_of(path) for name, path in by_object(options.mask, names, "mask").items()},
            occluders=options.occluders and options.occluders.upper(),
            mapping=options.mapping and options.mapping.upper(),
            exposure_ev=options.exposure,
            curve=options.curve,
            known_suns=None if options.known_suns is None else [_sun(scene, name) for name in options.known_suns],
        )


def _photo(options, scene, path, own):
    """The photo that the command line names, a path or an image, upright where that is asked for; None: the panel's.

    An upright copy of the panel's photo becomes the panel's; one of a file is for the job alone (``own``).
    """
    path = path or options.image
    path = path and bpy.path.abspath(str(path))
    if not getattr(options, "upright", False):
        lies = upright.orientation_of(scene.btfsep.image) if path is None else photo_file.facts_of(path).orientation
        if lies > 4 and hasattr(options, "upright"):
            say("the photo's file asks for it to be turned, which --upright does", sys.stderr)
        return path
    if path is None:
        if upright.orientation_of(scene.btfsep.image) != 1:
            scene.btfsep.image = upright.copy_of(scene.btfsep.image)
        return None
    if photo_file.facts_of(path).orientation == 1:
        return path
    try:
        return own(upright.copy_of(own(bpy.data.images.load(str(Path(path).absolute()), check_existing=False))))
    except RuntimeError as error:
        raise InputError(f"the photo {path}", error, "choose an EXR, HDR, PNG, JPEG, TIFF or WebP") from None


def _sun(scene, name: str):
    lamp = named(scene.objects, "object", name)
    if lamp.type != "LIGHT" or lamp.data.type != "SUN":
        raise InputError(f"--known-sun '{name}'", "it is no Sun lamp", "name a Sun lamp of the scene")
    return lamp


def _image_of(path: str):
    try:
        return bpy.data.images.load(str(Path(path).absolute()), check_existing=True)
    except RuntimeError as error:
        raise InputError(f"the mask {path}", error, "give an image of the photo's size") from None


def run_engine(arguments, engine: str | None = None, *, stays: bool = False) -> dict:
    """The engine's result; what it says on the way goes to standard error. ``stays`` : as of `runs.start_engine`.

    Raises
    ------
    InputError, EngineBug, KeyboardInterrupt
        As the engine ends.
    """
    process = runs.start_engine(arguments, engine or "", stays=stays)
    announced = set()

    def heard(message):
        if isinstance(message, engine_process.Notice):
            say(f"warning: {message.message}", sys.stderr)
            if speech.json:
                speech.line(type="warning", message=message.message)
        elif isinstance(message, engine_process.Progress) and speech.json:
            speech.line(type="progress", **asdict(message))
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
