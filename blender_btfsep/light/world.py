# SPDX-License-Identifier: GPL-3.0-or-later
"""Writes a lighting into a scene as its World: as editable spherical harmonics, or baked into a texture.

Key lights (suns) become Sun lamps beside a World of the rest, or stay in the World's harmonics (`sun_lamp`).

A World made here carries WORLD_TAG. Only such Worlds are ever changed; a World of the user's is kept in the file
(fake user) and can be put back.
"""

import bpy
import numpy as np

from ..basics import colour, harmonics, pixels
from ..basics.errors import InputError
from . import group_ahead, sh_nodes, sun_lamp

WORLD_NAME = "BTFsep Lighting"
IMAGE_NAME = "BTFsep Lighting Map"
WORLD_TAG = "btfsep_lighting"
PREVIOUS = "btfsep_previous_world"
PREVIOUS_WAS_FAKE = "btfsep_previous_had_fake_user"
MAP_HEIGHT = 256
SAMPLING_MAP = 256
"""Width at which Cycles tabulates the nodes for light sampling: plenty for order 9. Its automatic choice is so
large that a render of order 9 spends half a minute before its first sample."""


def is_ours(world) -> bool:
    """Whether BTFsep made ``world`` and may change it."""
    return world is not None and WORLD_TAG in world and world.library is None


def apply_lighting(
    scene, lighting: dict, *, mode: str = "NODES", clamp: bool = True, lamp: bool = True
) -> bpy.types.World:
    """Makes ``lighting`` the light of ``scene``, in place of an earlier one of ours; never changes the user's World.

    Parameters
    ----------
    scene : bpy.types.Scene
    lighting : dict, as lighting_file.read returns it; "coefficients" are ((L + 1)^2, 3), linear Rec.709 radiance;
        a "map" (h, 2 h, 3) of the light without its lamps, row 0 up, is the texture
    mode : "NODES" (a node group with the coefficients as inputs; up to order 9) or "TEXTURE" (a packed map)
    clamp : a light that is negative somewhere is made positive (`harmonics.positive_map`)
    lamp : whether key lights become Sun lamps, and the World the rest; else the World is all of the light

    Returns
    -------
    bpy.types.World

    Raises InputError when the order is too high for nodes.
    """
    suns = lighting.get("suns") if lamp else None
    coefficients = np.asarray(suns["sky"] if suns else lighting["coefficients"], np.float64)
    order = harmonics.order_of(len(coefficients))
    if mode not in {"NODES", "TEXTURE"}:
        raise ValueError(f"mode is {mode!r}, not 'NODES' or 'TEXTURE'")
    if mode == "NODES" and order > sh_nodes.MAX_NODE_ORDER:
        raise InputError(
            "the lighting",
            f"its order is {order}, nodes go up to order {sh_nodes.MAX_NODE_ORDER}",
            "apply it as a texture",
        )
    world, node = _own_node(scene, order if mode == "NODES" else 0)
    _forget_keys(world.node_tree, node)
    if mode == "NODES":
        if node.node_tree[sh_nodes.GROUP_TAG] != order:  # else it is there already: most of the time is its building
            _put_group(node, group_ahead.take(order))
        _write_coefficients(node, colour.to_working(coefficients), order, clamp)
    else:
        radiance = lighting.get("map") if lamp or not lighting.get("suns") else None
        if radiance is None:
            radiance = (harmonics.positive_map if clamp else harmonics.to_map)(coefficients, MAP_HEIGHT, 2 * MAP_HEIGHT)
        image, old = _image_of(colour.to_working(radiance)), sh_nodes.map_of(node.node_tree)
        own = old is not None and WORLD_TAG in old and old.users == node.node_tree.users == 1
        if not (own and pixels.move(image, old)):
            _put_group(node, sh_nodes.build_map_group(image))
    _remove_orphans()
    sampling = getattr(world, "cycles", None)  # absent when the Cycles add-on is off
    if sampling is not None:
        sampling.sampling_method = "MANUAL" if mode == "NODES" else "AUTOMATIC"
        sampling.sample_map_resolution = SAMPLING_MAP
    world[WORLD_TAG] = {"mode": mode, "order": order, "exposure_ev": float(lighting.get("exposure_ev", 0.0))}
    sun_lamp.set_lamps(scene, suns["lamps"] if suns else [])
    return world


def restore_previous(scene):
    """Puts the World back that ``scene`` had before BTFsep, and removes ours and its lamps.

    Gives the World that is back, or None if there was none.

    Raises InputError when the scene's World is not one of ours.
    """
    if not is_ours(scene.world):
        raise InputError("the World", "it was not made by BTFsep", "there is nothing to restore")
    ours = scene.world
    previous = ours.get(PREVIOUS)
    if previous is not None and not ours.get(PREVIOUS_WAS_FAKE, True):
        previous.use_fake_user = False
    if hasattr(scene, "btfsep"):
        scene.btfsep.known_suns.clear()
    scene.world = previous
    sun_lamp.set_lamps(scene, [])
    if ours.users == 0:
        bpy.data.worlds.remove(ours)
    _remove_orphans()
    return previous


def needs_group(scene, order: int) -> bool:
    """Whether a light of ``order`` as nodes would need a node group that the scene's World has not."""
    node = sh_nodes.node_of(scene.world.node_tree) if is_ours(scene.world) and scene.world.node_tree else None
    return node is None or node.node_tree[sh_nodes.GROUP_TAG] != order


def fits(scene, lighting: dict, *, mode: str = "NODES", lamp: bool = True) -> bool:
    """Whether a light, as of :func:`apply_lighting`, can be put in what is there: with no other nodes nor lamps."""
    suns = lighting.get("suns") if lamp else None
    if not sun_lamp.are_as_many(scene, suns["lamps"] if suns else []):
        return False
    if mode == "NODES":
        return not needs_group(scene, harmonics.order_of(len(suns["sky"] if suns else lighting["coefficients"])))
    node = sh_nodes.node_of(scene.world.node_tree) if is_ours(scene.world) and scene.world.node_tree else None
    return node is not None and sh_nodes.map_of(node.node_tree) is not None


def _own_node(scene, order: int):
    """The World of ours that ``scene`` has, or a new one with the group of ``order``, and its node of ours.

    A World from which the user has taken our node is the user's from then on. One that another scene has, too, stays
    that one's: this scene gets a copy.
    """
    world = scene.world
    if is_ours(world):
        node = sh_nodes.node_of(world.node_tree) if world.node_tree else None
        if node is not None and any(other.world == world for other in bpy.data.scenes if other != scene):
            world = scene.world = _copy(world)
            node = sh_nodes.node_of(world.node_tree)
        if node is not None:
            return world, node
        del world[WORLD_TAG]
    previous = world
    world = bpy.data.worlds.new(WORLD_NAME)
    world[WORLD_TAG] = {}
    if previous is not None:
        world[PREVIOUS] = previous
        world[PREVIOUS_WAS_FAKE] = previous.use_fake_user
        previous.use_fake_user = True
    scene.world = world
    if world.node_tree is None:  # Blender 4: Worlds start without nodes; in 5 they always have them
        world.use_nodes = True
    tree = world.node_tree
    tree.nodes.clear()
    node, background, output = (tree.nodes.new(f"ShaderNode{kind}") for kind in ("Group", "Background", "OutputWorld"))
    node.width, node.location, output.location = 240, (-320, 0), (240, 0)
    _put_group(node, group_ahead.take(order))
    tree.links.new(node.outputs[0], background.inputs["Color"])
    tree.links.new(background.outputs["Background"], output.inputs["Surface"])
    return world, node


def _copy(world):
    """A copy of a World with keyframes of its own: Blender's copies share them."""
    world = world.copy()
    for animation in (world.animation_data, world.node_tree.animation_data):
        if animation is not None and animation.action is not None:
            slot = getattr(animation, "action_slot", None)
            animation.action = animation.action.copy()
            if slot is not None:
                animation.action_slot = animation.action.slots[slot.identifier]
    return world


def _put_group(node, group) -> None:
    """Makes ``group`` the node's. The user's inputs are the first of any, so Blender keeps values and links of them."""
    node.node_tree = group
    _remove_orphans()  # the one before, whose name this may have
    group.name = node.name = node.label = group.name.partition(".")[0]


def bags(animation) -> list:
    """The collections of curves of ``animation`` (AnimData, or None): its slot's since Blender 4.4, or the action's."""
    action = animation and animation.action
    slot = getattr(animation, "action_slot", None)
    if not action or slot is None:
        return [action.fcurves] if action and hasattr(action, "fcurves") else []
    found = [strip.channelbag(slot) for layer in action.layers for strip in layer.strips]
    return [bag.fcurves for bag in found if bag is not None]


def _forget_keys(tree, node) -> None:
    """Takes the keyframes of a sequence away that was here before; the user's own stay."""
    animation = tree.animation_data
    ours = {s.path_from_id("default_value") for s in node.inputs if s.name not in sh_nodes.USERS}
    left = 0
    for curves in bags(animation):
        for curve in [curve for curve in curves if curve.data_path in ours]:
            curves.remove(curve)
        left += len(curves)
    if animation and not left and not animation.drivers and not animation.nla_tracks:
        tree.animation_data_clear()


def _remove_orphans() -> None:
    """Removes Worlds, groups, maps and keyframes of ours that nothing uses any more."""
    group_ahead.give_up()
    for world in [w for w in bpy.data.worlds if is_ours(w) and w.users == 0]:
        bpy.data.worlds.remove(world)
    for group in [g for g in bpy.data.node_groups if sh_nodes.GROUP_TAG in g and g.users == 0 and not g.library]:
        bpy.data.node_groups.remove(group)
    for action in [a for a in bpy.data.actions if WORLD_TAG in a and a.users == 0 and not a.library]:
        bpy.data.actions.remove(action)
    for image in [i for i in bpy.data.images if WORLD_TAG in i and i.users == 0 and not i.library]:
        bpy.data.images.remove(image)


def clamping(coefficients, clamp: bool) -> dict:
    """Values of the node group's inputs that keep ``coefficients`` from being negative, if ``clamp`` and they are."""
    share, gain = harmonics.positive_share(coefficients) if clamp else (0.0, 1.0)
    return {sh_nodes.CLAMP: share, sh_nodes.CLAMP_GAIN: gain}


def _write_coefficients(node, coefficients, order: int, clamp: bool) -> None:
    for name, value in clamping(coefficients, clamp).items():
        node.inputs[name].default_value = value
    for l in range(order + 1):
        for m in range(-l, l + 1):
            node.inputs[sh_nodes.coefficient_name(l, m)].default_value = coefficients[l * l + l + m]


def _image_of(radiance):
    """A packed image of a map (height, width, 3), row 0 up."""
    image = pixels.new(IMAGE_NAME, radiance[::-1])
    image[WORLD_TAG] = True
    image.use_half_precision = False
    image.pack()
    return image
