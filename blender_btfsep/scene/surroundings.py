# SPDX-License-Identifier: GPL-3.0-or-later
"""What stands around the objects, as a job has it: of what it is made, and what is no occluder at all."""

import bpy
import numpy as np
from mathutils import Vector
from mathutils.bvhtree import BVHTree

from ..basics import pixels
from ..basics.colour import to_rec709
from ..basics.scratch import scratch
from ..photo import photo
from .bake import source_of

DEFAULT = {"base_color": [0.8, 0.8, 0.8], "roughness": 1.0, "metallic": 0.0, "specular": 0.0}  # Cycles', of no material
LAYERS = {"coat": 0.0, "coat_roughness": 0.03, "sheen": [0.0, 0.0, 0.0], "sheen_roughness": 0.5}  # of Principled
BLACK = DEFAULT | {"base_color": [0.0, 0.0, 0.0]}
RELIEF = {"NORMAL_MAP", "BUMP"}
OF_FILES = {"FILE", "SEQUENCE", "MOVIE", "TILED"}  # sources of images
GONE = "the file of image '{}' is not there"
CLEAR = {"BSDF_GLASS", "BSDF_REFRACTION", "BSDF_TRANSPARENT", "BSDF_TRANSLUCENT"}
SENDS = 1.0  # radiance of what is a lamp: as much as the whitest things send under a sky of brightness one
SHINING = "material '{}' shines: its light is found as the World's, and a render that shows both has it twice"
NOT_KNOWN = "what it reflects is not known"
LITTLE = 0.01  # of an input: no more than that is nothing
MOST_OF = 0.85  # of the upper hemisphere: what hides so much of it from objects and camera is a dome or a room
RAYS = 256


class Clear(Exception):
    """Light goes through it, or it has no surface at all; says how, in words."""


def surface_of(areas: dict, warn, *, otherwise: str = NOT_KNOWN) -> dict | None:
    """The ``surface`` of what is made of several materials: the mean of their numbers by area.

    Parameters
    ----------
    areas : bpy.types.Material or None -> its area
    warn : called with a sentence about what is left out
    otherwise : the end of a sentence about a material that cannot be read

    Returns
    -------
    as in a job; None where none of the materials can be read

    Raises Clear: light goes through all of it.
    """
    read, clear = [], ""
    for material, area in areas.items():
        try:
            numbers = _numbers(material, warn, otherwise)
        except Clear as error:
            clear = str(error)
            continue
        if numbers is not None:
            read.append((numbers, area))
    if not read:
        if clear and len(areas) == 1:
            raise Clear(clear)
        return None
    if clear:
        warn(f"{clear}: that part of it is left out")
    weights = [area for _, area in read]
    # rounded: a mean of ones must not be more than one
    mean = {
        key: np.average([n.get(key, value) for n, _ in read], axis=0, weights=weights).round(6).tolist()
        for key, value in (DEFAULT | LAYERS).items()
    }
    for layer in ("coat", "sheen"):
        if np.max(mean[layer]) < LITTLE:
            del mean[layer], mean[f"{layer}_roughness"]
    left = list(dict.fromkeys(word for n, _ in read for word in n.get("left_out", ())))
    return mean | ({"left_out": left} if left else {})


def left_out(areas: dict) -> dict:
    """{material: why, in words} of those of ``areas`` that are no occluder, but clear, or a lamp."""
    out = {}
    for material in areas:
        try:
            numbers = _numbers(material, lambda sentence: None)
        except Clear as error:
            out[material] = str(error)
            continue
        if numbers is not None and numbers.get("sends", 0.0) >= SENDS:
            out[material] = SHINING.format(material.name)
    return out


def read_alone(material) -> dict | None:
    """The ``surface`` of one material (or None: of no material); None where it cannot be read or light goes through."""
    try:
        return _numbers(material, lambda sentence: None)
    except Clear:
        return None


def _numbers(material, warn, otherwise: str = NOT_KNOWN) -> dict | None:
    """The numbers of one material, None where they cannot be read; arguments as of `surface_of`."""
    if material is None:
        return DEFAULT
    what = f"material '{material.name}'"
    output = material.node_tree.get_output_node("CYCLES") if material.use_nodes and material.node_tree else None
    if output is None:
        warn(f"{what} has no Material Output; {otherwise}")
        return None
    if source_of(output.inputs["Volume"]) is not None:
        warn(f"{what} has a volume, which is left out")
    source = source_of(output.inputs["Surface"])
    if source is None:
        raise Clear(f"{what} has no surface")
    node = source.node
    if node.type in CLEAR:
        raise Clear(f"light goes through {what}")
    if node.type == "EMISSION":
        warn(f"{what} shines, which is left out")
        return BLACK | {"sends": _up_to(node.inputs["Strength"]) * _up_to(node.inputs["Color"])}
    if node.type == "BSDF_PRINCIPLED":
        if _up_to(node.inputs["Transmission Weight"]) > LITTLE or _up_to(node.inputs["Alpha"], least=True) < 1 - LITTLE:
            raise Clear(f"light goes through {what}")
        if _shines(node):
            warn(f"{what} shines, which is left out")
        ior = _mean(node.inputs["IOR"], 1.5)
        f0 = ((ior - 1) / (ior + 1)) ** 2 * 2 * _mean(node.inputs["Specular IOR Level"], 0.5)
        more = {"metallic": _mean(node.inputs["Metallic"], 0.0), "specular": min(f0 / 0.08, 1.0)} | _layers(node)
        more |= {"left_out": _left_out(node), "sends": _shines(node)}
        colour, roughness = node.inputs["Base Color"], _mean(node.inputs["Roughness"], 0.5)
    elif node.type == "BSDF_DIFFUSE":
        colour, roughness, more = node.inputs["Color"], 1.0, {"metallic": 0.0, "specular": 0.0}
    elif node.type in ("BSDF_GLOSSY", "BSDF_METALLIC"):
        colour = node.inputs.get("Color") or node.inputs["Base Color"]
        roughness, more = _mean(node.inputs["Roughness"], 0.5), {"metallic": 1.0, "specular": 0.5}
    else:
        warn(f"the surface of {what} is '{node.name}'; {otherwise}")
        return None
    base = _colour(colour)
    if base is None:
        gone = missing_images(material)
        warn(f"{GONE.format(gone[0].name) if gone else _unread(what)}; {otherwise}")
        return None
    return {"base_color": np.clip(base, 0, 1), "roughness": float(np.clip(roughness, 0, 1)), **more}


def _unread(what: str) -> str:
    return f"the colour of {what} is neither a number nor an image"


def missing_images(material, *, relief: bool = False) -> list:
    """The images that a material (or None) takes from files that are not there, which Blender renders pink.

    ``relief`` : also those of normals, bumps and displacement. For a panel, too: no image is read.
    """
    output = material.node_tree.get_output_node("CYCLES") if material and material.use_nodes else None
    ends = [output.inputs[name] for name in ("Surface", *(["Displacement"] * relief))] if output else []
    idle, seen = set() if relief else RELIEF, set()
    return [image for end in ends for image in _images_before(end, idle, seen) if _is_missing(image)]


def _images_before(socket, idle: set, seen: set) -> list:
    """The images of all nodes before an input, but for what feeds nodes of types that are ``idle``.

    ``seen`` : (tree, name) of nodes that were looked at.
    """
    source = source_of(socket)
    node = source and source.node
    if node is None or node.type in idle or (node.id_data, node.name) in seen:
        return []
    seen.add((node.id_data, node.name))
    found = [node.image] if node.type == "TEX_IMAGE" and node.image else []
    inner = node.node_tree.nodes if node.type == "GROUP" and node.node_tree else ()
    ends = [each for each in inner if each.type == "GROUP_OUTPUT" and each.is_active_output]
    return found + [image for each in (node, *ends) for i in each.inputs for image in _images_before(i, idle, seen)]


def _is_missing(image) -> bool:
    files = () if image.packed_files or image.is_dirty or image.source not in OF_FILES else files_of(image)
    return any(file is None or not file.is_file() for file in files)


def files_of(image) -> list:
    """The file of an image, of one of tiles (UDIM) those of all; None where none is named."""
    file = photo.file_of(image)
    if file is None or image.source != "TILED":
        return [file]
    return [file.with_name(file.name.replace("<UDIM>", str(tile.number))) for tile in image.tiles]


def with_relief(areas: dict) -> list:
    """Those materials that are lit otherwise than the mesh's own shape is: by a normal map or a bump."""
    return [material for material in areas if material is not None and material.use_nodes and _has_relief(material)]


def _has_relief(material) -> bool:
    tree = material.node_tree
    output = tree.get_output_node("CYCLES")
    if material.displacement_method == "BUMP" and output is not None:
        if source_of(output.inputs["Displacement"]) is not None:
            return True
    return any(_bends_normals(node) for node in tree.nodes)


def _bends_normals(node) -> bool:
    if node.type == "GROUP" and node.node_tree:
        return any(_bends_normals(inner) for inner in node.node_tree.nodes)
    return node.type in RELIEF and any(socket.is_linked for socket in node.outputs)


def displaced(areas: dict) -> bool:
    """Whether a render moves the surface by what one of its materials says (as a bump alone does not)."""
    for material in areas:
        if material is None or material.displacement_method == "BUMP":
            continue
        output = material.node_tree.get_output_node("CYCLES") if material.use_nodes and material.node_tree else None
        if output is not None and source_of(output.inputs["Displacement"]) is not None:
            return True
    return False


def _layers(node) -> dict:
    """Coat and sheen of a Principled BSDF."""

    def share(name: str, otherwise: float) -> float:
        return float(np.clip(_mean(node.inputs[name], otherwise), 0, 1))

    tint = _colour(node.inputs["Sheen Tint"])
    sheen = share("Sheen Weight", 0.0) * (np.ones(3) if tint is None else np.clip(tint, 0, 1))
    roughness = {"coat_roughness": share("Coat Roughness", 0.03), "sheen_roughness": share("Sheen Roughness", 0.5)}
    return {"coat": share("Coat Weight", 0.0), "sheen": sheen, **roughness}


def _left_out(node) -> list[str]:
    """What of a Principled BSDF a job's surface has no number for, in words."""
    found = []
    if _up_to(node.inputs["Subsurface Weight"]) > LITTLE:
        found.append("light that goes on below its surface")
    if _up_to(node.inputs["Sheen Weight"]) > LITTLE:
        found.append("how bright its sheen is at a slant")
    if _up_to(node.inputs["Anisotropic"]) > LITTLE:
        found.append("how its gloss is stretched")
    tint = node.inputs["Specular Tint"]
    if source_of(tint) is not None or min(tint.default_value[:3]) < 1 - LITTLE:
        found.append("the tint of its gloss")
    film = node.inputs.get("Thin Film Thickness")
    if film is not None and _up_to(film) > 0:
        found.append("its thin film")
    if _shines(node):
        found.append("that it shines")
    if source_of(node.inputs["Alpha"]) is not None:
        found.append("its cut-outs")
    return found


def _shines(node) -> float:
    """The radiance that a Principled BSDF sends, at most; what feeds its inputs may be anything: one."""
    return _up_to(node.inputs["Emission Strength"]) * _up_to(node.inputs["Emission Color"])


def _up_to(socket, *, least: bool = False) -> float:
    """The largest value (or the least) that an input is set to; what feeds it may be anything: 1 (or the input's)."""
    value = np.atleast_1d(socket.default_value)[:3]
    if source_of(socket) is not None:
        return float(value.min()) if least else 1.0
    return float(value.min() if least else value.max())


def _mean(socket, otherwise: float) -> float:
    """A number, or the mean of its image; ``otherwise`` where something else says it."""
    if source_of(socket) is None:
        return float(socket.default_value)
    colour = _colour(socket)
    return otherwise if colour is None else float(colour.mean())


def _colour(socket):
    """(3,) linear, the mean of an image; None where neither a number nor an image says it."""
    source = source_of(socket)
    if source is None:
        return to_rec709(socket.default_value[:3])
    image = source.node.image if source.node.type == "TEX_IMAGE" and source.name == "Color" else None
    return None if image is None else mean_of_image(image)


def mean_of_image(image):
    """(3,) linear mean of an image's colours, of all its tiles; None where it cannot be read."""
    if image.source == "TILED" and not image.packed_files:  # Blender gives the pixels of the first tile alone
        means = [_mean_of_file(file, image.colorspace_settings.name) for file in files_of(image) if file.is_file()]
        return np.mean(means, 0) if means and all(mean is not None for mean in means) else None
    coded = image.colorspace_settings.name == "sRGB" and not image.is_float
    if not all(image.size) or not (coded or image.is_float or image.colorspace_settings.is_data):
        return None
    colours = pixels.colours(image).reshape(-1, 3)
    if coded:
        colours = np.where(colours <= 0.04045, colours / 12.92, ((colours + 0.055) / 1.055) ** 2.4)
    mean = colours.mean(0, dtype=np.float64)
    return to_rec709(mean) if image.is_float and not image.colorspace_settings.is_data else mean


def _mean_of_file(file, colorspace: str):
    with scratch() as own:
        image = own(bpy.data.images.load(str(file), check_existing=False))
        image.colorspace_settings.name = colorspace
        return mean_of_image(image)


def encloses(positions, *places) -> bool:
    """Whether triangles (f, 3, 3) stand around all ``places`` (3,): above each they hide nearly all of the sky."""
    flat = np.asarray(positions).reshape(-1, 3)
    low, high = flat.min(0), flat.max(0)
    if any((p <= low).any() or (p >= high).any() for p in places):
        return False
    tree = BVHTree.FromPolygons(flat.tolist(), np.arange(len(flat)).reshape(-1, 3).tolist())
    z = (np.arange(RAYS) + 0.5) / RAYS
    turn = np.arange(RAYS) * np.pi * (3 - np.sqrt(5))  # the golden angle
    s = np.sqrt(1 - z**2)
    rays = [Vector(ray) for ray in np.stack([s * np.cos(turn), s * np.sin(turn), z], -1)]
    hidden = [np.mean([tree.ray_cast(Vector(place), ray)[0] is not None for ray in rays]) for place in places]
    return min(hidden) > MOST_OF
