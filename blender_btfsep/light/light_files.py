# SPDX-License-Identifier: GPL-3.0-or-later
"""Lights in files of other programs: environment maps, cmgen's harmonics as text, USD; and what light a World is."""

import json
import math
import re
from pathlib import Path

import bpy
import numpy as np

from ..basics import atomic, colour, harmonics, pixels
from ..basics.errors import InputError
from ..basics.scratch import scratch
from . import lighting_file, sh_nodes, sun_lamp, world

OWN, MAPS, TEXT, USD = {".json", ".btfsep"}, {".exr", ".hdr"}, {".txt"}, {".usda", ".usd", ".usdc"}
SUMMED = 256  # rows of a map that is projected: enough for all orders that nodes have
LEAST_RADIUS = 0.01  # of a lamp nearby in USD, of its distance: one without an area has no radiance
USUAL_ORDER = 4  # of harmonics
ROWS = 256  # of the map of harmonics
MAP = "BTFsep map"
DISC = 3.0  # pixels of a key light in a map, at least
_LINE = re.compile(r"\(\s*(\S+)\s*,\s*(\S+)\s*,\s*(\S+?)\s*\)\s*;?\s*//\s*L(\d+?)(-?\d+)\b(.*)")
_COSINE = {0: 1.0, 1: 2 / 3, 2: 1 / 4}  # of the orders, over pi: what light is to a matte surface
_SHADER = np.sqrt([1 / 4, 3 / 4, 3 / 4, 3 / 4, 15 / 4, 15 / 4, 5 / 16, 15 / 4, 15 / 16]) / np.sqrt(np.pi)
_SHADER *= [1, -1, 1, -1, 1, -1, 1, -1, 1]  # what a shader multiplies by y, z, x, xy, yz, 3 z^2 - 1, xz, x^2 - y^2
_Y_UP = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]])  # a direction of Blender's in a frame whose Y is up


def read(path, order: int = USUAL_ORDER) -> dict:
    """The light in a file, as lighting_file.read gives it; of a map with "map" (h, w, 3), linear Rec.709, row 0 up.

    ``order`` : up to which a map is projected. Raises InputError.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix in MAPS:
        radiance = read_map(path)
        return _plain(project(radiance, order)) | {"map": radiance}
    return _plain(_read_text(path)) if suffix in TEXT else lighting_file.read(path)


def _plain(coefficients) -> dict:
    data = {"order": harmonics.order_of(len(coefficients)), "coefficients": np.asarray(coefficients).tolist()}
    return lighting_file.validate(lighting_file.as_data(data))


def read_map(path: Path) -> np.ndarray:
    """(h, 2 h, 3) float, linear Rec.709, >= 0, row 0 up, of an environment map. Raises InputError."""
    with scratch() as own:
        try:
            image = own(bpy.data.images.load(str(path), check_existing=False))
        except RuntimeError as error:
            raise InputError(path.name, error, "choose an EXR or HDR that can be read") from None
        image.colorspace_settings.name = "Linear Rec.709"  # which files do not say, and other working spaces are not
        width, height = image.size
        if not width or width != 2 * height:
            got = f"it is {width} x {height}" if width else "it has no pixels"
            raise InputError(path.name, got, "choose an environment map, twice as wide as high")
        radiance = pixels.colours(image)[::-1]
        if not np.isfinite(radiance).all():
            raise InputError(path.name, "it has pixels that are no numbers", "export it again")
        return np.maximum(colour.to_rec709(radiance), 0)


def _read_text(path: Path) -> np.ndarray:
    """cmgen's harmonics (``--sh-file``): radiance, or irradiance, or as a shader takes them; its Y is up."""
    try:
        text = path.read_text(encoding="utf-8", errors="replace")
    except OSError as error:
        raise InputError(path.name, error, "choose a text of cmgen that can be read") from None
    rows = {}
    for *values, l, m, kind in _LINE.findall(text):
        try:
            row, l, m = np.array([float(v) for v in values]), int(l), int(m)
        except ValueError:
            raise InputError(path.name, f"{values} are not three numbers", "export it again with cmgen") from None
        if "pre-scaled" in kind and l <= 2:
            row = row / _SHADER[l * l + l + m]
        if "irradiance" in kind or "pre-scaled" in kind:
            if l not in _COSINE:
                raise InputError(path.name, f"irradiance of order {l} says nothing of the light", "give 3 bands")
            row = row / _COSINE[l]
        rows[l * l + l + m] = row
    if not rows or sorted(rows) != list(range(len(rows))) or math.isqrt(len(rows)) ** 2 != len(rows):
        got = f"{len(rows)} coefficients, not all of an order" if rows else "there are no lines as '(r, g, b); // L1-1'"
        raise InputError(path.name, got, "choose what cmgen --sh-file has written")
    return _turned(np.array([rows[i] for i in range(len(rows))]), _Y_UP)


def _turned(coefficients, frame) -> np.ndarray:
    """The coefficients in Blender's axes of a light whose own axes are ``frame @ direction``; exact in every order."""
    order = harmonics.order_of(len(coefficients))
    i = np.arange(8 * len(coefficients)) + 0.5
    z, turn = 1 - 2 * i / len(i), np.pi * (1 + math.sqrt(5)) * i
    d = np.stack([np.sqrt(1 - z**2) * np.cos(turn), np.sqrt(1 - z**2) * np.sin(turn), z], -1)
    seen = harmonics.evaluate(order, d @ frame.T) @ coefficients
    return np.linalg.lstsq(harmonics.evaluate(order, d), seen, rcond=None)[0]


def solid_angles(height: int) -> np.ndarray:
    """(height, 1) of a pixel in each row of an environment map (height, 2 height), exact."""
    return harmonics.row_heights(height) * np.pi / height


def project(radiance, order: int) -> np.ndarray:
    """((order + 1)^2, 3) of an environment map (h, 2 h, 3)."""
    height = len(radiance)
    step = max(n for n in range(1, max(height // SUMMED, 1) + 1) if height % n == 0)
    rows = height // step
    weighted = (radiance * solid_angles(height)[..., None]).reshape(rows, step, 2 * rows, step, 3).sum((1, 3))
    return np.einsum("hwk,hwc->kc", harmonics.evaluate(order, harmonics.map_directions(rows, 2 * rows)), weighted)


# ---------------------------------------------------------------------- what a World is now


def of_world(scene) -> tuple[np.ndarray, list]:
    """The light of ``scene``, whose World is ours, as it is set now: (height, 2 height, 3), and its lamps.

    The map is linear Rec.709 and without the lamps, each "direction", "irradiance" (Rec.709) and "size_degrees".
    Raises InputError when the World is not ours.
    """
    node = sh_nodes.node_of(scene.world.node_tree) if world.is_ours(scene.world) else None
    if node is None:
        raise InputError("the World", "it is none of BTFsep's", "estimate a light or import one first")
    value = {socket.name: socket.default_value for socket in node.inputs}
    image, height = sh_nodes.map_of(node.node_tree), ROWS
    if image is not None:
        radiance = pixels.colours(image)[::-1].astype(np.float64)
        height = len(radiance)
    else:
        named = [name for name in value if name.startswith("Y ")]
        coefficients = np.array([tuple(value[name]) for name in sorted(named, key=_place)])
        clamped = value[sh_nodes.CLAMP] > 0
        radiance = (harmonics.positive_map if clamped else harmonics.to_map)(coefficients, height, 2 * height)
    radiance = colour.adjusted(radiance, tint=tuple(value["Tint"])[:3], saturation=value["Saturation"])
    radiance = colour.to_rec709(value["Strength"] * radiance)
    shift = value["Rotation"] / (2 * np.pi) * 2 * height  # columns; between two of them: some of both
    whole = math.floor(shift)
    left, right = (np.roll(radiance, -n, 1) for n in (whole, whole + 1))
    return left + (shift - whole) * (right - left), [_lamp(lamp) for lamp in sun_lamp.lamps(scene)]


def _place(name: str) -> int:
    l, m = map(int, name.split()[1:])
    return l * l + l + m


def _lamp(lamp) -> dict:
    direction, energy, width, near = sun_lamp.beam(lamp)
    return {
        "direction": direction.tolist(),
        "irradiance": np.maximum(colour.to_rec709(energy * np.array(lamp.data.color)), 0).tolist(),
        "size_degrees": math.degrees(width),
        **({"near": near} if near else {}),
    }


def with_lamps(radiance, lamps) -> np.ndarray:
    """The map with each lamp as a disc of its irradiance."""
    height = len(radiance)
    d, area, out = harmonics.map_directions(height, 2 * height), solid_angles(height), np.array(radiance)
    for lamp in lamps:
        half = max(math.radians(lamp["size_degrees"]), DISC * np.pi / height) / 2
        cosine = d @ lamp["direction"]
        disc = np.clip((half - np.arccos(np.clip(cosine, -1, 1))) / (np.pi / height) + 0.5, 0, 1)
        received = (disc * np.clip(cosine, 0, 1) * area).sum()
        out += disc[..., None] * (np.array(lamp["irradiance"]) / received)
    return out


def without_lamps(radiance, lamps) -> np.ndarray:
    """The map without the discs that :func:`with_lamps` draws."""
    return radiance - with_lamps(np.zeros_like(radiance), lamps)


def beam(lamp: dict, order: int) -> np.ndarray:
    """((order + 1)^2, 3): the harmonics of a lamp, a disc."""
    c = math.cos(math.radians(lamp["size_degrees"]) / 2)
    legendre = [np.polynomial.legendre.legval(c, np.eye(order + 2)[l]) for l in range(order + 2)]
    cap = [1.0]
    for l in range(1, order + 1):
        cap.append((legendre[l - 1] - legendre[l + 1]) / ((2 * l + 1) * (1 - c)) if c < 1 - 1e-12 else 1.0)
    shape = harmonics.evaluate(order, np.array(lamp["direction"])) * np.repeat(cap, 2 * np.arange(order + 1) + 1)
    return shape[:, None] * np.array(lamp["irradiance"])


def order_to_write(scene) -> int:
    """The order of harmonics in which the light of ``scene`` is written where nobody says it: 4, or its nodes' own
    where that is higher."""
    node = sh_nodes.node_of(scene.world.node_tree) if world.is_ours(scene.world) else None
    return max(USUAL_ORDER, node.node_tree[sh_nodes.GROUP_TAG] if node else 0)


def write(path, scene, order: int = USUAL_ORDER) -> None:
    """Writes the light of ``scene`` as it is now, in the format of the suffix of ``path``. Raises InputError."""
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in OWN | MAPS | TEXT | USD:
        raise InputError(path.name, "no format has this suffix", "give .json, .btfsep, .exr, .hdr, .txt or .usda")
    scene.view_layers[0].update()
    radiance, lamps = of_world(scene)
    if suffix in OWN | TEXT:
        sky = project(radiance, order)
        whole = sky + sum((beam(lamp, order) for lamp in lamps), np.zeros_like(sky))
    if suffix in OWN:
        known = [lamp | {"stddev": [0.0, 0.0, 0.0]} for lamp in lamps]
        suns = {"suns": {"lamps": known, "sky": sky.tolist()}} if lamps else {}
        data = lighting_file.as_data({"order": order, "coefficients": whole.tolist(), "exposure_ev": 0.0, **suns})
        atomic.write_bytes(path, json.dumps(data, indent=1).encode())
    elif suffix in TEXT:
        turned = _turned(whole, np.linalg.inv(_Y_UP))
        names = [f"L{l}{m}" for l in range(order + 1) for m in range(-l, l + 1)]
        lines = [f"({r:.9f}, {g:.9f}, {b:.9f}); // {name}\n" for (r, g, b), name in zip(turned, names, strict=True)]
        atomic.write_bytes(path, "".join(lines).encode())
    elif suffix in MAPS:
        with scratch() as own, atomic.replacing(path) as file:
            _save_map(own(pixels.new(MAP, with_lamps(radiance, lamps)[::-1])), file)
    else:
        _write_usd(path, radiance, lamps)


def _save_map(image, file: Path) -> None:
    image.filepath_raw, image.file_format = str(file), "HDR" if file.suffix.lower() == ".hdr" else "OPEN_EXR"
    image.save()


def _write_usd(path: Path, radiance, lamps) -> None:
    """By Blender's own exporter, which knows how a map lies in USD: a scene of a plain World and lamps."""
    if not bpy.app.build_options.usd:
        raise InputError(path.name, "this Blender was built without USD", "write an .exr, or take another Blender")
    with scratch() as own:
        image = own(pixels.new(MAP, radiance[::-1]))
        beside = path.with_name(f"{path.stem}_light.exr")
        _save_map(image, beside)
        stage, plain = own(bpy.data.scenes.new("BTFsep light")), own(bpy.data.worlds.new("BTFsep light"))
        plain.use_nodes = True
        texture = plain.node_tree.nodes.new("ShaderNodeTexEnvironment")
        texture.image = image
        plain.node_tree.links.new(texture.outputs[0], plain.node_tree.nodes["Background"].inputs[0])
        stage.world = plain
        for lamp in lamps:
            near, strength, width = lamp.get("near"), max(lamp["irradiance"]), math.radians(lamp["size_degrees"])
            data = own(bpy.data.lights.new("Key", "POINT" if near else "SUN"))
            thing = own(bpy.data.objects.new("Key", data))
            data.color = np.array(lamp["irradiance"]) / max(strength, 1e-300)
            if near:  # a SphereLight of `normalize`, whose intensity is the power over pi whatever its radius
                distance = near["distance"]
                data.energy = sun_lamp.power(strength, near)
                data.shadow_soft_size = max(distance * math.tan(width / 2), LEAST_RADIUS * distance)
                thing.location = np.array(near["centre"]) + distance * np.array(lamp["direction"])
            else:
                data.energy, data.angle = strength, width
                thing.rotation_euler = sun_lamp.facing(lamp["direction"]).to_euler()
            stage.collection.objects.link(thing)
        with atomic.replacing(path) as file, bpy.context.temp_override(scene=stage, view_layer=stage.view_layers[0]):
            bpy.ops.wm.usd_export(filepath=str(file), convert_world_material=True, export_textures_mode="KEEP")
            if path.suffix.lower() == ".usda":  # so that no search path is looked through
                text = file.read_text(encoding="utf-8")
                file.write_text(text.replace(f"@{beside.name}@", f"@./{beside.name}@"), encoding="utf-8")
