# SPDX-License-Identifier: GPL-3.0-or-later
"""What is stated of the light where an object with a texture was taken for something that only looks like it.

A texture that nobody measured is a relief as well: its slopes, pores and fibres reflect otherwise than a surface alike
all over of the same colour, and otherwise than the material of a library that looks the most like it. Light imitates
the difference, and little of it is left over for a fit to see. Of what a library has the photo is no stranger than
photos of that are as a rule. Where it is stranger, and where a surface without a texture stands for one that has, more
is stated: of 50 photographs of textures by others, the light errs up to order 2 by 1.5 times what the fit states in the
median where they are recognised, 1.3 times where their mean colour and roughness are told.

Noise varies from pixel to pixel as well. Of a grainy photo as much more is stated (15 plates with 3 to 9 % of noise err
1.0 times what is stated so, at worst 1.9), but that it is a texture is not said.
"""

from dataclasses import replace

from btfsep_engine.btf.surfaces import GIVEN, SURFACES
from btfsep_engine.fit.stated import widened
from btfsep_engine.pipeline.like_pixels import is_grainy

GUESSED, BY_NUMBERS = 2.0, 1.5  # times what is stated
LOOK_ALIKE = "look_alike"  # its name among what is chosen
TEXTURED = "the photo shows a texture of {} of which it is not known how it reflects"
GRAINY = "the photo is grainy where it shows {}, which may hide a texture"


def look_alike(model, light):
    """The refinement: wider ranges where what the photo shows the texture of is not known to be made as it is said."""
    if light.fit.samples is None:
        return model, light, {}
    factors, grainy = {}, set()
    for problem, materials in zip(model.problems, model.materials, strict=True):
        for i, (thing, material) in enumerate(zip(problem.scene.job.objects, materials, strict=True)):
            if problem.around is not None and (factor := _factor(material)) > 1:
                factors[thing.name] = max(factor, factors.get(thing.name, 1.0))
                if not material.looks_alike and is_grainy(problem.scene, i):
                    grainy.add(thing.name)
    if not factors:
        return model, light, {}
    most = max(factors.values())
    textured, grainy = ([name for name in factors if (name in grainy) is noise] for noise in (False, True))
    shown = [TEXTURED.format(_named(textured))] * bool(textured) + [GRAINY.format(_named(grainy))] * bool(grainy)
    words = f"{'; '.join(shown)}: what is known of the light is stated {most:g} times as wide"
    return model, replace(light, fit=widened(light.fit, most)), {LOOK_ALIKE: words}


def _named(names) -> str:
    return ", ".join(f"object '{name}'" for name in names)


def _factor(material) -> float:
    """By how much a textured object's `ObjectMaterial` widens what is stated."""
    if material.mirror is not None:
        return 1.0
    if material.looks_alike or (material.is_given and material.name in SURFACES):
        return GUESSED
    return BY_NUMBERS if material.name == GIVEN and not material.material.has_texture else 1.0
