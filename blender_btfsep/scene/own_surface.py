# SPDX-License-Identifier: GPL-3.0-or-later
"""What an object is made of where the user says it: a colour, or the object's own Blender material."""

import re

import numpy as np

from ..basics.colour import to_rec709
from ..basics.errors import InputError
from ..photo import photo
from . import meshes, object_bake, palette, surroundings
from .bake import source_of

BLENDER = "BLENDER"
NAME = "btfsep_material"  # custom property of a Blender material: the library's material that it stands for
FINISH = ("roughness", "metallic", "specular")  # in an image of finishes: red, green, blue
VARYING = ("Roughness", "Metallic", "Specular IOR Level", "Base Color", "Color")  # inputs whose links are baked
MOST_FINISHES = 16  # that a job may have of one object
RELIEF = "material '{}' has a normal or bump map, which is not followed: the light goes by the mesh's own shape"
FIND = "find it (File > External Data > Find Missing Files), or give the object's colour"
NEW = 0.8  # of each channel of a new material's colour, which says nothing
ALIKE = 0.01  # numbers of materials that differ by less are one


def material_named_by(thing) -> str:
    """The library's material that the Blender material of an object stands for; empty where it stands for none."""
    own = {slot.material.get(NAME, "") if slot.material else "" for slot in thing.material_slots} if thing else set()
    return str(own.pop()) if len(own) == 1 else ""


def material_of(entry) -> str | None:
    """The library's material that an entry of the object list names; None: none is named."""
    if entry is not None and entry.source == BLENDER:
        return material_named_by(entry.object) or None
    return entry.material or None if entry is not None and entry.source == "LIBRARY" else None


def chosen(entry):
    """What `surface_of` takes for an entry of the object list: a "surface" of the job, BLENDER, or None."""
    if entry.source == "COLOUR":
        base = [round(float(value), 6) for value in to_rec709(entry.colour).clip(0, 1)]
        return {"base_color": base, "roughness": round(entry.roughness, 6), "metallic": round(entry.metallic, 6)}
    stands_for = material_named_by(entry.object)
    return BLENDER if entry.source == BLENDER and not stands_for else None


def material_words(thing) -> str:
    """What an object (or None) is made of as in Blender, for the panel."""
    if thing is None:
        return "It has no material of its own"
    if thing.instance_type == "COLLECTION":
        return "As what it instances"
    names = dict.fromkeys(f"'{slot.material.name}'" for slot in thing.material_slots if slot.material)
    own = ", ".join(names) + (", each where it is" if len(names) > 1 else "")
    return material_named_by(thing) or own or "It has no material: white"


def tells_a_colour(thing) -> bool:
    """Whether the Blender material of an object (or None) says a colour: another one than a new material has."""
    return any(_is_coloured(slot.material) for slot in _slots(thing))


def missing_image(thing):
    """An image of the object's own material whose file is not there; None where all are."""
    return next((image for s in _slots(thing) for image in surroundings.missing_images(s.material)), None)


def _slots(thing) -> list:
    """The material slots of an object (or None), of an instance those of what it instances."""
    held = thing.instance_collection if thing is not None and thing.instance_type == "COLLECTION" else None
    things = held.all_objects if held is not None else [thing] if thing is not None else []
    return [slot for each in things for slot in each.material_slots]


def _is_coloured(material) -> bool:
    output = material.node_tree.get_output_node("CYCLES") if material and material.node_tree else None
    source = source_of(output.inputs["Surface"]) if output else None
    socket = source and (source.node.inputs.get("Base Color") or source.node.inputs.get("Color"))
    if not socket:
        return False
    return source_of(socket) is not None or max(abs(c - NEW) for c in socket.default_value[:3]) > ALIKE


def bakes(things: dict, parts: dict, surfaces: dict | None, depsgraph) -> dict:
    """object_bake.BakedSurface of those whose material cannot be told otherwise, by their names.

    ``things`` : of `meshes.names_of` -> object; ``parts`` : its triangles, of `meshes.gather`, by its full name
    """
    out = {}
    for name, thing in things.items():
        part = parts.get(thing.name_full)
        if (surfaces or {}).get(name) != BLENDER or part is None or not _varies(part["areas"]):
            continue
        baked = object_bake.bake_object(thing, depsgraph) if thing.type in meshes.SURFACE_TYPES else None
        if baked is not None and len(baked.uv) == len(part["positions"]):
            out[name] = baked
    return out


def _varies(areas: dict) -> bool:
    """Whether materials that can be baked have more than numbers, and than one image by the UV map."""
    linked = False
    for material in areas:
        output = material.node_tree.get_output_node("CYCLES") if material and material.use_nodes else None
        source = source_of(output.inputs["Surface"]) if output else None
        if material is not None and not object_bake.readable(source):
            return False
        node = source.node if source else None
        inputs = () if node is None else (i for i in node.inputs if i.name in VARYING)
        linked |= node is not None and (node.type not in object_bake.LEAVES or any(map(source_of, inputs)))
    only = texture_of(areas)
    return linked and (only is None or any(map(source_of, _finish_inputs(areas))))


def _finish_inputs(areas: dict) -> list:
    """The inputs of an object's one shader that say its gloss."""
    shader = source_of(next(iter(areas)).node_tree.get_output_node("CYCLES").inputs["Surface"])
    return [i for i in shader.node.inputs if i.name in VARYING[:-2]]


def surface_of(name: str, part: dict | None, surfaces: dict | None, folder, *, mapping: str, warn, baked=None) -> tuple:
    """The "surface" of an object in the job, or None, and the texture coordinates that it needs instead of the part's.

    Parameters
    ----------
    name : of the object
    part : its triangles, of `meshes.gather`; None for the surface of a depth
    surfaces : object name -> as of `chosen`
    folder : the job's; an image of the base colour is put there
    mapping : of `export.export_job`
    baked : object_bake.BakedSurface, of `bakes`, or None
    warn : called with a sentence about what is left out

    Raises InputError: the object's own material cannot be read, or light goes through it.
    """
    wanted = (surfaces or {}).get(name)
    if wanted != BLENDER:
        return wanted, None
    if part is None:
        raise InputError("the surface of the depth", "it has no material of its own", "give its colour, or a material")
    told = []
    gone = next((image for material in part["areas"] for image in surroundings.missing_images(material)), None)
    if gone is not None:
        raise InputError(f"object '{name}'", surroundings.GONE.format(gone.name), FIND)
    try:
        surface = surroundings.surface_of(part["areas"], told.append)
    except surroundings.Clear as error:
        raise InputError(f"object '{name}'", error, "give its colour, or have it recognised") from None
    if baked is not None:
        told = told if surface is not None else []
        surface = _baked(name, baked, surface or dict(surroundings.DEFAULT), folder)
    if surface is None:
        why = told[0] if told else surroundings.NOT_KNOWN
        raise InputError(f"object '{name}'", why, "give its colour, or have it recognised")
    told += [RELIEF.format(material.name) for material in surroundings.with_relief(part["areas"])]
    for sentence in told:
        warn(f"object '{name}': {sentence}")
    if baked is not None:
        return surface, baked.uv if isinstance(surface["base_color"], str) else None
    if len(part["areas"]) > 1:
        return _of_several(name, part, surface, folder, warn)
    image = texture_of(part["areas"])
    if image is not None and part["uv"] is not None and mapping != "UNWRAP":
        surface["base_color"] = photo.put_texture(image, folder, _stem("colour", name))
    return surface, None


def _baked(name: str, baked, surface: dict, folder) -> dict:
    """The ``surface`` with what was baked, in images where it varies."""
    colour, at = np.clip(to_rec709(baked.colour), 0, 1).astype(np.float32), tuple(baked.places.T)
    finish = object_bake.grouped(baked.finish, baked.finish[at])
    mean = dict(zip(FINISH, finish[at].mean(0, dtype=np.float64).round(6).tolist(), strict=True))
    glosses = np.ptp(finish[at], axis=0).max() > 0
    if not glosses and np.ptp(colour[at], axis=0).max() < ALIKE:
        return surface | mean | {"base_color": colour[at].mean(0, dtype=np.float64).round(6).tolist()}
    files = {"base_color": photo.put_numbers(colour, folder, _stem("colour", name))}
    if glosses:
        files["finish"] = photo.put_numbers(finish, folder, _stem("finish", name))
    return surface | mean | files


def _stem(what: str, name: str) -> str:
    """Of the file of an object's colours or finishes."""
    return re.sub(r"[^A-Za-z0-9_-]+", "_", f"{what}_{name}")[:60]


def _of_several(name: str, part: dict, mean: dict, folder, warn) -> tuple:
    """`surface_of` for several materials: what each reflects, in images; the ``mean`` for what cannot be read."""
    each = [surroundings.read_alone(material) or mean for material in part["areas"]]
    values = np.array([[*numbers["base_color"], *(numbers[key] for key in FINISH)] for numbers in each])
    if np.ptp(values, axis=0).max() < ALIKE:
        return mean, None
    if len(np.unique(values[:, 3:].round(3), axis=0)) > MOST_FINISHES:
        values[:, 3:] = [mean[key] for key in FINISH]
        warn(f"object '{name}': it has more than {MOST_FINISHES} kinds of gloss: their mean counts")
    number = {material: i for i, material in enumerate(part["areas"])}
    numbers = np.array([number.get(material, 0) for material in part["materials"]])  # those without area: any
    image, uv = palette.laid(values, numbers)
    files = [
        photo.put_numbers(image[..., c : c + 3], folder, _stem(what, name))
        for what, c in (("colour", 0), ("finish", 3))
    ]
    return {**mean, "base_color": files[0], "finish": files[1]}, uv


def texture_of(areas: dict):
    """The image that is the base colour of all of an object, by its active UV map; None where it is something else."""
    material = next(iter(areas)) if len(areas) == 1 else None
    output = material.node_tree.get_output_node("CYCLES") if material and material.use_nodes else None
    shader = source_of(output.inputs["Surface"]) if output else None
    colour = shader and (shader.node.inputs.get("Base Color") or shader.node.inputs.get("Color"))
    source = source_of(colour) if colour else None
    if source is None or source.node.type != "TEX_IMAGE" or source.name != "Color":
        return None
    node = source.node
    placed = source_of(node.inputs["Vector"])
    by_uv = placed is None or (placed.node.type == "TEX_COORD" and placed.name == "UV")
    plain = node.projection == "FLAT" and node.extension == "REPEAT" and by_uv
    return node.image if plain and node.image and node.image.source in ("FILE", "GENERATED") else None
