# SPDX-License-Identifier: GPL-3.0-or-later
"""Writes a lighting into a scene as its World: as editable spherical harmonics, or baked into a texture.

Key lights (suns) become Sun lamps beside a World of the rest, or stay in the World's harmonics (`sun_lamp`).

A World made here carries WORLD_TAG. Only such Worlds are ever changed; a World of the user's is kept in the file
(fake user) and can be put back.
"""

import bpy
import numpy as np

from . import harmonics, sh_nodes, sun_lamp
from .errors import InputError

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
    lighting : dict, as lighting_file.read returns it; "coefficients" are ((L + 1)^2, 3), linear Rec.709 radiance
    mode : "NODES" (a node group with the coefficients as inputs; up to order 9) or "TEXTURE" (a packed map)
    clamp : a light that is negative somewhere is made positive (`harmonics.positive_map`)
    lamp : whether key lights become Sun lamps, and the World the rest; else the World is all of the light

    Returns
    -------
    bpy.types.World

    Raises
    ------
    InputError
        When the order is too high for nodes.
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
    world = _own_world(scene)
    tree = world.node_tree
    tree.nodes.clear()
    tree.animation_data_clear()  # the keyframes of a sequence that was here before
    _remove_orphans()
    sampling = getattr(world, "cycles", None)  # absent when the Cycles add-on is off
    if sampling is not None:
        sampling.sampling_method = "MANUAL" if mode == "NODES" else "AUTOMATIC"
        sampling.sample_map_resolution = SAMPLING_MAP
    if mode == "NODES":
        _write_nodes(tree, coefficients, order, clamp)
    else:
        _write_texture(tree, coefficients, clamp)
    sun_lamp.put(scene, suns["lamps"] if suns else [])
    world[WORLD_TAG] = {"mode": mode, "order": order, "exposure_ev": float(lighting.get("exposure_ev", 0.0))}
    return world


def restore_previous(scene):
    """Puts the World back that ``scene`` had before BTFsep, and removes ours and its lamps.

    Returns
    -------
    The World that is back, or None if there was none.

    Raises
    ------
    InputError
        When the scene's World is not one of ours.
    """
    if not is_ours(scene.world):
        raise InputError("the World", "it was not made by BTFsep", "there is nothing to restore")
    ours = scene.world
    previous = ours.get(PREVIOUS)
    if previous is not None and not ours.get(PREVIOUS_WAS_FAKE, True):
        previous.use_fake_user = False
    scene.world = previous
    sun_lamp.put(scene, [])
    if ours.users == 0:
        bpy.data.worlds.remove(ours)
    _remove_orphans()
    return previous


def _own_world(scene):
    if is_ours(scene.world):
        world = scene.world
    else:
        previous = scene.world
        world = bpy.data.worlds.new(WORLD_NAME)
        world[WORLD_TAG] = {}
        if previous is not None:
            world[PREVIOUS] = previous
            world[PREVIOUS_WAS_FAKE] = previous.use_fake_user
            previous.use_fake_user = True
        scene.world = world
    if world.node_tree is None:  # Blender 4: Worlds start without nodes; in 5 they always have them
        world.use_nodes = True
    return world


def _remove_orphans() -> None:
    """Removes Worlds, groups, maps and keyframes of ours that nothing uses any more."""
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


def _write_nodes(tree, coefficients, order: int, clamp: bool) -> None:
    group = tree.nodes.new("ShaderNodeGroup")
    group.node_tree = sh_nodes.build_group(order)
    group.name = group.label = sh_nodes.GROUP_NAME
    group.width = 240
    for name, value in clamping(coefficients, clamp).items():
        group.inputs[name].default_value = value
    for l in range(order + 1):
        for m in range(-l, l + 1):
            group.inputs[sh_nodes.coefficient_name(l, m)].default_value = coefficients[l * l + l + m]
    group.location = (-320, 0)
    _output(tree, group.outputs["Color"])


def _write_texture(tree, coefficients, clamp: bool) -> None:
    radiance = (harmonics.positive_map if clamp else harmonics.to_map)(coefficients, MAP_HEIGHT, 2 * MAP_HEIGHT)
    image = bpy.data.images.new(IMAGE_NAME, 2 * MAP_HEIGHT, MAP_HEIGHT, float_buffer=True, alpha=False, is_data=True)
    image[WORLD_TAG] = True
    image.use_half_precision = False
    pixels = np.ones((MAP_HEIGHT, 2 * MAP_HEIGHT, 4), np.float32)
    pixels[..., :3] = radiance[::-1]  # Blender's first row is the lowest
    image.pixels.foreach_set(pixels.ravel())
    image.update()
    image.pack()

    coordinates = tree.nodes.new("ShaderNodeTexCoord")
    mapping = tree.nodes.new("ShaderNodeMapping")
    mapping.vector_type = "TEXTURE"  # so that a positive rotation turns the light counter-clockwise
    texture = tree.nodes.new("ShaderNodeTexEnvironment")
    texture.image = image
    tree.links.new(coordinates.outputs["Generated"], mapping.inputs["Vector"])
    tree.links.new(mapping.outputs["Vector"], texture.inputs["Vector"])
    for node, x in ((coordinates, -840), (mapping, -620), (texture, -320)):
        node.location = (x, 0)
    _output(tree, texture.outputs["Color"])


def _output(tree, color) -> None:
    background = tree.nodes.new("ShaderNodeBackground")
    output = tree.nodes.new("ShaderNodeOutputWorld")
    output.location = (240, 0)
    tree.links.new(color, background.inputs["Color"])
    tree.links.new(background.outputs["Background"], output.inputs["Surface"])
