# SPDX-License-Identifier: GPL-3.0-or-later
"""Labels over several lines, in the sidebar and in the preferences."""

import re

import blf

FONT_SIZE = 11  # of Blender's labels, in points, at scale 1
MARGIN = 105  # pixels of a region's width that a label with an icon in a box cannot have, at scale 1
TOGETHER = re.compile(r"(?<=\d) (?=(?:%|K\b|m\b|s\b|°))")  # between a number and its unit no line ends


def wrapped(context, layout, text: str, *, icon: str = "NONE", icon_value: int = 0, share: float = 1.0) -> None:
    """A label over as many lines as the region's width needs: Blender's own labels are cut off.

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


def parted(context, layout, message: str) -> None:
    """An error for people, its parts (``what; what was got; what to do``) one below the other."""
    for number, part in enumerate(message.split("; ")):
        wrapped(context, layout, part[:1].upper() + part[1:], icon="BLANK1" if number else "ERROR")


def lines(text: str, fits) -> list:
    """``text`` in lines of which ``fits(line)``; a word that is too long for one, as a path, is broken."""
    made = [""]
    for word in re.split(r"[ \n]+", TOGETHER.sub("\u00a0", text).strip()):
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
