# SPDX-License-Identifier: GPL-3.0-or-later
"""The engine's doubts in a line each, how much they weigh, and the button that mends them. No bpy in this file.

tests/blender/test_twins.py finds every phrase in what the engine says.
"""

import re
from dataclasses import dataclass

LEVELS = ("GREEN", "AMBER", "RED")
MATERIAL = "does not rule them out"  # `card` says it from the answer itself, by names
NONE_OF_THESE = "looks like none of the library's materials"
MISFIT = "does not go with the photo"
LOOK_ALIKE = "of which it is not known how it reflects"
OUT_OF_LINE, MADE_UP_FOR = "geometry and photo do not line up", "geometry and photo did not line up"
COLOUR_UNKNOWN = "the object's colour is not known"
OVEREXPOSED, SATURATED = "are saturated or transparent", "pixels are saturated"
BY_CURVE = "with the photo read by the tone curve that was found"
RELIEF = "has a normal or bump map, which is not followed"  # the add-on says it itself
LAYERS = {"fuzz of cloth": "as cloth (sheen)", "clear coat": "varnished (coat)"}  # the engine's words, Principled's
FEW = 1e-3  # of the photo's pixels: of fewer that are left out nothing is said but under Details


@dataclass(frozen=True)
class Advice:
    """``phrase`` : part of the engine's sentence; ``short`` : what the panel says ({0}: the object, {1}: how much
    brighter or darker it is, {2}: how rough, {3}: how much of it, {4}: what lies on it); "" hides it under Details;
    ``mend`` : key of `mending.MENDS`, or "ALIGN", "UPRIGHT", "MASK", "FREEZE" (the suns), which have their own
    buttons; ``level`` : the trust that is left at best; ``objects`` : what the engine's sentence names
    """

    phrase: str
    short: str
    mend: str = ""
    level: str = "GREEN"
    objects: tuple = ()


KNOWN = (
    Advice(OUT_OF_LINE, "Photo and geometry do not line up", "ALIGN", "RED"),
    Advice(MADE_UP_FOR, "Objects or camera are out of place; the engine made up for it", "ALIGN"),
    Advice(MATERIAL, ""),
    Advice(
        NONE_OF_THESE,
        "{0} looks like no material of the library; give its colour",
        "COLOUR",
        "AMBER",
    ),
    Advice(BY_CURVE, "What {0} is taken for depends on the tone curve; choose its material", "MATERIAL", "AMBER"),
    Advice(COLOUR_UNKNOWN, "The object's own colour is not known; give it", "COLOUR", "AMBER"),
    Advice(
        "has a colour that is seldom met",
        "Coloured lamps, or {0} is of another colour than it is said to be",
        "COLOUR",
        "AMBER",
    ),
    Advice(
        "the photo is black and white", "A black-and-white photo: the colours of the light are not known", level="AMBER"
    ),
    Advice("light from nearby", "Part of the light is near (a lamp, a window); a World is far away", level="AMBER"),
    Advice(
        "brighter than they should be",
        "Something that is not in the scene throws light on the object; add it",
        level="AMBER",
    ),
    Advice("stand on a ground that", "The objects stand on a ground that is not in the scene", "GROUND"),
    Advice("has light in it, as scans have", "The texture of {0} has light in it, which was taken off", "KEEP"),
    Advice(
        "casts a shadow on the objects",
        "Something that is not in the scene casts a shadow on the object; add it",
        level="AMBER",
    ),
    Advice(LOOK_ALIKE, "{0} has a texture that nobody measured; choose or measure its material", "MATERIAL", "AMBER"),
    Advice("as of dust on it", "{0} looks dusty on top, of which its material says nothing; the light goes by that"),
    Advice("is grainy where it shows", "The photo is grainy: one with less noise says more"),
    Advice("highlights that are not those of", "The photo shows more gloss than the material has", "MATERIAL", "AMBER"),
    Advice(MISFIT, "The material does not quite fit the photo", "MATERIAL", "AMBER"),
    Advice("poorly (relative residual", "The light explains {0} poorly: material, shape or camera", "ALIGN", "RED"),
    Advice(
        "show something else than the light explains",
        "{3} of {0} is left out: something is in front of it, or it has paint there",
        "MASK",
    ),
    Advice("lies over the photo and never met them", "Haze or stray light over the photo is taken off", level="AMBER"),
    Advice("lie beside where the mesh has them", "Shape or pose of {0} is not what the photo shows", level="AMBER"),
    Advice(
        "brighter or darker than the light makes",
        "Shape, pose or paint of {0} is not what the photo shows",
        level="AMBER",
    ),
    Advice(
        "says to be alike all over",
        "There may be paint on {0}, or another finish than its material has",
        "SELECT",
        "AMBER",
    ),
    Advice(
        "which it was taken to reflect",
        "The photo shows {0} in another colour than Blender has; the light goes by the photo's",
        "SELECT",
    ),
    Advice("where its surface says", "The photo shows {0} with a roughness of {2}; the light goes by that", "SELECT"),
    Advice(
        "of which its surface says nothing",
        "The photo shows {0} {4}, of which its material says nothing; the light goes by that",
        "SELECT",
    ),
    Advice(
        "or what is said is wrong",
        "The photo shows {0} in another colour than Blender has: the material is wrong, or the light",
        "SELECT",
        "AMBER",
    ),
    Advice(
        "in the photo than its 'surface' is under",
        "{0} is {1} in the photo than in this light: the material is wrong, or the light",
        "SELECT",
    ),
    Advice("the mesh is coarse", "The mesh is coarse for its smooth shading; give a finer one", level="AMBER"),
    Advice(
        "lamps are clipped in what mirrors", "How bright the mirror's overexposed lamps are is a guess", level="AMBER"
    ),
    Advice("left out of what the objects are made of", "Not all of what {0} is made of is followed", level="AMBER"),
    Advice(OVEREXPOSED, "{3} of {0} is overexposed or transparent in the photo"),
    Advice("pixels are transparent", "Transparent pixels of the photo are left out"),
    Advice(SATURATED, "Overexposed pixels are left out"),
    Advice("is mapped by projecting patches", ""),
    Advice("is negative in some directions", ""),
    Advice("have no area and are left out", ""),
    Advice("not all of the first four", "The photo tells only in part from where the light comes", "FREEZE", "RED"),
    Advice("the photo speaks against", "The photo speaks against a known sun", "FREEZE", "AMBER"),
    Advice("is little more than a guess", "A known sun lights nothing that the photo shows; its power is a guess"),
    Advice("lamps whose direction is given are left out", "This preset leaves known suns out", level="AMBER"),
    Advice("the fit is badly conditioned", "The photo tells little of so fine a light; a lower order is steadier"),
    Advice("a render that was saved with that view", "The photo looks like a render saved with AgX", "AGX", "RED"),
    Advice("a camera's own picture", "The photo looks like a camera's own picture", "CAMERA", "AMBER"),
    Advice("an estimate finds it, and recognises by it", "Read as sRGB here; Estimate Light finds how it was saved"),
    Advice(
        "a phone moved the photo's tones", "How far the phone raised shadows is open; raw tells more", level="AMBER"
    ),
    Advice("tone curve is doubtful", "The photo's tone curve may be another one", "CURVE", "AMBER"),
    Advice("it says that it is to be turned", "The photo's file asks for it to be turned", "UPRIGHT"),
    Advice("a depth shows one side", "The depth shows one side of it only"),
)

OURS = (
    Advice(RELIEF, "Bumps of {0}'s material are not followed: the light goes by the mesh alone"),
    Advice(
        "its light is found as the World's",
        "{0} shines, and the World has its light, too: switch its emission off, or hide it from renders",
        "SELECT",
    ),
    Advice("like a sky or a room", "{0} stands around all: hide it from renders, or it keeps the World's light out"),
    Advice("is left out, as light goes through", "{0} is see-through, and keeps no light away here"),
)
"""What the add-on says itself (`scene.own_surface`, `scene.surroundings`, `scene.export`)."""


def advice(sentence: str) -> Advice:
    """What to make of a warning; of one that is not known, how it begins."""
    pixels = re.search(r"\b(\d+) of (\d+) pixels (?:are|show)", sentence)
    if pixels and int(pixels[1]) < FEW * int(pixels[2]):
        return Advice(pixels[0], "")
    for known in (*KNOWN, *OURS):
        if known.phrase in sentence:
            named = tuple(dict.fromkeys(re.findall(r"(?:object|occluder) '(.+?)'(?=[ ,:;]|$)", sentence)))
            called, mend = ", ".join(named), known.mend
            if not named:  # of what has no name, nothing can be selected
                called, mend = ("what stands around", "") if mend == "SELECT" else ("the object", mend)
                called = called[:1].upper() + called[1:] if known.short.startswith("{0}") else called
            told = (asked(sentence) for asked in (_how_much, _how_rough, _share, _layer))
            return Advice(known.phrase, known.short.format(called, *told), mend, known.level, named)
    first = re.match(r".{30,}?(?=[;:] | \(|$)|.*", sentence.removeprefix("occluder "))[0].strip()
    return Advice("", first[:1].upper() + first[1:])


def _how_much(sentence: str) -> str:
    """How much brighter or darker something is said to be: "25 % brighter"; of nothing, that it is not the same."""
    told = re.search(r"\d+ % (?:brighter|darker)", sentence)
    return told[0] if told else "brighter or darker"


def _how_rough(sentence: str) -> str:
    """The roughness that an object was taken to have, of several the numbers of all."""
    return ", ".join(re.findall(r"a roughness of ([\d.]+)", sentence))


def _share(sentence: str) -> str:
    """How much of the pixels a sentence tells of: "33 %"; of none, "A part"."""
    counted, told = re.search(r"\b(\d+) of (\d+) pixels", sentence), re.search(r"\b(\d+) % of the pixels", sentence)
    if counted is None and told is None:
        return "A part"
    share = 100 * int(counted[1]) / max(int(counted[2]), 1) if counted else int(told[1])
    return f"{share:.0f} %" if share >= 1 else "A little"


def _layer(sentence: str) -> str:
    """What is said to lie on an object, in Principled's word; of several objects all that is."""
    return " or ".join(words for layer, words in LAYERS.items() if layer in sentence)


def worst(*levels) -> str:
    """The least trust among ``levels``."""
    return max(levels, key=LEVELS.index)
