# SPDX-License-Identifier: GPL-3.0-or-later
"""The colour of a table or floor of which the job does not say it, where the photo shows it.

A matte surface shows its albedo times what a white one in its place shows, and that the light that is being found says:
the albedo is the photo over the white one, channel by channel. Places count by how much light they send the objects, so
that of a texture, or of things that lie on the table, the mean is that which lights them. Colour and light are found by
turns; an error of the light's strength is one of the albedo's the other way round, and what the objects receive stays.

What the pixels show may be something else: clutter, a wall in front, a background painted over. Colours are sure where
the pixels agree with each other, and with the objects; all others stand beside greys that know nothing of the pixels
(`refine.surroundings`), and the evidence of the objects decides.
"""

from dataclasses import dataclass, replace

import numpy as np

from btfsep_engine.light.lightings import SHLighting
from btfsep_engine.pipeline.basis import USUAL
from btfsep_engine.pipeline.ground_places import WHITE, places_of
from btfsep_engine.pipeline.settings import MODELLED_BOUNCES
from btfsep_engine.pipeline.together import fit_together

DARKEST, BRIGHTEST = 0.02, 0.95
ROUNDS = 2  # of colours and the light that they are seen under
SETTLED = 0.05  # of a colour: a change by less is not followed
AGREE = 0.12  # of what is seen, not explained: one colour leaves 0.03 to 0.12, under hard lamps 0.2, checks 0.5
AGAINST = 5.0  # of the logarithm of the evidence
METAL = 0.5  # metallic: what is more of a metal shows the light, and no colour of its own
LEAST_COSINE = 0.1  # of the way to the objects: one that looks past their middle lights a part of them


@dataclass(frozen=True)
class Read:
    """Models without and with light between surfaces, and the SolvedLight, of occluders in the colours of their pixels.

    ``sure`` : whether nothing speaks against these
    """

    direct: object
    model: object
    light: object
    sure: bool


def by_own_pixels(direct, model, light, with_reflections, of=None) -> Read | None:
    """What the photos show of occluders whose surface is not known; None where they show nothing of it.

    Parameters
    ----------
    direct, model : Model without and with light between surfaces; light : SolvedLight of the second
    with_reflections : Model -> the same with light between surfaces
    of : numbers of occluders in each photograph, which have a surface, instead
    """
    if light.fit.evidence is None:
        return None
    places = [seen_places(problem.scene, said=of is not None) for problem in model.problems]
    if of is not None:
        places = [{k: each[k] for k in own} for each, own in zip(places, of, strict=True)]
    if not any(places):
        return None
    first, before = light.fit.evidence, np.inf
    for _ in range(ROUNDS):
        x, found = light.fit.all_coefficients, []  # whatever colour the objects are
        for problem, some, exposure in zip(model.problems, places, light.exposures, strict=True):
            found.append(seen_colours(problem, some, exposure * x, model.settings))
        colours = [{k: colour for k, (colour, _) in each.items()} for each in found]
        flat = np.array([colour for each in colours for colour in each.values()])
        if np.all(np.abs(flat / before - 1) < SETTLED):
            break
        before = flat
        direct = with_colours(direct, colours)
        model = replace(with_reflections(direct), appearance=model.appearance)
        light = fit_together(model.problems, replace(model.modelled, order=light.order), beside=light.fit)
    agree = all(left < AGREE for each in found for _, left in each.values())
    return Read(direct, model, light, agree and light.fit.evidence > first - AGAINST)


def with_colours(model, colours):
    """The model with occluders of the ``colours`` of each photograph, {number: (3,)}."""
    return model.changed(lambda p, own: replace(p, scene=p.scene.with_colours(own)), colours)


def seen_places(scene, *, said: bool = False) -> dict:
    """{number of an occluder: (SurfacePoints, photo (p, 3))} of those that the photo shows and the job does not say.

    ``said`` : of those of which the job says that they are matte or plastic, and do not shine themselves
    """
    asked = [k for k, o in enumerate(scene.job.occluders) if _is_asked(o.surface, said)]
    seen = {k: places_of(scene, k) for k in asked if not (said and k in scene.colours)}
    return {k: places for k, places in seen.items() if places and places[1].any()}  # all black: what was cut out


def _is_asked(surface, said: bool) -> bool:
    return surface is None if not said else bool(surface and surface.metallic < METAL and not any(surface.emission))


def seen_colours(problem, places, x, settings, *, brightest: float = BRIGHTEST) -> dict:
    """{number of an occluder: (what it reflects (3,), what that leaves of its pixels, relative)}, under a light x.

    Parameters
    ----------
    places : as of `seen_places`
    x : (terms, 3), in the photo's own exposure
    brightest : that is believed
    """
    out, scene, light = {}, problem.scene, SHLighting(np.asarray(x))
    indirect = scene.indirect(problem.materials, light, settings, bounces=MODELLED_BOUNCES) if places else None
    for k, (points, photo) in places.items():
        white = scene.radiance(points, WHITE, light, directions=USUAL, indirect=indirect)[:, 0]
        white = np.maximum(white.astype(np.float64), 0)
        weight = sent(points, scene.tracer)[:, None]
        colour = (weight * photo).sum(0) / np.maximum((weight * white).sum(0), 1e-300)
        left = (weight * np.square(photo - colour * white)).sum() / (weight * np.square(photo)).sum()
        colour *= min(1, brightest / colour.max())  # brighter than white: the light is, and the hue stays
        out[k] = np.maximum(colour, DARKEST), float(np.sqrt(left))
    return out


def sent(points, tracer) -> np.ndarray:
    """How much of what a pixel shows of a matte surface the middle of the objects receives, (p,), in any unit."""
    way = tracer.centre - points.position
    distance = np.linalg.norm(way, axis=1)
    cosine = np.maximum((way * points.flat_normal).sum(1) / np.maximum(distance, 1e-300), LEAST_COSINE)
    return cosine * np.square(points.footprint / np.maximum(distance, tracer.radius))
