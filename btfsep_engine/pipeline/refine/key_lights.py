# SPDX-License-Identifier: GPL-3.0-or-later
"""Which lamps of a light are told apart from the sky, as suns: those of a good part of it."""

from dataclasses import replace

import numpy as np

from btfsep_engine import sh
from btfsep_engine.fit.near_lamp import MOUND, mounds
from btfsep_engine.fit.products import SINGLE
from btfsep_engine.fit.stated import Fit
from btfsep_engine.light.sun import Sun, cap_around
from btfsep_engine.pipeline.doubts import angles_words

LEAST = 0.2  # of the light's mean radiance: what is less stays in the sky
SAME = 10.0  # degrees: a lamp whose distance was found, and one of the final light
SPREAD = 200  # directions about a broad lamp
BLUR = 25.0  # degrees: how wide a light shows what has no width (softboxes of 27 to 37 come out as 37 to 47)
NARROW = 15.0  # degrees, of a lamp's direction: what is known worse is no lamp that anybody wants to see a shadow of


def key_lights(model, light):
    """The refinement: the lamps of a fit that become suns, the brightest first; and those nearby that its sky holds.

    A lamp of the fit has no size here: its harmonics, 20 degrees wide, cannot tell one.
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
    suns = tuple(sorted((*suns, *broad_lamps(light, suns)), key=lambda sun: -sun.share))
    metres = model.problems[0].scene.job.metres_per_unit
    return model, replace(light, suns=suns), {"key_light": key_light_words(suns, light.fit, metres)}


def broad_lamps(light, suns) -> list[Sun]:
    """Softboxes and windows nearby, which a light has as a part of its sky, beside the lamps that are ``suns``."""
    within, told = np.cos(np.radians(MOUND)), [sun.direction for sun in suns]
    apart = [(direction, how) for direction, how in light.near if all(direction @ d < within for d in told)]
    if not apart:
        return []
    fit, order = light.fit, sh.order_of(len(light.fit.all_coefficients))
    whole, samples = SINGLE * fit.all_coefficients[0].mean(), fit.samples.mean(2)
    out = []
    for (direction, how), own in zip(apart, mounds(fit.election, [d for d, _ in apart], order), strict=True):
        # how uncertain it is: by what samples have there, as their harmonics show it, which are about as broad
        towards = cap_around(direction, np.radians(MOUND), SPREAD)
        above = samples @ sh.evaluate(order, towards).T - (own.base * fit.tint.gain).mean()
        much, middles = above.mean(1), above @ towards
        part = much / np.maximum(samples[:, 0], 1e-300)
        cosines = middles @ middles.mean(0) / (np.linalg.norm(middles, axis=1) * np.linalg.norm(middles.mean(0)))
        degrees = float(np.degrees(np.sqrt(np.square(np.arccos(np.clip(cosines, -1, 1))).mean())))
        irradiance = own.irradiance * fit.tint.gain
        share = float(irradiance.mean() / whole)
        if share >= LEAST and degrees <= NARROW:
            out.append(
                Sun(
                    direction,
                    irradiance,
                    irradiance * much.std() / abs(much.mean()),
                    size_degrees=float(np.sqrt(max(own.size_degrees**2 - BLUR**2, 0))),
                    direction_stddev_degrees=degrees,
                    share=share,
                    share_stddev=float(share * part.std() / abs(part.mean())),
                    near=how,
                )
            )
    return out


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
