# SPDX-License-Identifier: GPL-3.0-or-later
"""The key lights of a lighting as Sun lamps, or Point lamps where they stand near, beside a World of the rest.

A lamp made here carries LAMP_TAG: the key light that it is, and what was written of it. What it is now beside what was
written is the user's doing, and stays when another light is written: twice as strong stays twice as strong, a turn
stays a turn. Only such lamps are ever changed or removed; a copy that the user makes of one is the user's.

The World's Rotation turns the lamps, by drivers of their delta rotation and, of Point lamps, which go round the middle
of the objects, of their delta location: their own are free to be edited.

Blender's Sun: the strength is the irradiance on a surface that faces it, so that a white matte surface shows the
strength over pi (a test renders it); the angle is the disc's whole width. A Point lamp of power P has the irradiance
P / (4 pi d^2) at the distance d (so has a test).
"""

import math
from collections import Counter

import bpy
import numpy as np
from mathutils import Matrix, Quaternion, Vector

from ..basics import colour
from . import lamp_collection, sh_nodes

LAMP_NAME = "BTFsep Sun"
LAMP_TAG = "btfsep_sun"
KINDS = {"SUN": "Sun lamp", "POINT": "Point lamp"}  # what ours are made as
KEY = "btfsep_key"  # of the World: factor on its lamps
DISTANCE = 5.0  # from the world's origin, in the view; a Sun's place makes no difference to its light
SAME = 1e-4  # relative: a number that is so near to what was written was not edited


def lamps(scene) -> list:
    """The lamps of ``scene`` that BTFsep made and may change."""
    tagged = _tagged(scene)
    copies = set(_copies(tagged))
    return [thing for thing in tagged if thing not in copies]


def _tagged(scene) -> list:
    return [thing for thing in scene.objects if LAMP_TAG in thing and thing.library is None]


def _copies(tagged) -> list:
    """What the user has duplicated of lamps of ours: no two key lights are the same. Ours is what was edited less."""
    first = {}
    for lamp in sorted(tagged, key=lambda lamp: (_edits(lamp), lamp.session_uid)):
        first.setdefault(repr([list(_tag(lamp).get(name, ())) for name in ("direction", "irradiance")]), lamp)
    return [lamp for lamp in tagged if lamp not in first.values()]


def _edits(lamp) -> int:
    """In how many ways a lamp is not as it was written."""
    tag = _tag(lamp)
    if "energy" not in tag:
        return 0
    turn = _rotation_of(lamp).rotation_difference(facing(tag["direction"])).angle
    turned = min(turn, 2 * math.pi - turn) > SAME
    brighter = abs(lamp.data.energy - tag["energy"] * tag["times"]) > SAME * lamp.data.energy
    return int(turned) + int(brighter)


def are_moved(scene) -> bool:
    """Whether the user has some of them in hand (G, R, S): Blender dies of the removal of what it moves."""
    if not in_hand():
        return False
    near = scene.tool_settings.use_proportional_edit_objects  # then also what is not selected
    held = {thing for layer in scene.view_layers for thing in (layer.objects if near else layer.objects.selected)}
    return any(lamp in held for lamp in lamps(scene))


def in_hand() -> bool:
    """Whether the user is moving anything."""
    windows = bpy.context.window_manager.windows
    return any(o.bl_idname.startswith("TRANSFORM_OT") for w in windows for o in getattr(w, "modal_operators", ()))


def are_as_many(scene, suns) -> bool:
    """Whether ``suns``, as of :func:`set_lamps`, need no other lamps than there are, and all of these."""
    return len(lamps(scene)) == sum(max(sun["irradiance"]) > 0 for sun in suns)


def beside(scene) -> str:
    """What is to be said of them after "the World is the light": how many there are of each kind; of none, nothing."""
    kinds = Counter(KINDS.get(lamp.data.type, "lamp") for lamp in lamps(scene))
    each = [f"one {kind}" if count == 1 else f"{count} {kind}s" for kind, count in kinds.items()]
    return f", with {' and '.join(each)} beside it" if each else ""


def others(scene) -> list:
    """Lamps of ``scene`` that a render shows beside the light, and that the light knows nothing of."""
    ours = {*lamps(scene), *known_suns(scene)}
    return [t for t in scene.objects if t.type == "LIGHT" and not t.hide_render and t not in ours]


def known_suns(scene) -> list:
    """The Sun lamps of ``scene`` whose direction the user knows, each once: ours or others."""
    settings = getattr(scene, "btfsep", None)  # a light can be put into a scene without the add-on's panel
    things = [entry.object for entry in settings.known_suns] if settings else []
    suns = (t for t in things if t is not None and t.type == "LIGHT" and t.data.type == "SUN")
    return list(dict.fromkeys(sun for sun in suns if sun.name in scene.objects))


def known_direction(scene, lamp, depsgraph=None) -> np.ndarray:
    """To the sun ``lamp`` (3,), unit, as it stands in the scene without the World's Rotation.

    That turns all of the light, the lamps of BTFsep with it, after the photo has been explained.
    """
    shown, world, turn = lamp if depsgraph is None else lamp.evaluated_get(depsgraph), scene.world, 0.0
    node = sh_nodes.node_of(world.node_tree) if world is not None and world.node_tree is not None else None
    if node is not None:
        turn = node.inputs[sh_nodes.ROTATION].default_value
    to = np.array(Matrix.Rotation(-turn, 3, "Z") @ shown.matrix_world.to_3x3().col[2])
    return to / np.linalg.norm(to)


def set_lamps(scene, suns) -> None:
    """Makes ``suns`` the lamps of ``scene``: earlier ones of ours become the nearest of them, the others go.

    Those of ours whose direction is known stay where they stand: they become what was found of them, and are dark where
    that is left to the World, or the light is of another time.

    Parameters
    ----------
    scene : bpy.types.Scene, whose World is ours where there are suns
    suns : list of "lamps" of what lighting_file.read returns; one without light gives no lamp
    """
    lamp_collection.leave_shared(scene)
    for copy in _copies(_tagged(scene)):
        del copy[LAMP_TAG]
    free, held = [], []
    directions = {lamp.name: known_direction(scene, lamp) for lamp in known_suns(scene)}
    for old in lamps(scene):
        if len(old.users_scene) > 1 or "direction" not in _tag(old):
            _remove(scene, old)  # another scene has it, too
        else:
            (held if old.name in directions else free).append(old)
    for sun in (sun for sun in suns if max(sun["irradiance"]) > 0):
        mine = next((old for old in held if _is(directions[old.name], sun["direction"])), None)
        if mine is not None:
            held.remove(mine)
            _stay(mine, sun, scene.world)
            continue
        lamp = max(free, key=lambda old: np.dot(_tag(old)["direction"], sun["direction"]), default=None)
        if lamp is None:
            lamp = bpy.data.objects.new(LAMP_NAME, bpy.data.lights.new(LAMP_NAME, "SUN"))
            lamp_collection.add_lamp(scene, lamp)
            lamp[LAMP_TAG] = {}
            _turn_with(scene.world, lamp)
        else:
            free.remove(lamp)
        _write(lamp, dict(sun), scene.world)
    for old in held:
        _stay(old, {"irradiance": (0.0, 0.0, 0.0), "size_degrees": _tag(old)["size_degrees"]}, scene.world)
    for old in free:
        _remove(scene, old)
    lamp_collection.tidy(scene)


def _is(direction, other) -> bool:
    """Whether two directions are one but for rounding."""
    return np.dot(direction, other) > 1 - 1e-8


def _stay(lamp, sun: dict, world) -> None:
    """Makes a lamp the key light ``sun`` where it stands now: that is its direction, no turn of the user's."""
    there = [*(_rotation_of(lamp) @ Vector((0, 0, 1)))]
    lamp[LAMP_TAG] = {**_tag(lamp), "direction": there}
    _write(lamp, {**sun, "direction": there}, world)


def follow(world) -> None:
    """Has the lamps of all scenes that ``world`` lights be as its tint, saturation and key say."""
    for scene in bpy.data.scenes:
        for lamp in lamps(scene) if scene.world == world else ():
            if "irradiance" in _tag(lamp):
                _write(lamp, _tag(lamp), world)


def beam(lamp):
    """What a lamp of ours is now: direction (3,), the whole irradiance, width in radians, and "near" or None."""
    near = _tag(lamp).get("near")
    if near is None:
        direction = np.array(lamp.matrix_world)[:3, 2]
        return direction / np.linalg.norm(direction), lamp.data.energy, lamp.data.angle, None
    away = np.array(lamp.matrix_world.translation) - np.array(near["centre"])
    distance = max(float(np.linalg.norm(away)), 1e-9)
    near = {"centre": list(near["centre"]), "distance": distance}
    return (
        away / distance,
        lamp.data.energy / power(1.0, near),
        2 * math.atan(lamp.data.shadow_soft_size / distance),
        near,
    )


def power(irradiance: float, near: dict) -> float:
    """Of a Point lamp that has an irradiance where it is said of."""
    return 4 * math.pi * near["distance"] ** 2 * irradiance


def _tag(lamp) -> dict:
    tag = lamp[LAMP_TAG]
    return tag.to_dict() if hasattr(tag, "to_dict") else {}


def _write(lamp, sun: dict, world) -> None:
    """Makes a lamp the key light ``sun``, and keeps what the user has changed of it."""
    before, data = _tag(lamp), lamp.data
    irradiance = colour.to_working(_as_the_world(sun["irradiance"], world))
    energy = float(irradiance.max())
    tint = irradiance / energy if energy > 0 else np.ones(3)
    near, turned, place = sun.get("near"), facing(sun["direction"]), _place(sun)
    kind = "POINT" if near else "SUN"
    if data.type != kind:
        data.type = kind
        data = lamp.data  # Blender has another class for each
    if near:
        energy = power(energy, near)
    angle = math.radians(sun["size_degrees"])
    times, shades = before.get("times", 1.0), np.array(before.get("shades", (1.0, 1.0, 1.0)))
    user_turn, moved, resized = Quaternion(), False, False
    if "energy" in before:
        written, was = before["energy"], Vector(before["direction"])
        if written > 0:
            times = _ratio(data.energy, written)
            shades = np.array([_ratio(now, then) for now, then in zip(data.color, before["color"], strict=True)])
        user_turn = _rotation_of(lamp) @ facing(was).inverted()
        stood = _place(before)
        moved = (lamp.location - stood).length > SAME * max(stood.length, DISTANCE)
        if ("near" in before) == bool(near):
            resized = abs(_width(data, before) - math.radians(before["size_degrees"])) > SAME
    data.energy, data.color = energy * times, np.clip(tint * shades, 0, None)
    if not resized and near:
        data.shadow_soft_size = near["distance"] * math.tan(angle / 2)
    elif not resized:
        data.angle = angle
    if not moved:
        lamp.location = place
    _rotate(lamp, user_turn @ turned)
    _go_round_with(world, lamp, sun)
    lamp[LAMP_TAG] = {
        **{name: [float(v) for v in sun[name]] for name in ("direction", "irradiance")},
        "size_degrees": math.degrees(angle) if not resized else before["size_degrees"],
        **(
            {"near": {"centre": [float(v) for v in near["centre"]], "distance": float(near["distance"])}}
            if near
            else {}
        ),
        "energy": energy,
        "color": [float(v) for v in tint],
        "times": float(times),
        "shades": [float(v) for v in shades],
    }


def _place(sun: dict) -> Vector:
    """Where a lamp is put: in its direction from the origin, or where it stands near."""
    direction, near = Vector(sun["direction"]), sun.get("near")
    return Vector(near["centre"]) + near["distance"] * direction if near else DISTANCE * direction


def _width(data, sun: dict) -> float:
    """The angle under which a lamp shines, radians."""
    near = sun.get("near")
    return 2 * math.atan(data.shadow_soft_size / near["distance"]) if near else data.angle


def _as_the_world(irradiance, world) -> np.ndarray:
    node = sh_nodes.node_of(world.node_tree)
    tint, saturation = node.inputs[sh_nodes.TINT].default_value[:3], node.inputs[sh_nodes.SATURATION].default_value
    return world.get(KEY, 1.0) * colour.adjusted(irradiance, tint=tint, saturation=saturation)


def _ratio(now: float, written: float) -> float:
    """What the user has multiplied a number by; 1 where only rounding has."""
    ratio = now / written if written > 0 else 1.0
    return 1.0 if abs(ratio - 1) < SAME else ratio


def facing(direction) -> Quaternion:
    """The rotation of a lamp whose light comes from ``direction``."""
    return Vector(direction).to_track_quat("Z", "Y")


def _rotation_of(lamp) -> Quaternion:
    if lamp.rotation_mode == "QUATERNION":
        return lamp.rotation_quaternion.copy()
    if lamp.rotation_mode == "AXIS_ANGLE":
        angle, *axis = lamp.rotation_axis_angle
        return Quaternion(axis, angle)
    return lamp.rotation_euler.to_quaternion()


def _rotate(lamp, turn: Quaternion) -> None:
    if lamp.rotation_mode == "QUATERNION":
        lamp.rotation_quaternion = turn
    elif lamp.rotation_mode == "AXIS_ANGLE":
        axis, angle = turn.to_axis_angle()
        lamp.rotation_axis_angle = (angle, *axis)
    else:
        lamp.rotation_euler = turn.to_euler(lamp.rotation_mode)


def _turn_with(world, lamp) -> None:
    """Has the World's Rotation turn the lamp about the vertical; no Python, so that it works wherever the file goes."""
    driver = lamp.driver_add("delta_rotation_euler", 2).driver
    driver.type = "SUM"
    _read_rotation(world, driver)


def _read_rotation(world, driver):
    """A new variable of a driver: the World's Rotation."""
    variable = driver.variables.new()
    target, socket = variable.targets[0], sh_nodes.node_of(world.node_tree).inputs[sh_nodes.ROTATION]
    target.id_type, target.id = "WORLD", world
    target.data_path = f"node_tree.{socket.path_from_id('default_value')}"
    return variable


def _go_round_with(world, lamp, sun: dict) -> None:
    """Has the World's Rotation carry a lamp that stands near about the vertical through the middle of the objects.

    The expressions are simple ones, which Blender reckons without Python.
    """
    for axis in (0, 1):
        lamp.driver_remove("delta_location", axis)
    lamp.delta_location = (0, 0, 0)
    if not sun.get("near"):
        return
    x, y, _ = _place(sun) - Vector(sun["near"]["centre"])
    for axis, (along, across) in enumerate(((x, -y), (y, x))):
        driver = lamp.driver_add("delta_location", axis).driver
        driver.type, driver.expression = "SCRIPTED", f"(cos(r) - 1) * {along:.9g} + sin(r) * {across:.9g}"
        _read_rotation(world, driver).name = "r"


def _remove(scene, lamp) -> None:
    """Takes a lamp out of ``scene``, and out of the file where no other scene has it."""
    data = lamp.data
    if len(lamp.users_scene) > 1:
        for collection in (scene.collection, *scene.collection.children_recursive):
            if lamp.name in collection.objects:
                collection.objects.unlink(lamp)
        return
    bpy.data.objects.remove(lamp)
    if data is not None and data.users == 0:
        bpy.data.lights.remove(data)
