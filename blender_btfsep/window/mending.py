# SPDX-License-Identifier: GPL-3.0-or-later
"""The buttons beside a doubt: each goes where what is in doubt can be set right.

What was pressed is kept with the light (so that it follows undo) until there is another: the card shows it, and what
is still to be said.
"""

import contextlib
import json

import bpy
from bpy.props import EnumProperty, StringProperty

from ..basics.errors import InputError
from ..light import kept_light
from ..run import buttons, request
from ..scene import ground_plane, own_surface
from . import use_photo

MENDS = (
    ("COLOUR", "Give Its Colour", "Say the object's own colour, so that it is not taken for the light's"),
    ("BLENDER", "As in Blender", "Take what the object's own Blender material says; estimate again afterwards"),
    ("MATERIAL", "Choose Material", "Choose the object's material in the library"),
    ("AGX", "Read as AgX", "Read the photo as a render that was saved with AgX; estimate again afterwards"),
    (
        "STANDARD",
        "Read as Standard",
        "Read the photo as a render that was saved with Standard; estimate again afterwards",
    ),
    ("CAMERA", "Read as a Camera's", "Read the photo by the usual curve of cameras; estimate again afterwards"),
    ("SELECT", "Go to Its Material", "Select what is in doubt, and show its material in the properties"),
    (
        "GROUND",
        "Add a Ground",
        "Put a plane under the objects that catches their shadows; estimate again afterwards",
    ),
    (
        "KEEP",
        "Keep Its Colours",
        "Take all textures for the objects' own colours, as they are; estimate again afterwards",
    ),
    ("CURVE", "Find the Curve", "Have the photo's tone curve found; estimate again afterwards"),
)
WORDS = {how: words for how, words, _ in MENDS}
READ_AS = {"AGX": "agx", "STANDARD": "srgb", "CAMERA": "camera", "CURVE": "unknown"}
OPEN = ("auto", "blender", "unknown")  # curves with which the engine chooses among the views of a render
SOURCE = {"COLOUR": "COLOUR", "BLENDER": own_surface.BLENDER, "MATERIAL": "LIBRARY"}
AGAIN = "estimate again"
SAID = {
    "COLOUR": f"say the colour of {{}}, and {AGAIN}",
    "BLENDER": f"{{}} is taken as its Blender material says; {AGAIN}",
    "MATERIAL": f"choose the material of {{}}, and {AGAIN}",
}


class BTFSEP_OT_mend(buttons.Greyed, buttons.AtOnce, bpy.types.Operator):
    """Set right what is in doubt; estimate again afterwards"""

    bl_idname = "btfsep.mend"
    bl_label = "Mend"
    bl_options = {"UNDO", "INTERNAL"}  # nothing of it is worth being adjusted
    how: EnumProperty(name="How", items=MENDS, options={"SKIP_SAVE"})
    object: StringProperty(
        name="Object",
        description="In the list; empty: the active one. Of what is to be selected, any, in lines",
        options={"SKIP_SAVE"},
    )

    @classmethod
    def description(cls, context, properties):
        return next(about for name, _, about in MENDS if name == properties.how)

    def do(self, context):
        if self.how == "SELECT":
            return select(context, self.object.splitlines())
        said = self._mend(context)
        light = kept_light.kept(context.scene)
        if light is None:
            return said.removesuffix(f"; {AGAIN}")
        light.mended = json.dumps([*done(light), [self.how, self.object]])
        return said

    def _mend(self, context) -> str:
        settings = context.scene.btfsep
        if self.how in READ_AS:
            settings.curve = READ_AS[self.how]
            return f"the photo: {use_photo.READ[settings.curve]}; {AGAIN}"
        if self.how == "GROUND":
            ground_plane.add(context, [e.object for e in settings.objects if e.object and not settings.depth])
            settings.occluders = "OTHERS"
            return f"'{ground_plane.NAME}' is below the objects; {AGAIN}"
        if self.how == "KEEP":
            settings.delight = "never"
            return f"textures are taken for the objects' own colours; {AGAIN}"
        entry = entry_of(settings, self.object)
        if settings.depth is None and self.object:
            settings.active_object = number_of(settings, self.object)
        entry.source = SOURCE[self.how]
        return SAID[self.how].format(f"'{entry.object.name}'" if entry.object else "the surface")


def done(light) -> list:
    """What was pressed since there is this light (or None): lists of how, and of what object, as of the operator."""
    try:
        return [list(map(str, each)) for each in json.loads((light and light.mended) or "[]")]
    except (ValueError, TypeError):
        return []


def is_done(scene, light, how: str, name: str) -> bool:
    """Whether a doubt of ``light`` was mended by ``how``, and that was not taken back by other means."""
    settings = scene.btfsep
    if [how, name] not in done(light):
        return False
    if how in READ_AS:
        return settings.curve == READ_AS[how]
    if how == "KEEP":
        return settings.delight == "never"
    if how == "GROUND":
        return ground_plane.there(scene) is not None
    try:
        entry = entry_of(settings, name)
    except InputError:
        return False
    return entry.source == SOURCE[how]


def entry_of(settings, name: str):
    """The entry of the object in doubt; of no name, the active one. Raises InputError."""
    number = number_of(settings, name) if name and settings.depth is None else None
    if name and settings.depth is None and number is None:
        raise InputError(f"object '{name}'", "it is not in the list", "add it")
    entry = request.active_entry(settings) if number is None else settings.objects[number]
    if entry is None:
        raise InputError("the list of objects", "it is empty", "add what the photo shows")
    return entry


def ways(scene, light, mend: str, name: str) -> list:
    """The buttons of a doubt: pairs of how, and of what object (as of the operator).

    What is given is not thrown away for a material of the library: there the numbers, or its Blender material, are
    looked at again.
    """
    settings = scene.btfsep
    if mend == "COLOUR":
        again = any(thing == name and how in SOURCE for how, thing in done(light))
        own = may_be_its_own(settings, name, again=again)
        return [("BLENDER", name), (mend, name)] if own else [(mend, name)]
    if mend in ("AGX", "STANDARD") and (settings.curve in OPEN or done(light)):
        return [("AGX", name), ("STANDARD", name)]  # what it was taken for can be said as well
    if mend == "MATERIAL" and [mend, name] not in done(light):
        with contextlib.suppress(InputError):
            entry = entry_of(settings, name)
            if entry.source == "BLENDER" and entry.object:
                return [("SELECT", entry.object.name)]
            if entry.source == "COLOUR":
                return [("COLOUR", name)]
    return [(mend, name)]


def number_of(settings, name: str) -> int | None:
    """Which of the list's entries has the object of that name; None: none."""
    return next((n for n, e in enumerate(settings.objects) if e.object and e.object.name == name), None)


def may_be_its_own(settings, name: str, *, again: bool = False) -> bool:
    """Whether the object in doubt (of no name: the active one) might be taken as its Blender material says, and is not
    yet; or, ``again``, could be."""
    number = number_of(settings, name) if name else settings.active_object
    if settings.depth is not None or number is None or not 0 <= number < len(settings.objects):
        return False
    entry = settings.objects[number]
    return (again or entry.source in ("RECOGNISE", "LIBRARY")) and own_surface.tells_a_colour(entry.object)


def select(context, names) -> str:
    """Selects objects alone, the first is the active one, with its material in the properties.

    Gives a sentence where none of them is seen. Raises InputError.
    """
    objects = context.view_layer.objects
    chosen = [objects[name] for name in names if name in objects]
    if not chosen:
        raise InputError(f"'{', '.join(names)}'", "no object of this view layer has that name", "look for it by eye")
    if context.object is not None and context.object.mode != "OBJECT":
        bpy.ops.object.mode_set(mode="OBJECT")
    for thing in objects:
        thing.select_set(thing in chosen)
    objects.active = chosen[0]
    for space in (area.spaces.active for window in context.window_manager.windows for area in window.screen.areas):
        if space.type == "PROPERTIES":
            with contextlib.suppress(TypeError):  # it is pinned to something else
                space.context = "MATERIAL"
    return "" if any(thing.visible_get() for thing in chosen) else f"'{chosen[0].name}' is hidden in the viewport"


register, unregister = bpy.utils.register_classes_factory((BTFSEP_OT_mend,))
