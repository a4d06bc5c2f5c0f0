# SPDX-License-Identifier: GPL-3.0-or-later
"""The lights of a sequence as keyframes of the World's node group."""

import numpy as np

from ..basics import colour
from ..basics.errors import InputError
from . import sh_nodes, world
from .world import bags

INTERPOLATIONS = (
    ("LINEAR", "Linear", "Between two photos the light goes over from one to the other"),
    ("CONSTANT", "Constant", "Each light stays until the next photo"),
)


def apply_sequence(scene, frames, *, clamp: bool = True, interpolation: str = "LINEAR"):
    """Makes the lights of a sequence the World of ``scene``, one keyframe each.

    Keyed are the coefficients, and Clamp Negative and Clamp Gain, which depend on them. All else of the node group
    (Strength, Rotation) is free to be changed or keyed by hand.

    Parameters
    ----------
    scene : bpy.types.Scene
    frames : list of (frame number, lighting as lighting_file.read returns it), frames ascending
    clamp : as in `world.apply_lighting`
    interpolation : "LINEAR" or "CONSTANT"

    Returns
    -------
    bpy.types.World

    Raises InputError when there are none, or their orders differ. The World is then as it was.
    """
    if not frames:
        raise InputError("the sequence", "it has no frame", "choose the photos again")
    orders = {lighting["order"] for _, lighting in frames}
    if len(orders) > 1:
        raise InputError("the sequence", f"its lights have the orders {sorted(orders)}", "estimate it anew")
    order = orders.pop()
    made = world.apply_lighting(scene, frames[0][1], mode="NODES", clamp=clamp, lamp=False)
    tree = made.node_tree
    group = sh_nodes.node_of(tree)
    earlier = tree.animation_data and tree.animation_data.action  # of the user's own keys

    coefficients = colour.to_working([lighting["coefficients"] for _, lighting in frames])
    values = {
        sh_nodes.coefficient_name(l, m): coefficients[:, l * l + l + m]
        for l in range(order + 1)
        for m in range(-l, l + 1)
    }
    clamping = [world.clamping(c, clamp) for c in coefficients]
    values |= {name: np.array([[one[name]] for one in clamping]) for name in clamping[0]}
    paths = {}
    for name, rows in values.items():
        socket = group.inputs[name]
        socket.keyframe_insert("default_value", frame=frames[0][0])  # the one way that all Blenders share
        paths[socket.path_from_id("default_value")] = rows
    times = [number for number, _ in frames]
    for curve in fcurves(tree.animation_data):
        if curve.data_path in paths:
            _fill(curve, times, paths[curve.data_path][:, curve.array_index], interpolation)
    action = tree.animation_data.action
    if action != earlier:
        action[world.WORLD_TAG] = True  # so that it goes when its World does
        action.name = world.WORLD_NAME
    return made


def fcurves(animation):
    """The curves of ``animation`` (AnimData with an action): its slot's since Blender 4.4, the action's before."""
    return [curve for bag in bags(animation) for curve in bag]


def _fill(curve, times, values, interpolation: str) -> None:
    points = curve.keyframe_points
    points.add(len(times) - len(points))
    points.foreach_set("co", np.column_stack([times, values]).astype(np.float32).ravel())
    for point in points:
        point.interpolation = interpolation
        point.handle_left_type = point.handle_right_type = "AUTO_CLAMPED"  # should someone choose Bezier
    curve.update()
