# SPDX-License-Identifier: GPL-3.0-or-later
"""A doubt of a card, or of a run: its sentence, the buttons that mend it, and what is to be done after one was pressed.

Of the Sun lamps, which stand below the card as well as in the doubt that asks for one to be frozen, each is shown once.
"""

from ..basics import labels
from ..light import kept_light, sun_lamp
from ..run import request
from ..window import mending
from . import made_of, sidebar

PREFIX = "BTFsep "  # of our lamps: their numbers at the end are what tells them apart
FIELDS = ("COLOUR", "MATERIAL")  # mends that ask for more than a press


def of_card(scene) -> list:
    """The doubts of the light that is shown."""
    light = kept_light.kept(scene)
    return [] if light is None else kept_light.card(light).get("warnings") or []


def draw(context, box, doubt) -> None:
    """``doubt`` : dict, as of `light.card.card_of`"""
    labels.wrapped(context, box, doubt["short"], icon="ERROR")
    mend = doubt["mend"]
    if mend == "ALIGN":
        sidebar.refine_alignment(box, context.scene.btfsep)
    elif mend == "UPRIGHT":
        box.operator("btfsep.turn_upright", icon="LOOP_FORWARDS")
    elif mend == "MASK":
        _mask(context, box)
    elif mend == "FREEZE":
        suns(context, box)
    elif mend:
        _buttons(context, box, mend, doubt["object"])


def _mask(context, box) -> None:
    """The mask of the active object. (The operators are the mask's own: one with properties of its own, which Blender
    shows in the 3D view to be adjusted, must not open a window in Blender 4.3, which crashes then.)
    """
    entry = request.active_entry(context.scene.btfsep)
    if entry is None or entry.mask is None:
        box.operator("btfsep.new_mask", text="Make a Mask")
        return
    box.operator("btfsep.paint_mask")
    _again(context, box)


def _again(context, box) -> None:
    """Of the estimate that the card is of: not of a sequence, nor where the light follows by itself."""
    if kept_light.kept(context.scene) is not None and not context.scene.btfsep.live:
        box.operator("btfsep.estimate", text="Estimate Again", icon="LIGHT_SUN")


def _buttons(context, box, mend: str, name: str) -> None:
    scene = context.scene
    light = kept_light.kept(scene)
    ways = mending.ways(scene, light, mend, name)
    pressed = [way for way in ways if mending.is_done(scene, light, *way)]
    row = sidebar.beside(context, box)
    for how, thing in ways:
        button = row.operator("btfsep.mend", text=mending.WORDS[how], depress=(how, thing) in pressed)
        button.how, button.object = how, thing
    if not pressed:
        return
    how, thing = pressed[-1]
    if how in FIELDS:
        made_of.source(context, box, mending.entry_of(scene.btfsep, thing), whole=False)
    _again(context, box)


def suns(context, layout) -> None:
    """The Sun lamps: those of the estimate, those that are known, and the active one, each with its button."""
    scene, known, active = context.scene, sun_lamp.known_suns(context.scene), context.object
    chosen = [active] if active is not None and active.type == "LIGHT" else []
    shown = dict.fromkeys((*known, *sun_lamp.lamps(scene), *chosen))
    column, freeze = layout.column(align=True), "Freeze" if sidebar.is_narrow(context) else "Freeze Sun"
    for lamp in (lamp for lamp in shown if lamp.data.type == "SUN"):
        row = column.row(align=True)
        held = lamp in known
        row.label(text=lamp.name.removeprefix(PREFIX), icon="LIGHT_SUN")
        words, icon = ("Free", "UNLOCKED") if held else (freeze, "LOCKED")
        row.operator(f"btfsep.{'free' if held else 'freeze'}_sun", text=words, icon=icon).name = lamp.name
