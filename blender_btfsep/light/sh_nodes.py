# SPDX-License-Identifier: GPL-3.0-or-later
"""Builds the node groups that are a light: spherical harmonics with their coefficients as inputs, or a map.

Both have the same inputs for the user, first and in the same order, so that one can take the place of the other.
"""

import bpy

from ..basics import harmonics

GROUP_NAME, MAP_NAME = "BTFsep SH Lighting", "BTFsep Light Map"
GROUP_TAG = "btfsep_sh_group"
MAX_NODE_ORDER = 9
"""Highest order that is written as nodes (100 coefficients); a test renders it with Cycles."""

COLUMNS = 12  # nodes a row of the layout


class _Builder:
    """Makes nodes, left to right in rows, in the order in which they are to be computed.

    Cycles generates code in the order of creation, since Blender 5 in that in which the output asks for values, and
    frees a value after its last user: its stack has 255 floats, and a World that needs more is black. So each user is
    created right after what it uses, and what has two users is one of few. For the same reason no float is linked to a
    vector socket: such links become hidden conversion nodes that Cycles computes all at once.
    """

    def __init__(self, tree):
        self.tree, self.count = tree, 0

    def node(self, kind: str, label: str = ""):
        node = self.tree.nodes.new(kind)
        node.location = (200 * (self.count % COLUMNS), -200 * (self.count // COLUMNS))
        node.hide = True
        node.label = label
        self.count += 1
        return node

    def feed(self, socket, value) -> None:
        """Links ``value`` (an output socket or a _Scalar) to ``socket``, or sets it there if it is a number."""
        if isinstance(value, _Scalar):
            value = value.socket
        if isinstance(value, bpy.types.NodeSocket):
            self.tree.links.new(value, socket)
        else:
            socket.default_value = value

    def math(self, operation: str, *operands, label: str = ""):
        node = self.node("ShaderNodeMath", label)
        node.operation = operation
        for socket, operand in zip(node.inputs, operands, strict=False):
            self.feed(socket, operand)
        return _Scalar(self, node.outputs[0])

    def luminance(self, vector):
        node = self.node("ShaderNodeVectorMath", "luminance")
        node.operation = "DOT_PRODUCT"
        self.feed(node.inputs[0], vector)
        node.inputs[1].default_value = harmonics.LUMINANCE
        return _Scalar(self, node.outputs["Value"])

    def vector(self, operation: str, *operands, scale=None, label: str = ""):
        node = self.node("ShaderNodeVectorMath", label)
        node.operation = operation
        for socket, operand in zip(node.inputs, operands, strict=False):
            self.feed(socket, operand)
        if scale is not None:
            self.feed(node.inputs["Scale"], scale)
        return node.outputs["Vector"]

    def mix(self, label: str, factor, a, b):
        node = self.node("ShaderNodeMix", label)
        node.data_type, node.clamp_factor = "VECTOR", False
        by_kind = {(socket.name, socket.type): socket for socket in node.inputs}
        self.feed(by_kind["Factor", "VALUE"], factor)
        self.feed(by_kind["A", "VECTOR"], a)
        self.feed(by_kind["B", "VECTOR"], b)
        return next(socket for socket in node.outputs if socket.type == "VECTOR")


class _Scalar:
    """A float socket with arithmetic: harmonics.terms works on it as it does on arrays."""

    def __init__(self, builder: _Builder, socket):
        self.builder, self.socket = builder, socket

    def __mul__(self, other):
        if isinstance(other, float) and other == 1.0:
            return self
        return self.builder.math("MULTIPLY", self, other)

    __rmul__ = __mul__

    def __add__(self, other):
        return self.builder.math("ADD", self, other)

    def __sub__(self, other):
        return self.builder.math("SUBTRACT", self, other)


STRENGTH, ROTATION, TINT, SATURATION = USERS = "Strength", "Rotation", "Tint", "Saturation"
"""The inputs that are the user's: what they are set or linked to stays when the light is another."""
CLAMP, CLAMP_GAIN = "Clamp Negative", "Clamp Gain"


def coefficient_name(l: int, m: int) -> str:
    """The name of a coefficient's input, as "Y 2 -1"."""
    return f"Y {l} {m:+d}" if m else f"Y {l} 0"


def build_group(order: int) -> bpy.types.ShaderNodeTree:
    """A new node group of ``order`` (0 to MAX_NODE_ORDER).

    Inputs: Strength; Rotation (radians, turns the light counter-clockwise about +Z as seen from above); Tint;
    Saturation; Clamp Negative and Clamp Gain (as harmonics.positive_share gives them; 0: the sum of the harmonics as
    it is); one vector a coefficient (red, green, blue; may be negative). Output: Color, linear radiance along the
    direction in which the World is looked at.
    """
    pieces = group_in_pieces(order)
    tree = next(pieces)
    for _ in pieces:
        pass
    return tree


def group_in_pieces(order: int):
    """As :func:`build_group`, as a generator that gives the tree after each of its pieces, unfinished but for the last.

    Blender looks at the whole tree with each node and link that comes: order 4 takes a tenth of a second, 9 more than
    one.
    """
    if not 0 <= order <= MAX_NODE_ORDER:
        raise ValueError(f"order {order} is not in 0 to {MAX_NODE_ORDER}")
    tree, build, inputs, direction = _begun(GROUP_NAME, order)
    _coefficient_inputs(tree, order)
    separate = build.node("ShaderNodeSeparateXYZ", "x, y, z")
    build.feed(separate.inputs[0], direction)
    x, y, z = (_Scalar(build, socket) for socket in separate.outputs)

    bands = [None] * (order + 1)
    for l, m, value in harmonics.terms(order, x, y, z):
        name = coefficient_name(l, m)
        if isinstance(value, _Scalar):
            value.socket.node.label = name
        term = build.vector("SCALE", inputs.outputs[name], scale=value)
        bands[l] = term if bands[l] is None else build.vector("ADD", bands[l], term)
        yield tree
    total = blurred = bands[0]
    for weight, band in zip(harmonics.positive_window(order)[1:], bands[1:], strict=True):
        total = build.vector("ADD", total, band)
        blurred = build.vector("MULTIPLY_ADD", band, (float(weight),) * 3, blurred)

    colour = build.vector("MAXIMUM", blurred, (0.0, 0.0, 0.0), label="blurred, not negative")
    y = build.luminance(colour)
    level = build.math("MAXIMUM", build.luminance(total), y * harmonics.FLOOR, label="not too dark")
    level = build.math("DIVIDE", level, y) * _Scalar(build, inputs.outputs[CLAMP_GAIN])
    positive = build.vector("SCALE", colour, scale=level, label="same light")
    _ended(build, inputs, build.mix("clamp negative", inputs.outputs[CLAMP], total, positive))
    yield tree


def build_map_group(image) -> bpy.types.ShaderNodeTree:
    """A new node group of an environment map, with the inputs that are the user's."""
    tree, build, inputs, direction = _begun(MAP_NAME, -1)
    texture = build.node("ShaderNodeTexEnvironment")
    texture.image = image
    build.feed(texture.inputs["Vector"], direction)
    _ended(build, inputs, texture.outputs["Color"])
    return tree


def map_of(tree):
    """The image of a tree of :func:`build_map_group`; None of another."""
    return next((node.image for node in tree.nodes if node.type == "TEX_ENVIRONMENT"), None)


def node_of(tree):
    """The node of ours among a World's nodes; None where there is none."""
    ours = (n for n in tree.nodes if n.type == "GROUP" and n.node_tree is not None and GROUP_TAG in n.node_tree)
    return next(ours, None)


def _begun(name: str, order: int):
    """A tree with the user's inputs; its builder, the inputs' node, the direction that is looked at, turned back."""
    tree = bpy.data.node_groups.new(name, "ShaderNodeTree")
    tree[GROUP_TAG] = order
    _users_inputs(tree.interface)
    build = _Builder(tree)
    inputs = build.node("NodeGroupInput")
    generated = build.node("ShaderNodeTexCoord").outputs["Generated"]
    unit = build.vector("NORMALIZE", generated, label="direction")
    turn = build.math("MULTIPLY", inputs.outputs[ROTATION], -1.0)
    rotate = build.node("ShaderNodeVectorRotate", "turned back")
    rotate.rotation_type = "Z_AXIS"
    build.feed(rotate.inputs["Vector"], unit)
    build.feed(rotate.inputs["Angle"], turn)
    return tree, build, inputs, rotate.outputs[0]


def _ended(build: _Builder, inputs, colour) -> None:
    """Saturation, tint and strength, and the way out."""
    y = build.luminance(colour)
    grey = build.node("ShaderNodeCombineXYZ", "grey")
    for socket in grey.inputs:
        build.feed(socket, y)
    saturate = build.mix("saturation", inputs.outputs[SATURATION], grey.outputs[0], colour)
    tinted = build.vector("MULTIPLY", saturate, inputs.outputs[TINT], label="tint")
    strong = build.vector("SCALE", tinted, scale=inputs.outputs[STRENGTH], label="strength")
    build.feed(build.node("NodeGroupOutput").inputs["Color"], strong)


def _users_inputs(face) -> None:
    face.new_socket("Color", in_out="OUTPUT", socket_type="NodeSocketColor", description="Linear Rec.709 radiance")
    strength = face.new_socket(STRENGTH, in_out="INPUT", socket_type="NodeSocketFloat")
    strength.default_value, strength.min_value = 1.0, 0.0
    strength.description = "Factor on the whole light"
    rotation = face.new_socket(ROTATION, in_out="INPUT", socket_type="NodeSocketFloat")
    rotation.subtype = "ANGLE"
    rotation.description = "Turns the light about the vertical, counter-clockwise as seen from above"
    tint = face.new_socket(TINT, in_out="INPUT", socket_type="NodeSocketColor")
    tint.default_value, tint.description = (1.0, 1.0, 1.0, 1.0), "Colour by which the light is multiplied"
    saturation = face.new_socket(SATURATION, in_out="INPUT", socket_type="NodeSocketFloat")
    saturation.default_value, saturation.min_value = 1.0, 0.0
    saturation.description = "0: grey; 1: as estimated; more: stronger colours"


def _coefficient_inputs(tree, order: int) -> None:
    face = tree.interface
    clamp = face.new_socket(CLAMP, in_out="INPUT", socket_type="NodeSocketFloat")
    clamp.subtype, clamp.default_value, clamp.min_value, clamp.max_value = "FACTOR", 1.0, 0.0, 1.0
    clamp.description = "How far the light is kept from being negative. 0: the sum of the harmonics as it is"
    gain = face.new_socket(CLAMP_GAIN, in_out="INPUT", socket_type="NodeSocketFloat")
    gain.default_value, gain.min_value = 1.0, 0.0
    gain.description = "Factor on the light that is clamped: keeps its whole amount"
    for l in range(order + 1):
        panel = face.new_panel(f"Order {l}", default_closed=l > 1)
        panel.description = "Coefficients of the real spherical harmonics: red, green and blue of each"
        for m in range(-l, l + 1):
            socket = face.new_socket(
                coefficient_name(l, m), in_out="INPUT", socket_type="NodeSocketVector", parent=panel
            )
            socket.hide_value = False
            socket.description = "Red, green and blue; negative values are meaningful"
