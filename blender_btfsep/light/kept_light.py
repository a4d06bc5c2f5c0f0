# SPDX-License-Identifier: GPL-3.0-or-later
"""The light that was found, kept in the file: lighting, card and pictures, with the scene and with the World.

It is ordinary data of Blender's, so that it follows undo, is saved, and goes where the World goes.
"""

import json
from functools import lru_cache
from pathlib import Path

import bpy
import numpy as np

from ..basics import pixels
from ..basics.errors import InputError
from ..photo import camera as pinhole
from . import light_files, light_picture, lighting_file
from .card import card_of

REPORT = "BTFsep Report"
PICTURE = "BTFsep Light"
SKY = "BTFsep Sky"
PICTURES = ("picture", "report", "sky")


def keep(scene, lighting: dict, result: dict | None = None, *, warnings=()) -> None:
    """Keeps ``lighting`` (of `lighting_file`) as the last light of ``scene``, with its card and pictures.

    ``result`` : the engine's answer, where it is its estimate; ``warnings`` : as of `card.card_of`
    """
    light, camera = scene.btfsep.light, scene.btfsep.camera or scene.camera
    to_world = None
    if camera is not None:
        try:
            to_world = pinhole.to_world(camera)
        except InputError:
            pass  # a mirrored camera: directions are then the world's
    units = scene.unit_settings
    unit = 1.0 if units.system == "NONE" else units.scale_length
    card = card_of(result or {}, lighting, to_world, warnings=warnings, metres_per_unit=unit)
    light.text, light.mended = json.dumps({"lighting": lighting_file.as_data(lighting), "card": card}), ""
    out = Path(str((result or {}).get("out") or ""))
    sky, report = (out / name if (out / name).is_file() else None for name in ("lighting.exr", "report.png"))
    picture = pixels.new(PICTURE, light_picture.picture_of(scene, lighting, to_world, map_file=sky)[::-1], floats=False)
    picture.pack()
    _put(scene, "picture", picture)
    _put_report(scene, report)
    mirrored = sky is not None and "mirrors" in ((result or {}).get("choice") or {})
    _put(scene, "sky", _sky(sky, lighting) if mirrored else None)


def put_with_world(scene) -> None:
    """Gives the scene's World a copy of what is kept of the light that was made its own."""
    here, there = scene.btfsep.light, scene.world.btfsep_kept
    there.text, there.mended = here.text, here.mended
    for name in PICTURES:
        _replace(there, name, getattr(here, name))


def forget(scene) -> None:
    """Keeps no light any more: another one, which has no card, is the World."""
    for light in (scene.btfsep.light, scene.world and scene.world.btfsep_kept):
        if light:
            light.text = light.mended = ""
            for name in PICTURES:
                _replace(light, name, None)


def kept(scene):
    """What the panel shows: the scene's last light, else that of a World from elsewhere; None where there is none."""
    both = (scene.btfsep.light, scene.world and scene.world.btfsep_kept)
    return next((light for light in both if light and light.text), None)


def is_the_world(scene, light) -> bool:
    """Whether ``light``, of :func:`kept`, is what the scene's World was made of."""
    return scene.world is not None and scene.world.btfsep_kept.text == light.text


def lighting_of(light) -> dict:
    """The lighting that is kept, as lighting_file.read gives it; of a mirror with "map", the sky as that shows it.

    Raises InputError where the file was tampered with.
    """
    lighting = lighting_file.validate(_content(light.text).get("lighting"), "the light kept in this file")
    return lighting if light.sky is None else lighting | {"map": pixels.colours(light.sky)[::-1]}


def card(light) -> dict:
    """The card that is kept."""
    return _content(light.text).get("card") or {}


def is_kept(scene, lighting: dict) -> bool:
    """Whether ``lighting`` is the scene's last light."""
    return _content(scene.btfsep.light.text).get("lighting") == lighting_file.as_data(lighting)


@lru_cache(maxsize=4)
def _content(text: str) -> dict:
    """The JSON of a light; of what is none, nothing."""
    try:
        found = json.loads(text or "{}")
    except ValueError:
        return {}
    return found if isinstance(found, dict) else {}


def _put(scene, name: str, image) -> None:
    """Gives the scene's light another picture: in the data-block that it has, or had, where nothing else uses that.

    What comes as a new one is to be known to a step of undo (`run/between_steps`).
    """
    old = None if image is None else _own(scene, name, image.name.partition(".")[0], but=image)
    if old is not None and pixels.move(image, old):
        image = old
    _replace(scene.btfsep.light, name, image)


def _put_report(scene, file: Path | None) -> None:
    """As :func:`_put`, of a file: its pixels, of which there are many, are neither read nor coded anew."""
    image = None if file is None else _own(scene, "report", REPORT)
    if image is not None and image.source == "FILE" and image.packed_file:
        pixels.repack(image, file.read_bytes())
    else:
        image = file and _packed(file)
    _replace(scene.btfsep.light, "report", image)


def _own(scene, name: str, kind: str, *, but=None):
    """The data-block of a picture that the scene's light has, or had, where nothing else uses it; else None."""
    light, world = scene.btfsep.light, scene.world
    old = getattr(light, name)
    if old is None:
        spare = (each for each in bpy.data.images if each != but and not each.users and not each.library)
        old = next((each for each in spare if each.name.partition(".")[0] == kind), None)
    beside = world is not None and old is not None and getattr(world.btfsep_kept, name) == old
    if old is None or (beside and scene.btfsep.world_mode == "NONE"):
        return None  # the World's light stays what it is
    return old if old.users == (getattr(light, name) == old) + beside else None


def _replace(light, name: str, image) -> None:
    """Gives a light another picture, and removes the one that is not used any more where this comes in its place."""
    old = getattr(light, name)
    setattr(light, name, image)
    if old is not None and image is not None and old != image and old.users == 0:
        bpy.data.images.remove(old)


def _sky(file: Path, lighting: dict):
    """A packed image of the engine's map, without the key lights that are drawn in it."""
    radiance = light_files.read_map(file)
    lamps = lighting["suns"]["lamps"] if lighting["suns"] else []
    image = pixels.new(SKY, np.maximum(light_files.without_lamps(radiance, lamps), 0)[::-1])
    image.pack()
    return image


def _packed(path: Path):
    image = bpy.data.images.load(str(path), check_existing=False)
    image.name = REPORT
    image.pack()
    return image
