# SPDX-License-Identifier: GPL-3.0-or-later
"""What the panels of the tab "BTFsep" have in common: where they are, columns of fields, labels over several lines."""

import blf

from ..engine import engine_settings

FONT_SIZE = 11  # of Blender's labels, in points, at scale 1
MARGIN = 105  # pixels of the sidebar's width that a label with an icon in a box cannot have, at scale 1


class Sidebar:
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "BTFsep"


def fields(layout):
    """A column whose names stand beside their fields."""
    column = layout.column()
    column.use_property_split, column.use_property_decorate = True, False
    return column


def engine_rows(column, settings, part: str) -> None:
    """The engine's settings that stand in ``part`` of the panel."""
    for s in engine_settings.PANEL:
        if s.panel == part:
            row = column.row(align=True)
            value = row.row(align=True)
            value.prop(settings, s.name)
            if s.auto:
                value.active = not getattr(settings, f"auto_{s.name}")
                row.prop(settings, f"auto_{s.name}", text="Auto", toggle=True)


def wrapped(context, layout, text: str, *, icon: str = "NONE", icon_value: int = 0, share: float = 1.0) -> None:
    """A label over as many lines as the sidebar's width needs: Blender's own labels are cut off.

    ``share`` : of the width that there is
    """
    scale = context.preferences.system.ui_scale
    blf.size(0, FONT_SIZE * scale)
    has_icon = icon != "NONE" or icon_value
    margin = MARGIN if has_icon else MARGIN - 20
    room = max((context.region.width - margin * scale) * share, 60 * scale)
    column = layout.column(align=True)
    column.scale_y = 0.8
    given = {"icon_value": icon_value} if icon_value else {"icon": icon}
    for line in lines(text, lambda part: blf.dimensions(0, part)[0] <= room):
        column.label(text=line, **given)
        given = {"icon": "BLANK1" if has_icon else "NONE"}


def lines(text: str, fits) -> list:
    """``text`` in lines of which ``fits(line)``; a word that is too long for one, as a path, is broken."""
    made = [""]
    for word in text.split():
        if fits(f"{made[-1]} {word}".strip()):
            made[-1] = f"{made[-1]} {word}".strip()
            continue
        while not fits(word):
            much = next((n for n in range(len(word) - 1, 1, -1) if fits(word[:n])), 1)
            at = word.rfind("/", 1, much) + 1  # of a path rather between two names
            made.append(word[: at or much])
            word = word[at or much :]
        made.append(word)
    return [line for line in made if line] or [""]


def refine_alignment(layout, settings) -> None:
    """The button; of a depth only the photo can be shifted."""
    if settings.depth is None:
        layout.operator_menu_enum("btfsep.refine_alignment", "moves", icon="CON_CAMERASOLVER")
    else:
        layout.operator("btfsep.refine_alignment", icon="CON_CAMERASOLVER")
