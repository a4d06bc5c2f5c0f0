# SPDX-License-Identifier: GPL-3.0-or-later
"""The engine's settings that Blender shows, one row each. No bpy in this file.

A row makes the property, its place in the panel, the option of ``blender --command btfsep``, what the engine is told.
tests/blender/test_twins.py holds the rows against the engine's own settings.
"""

import argparse
import math
from dataclasses import dataclass, replace


@dataclass(frozen=True)
class EngineSetting:
    """One of the engine's settings.

    Attributes
    ----------
    name : of the property and, with - for _, of the option
    label, description : for people
    default : of the property; None: there is none, only the option
    items : (value, label, description) of each choice
    kind : type of its values where they are no choice
    low, high : ends of its range
    auto : what "auto" means, where a number may be that: a property ``auto_NAME`` beside it
    unsaid : value of the property of which the engine is not told: it has its own way then
    option : the engine's, where ``name`` does not say it
    panel : part of the panel where it stands, "light" or "advanced"
    required : whether the command line has to say it
    """

    name: str
    label: str
    description: str
    default: object = None
    items: tuple = ()
    kind: type = int
    low: float | None = None
    high: float | None = None
    auto: str = ""
    unsaid: object = None
    option: str = ""
    panel: str = ""
    required: bool = False

    @property
    def flag(self) -> str:
        """The option of the engine and of the command line."""
        return self.option or f"--{self.name.replace('_', '-')}"

    def value_of(self, properties):
        """The value that the engine is told, of Blender's properties; None: nothing."""
        if self.default is None or properties is None:
            return None
        if self.auto and getattr(properties, f"auto_{self.name}"):
            return "auto"
        value = getattr(properties, self.name)
        return None if value == self.unsaid else value


PRESETS = (
    ("draft", "Draft", "A first look"),
    ("balanced", "Balanced", "Good for most photos"),
    ("accurate", "Accurate", "Slow and careful"),
    ("paper", "Paper", "The settings of the published method"),
)
APPEARANCES = (
    ("auto", "Automatic", "The texture where it lines up with the photo and explains more of it, else the mean"),
    ("mean", "Mean", "The material without its texture: right where the texture does not line up with the photo"),
    ("textured", "Textured", "The material with its texture"),
)
CLASSES_OF_MATERIAL = (
    *("carpet", "fabric", "felt", "leather", "stone", "wallpaper", "wood"),  # of UBO2014
    *("ceramic", "metal", "paint", "paper", "plaster", "plastic"),
)
USUAL_CLASS = "plastic"  # what things are mostly made of, where neither the user nor the material's name says it
CLASSES = tuple((name, name.capitalize(), "") for name in CLASSES_OF_MATERIAL)

Row = EngineSetting
HIGHEST = "The highest order of which the photo determines something. A sequence takes the number beside"
ORDER = Row("order", "Order", "Order of the harmonics of the light", 4, low=0, high=9, auto=HIGHEST, panel="light")
PRESET = Row("preset", "Preset", "Speed against accuracy", "balanced", PRESETS, panel="light")
TEXTURE = Row("appearance", "Texture", "How a material is compared with the photo", "auto", APPEARANCES, unsaid="auto")
EVIDENCES = (
    ("auto", "Automatic", "Those whose 'Use as Evidence' is on; else plain ones, where the light explains all of them"),
    ("job", "As the Objects Say", "Only those whose 'Use as Evidence' is on"),
    ("all", "All", "All occluders that the photo shows"),
    ("never", "Never", "None of them"),
)
EVIDENCE = Row("evidence", "Evidence", "Which occluders' own pixels tell of the light, too", items=EVIDENCES)
DELIGHTS = (
    ("auto", "Automatic", "Light that is found in a texture is taken off for the estimate"),
    ("never", "As They Are", "Textures are the objects' own colours: nothing is taken off"),
)
TAKEN_OFF = "What is done with light in textures, as scans have it that were not de-lit"
DELIGHT = Row("delight", "De-light", TAKEN_OFF, "auto", DELIGHTS, unsaid="auto")
PANEL = (PRESET, ORDER, replace(TEXTURE, panel="advanced"), replace(DELIGHT, panel="advanced"))
COMMANDS = {
    "estimate": (*PANEL, EVIDENCE),
    "sequence": (PRESET, replace(ORDER, auto=""), TEXTURE, DELIGHT),
    "recognise": (PRESET,),
}
"""Command of the engine -> the settings that it is told."""

SQUARE = "What is measured, in millimetres: a square, UV 0 to 1, around the object's origin"
TEXELS = "Along an edge; the time grows with their square. 0: by the size"
PATHS = "Paths a texel and view; the time grows with them"
MEASURE = (
    Row("material_class", "Class", "Of the material", USUAL_CLASS, CLASSES, option="--class", required=True),
    Row("size_mm", "Size (mm)", SQUARE, 30.0, kind=float, low=0.1, high=10_000, required=True),
    Row("texels", "Texels", TEXELS, 0, low=0, high=1024, unsaid=0),
    Row("samples", "Samples", PATHS, 1, low=1, high=256),
    Row("components", "Components", "Of the factorisation"),
    Row("seed", "Seed", "Of all random numbers"),
    Row("replace", "Replace", "Replace a material of this name", False, kind=bool, unsaid=False),
)


TEXELS_A_MM, FEWEST, MOST = 2, 80, 160
SECONDS, CORES = 20, 2  # what 80 texels with one path took on so many cores (docs/library.md: 10 to 27 s)


def default_texels(size_mm: float) -> int:
    """Texels along an edge, where nobody says it."""
    return int(min(max(FEWEST, math.ceil(size_mm * TEXELS_A_MM)), MOST))


def measuring_words(size_mm: float, texels: int, samples: int, cores: int) -> str:
    """How long a measurement will take, roughly, in words."""
    texels = texels or default_texels(size_mm)
    seconds = SECONDS * (texels / FEWEST) ** 2 * samples * CORES / max(cores, 1)
    words = f"{max(10 * round(seconds / 10), 10)} seconds" if seconds < 90 else f"{round(seconds / 60)} minutes"
    return f"{texels} x {texels} texels: about {words if seconds < 5400 else f'{seconds / 3600:.1f} hours'}"


def add_options(parser: argparse.ArgumentParser, settings, default: str) -> None:
    """Options of the command line; ``default`` says in words what holds where one is not given; "": the row's own."""
    for s in settings:
        held = default or ("the engine's" if s.default is None else s.default)
        about = {"dest": s.name, "help": s.description if s.required else f"{s.description} (default: {held})"}
        if s.kind is bool:
            parser.add_argument(s.flag, action="store_true", default=None, **about)
            continue
        takes = {"choices": [value for value, *_ in s.items]} if s.items else {"type": s.kind, "metavar": "N"}
        if s.auto:
            takes = {"type": lambda text, kind=s.kind: text if text == "auto" else kind(text), "metavar": "N|auto"}
        parser.add_argument(s.flag, required=s.required, **about, **takes)


def engine_options(settings, properties, options=None) -> list:
    """What the engine is told: as ``options`` (argparse.Namespace, of the command line), else as the properties say."""
    out = []
    for s in settings:
        value = getattr(options, s.name, None)
        value = s.value_of(properties) if value is None else value
        if value is not None:
            out += [s.flag] if s.kind is bool else [s.flag, value]
    return out
