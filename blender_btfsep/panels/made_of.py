# SPDX-License-Identifier: GPL-3.0-or-later
"""What an object is made of, as fields: in the panel of the objects, and on the card where that is in doubt."""

import bpy

from ..basics import labels
from ..engine import preferences
from ..run import runs
from ..scene import own_surface
from ..window import icons, library, mending
from . import sidebar

SHOWN = 3  # candidates in the panel
PICTURE = 5  # units, the height of a material's picture


def source(context, layout, entry, *, whole: bool = True) -> None:
    """The fields of what ``entry``, of the list or of a depth, is said to be made of.

    ``whole`` : with the choice between the ways to say it, and all that the library's materials can be
    """
    split = sidebar.fields(layout)
    if whole and sidebar.is_narrow(context):  # beside their name, its words would be cut off
        layout.prop(entry, "source", text="")
    elif whole:
        split.prop(entry, "source")
    if entry.source == "COLOUR":
        split.prop(entry, "colour")
        split.prop(entry, "roughness")
        split.prop(entry, "metallic")
    elif entry.source == "BLENDER":
        labels.wrapped(context, layout, own_surface.material_words(entry.object), icon="MATERIAL")
    elif entry.source == "LIBRARY":
        _library(context, layout, entry, whole)
    elif whole and not entry.recognised and own_surface.tells_a_colour(entry.object):
        words = "Its material in Blender has a colour: that is surer than what is recognised, and sooner done"
        labels.wrapped(context, layout, words, icon="INFO")
        button = layout.operator("btfsep.mend", text=mending.WORDS["BLENDER"], icon="MATERIAL")
        button.how, button.object = "BLENDER", entry.object.name
    elif entry.candidates:
        _candidates(context, layout, entry)


def _library(context, layout, entry, whole: bool):
    library.ensure()
    run = runs.run_state()
    row = layout.row(align=True)
    if run.library:
        row.prop(run, "library_class", text="")
        row.operator("btfsep.library_assets", text="", icon="ASSET_MANAGER")
        row.operator("btfsep.read_library", text="", icon="FILE_REFRESH")
        layout.template_icon_view(entry, "browse", show_labels=True, scale=PICTURE, scale_popup=4.5)
        layout.prop_search(entry, "material", run, "library", text="", icon="MATERIAL")
    elif run.library_error:
        layout.prop(entry, "material", text="", icon="MATERIAL")  # a search would show any name as wrong
        labels.parted(context, layout, run.library_error)
        layout.operator("btfsep.read_library", icon="FILE_REFRESH")
    else:  # as high as what comes, or all below would jump away from the mouse
        layout.label(text="Reading the library …", icon="SORTTIME")
        room = layout.box()
        room.scale_y = PICTURE
        room.label()
        layout.prop(entry, "material", text="", icon="MATERIAL")
    if not whole:
        return
    chosen = preferences.get(context)
    if isinstance(chosen, bpy.types.AddonPreferences):
        layout.prop(chosen, "library", text="", placeholder="The library that comes with it")
    layout.operator("btfsep.measure_material", icon="NODE_MATERIAL")


def _candidates(context, layout, entry):
    box = layout.box()
    if entry.unknown:
        labels.wrapped(context, box, "It looks like nothing of the library; the likeliest are:", icon="QUESTION")
    column = box.column(align=True)
    library.ensure()  # for the thumbnails
    pictures = {material.name: material.thumbnail for material in runs.run_state().library}
    for candidate in entry.candidates[:SHOWN]:
        row = column.split(factor=0.7, align=True)
        row.active = candidate.name == entry.recognised
        name, picture = candidate.name, pictures.get(candidate.name)
        own = name.rsplit("/", 1)[-1]
        shown = icons.of_file(picture) if picture else 0
        row.operator("btfsep.use_candidate", text=own, icon_value=shown, emboss=False).material = name
        row.progress(factor=candidate.score, type="BAR", text=f"{100 * candidate.score:.0f} %")
