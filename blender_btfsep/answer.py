# SPDX-License-Identifier: GPL-3.0-or-later
"""What the engine answers, put into the scene and said in sentences; for the buttons and the command line alike."""

from . import lighting_file, request, sun_lamp, world


def take_materials(scene, objects: list, ids=None) -> list:
    """Puts the engine's word on each object's material into the list; gives sentences about them.

    ``ids`` : of :func:`request.ids_of` when the job was written, where the user may have named objects anew since.
    """
    by_name = request.fitted(scene.btfsep, ids)
    sentences = []
    for found in objects or []:
        name, material, unknown = found.get("name"), str(found.get("material") or ""), bool(found.get("unknown"))
        sentences.append(f"{name}: {material}" + (" (unsure)" if unknown else ""))
        entry = by_name.get(name)
        if entry is None:
            continue
        entry.recognised, entry.unknown = material, unknown
        entry.candidates.clear()
        for candidate in found.get("candidates") or []:
            item = entry.candidates.add()
            item.name, item.score = str(candidate["name"]), float(candidate["score"])
    return sentences


def take_estimate(scene, result: dict, ids=None, *, mode: str | None = None, lamp: bool | None = None) -> list:
    """Puts the engine's estimate into the scene; gives sentences about it: what matters, "", and the details.

    ``ids`` : as of :func:`take_materials`; ``mode``, ``lamp`` : as of :func:`apply_light`. Raises InputError where the
    lighting cannot be read; nothing is changed then.
    """
    lighting = lighting_file.read(result["lighting"])
    sentences = take_materials(scene, result.get("objects"), ids) + findings(result)
    if (mode or scene.btfsep.world_mode) != "NONE":
        sentences.append(apply_light(scene, lighting, mode=mode, lamp=lamp))
    return [*sentences, "", *details(result)]


def apply_light(scene, lighting: dict, *, mode: str | None = None, clamp: bool | None = None, lamp=None) -> str:
    """Makes a lighting the World, as the panel says where the others are None; gives a sentence about it."""
    settings = scene.btfsep
    world.apply_lighting(
        scene,
        lighting,
        mode=mode or settings.world_mode,
        clamp=settings.clamp if clamp is None else clamp,
        lamp=settings.sun_lamp if lamp is None else lamp,
    )
    return f"The World is now the lighting of order {lighting['order']}{sun_lamp.beside(scene)}"


def findings(result: dict) -> list:
    """What matters most of an estimate, in sentences: what the photo determines, the error to expect, the key light."""
    words = [str(result["determined"])] if result.get("determined") else []
    expected = (result.get("expected_error") or {}).get("order_2")
    if expected:
        median, low, high = (f"{100 * expected[key]:.0f}" for key in ("median", "low", "high"))
        words.append(f"Error to expect up to order 2: {median}% ({low}% to {high}%)")
    return _capitalised([*words, str((result.get("choice") or {}).get("key_light", ""))])


def details(result: dict) -> list:
    """What else the engine chose, and why, in sentences."""
    return _capitalised(str(why) for key, why in (result.get("choice") or {}).items() if key != "key_light")


def _capitalised(words) -> list:
    """Sentences; one that begins with a material's name keeps that name as it is."""
    return [word[:1].upper() + word[1:] if word.split()[0].isalpha() else word for word in words if word.strip()]
