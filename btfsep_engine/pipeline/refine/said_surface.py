# SPDX-License-Identifier: GPL-3.0-or-later
"""What stands around in another colour than the job says, as where a stand-in has not the material of the real table.

A matte surface shows its albedo times what a white one in its place would show under the light that is found
(`refine.seen_colour`): of tables that are as the job says, that is right to a tenth. One that is far from it is taken
as the photo shows it, where the objects are explained clearly better so; where they are not, that the photo shows
another colour is a doubt (`pipeline.checks`): of the light, or of the surface.

Which of both, nobody knows; but where the surface is as it is said to be, how much brighter or darker it is than the
light makes it tells how much the light errs: of 77 plates on tables of a known colour that was 0.04 in the median; 15
where it was more than 0.1 erred by 1.4 times that in the median, and up to 4.9 times what they stated. Who puts up a
stand-in for a table hits its albedo no better than that, and the light is hardly worse for it. So that is the least
that is stated in half of the samples, and the others stay as they are; in all, where nobody would be so far off.
"""

from dataclasses import replace

import numpy as np

from btfsep_engine.fit.stated import expected_error, shown_error, widened
from btfsep_engine.pipeline.doubts import THRESHOLDS, albedo_differs, albedo_words, occluder_words
from btfsep_engine.pipeline.refine.interreflection import light_between_surfaces, with_reflections
from btfsep_engine.pipeline.refine.seen_colour import DARKEST, by_own_pixels, seen_colours, seen_places
from btfsep_engine.pipeline.refine.surroundings import by_photo

CLEARLY = 5.0  # of the logarithm of the evidence
OTHERWISE = "said_surface"  # its name among what is chosen
STAND_IN = 0.25  # by which who puts one up may miss an albedo, of its logarithm
DIFFERS, ERROR = 0.1, 1.4  # logarithm of how many times as bright; the error that is stated at least, over it
WORTH, WIDEST = 1.25, 4.0  # times what the fit states
UNLIKE = "surfaces_unlike"  # its name


def said_and_shown(problem, x, settings, **how) -> list:
    """Number and name, for people, colour (3,) that its surface says, colour (3,) that the photo shows of it, and what
    that leaves of its pixels, relative, of each occluder that has a surface and is seen.

    ``x`` : (terms, 3), the light in the photo's own exposure; ``how`` : as of `seen_colours`
    """
    places, albedos = seen_places(problem.scene, said=True), problem.scene.occluder_albedos
    shown = seen_colours(problem, places, x, settings, **how)
    return [
        (k, called(problem.scene, k), np.asarray(albedos[k]).reshape(-1, 3).mean(0), *each) for k, each in shown.items()
    ]


def called(scene, number: int) -> str:
    """An occluder of a scene, for people."""
    return occluder_words(number, scene.job.occluders[number].name)


def surfaces_otherwise(problem, x, settings) -> dict:
    """{number of an occluder: (what its surface says (3,), what the photo shows (3,))} where these differ."""
    found = said_and_shown(problem, x, settings)
    return {k: (said, shown) for k, _, said, shown, left in found if albedo_differs(said, shown, left)}


def as_the_photo_shows(model, light):
    """The refinement: surfaces around the objects that are far from what the job says, in the photo's own colours."""
    of_default = model.settings.bounces == "auto" and model.settings.transport == "kernel" and model.bounces == 1
    if light.solver is None or not of_default:
        return model, light, {}
    each = [
        surfaces_otherwise(problem, exposure * light.fit.all_coefficients, model.settings)
        for problem, exposure in zip(model.problems, light.exposures, strict=True)
    ]
    if not any(each):
        return model, light, {}
    with model.reporter.stage("transport"):
        read = by_own_pixels(model, model, light, with_reflections, of=each)
        shown, brighter = by_photo(read.direct, read.model, read.light, with_reflections)
    as_said = light_between_surfaces(model, light)[1]
    if brighter.fit.evidence < as_said.fit.evidence + CLEARLY:
        return model, light, {}
    words = [
        albedo_words(called(problem.scene, k), said, problem.scene.colours[k])
        + ", which it was taken to reflect (by evidence); check its 'surface'"
        for problem, own in zip(shown.problems, each, strict=True)
        for k, (said, _) in own.items()
    ]
    return shown, replace(brighter, suns=light.suns), {OTHERWISE: "; ".join(dict.fromkeys(words))}


def unlike_surroundings(model, light):
    """The refinement: doubts, and wider ranges, where known surfaces are not as the light makes them."""
    if light.fit.samples is None or light.solver is None:
        return model, light, {}
    found = [
        each
        for problem, exposure in zip(model.problems, light.exposures, strict=True)
        for each in said_and_shown(problem, exposure * light.fit.all_coefficients, model.settings, brightest=np.inf)
    ]
    far = [albedo_words(name, *both) for _, name, *both, left in found if albedo_differs(*both, left)]
    words = [f"{'; '.join(far)}: the light is another than was found, or what is said is wrong"] if far else []
    times = [(log_brighter(*each), name) for _, name, *each in found]
    most, name = max(times, key=lambda each: abs(each[0]), default=(0.0, ""))
    of_shown = shown_error(light.fit) or expected_error(light.fit.all_coefficients, light.fit.samples)
    factor = min(ERROR * abs(most) / max(of_shown["order_2"]["median"], 1e-9), WIDEST)
    if abs(most) > DIFFERS and factor > WORTH:
        way = "brighter" if most > 0 else "darker"
        even = abs(most) < STAND_IN
        cases = "in half of the cases " if even else ""
        words.append(
            f"{name} is {100 * abs(np.expm1(most)):.0f} % {way} in the photo than its 'surface' is under "
            f"the light that was found: one of both is wrong, and {cases}what is known of the light is stated "
            f"{factor:.1f} times as wide; check its 'surface'"
        )
        light = replace(light, fit=widened(light.fit, factor, odds_even=even))
    return model, light, {UNLIKE: "; ".join(words)} if words else {}


def log_brighter(said, shown, left: float) -> float:
    """Logarithm of how many times as bright as its surface says a photo shows an occluder; 0 where it does not tell."""
    tells = left < THRESHOLDS.albedo_left and said.max() > DARKEST
    return float(np.log(shown.sum() / said.sum())) if tells else 0.0
