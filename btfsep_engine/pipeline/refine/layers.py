# SPDX-License-Identifier: GPL-3.0-or-later
"""What lies on a matte surface that its numbers do not say: the fuzz of cloth, or a clear coat.

Who takes a colour from a photo seldom knows more of a cloth than that it is matte. But fibres that stand out scatter
light where they are seen aslant (Principled's sheen; Zeltner, Burley and Chiang 2022), so that the whole rim is bright,
and light imitates that by lamps behind the object. And varnish has highlights that what is below has not. Where the
light leaves much over of an object that is said to be matte, and one of these explains the photo clearly better, it is
taken. (What has a gloss of its own hides both: of six such things told their velvet or coat, one erred a sixth less.)
"""

from dataclasses import replace

from btfsep_engine.btf.surfaces import Surface
from btfsep_engine.pipeline.refine.given import asked_of, gains_on_a_few, on_all, surface_of

MATTE = 0.45  # a roughness; smoother surfaces have a gloss of their own
LEFT = 0.06  # of the photo, that the light leaves over: of matte things that are as they are said to be 0.01 to 0.06
HOPEFUL, CLEARLY = 5.0, 30.0  # of the logarithm of the evidence: of a few pixels, of all
FUZZ, COAT = "the fuzz of cloth", "a clear coat"
LAYERED = "layers"  # its name among what is chosen
SAID = "on object '{}' lies {}, of which its surface says nothing (by evidence); check its 'surface'"


def layers_on(surface: Surface) -> list:
    """Pairs (what lies on it, the surface with that), for a surface; none where it has a layer, or a gloss."""
    if surface.metallic or surface.coat or any(surface.sheen) or surface.roughness < MATTE:
        return []
    fuzz = [(FUZZ, replace(surface, sheen=(much,) * 3, sheen_roughness=0.3)) for much in (0.4, 1.0)]
    return [*fuzz, (COAT, replace(surface, coat=1.0, coat_roughness=0.05))]


def layered(model, light):
    """The refinement: fuzz or a coat on matte objects of given numbers, where these explain the photo far better."""
    words = []
    with model.reporter.stage("reflectance"):
        for i in asked_of(model, light):
            found = _layer(model, light, i)
            if found is not None:
                model, light, what = found
                words.append(SAID.format(model.problems[0].scene.job.objects[i].name, what))
    return model, light, {LAYERED: "; ".join(words)} if words else {}


def _layer(model, light, i: int):
    """Model, light and layer of an object that explain the photo clearly better; None: none does."""
    tried, left = layers_on(surface_of(model, i)), light.share_left(model.problems)
    if not tried or left < LEFT:
        return None
    gain = gains_on_a_few(model, light, i)
    most, what, surface = max(((gain(surface), what, surface) for what, surface in tried), key=lambda each: each[0])
    if most < HOPEFUL:
        return None
    trial, answer = on_all(model, light, i, surface)
    if answer.fit.evidence < light.fit.evidence + CLEARLY or answer.share_left(trial.problems) > left:
        return None
    return replace(trial, highlights=trial.highlights and what != COAT), answer, what
