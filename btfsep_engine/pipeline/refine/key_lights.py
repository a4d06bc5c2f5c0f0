# SPDX-License-Identifier: GPL-3.0-or-later
"""Which lamps of a light are told apart from the sky, as suns: those of a good part of it."""

from dataclasses import replace

import numpy as np

from btfsep_engine.fit.stated import Fit
from btfsep_engine.light.sun import Sun
from btfsep_engine.pipeline.doubts import angles_words

LEAST = 0.2  # of the light's mean radiance: what is less stays in the sky
SAME = 10.0  # degrees: a lamp whose distance was found, and one of the final light
NARROW = 15.0  # degrees, of a lamp's direction: what is known worse is no lamp that anybody wants to see a shadow of


def key_lights(model, light):
    """The refinement: the lamps of a fit that become suns, the brightest first.

    A lamp has no size here: the fit's harmonics, 20 degrees wide, cannot tell one.
    """
    if model.settings.key_light == "never":
        return model, light, {"key_light": "lamps stay in the spherical harmonics: --key-light never"}
    if model.settings.estimator != "map":
        return model, light, {"key_light": "lamps were not looked for: that needs --estimator map"}
    suns = tuple(
        Sun(
            lamp.direction,
            lamp.irradiance,
            lamp.stddev,
            direction_stddev_degrees=lamp.degrees,
            share=lamp.share,
            share_stddev=lamp.share_stddev,
            near=None if lamp.given else nearness_of(lamp, light.near),
            given=lamp.given,
        )
        for lamp in light.fit.lamps
        if lamp.share >= LEAST and lamp.degrees <= NARROW
    )
    metres = model.problems[0].scene.job.metres_per_unit
    return model, replace(light, suns=suns), {"key_light": key_light_words(suns, light.fit, metres)}


def nearness_of(lamp, near):
    """The Near of a lamp, of those that were found (`refine.near`), or None."""
    found = [how for direction, how in near if direction @ lamp.direction > np.cos(np.radians(SAME))]
    return found[0] if found else None


def key_light_words(suns, fit: Fit, metres_per_unit: float) -> str:
    """The lamps for people."""
    kept = [
        lamp for lamp in fit.lamps if lamp.given and not any(np.allclose(lamp.direction, s.direction) for s in suns)
    ]
    beside = "".join(
        f"; of the lamp whose direction is given ({angles_words(lamp.direction)}) is {100 * lamp.share:.0f} % of the "
        "light: it stays in the spherical harmonics"
        for lamp in kept
    )
    if not suns and kept:
        return f"no key light{beside}"
    if not suns:
        if not fit.lamps:
            return "no single direction stands out: all of the light is in the spherical harmonics"
        part = max(lamp.share for lamp in fit.lamps)
        return (
            f"no key light: the strongest single direction has about {100 * part:.0f} % of the light, or is not known "
            "well enough; it stays in the spherical harmonics"
        )
    each = []
    for sun in suns:
        known = f"known to {sun.direction_stddev_degrees:.1f} degrees"
        away = f", {metres_per_unit * sun.near.distance:.2g} m away" if sun.near else ""
        each.append(
            f"{100 * sun.share:.0f} % of the light, from {angles_words(sun.direction)}, "
            f"{'as its direction is given' if sun.given else known}{away}"
        )
    first = "a key light is" if len(suns) == 1 else f"{len(suns)} key lights are"
    return f"{first} told apart from the sky: {'; '.join(each)}{beside}"
