# SPDX-License-Identifier: GPL-3.0-or-later
"""What the user sets and what was found (on the Scene and the World, saved); what a run says (on the WindowManager)."""

import bpy
from bpy.props import (
    BoolProperty,
    CollectionProperty,
    EnumProperty,
    FloatProperty,
    FloatVectorProperty,
    IntProperty,
    PointerProperty,
    StringProperty,
)

from ..engine import engine_settings
from ..light.animation import INTERPOLATIONS
from ..scene.meshes import has_surface
from . import library, live
from .blender_views import VIEWS

WORLD_MODES = (
    (
        "NODES",
        "Nodes",
        "An editable node group that evaluates the spherical harmonics, coefficients as its inputs. The light that a "
        "mirror shows is sharper, and becomes a texture",
    ),
    ("TEXTURE", "Texture", "An environment texture, packed into the .blend file"),
    ("NONE", "Do Not Apply", "Estimate only; the World stays as it is"),
)
OCCLUDERS = (
    (
        "OTHERS",
        "All Others",
        "Everything else that the render shows casts shadows on the objects; where there is nothing, a ground under "
        "them that the photo shows",
    ),
    ("NONE", "None", "The objects stand alone, on no ground either"),
)
CURVES = (
    (
        "auto",
        "Automatic",
        "As the image's colour space says: PNG, JPEG, TIFF and WebP in sRGB, EXR and HDR linear; a file that names its "
        "camera (EXIF) by the usual curve of cameras, a phone's as Phone, and one that says that Blender rendered it "
        "by the view found for it",
    ),
    ("srgb", "sRGB", "The file's whole numbers are coded in sRGB, and nothing else was done to them"),
    ("camera", "Camera", "A camera's own picture, with more contrast and softer highlights than sRGB alone"),
    (
        "phone",
        "Phone",
        "A phone's own picture: as a camera's, with shadows raised place by place, as far as it shows that",
    ),
    ("linear", "Linear", "The file's whole numbers are in proportion to the light"),
    ("unknown", "Unknown", "sRGB, the curve of a camera, or a rarer one: that which explains the photo best"),
    ("blender", "Blender Render", "A render that Blender saved: by the view transform that explains it best"),
    *(
        (name, view.words, f"A render that was saved with Blender's view transform {view.words}")
        for name, view in VIEWS.items()
    ),
)
RENDERS = 6  # of CURVES come before those of renders, from which a line parts them in the list
OVERLAYS = (
    ("OFF", "Off", "Nothing is drawn over the photo"),
    ("OUTLINE", "Outline", "The outlines of the objects"),
    ("EDGES", "Edges", "All edges of the objects"),
    ("SHADED", "Shaded", "The objects, half transparent"),
)
SOURCES = (
    ("RECOGNISE", "Recognise", "The material is recognised from the photo, in the library"),
    ("LIBRARY", "Material", "A material of the library"),
    ("COLOUR", "Colour", "One colour all over, with a roughness"),
    ("BLENDER", "As in Blender", "What the object's own Blender material says: colour, roughness, metal"),
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

    object: PointerProperty(name="Object", type=bpy.types.Object, poll=lambda self, thing: has_surface(thing))
    source: EnumProperty(name="Made Of", description="What the object is made of", items=SOURCES)
    material: StringProperty(
        name="Material",
        description="The object's material in the library, where you know it. Empty: recognised from the photo",
        update=lambda self, context: setattr(self, "source", "LIBRARY" if self.material else "RECOGNISE"),
    )
    colour: FloatVectorProperty(
        name="Colour",
        description="What share of the light the object reflects",
        subtype="COLOR",
        size=3,
        min=0,
        max=1,
        default=(0.5, 0.5, 0.5),
    )
    roughness: FloatProperty(
        name="Roughness", description="As of Blender's Principled BSDF", min=0, max=1, default=0.5, subtype="FACTOR"
    )
    metallic: FloatProperty(
        name="Metallic", description="As of Blender's Principled BSDF", min=0, max=1, subtype="FACTOR"
    )
    browse: EnumProperty(
        name="Material",
        description="The library's materials",
        items=lambda self, context: library.items(self),
        get=lambda self: library.number_of(self.material),
        set=lambda self, number: setattr(self, "material", library.name_of(number)),
    )
    mask: PointerProperty(
        name="Mask",
        description="Image of the photo's size, not black where the object may be used. Empty: all that is seen of it",
        type=bpy.types.Image,
    )
    recognised: StringProperty(name="Recognised Material")
    unknown: BoolProperty(name="Unknown", description="The photo looks like no material of the library")
    candidates: CollectionProperty(type=BTFSEP_PG_candidate)


def redraw_views(context) -> None:
    """Has the 3D views drawn again."""
    for window in context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                area.tag_redraw()


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


class BTFSEP_PG_kept(bpy.types.PropertyGroup):
    """A light that was found, with its card (`kept_light`): of the scene, and of the World that was made of it."""

    text: StringProperty(name="Light", description="Lighting and card, as JSON")
    mended: StringProperty(options={"HIDDEN"})  # what was done since about its doubts (`mending`), as JSON
    picture: PointerProperty(name="Picture", description="The light, to look at", type=bpy.types.Image)
    report: PointerProperty(name="Report", description="Photo, re-rendering, difference", type=bpy.types.Image)
    sky: PointerProperty(
        name="Sky", description="The map without key lights, of a mirror's light", type=bpy.types.Image
    )


class BTFSEP_PG_known_sun(bpy.types.PropertyGroup):
    """A sun whose direction is known (`known_suns`)."""

    object: PointerProperty(
        name="Known Sun",
        description="A Sun lamp whose direction is known; how bright it is, the photo says",
        type=bpy.types.Object,
        poll=lambda self, thing: thing.type == "LIGHT" and thing.data.type == "SUN",
    )


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
    mapping: EnumProperty(name="Mapping", description="How materials lie on the objects", items=MAPPINGS)
    exposure_ev: FloatProperty(
        name="Exposure",
        description="Stops that had been applied to the photo; it is kept with the light and changes no colour",
        soft_min=-10,
        soft_max=10,
        min=-100,
        max=100,
    )
    curve: EnumProperty(
        name="Photo's Curve",
        description="How a file of whole numbers codes the light; EXR is linear",
        items=(*CURVES[:RENDERS], None, *CURVES[RENDERS:]),
    )
    depth: PointerProperty(
        name="Depth",
        description="EXR of z-depth along the view axis, of the photo's size, instead of objects",
        type=bpy.types.Image,
    )
    depth_shift: FloatVectorProperty(
        name="Shift",
        description="Pixels to the right and down by which the photo shows what the depth shows elsewhere. Refine "
        "Alignment finds it",
        size=2,
        precision=1,
        step=10,
    )
    surface: PointerProperty(type=BTFSEP_PG_object)
    known_suns: CollectionProperty(name="Known Suns", type=BTFSEP_PG_known_sun)
    light: PointerProperty(type=BTFSEP_PG_kept)
    live: BoolProperty(
        name="Live",
        description="After an estimate the light follows photo, mask, camera, objects and what they are made of: "
        "a draft at once, the preset when nothing changes for a second",
        update=lambda self, context: live.switched(self),
    )
    live_step: IntProperty(options={"HIDDEN"})  # the number of the last step of undo that `live` made
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


class BTFSEP_PG_material(bpy.types.PropertyGroup):
    """A material of the library, ``name`` there."""

    kind: StringProperty(name="Class")
    thumbnail: StringProperty(name="Thumbnail", subtype="FILE_PATH")
    colour: FloatVectorProperty(name="Colour", subtype="COLOR", size=3, min=0, max=1, default=(0.5, 0.5, 0.5))


class BTFSEP_PG_run(bpy.types.PropertyGroup):
    """The run in progress, or the last one."""

    running: BoolProperty(name="Running", description="The engine is at work; the cross below stops it")
    task: StringProperty()
    stage: StringProperty()
    fraction: FloatProperty(min=0, max=1)
    message: StringProperty()
    following: StringProperty()  # what `live` asks now
    error: StringProperty()
    summary: StringProperty()
    show_details: BoolProperty(name="Details", description="What else was chosen, and why")
    overlay: EnumProperty(
        name="Overlay",
        description="What is drawn over the photo, as the camera should see the objects",
        items=OVERLAYS,
        update=lambda self, context: redraw_views(context),
    )
    warnings: CollectionProperty(type=BTFSEP_PG_name)
    library: CollectionProperty(type=BTFSEP_PG_material)
    library_error: StringProperty()
    library_for: StringProperty(default="?")  # the folder that `library` is of; "?": it was not read yet
    library_class: EnumProperty(
        name="Class", description="Materials to choose from", items=lambda self, context: library.classes()
    )


CLASSES = (
    BTFSEP_PG_candidate,
    BTFSEP_PG_object,
    BTFSEP_PG_kept,
    BTFSEP_PG_known_sun,
    BTFSEP_PG_settings,
    BTFSEP_PG_name,
    BTFSEP_PG_material,
    BTFSEP_PG_run,
)


_register_classes, _unregister_classes = bpy.utils.register_classes_factory(CLASSES)


def register():
    _register_classes()
    bpy.types.Scene.btfsep = PointerProperty(type=BTFSEP_PG_settings)
    bpy.types.Object.btfsep_evidence = BoolProperty(
        name="Use as Evidence",
        description="What the photo shows of this table or floor tells of the light, too: the shadows on it. It should "
        "be matte or plastic. Its colour need not be known; a pattern counts for less",
    )
    bpy.types.World.btfsep_kept = PointerProperty(type=BTFSEP_PG_kept)
    bpy.types.WindowManager.btfsep = PointerProperty(type=BTFSEP_PG_run)


def unregister():
    del bpy.types.WindowManager.btfsep
    del bpy.types.World.btfsep_kept
    del bpy.types.Object.btfsep_evidence
    del bpy.types.Scene.btfsep
    _unregister_classes()
