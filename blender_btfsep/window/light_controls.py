# SPDX-License-Identifier: GPL-3.0-or-later
"""Sliders for a light of ours: rotation, tint and saturation of all of it, key (the Sun lamps) and fill (the World).

They are no copies: each shows and sets what stands in the World's node group, so that files, undo and other add-ons
need know of nothing else. Only the key's factor is kept on the World itself.
"""

import bpy
from bpy.props import FloatProperty, FloatVectorProperty, PointerProperty

from ..light import sh_nodes, sun_lamp


def _node(self):
    tree = self.id_data.node_tree
    return sh_nodes.node_of(tree) if tree else None


def _input(name: str, otherwise, *, lamps: bool):
    """What reads and writes an input of the World's group; ``lamps``: the Sun lamps have to be told."""

    def read(self):
        node = _node(self)
        value = node.inputs[name].default_value if node and name in node.inputs else otherwise
        return value if isinstance(value, float) else tuple(value)[:3]

    def write(self, value):
        node = _node(self)
        if node and name in node.inputs:
            node.inputs[name].default_value = value if isinstance(value, float) else (*value, 1.0)
            if lamps:
                sun_lamp.follow(self.id_data)

    return {"get": read, "set": write}


def _set_key(self, value) -> None:
    self.id_data[sun_lamp.KEY] = value
    sun_lamp.follow(self.id_data)


class BTFSEP_PG_light(bpy.types.PropertyGroup):
    """The sliders, of a World of ours."""

    rotation: FloatProperty(
        name="Rotation",
        description="Turns World and Sun lamps about the vertical, counter-clockwise as seen from above",
        subtype="ANGLE",
        **_input(sh_nodes.ROTATION, 0.0, lamps=False),  # a driver turns them
    )
    key: FloatProperty(
        name="Key",
        description="Factor on the Sun lamps",
        min=0,
        soft_max=4,
        get=lambda self: self.id_data.get(sun_lamp.KEY, 1.0),
        set=_set_key,
    )
    fill: FloatProperty(
        name="Fill",
        description="Factor on the World: the light without the Sun lamps",
        min=0,
        soft_max=4,
        **_input(sh_nodes.STRENGTH, 1.0, lamps=False),
    )
    tint: FloatVectorProperty(
        name="Tint",
        description="Colour by which World and Sun lamps are multiplied",
        subtype="COLOR",
        min=0,
        soft_max=1,
        **_input(sh_nodes.TINT, (1.0, 1.0, 1.0), lamps=True),
    )
    saturation: FloatProperty(
        name="Saturation",
        description="Of World and Sun lamps. 0: grey; 1: as estimated",
        min=0,
        soft_max=2,
        **_input(sh_nodes.SATURATION, 1.0, lamps=True),
    )


def register():
    bpy.utils.register_class(BTFSEP_PG_light)
    bpy.types.World.btfsep = PointerProperty(type=BTFSEP_PG_light)


def unregister():
    del bpy.types.World.btfsep
    bpy.utils.unregister_class(BTFSEP_PG_light)
