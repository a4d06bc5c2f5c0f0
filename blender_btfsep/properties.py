# SPDX-License-Identifier: GPL-3.0-or-later
"""What the user sets (on the Scene, saved) and what a run says (on the WindowManager, not saved)."""

import bpy
from bpy.props import (
    BoolProperty,
    CollectionProperty,
    EnumProperty,
    FloatProperty,
    IntProperty,
    PointerProperty,
    StringProperty,
)

from . import engine_settings
from .animation import INTERPOLATIONS
from .meshes import SURFACE_TYPES

WORLD_MODES = (
    ("NODES", "Nodes", "An editable node group that evaluates the spherical harmonics, coefficients as its inputs"),
    ("TEXTURE", "Texture", "An environment texture, packed into the .blend file"),
    ("NONE", "Do Not Apply", "Estimate only; the World stays as it is"),
)
OCCLUDERS = (
    ("OTHERS", "All Others", "Everything else that the render shows casts shadows on the objects"),
    ("NONE", "None", "The objects stand alone"),
)
CURVES = (
    ("auto", "Automatic", "As the image's colour space says: PNG, JPEG, TIFF and WebP in sRGB, EXR and HDR linear"),
    ("srgb", "sRGB", "The file's whole numbers are coded in sRGB"),
    ("linear", "Linear", "The file's whole numbers are in proportion to the light"),
    ("unknown", "Unknown", "A curve from linear to steeper than sRGB is found that explains the photo best"),
)
MAPPINGS = (
    ("CHARTS", "Charts (computed)", "The engine cuts the surface into charts, each to scale"),
    ("UNWRAP", "Blender Unwrap", "Blender's angle-based unwrap with the seams of its smart projection, of a copy"),
    ("OWN", "The Object's UV Map", "The UV map that is active for rendering, to its mean scale"),
)


class BTFSEP_PG_candidate(bpy.types.PropertyGroup):
    """A material that was considered; ``name`` is its name in the library."""

    score: FloatProperty(name="Score")


class BTFSEP_PG_object(bpy.types.PropertyGroup):
    """An object that the photo shows, or the surface of its depth (then without ``object``)."""

    object: PointerProperty(name="Object", type=bpy.types.Object, poll=lambda self, thing: thing.type in SURFACE_TYPES)
    material: StringProperty(
        name="Material",
        description="The object's material in the library, where you know it. Empty: recognised from the photo",
    )
    mask: PointerProperty(
        name="Mask",
        description="Image of the photo's size, not black where the object may be used. Empty: all that is seen of it",
        type=bpy.types.Image,
    )
    recognised: StringProperty(name="Recognised Material")
    unknown: BoolProperty(name="Unknown", description="The photo looks like no material of the library")
    candidates: CollectionProperty(type=BTFSEP_PG_candidate)


def engine_properties(settings) -> dict:
    """Name -> property, of rows of `engine_settings`, to be added to the annotations of a class."""
    made = {}
    for s in settings:
        about = {"name": s.label, "description": s.description, "default": s.default}
        about |= {"options": {"SKIP_SAVE"}} if s.kind is bool else {}  # a button's switch is off the next time
        about |= {key: end for key, end in (("min", s.low), ("max", s.high)) if end is not None}
        if s.items:
            made[s.name] = EnumProperty(items=s.items, **about)
        elif s.default is not None:
            made[s.name] = {int: IntProperty, float: FloatProperty, bool: BoolProperty}[s.kind](**about)
        if s.auto:
            made[f"auto_{s.name}"] = BoolProperty(name=f"Automatic {s.label}", description=s.auto)
    return made


class BTFSEP_PG_settings(bpy.types.PropertyGroup):
    """Settings of one scene; the engine's come to these below."""

    image: PointerProperty(name="Photo", description="The photograph", type=bpy.types.Image)
    camera: PointerProperty(
        name="Camera",
        description="The camera that took the photo. Empty: the scene's camera",
        type=bpy.types.Object,
        poll=lambda self, thing: thing.type == "CAMERA",
    )
    objects: CollectionProperty(type=BTFSEP_PG_object)
    active_object: IntProperty(name="Active Object")
    occluders: EnumProperty(name="Occluders", description="What else casts shadows", items=OCCLUDERS)
    mapping: EnumProperty(name="Material Mapping", description="How materials lie on the objects", items=MAPPINGS)
    exposure_ev: FloatProperty(
        name="Exposure",
        description="Stops that had been applied to the photo; it is kept with the light and changes no colour",
        soft_min=-10,
        soft_max=10,
        min=-100,
        max=100,
    )
    curve: EnumProperty(
        name="Photo's Curve", description="How a file of whole numbers codes the light; EXR is linear", items=CURVES
    )
    depth: PointerProperty(
        name="Depth",
        description="EXR of z-depth along the view axis, of the photo's size, instead of objects",
        type=bpy.types.Image,
    )
    surface: PointerProperty(type=BTFSEP_PG_object)
    interpolation: EnumProperty(
        name="Between Photos", description="What a sequence's light does between two photos", items=INTERPOLATIONS
    )
    world_mode: EnumProperty(name="World", description="How the light is put into the scene", items=WORLD_MODES)
    clamp: BoolProperty(
        name="Clamp Negative",
        description="Dark, in the colour of what is around, where the sum of the harmonics is negative",
        default=True,
    )
    sun_lamp: BoolProperty(
        name="Sun Lamps",
        description="Suns and lamps that the photo shows become Sun lamps beside the World. Off: all of it is World",
        default=True,
    )


BTFSEP_PG_settings.__annotations__ |= engine_properties(engine_settings.PANEL)


class BTFSEP_PG_name(bpy.types.PropertyGroup):
    """A line of text; ``name`` holds it."""


class BTFSEP_PG_run(bpy.types.PropertyGroup):
    """The run in progress, or the last one."""

    running: BoolProperty()
    task: StringProperty()
    stage: StringProperty()
    fraction: FloatProperty(min=0, max=1)
    message: StringProperty()
    error: StringProperty()
    summary: StringProperty()
    show_details: BoolProperty(name="Details", description="What else was chosen, and why")
    report: StringProperty(subtype="FILE_PATH")
    folder: StringProperty(subtype="DIR_PATH")
    warnings: CollectionProperty(type=BTFSEP_PG_name)
    library: CollectionProperty(type=BTFSEP_PG_name)


CLASSES = (
    BTFSEP_PG_candidate,
    BTFSEP_PG_object,
    BTFSEP_PG_settings,
    BTFSEP_PG_name,
    BTFSEP_PG_run,
)


_register_classes, _unregister_classes = bpy.utils.register_classes_factory(CLASSES)


def register():
    _register_classes()
    bpy.types.Scene.btfsep = PointerProperty(type=BTFSEP_PG_settings)
    bpy.types.WindowManager.btfsep = PointerProperty(type=BTFSEP_PG_run)


def unregister():
    del bpy.types.WindowManager.btfsep
    del bpy.types.Scene.btfsep
    _unregister_classes()
