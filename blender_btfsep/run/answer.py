# SPDX-License-Identifier: GPL-3.0-or-later
"""What the engine answers, put into the scene and said in sentences; for the buttons and the command line alike."""

import re
from pathlib import Path

from ..light import kept_light, lighting_file, sun_lamp, world
from ..photo import photo
from . import request

APPLIED = "The World is now the lighting"
GIVEN = "surface/given"  # the engine's name for a surface by numbers
FOUND = "The light is found; the World is as it was"


def take_materials(scene, objects: list, ids=None) -> list:
    """Puts the engine's word on each object's material into the list; gives sentences about them.

    ``ids`` : of :func:`request.ids_of` when the job was written, where the user may have named objects anew since.
    """
    by_name = request.fitted(scene.btfsep, ids)
    sentences = []
    for found in objects or []:
        name, material, unknown = found.get("name"), str(found.get("material") or ""), bool(found.get("unknown"))
        called = "as given" if material == GIVEN else re.sub("^surface/", "plain ", material)  # that is no library's
        sentences.append(f"{name}: {called}" + (" (unsure)" if unknown else ""))
        entry = by_name.get(name)
        if entry is None:
            continue
        entry.recognised, entry.unknown = "" if material == GIVEN else material, unknown  # what is given is not
        entry.candidates.clear()
        for candidate in found.get("candidates") or []:
            item = entry.candidates.add()
            item.name, item.score = str(candidate["name"]), float(candidate["score"])
    return sentences


def take_estimate(scene, result: dict, ids=None, *, mode: str | None = None, lamp: bool | None = None, own=()) -> list:
    """Puts the engine's estimate into the scene, with its card; gives the card and the details in sentences.

    ``ids`` : as of :func:`take_materials`; ``mode``, ``lamp`` : as of :func:`apply_light`; ``own`` : the add-on's own
    warnings. Raises InputError where the lighting cannot be read; nothing is changed then.
    """
    lighting = lighting_file.read(result["lighting"])
    sentences = take_materials(scene, result.get("objects"), ids)
    said = photo.named(scene.btfsep.image, result.get("warnings") or [])
    kept_light.keep(scene, lighting, result, warnings=[*own, *said])
    found = kept_light.card(scene.btfsep.light)
    sentences += [f"{label}: {words}".removeprefix(": ") for label, words in found["lines"]]
    if (mode or scene.btfsep.world_mode) != "NONE":
        lighting = kept_light.lighting_of(scene.btfsep.light)
        sentences.append(apply_light(scene, lighting, mode=mode, lamp=lamp))
    return [*sentences, "", *found["details"]]


def take_light(scene, path) -> None:
    """Makes the lighting at ``path`` the World, as the panel says, while the engine still checks it.

    Raises InputError.
    """
    if scene.btfsep.world_mode != "NONE":
        lighting = lighting_file.read(path)
        kept_light.keep(scene, lighting, {"out": Path(path).parent})
        apply_light(scene, lighting)


def apply_light(scene, lighting: dict, *, mode: str | None = None, clamp: bool | None = None, lamp=None) -> str:
    """Makes a lighting the World, as the panel says where the others are None; gives a sentence about it.

    What a mirror shows (``lighting`` has a "map") is no node group: that would be as smooth as harmonics are.
    """
    settings = scene.btfsep
    world.apply_lighting(
        scene,
        lighting,
        mode=mode or _mode(settings, lighting),
        clamp=settings.clamp if clamp is None else clamp,
        lamp=settings.sun_lamp if lamp is None else lamp,
    )
    if not kept_light.is_kept(scene, lighting):
        kept_light.keep(scene, lighting)
    kept_light.put_with_world(scene)
    return f"{APPLIED} of order {lighting['order']}{sun_lamp.beside(scene)}"


def fits(scene, lighting: dict) -> bool:
    """Whether a lighting can become the World, as the panel says, in what is there: no lamps or nodes come or go."""
    settings = scene.btfsep
    if settings.world_mode == "NONE":
        return True
    return world.fits(scene, lighting, mode=_mode(settings, lighting), lamp=settings.sun_lamp)


def _mode(settings, lighting: dict) -> str:
    return "TEXTURE" if "map" in lighting and settings.world_mode == "NODES" else settings.world_mode
