# SPDX-License-Identifier: GPL-3.0-or-later
"""What the panels of the tab "BTFsep" have in common: where they are, columns of fields."""

from ..engine import engine_settings

NARROW = 250  # pixels of the sidebar's width, at scale 1, below which the words of two buttons do not stand in a row
AUTO = 1.15  # widths of its word that the switch beside a number has


class Sidebar:
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "BTFsep"


def fields(layout):
    """A column whose names stand beside their fields."""
    column = layout.column()
    column.use_property_split, column.use_property_decorate = True, False
    return column


def is_narrow(context) -> bool:
    """Whether the sidebar has been made so narrow that words would be cut off."""
    return context.region.width < NARROW * context.preferences.system.ui_scale


def beside(context, layout):
    """A row for two buttons; in a narrow sidebar a column."""
    return layout.column(align=True) if is_narrow(context) else layout.row(align=True)


def engine_rows(column, settings, part: str) -> None:
    """The engine's settings that stand in ``part`` of the panel."""
    for s in engine_settings.PANEL:
        if s.panel == part:
            row = column.row(align=True)
            value = row.row(align=True)
            value.prop(settings, s.name)
            if s.auto:
                value.active = not getattr(settings, f"auto_{s.name}")
                auto = row.row(align=True)
                auto.scale_x = AUTO  # or its word is cut off in a narrow sidebar
                auto.prop(settings, f"auto_{s.name}", text="Auto", toggle=True)


def refine_alignment(layout, settings) -> None:
    """The button; of a depth only the photo can be shifted."""
    if settings.depth is None:
        layout.operator_menu_enum("btfsep.refine_alignment", "moves", icon="CON_CAMERASOLVER")
    else:
        layout.operator("btfsep.refine_alignment", icon="CON_CAMERASOLVER")
