# SPDX-License-Identifier: GPL-3.0-or-later
"""The sidebars that show our panels: drawn again, and where they are in a window."""

import time

import bpy

DRAWN = 0.25  # seconds between drawings of the panel, at least


def over_panel(window, x: int, y: int) -> bool:
    """Whether a place in a window, in its pixels, is in a sidebar that shows our panel."""
    for area in window.screen.areas if window else ():
        for region in area.regions if area.type == "VIEW_3D" else ():
            inside = region.x <= x < region.x + region.width and region.y <= y < region.y + region.height
            if region.type == "UI" and inside:
                return getattr(region, "active_panel_category", "BTFsep") in {"BTFsep", "UNSUPPORTED"}
    return False


_drawn, _wanted = 0.0, False


def redraw(*, at_once: bool = False) -> None:
    """Has the panels drawn again, ``at_once`` or when it is time; the picture beside them is left alone."""
    global _wanted, _drawn
    _wanted = True
    if at_once:
        _drawn = 0.0
    draw_when_due()


def draw_when_due() -> None:
    """Has the panels drawn again that were to be, once it is time."""
    global _wanted, _drawn
    now = time.monotonic()
    if not _wanted or now - _drawn < DRAWN:
        return
    _wanted, _drawn = False, now
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            kind = {"VIEW_3D": "UI", "PREFERENCES": "WINDOW"}.get(area.type)
            for region in area.regions if kind else ():
                if region.type == kind:
                    region.tag_redraw()
