# SPDX-License-Identifier: GPL-3.0-or-later
"""What the elected model of the light says, in words, for JSON, and as radiance."""

import numpy as np

from btfsep_engine.fit.near_lamp import MOUND, mounds
from btfsep_engine.fit.stated import Fit
from btfsep_engine.light.files import Lighting

UNKNOWN_COLOUR = 0.5  # probability, from which on it is said that the object's colour is not known
WITHIN = np.cos(np.radians(MOUND))
HALO = 15.0  # degrees beyond, over which what a field shows around a lamp fades into the sky
BROAD = 30.0  # a lamp that is no sun: exp(BROAD cos), 15 degrees wide


def sky_radiance(fit: Fit, lighting: Lighting):
    """The fit's own positive radiance (directions (…, 3) -> (…, 3)), without its suns.

    Lamps that are no suns are broad discs; what is a lamp nearby is taken off where it is a part of the field.
    """
    kept = [lamp for lamp in fit.lamps if not any(np.allclose(lamp.direction, sun.direction) for sun in lighting.suns)]
    nearby, found = [sun.direction for sun in lighting.suns if sun.near], [lamp.direction for lamp in fit.lamps]
    broad = [sun for sun in nearby if not any(np.allclose(sun, lamp) for lamp in found)]
    around = mounds(fit.election, broad, 1)
    kept = [lamp for lamp in kept if all(lamp.direction @ sun < WITHIN for sun in broad)]

    def radiance(directions):
        out = fit.election.radiance(directions)
        for sun, own in zip(broad, around, strict=True):
            beyond = np.degrees(np.arccos(np.clip(directions @ sun, -1, 1))) - MOUND
            share = np.clip(1 - beyond / HALO, 0, 1)[..., None]
            out = out - share * np.maximum(out - own.base * fit.tint.gain, 0)
        for lamp in kept:
            disc = np.exp(BROAD * (np.asarray(directions) @ lamp.direction - 1))  # of integral 2 pi / BROAD
            out = out + disc[..., None] * (lamp.irradiance * BROAD / (2 * np.pi))
        return out

    return radiance


def lamp_record(lamp) -> dict:
    """A lamp of the fit for JSON."""
    return {
        "direction": lamp.direction,
        "direction_stddev_degrees": lamp.degrees,
        "irradiance": lamp.irradiance,
        "stddev": lamp.stddev,
        "share": lamp.share,
        "share_stddev": lamp.share_stddev,
        **({"given": True} if lamp.given else {}),
    }


def light_words(fit: Fit) -> str:
    """Which model of the light the photo asked for."""
    if fit.election is None:
        return "spherical harmonics by least squares"
    lamps = len(fit.lamps)
    beside = f" and {lamps} lamp{'s' if lamps > 1 else ''}" if lamps else ""
    plain = fit.election.solution.model.field.order == 0
    return (
        f"even light{beside}: nothing richer explains the photo better"
        if plain
        else f"light that is free in every direction{beside}"
    )


def colour_words(fit: Fit) -> str:
    """Whose colour a tint was taken to be."""
    if fit.tint is None:
        return "the light's colour is what the material's leaves over"
    if fit.tint.unknown > UNKNOWN_COLOUR:
        return (
            "the object's colour is not the material's, and not known: the light was taken to be as little coloured as "
            "light usually is"
        )
    if fit.tint.filtered > UNKNOWN_COLOUR and not fit.election.photo.fields[0].vivid:
        return "the object's colour was taken to be the one that is said, and the light to be strongly coloured"
    return "the object's colour was taken to be the material's"


def colour_doubts(fit: Fit) -> list[str]:
    """That the object's colour is not known."""
    if fit.tint is None:
        return []
    if fit.tint.filtered > UNKNOWN_COLOUR and not fit.election.photo.fields[0].vivid:
        return [
            "the light has a colour that is seldom met, as from a lamp with a filter, or the object has another colour "
            "than its 'surface' says: one photo cannot tell, and the light's colour is known only so far; check the "
            "object's colour"
        ]
    if fit.tint.unknown <= UNKNOWN_COLOUR:
        return []
    r, g, b = fit.tint.reflected
    return [
        "the object's colour is not known: no usual light makes the material look like the photo; the object was taken "
        f"to reflect {r:.2f}, {g:.2f}, {b:.2f} times (red, green, blue) its material, and what the light's colour is, "
        "is known only as well as lights usually scatter; give the object's colour ('surface'), if you know it"
    ]
