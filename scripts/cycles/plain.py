# SPDX-License-Identifier: GPL-3.0-or-later
"""Everyday surfaces that are alike all over, FINISH-COLOUR: what no library of textured materials holds."""

COLOURS = {
    "teal": (0.05, 0.35, 0.33), "red": (0.5, 0.04, 0.03), "clay": (0.55, 0.28, 0.17), "white": (0.78, 0.78, 0.76),
    "grey": (0.3, 0.3, 0.3), "yellow": (0.75, 0.5, 0.05), "navy": (0.03, 0.05, 0.2), "green": (0.12, 0.3, 0.06),
}  # fmt: skip
FINISHES = {"matte": (0.9, 0), "satin": (0.5, 0), "gloss": (0.2, 0), "metal": (0.4, 1)}  # roughness, metallic
MIRROR = {"mirror": (0.0, 1)}  # likewise, and no everyday surface: the library has it
CLASS = "plain"
NAMES = tuple(f"{CLASS}/{finish}-{colour}" for finish in (*FINISHES, *MIRROR) for colour in COLOURS)


def of(finish: str, colour: str) -> dict:
    """Numbers of Blender's Principled BSDF: colour (3,), roughness and metallic."""
    roughness, metallic = (FINISHES | MIRROR)[finish]
    return {"colour": COLOURS[colour], "roughness": roughness, "metallic": metallic}


def named(name: str) -> dict:
    """The same of one of `NAMES`."""
    return of(*name.removeprefix(f"{CLASS}/").split("-"))
