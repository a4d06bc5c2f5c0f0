# SPDX-License-Identifier: GPL-3.0-or-later
"""Warnings about an estimate, in words, and every threshold at which one is given.

The thresholds of structure were set above what a dozen photographs by Cycles with the right material and geometry show,
and well under what a lamp at four radii shows; docs/results/fit.md has how often each doubt is raised on others.
"""

from dataclasses import dataclass

import numpy as np

from btfsep_engine import sh
from btfsep_engine.conventions import angles_of_direction, pixel_solid_angles
from btfsep_engine.fit.diagnose import Effect
from btfsep_engine.fit.misalignment import Shift


@dataclass(frozen=True)
class Thresholds:
    """At which a doubt is said.

    Attributes
    ----------
    shift, shift_gain, shift_contrast : pixels; of the silhouette's mean gradient (`fit.misalignment.Shift`)
    near : chi^2 of three degrees of freedom; near_size : change of brightness over the object's radius
    blocked, diffuse : chi^2 of one degree of freedom, which real shapes and textures raise above 1; blocked_size : of
        what an even sky would be in the gaps (white without any reflections has 0.66 and more, what radiosity smooths
        away in narrow gaps up to 0.3)
    clamped : share of the light's power that is negative, where series of a low order end always somewhat below zero
    residual : relative misfit of an object
    explained : relative misfit of the photo, under which nothing is left that could speak of anything
    condition : of a least-squares fit
    clipped : share of an object's pixels
    given : of the logarithm of the evidence, that a photo gains without a lamp whose direction is given
    given_off : degrees between it and the lamp that the photo has in its place
    given_share : of the light, under which such a lamp is as good as dark
    albedo, albedo_times : by how much, and how many times, an occluder is brighter or darker in one channel than its
        surface says
    albedo_left : of its pixels, that one colour may leave unexplained
    """

    shift: float = 1.5
    shift_gain: float = 1.1
    shift_contrast: float = 1.3
    near: float = 50.0
    near_size: float = 0.3
    blocked: float = 60.0
    blocked_size: float = 0.4
    diffuse: float = 25.0
    clamped: float = 0.1
    residual: float = 0.55
    explained: float = 0.02
    condition: float = 300.0
    clipped: float = 0.05
    given: float = 5.0
    given_off: float = 5.0
    given_share: float = 0.05
    albedo: float = 0.2
    albedo_times: float = 1.6
    albedo_left: float = 0.6


THRESHOLDS = Thresholds()


def alignment_doubt(shift: Shift | None) -> str | None:
    """The photo's outline does not lie where the geometry says."""
    t = THRESHOLDS
    if shift is None or shift.distance < t.shift or shift.gain < t.shift_gain or shift.contrast < t.shift_contrast:
        return None
    down = f"{abs(shift.rows)} pixels {'down' if shift.rows > 0 else 'up'}"
    right = f"{abs(shift.columns)} to the {'right' if shift.columns > 0 else 'left'}"
    return (
        f"geometry and photo do not line up: the outlines in the photo lie {down} and {right} of where the camera "
        "should see them; check the camera's pose and lens, or let btfsep align move it"
    )


def given_lamp_doubts(lamp, *, gain: float, instead, shown: bool, beside: bool = False) -> list[str]:
    """What speaks against a lamp whose direction is given.

    Parameters
    ----------
    lamp : `fit.stated.Lamp`
    gain : of the logarithm of the evidence, without it
    instead : direction (3,) of the lamp that is then found nearest to it; None: there is none
    shown : whether it lights what the photo shows
    beside : whether the photo, with it, has a further lamp just beside it: a part of its light goes there
    """
    t, name = THRESHOLDS, f"the lamp whose direction is given ({angles_words(lamp.direction)})"
    if not shown:
        part = f"{100 * max(lamp.share - lamp.share_stddev, 0):.0f} to {100 * (lamp.share + lamp.share_stddev):.0f} %"
        return [
            f"{name} lights hardly anything that the photo shows: how bright it is, is little more than a guess: {part}"
            " of the light"
        ]
    off = None if instead is None else float(np.degrees(np.arccos(np.clip(instead @ lamp.direction, -1, 1))))
    if gain > t.given and off is not None and (off > t.given_off or beside):
        return [
            f"the photo speaks against {name}: it would have it {off:.0f} degrees away, at {angles_words(instead)}; "
            "turn it there, or leave it out"
        ]
    if lamp.share < t.given_share or (gain > t.given and off is None):
        return [
            f"the photo speaks against {name}: it has {100 * lamp.share:.0f} % of the light; check its direction, or "
            "leave it out"
        ]
    return []


def albedo_differs(said, shown, left: float) -> bool:
    """Whether an occluder's colour in the photo (3,), which leaves so much of its pixels over, is not its surface's."""
    t, off = THRESHOLDS, np.abs(said - shown)
    times = np.maximum(said, shown) / np.maximum(np.minimum(said, shown), 1e-3)
    return bool(left < t.albedo_left and ((off > t.albedo) & (times > t.albedo_times)).any())


def occluder_words(number: int, name: str = "") -> str:
    """An occluder for people: its name, or else its number in the job, which is given from 0 on."""
    return f"occluder '{name}'" if name else f"occluder {number + 1}"


def albedo_words(called: str, said, shown) -> str:
    """That they differ, of an occluder that is ``called`` so."""
    words = "{:.2f}, {:.2f}, {:.2f}"
    return (
        f"{called} is said to reflect {words.format(*said)} (red, green, blue), and the photo shows about "
        f"{words.format(*shown)} of it"
    )


def angles_words(direction) -> str:
    """A direction for people."""
    elevation, azimuth = angles_of_direction(direction)
    return f"{elevation:.0f} degrees above the horizon, azimuth {azimuth:.0f} degrees (from +X towards +Y)"


def clamped_share(x) -> float:
    """The power of a light (terms, 3) where it is negative, over that of where it is not."""
    radiance = sh.to_map(x, 32, 64)
    area = pixel_solid_angles(32, 64)[:, None, None]
    return float((area * np.maximum(-radiance, 0)).sum() / max((area * np.maximum(radiance, 0)).sum(), 1e-300))


def structure_doubts(effects: dict[str, Effect], *, residual: float, names, mirrored: bool = False) -> list[str]:
    """What the residual's structure speaks for.

    Parameters
    ----------
    effects : of `fit.diagnose.diagnose`
    residual : of the fit, relative
    names : of the materials
    mirrored : whether a mirror's picture was put together, for which all light was taken to come from far away
    """
    out, t = [], THRESHOLDS
    material = " or ".join(dict.fromkeys(names))
    near, blocked, diffuse = (effects[k] for k in ("near", "blocked", "diffuse"))
    speaks = residual > t.explained
    if speaks and not mirrored and near.chi2 > t.near and np.linalg.norm(near.size) > t.near_size:
        out.append(
            f"brightness changes with the place by {100 * np.linalg.norm(near.size):.0f} % over the object where its "
            "orientation does not: light from nearby (a lamp, a window, a table), which the method takes to be far away"
        )
    if speaks and blocked.chi2 > t.blocked and blocked.size[0] > t.blocked_size:
        out.append(
            "places that see little of the sky are brighter than they should be: reflections from surfaces that are "
            "not modelled (more --bounces, or what stands beside them as occluders with a 'surface')"
        )
    if speaks and diffuse.chi2 > t.diffuse:
        out.append(
            f"the material ({material}) does not go with the photo: what is left over looks like shading; its gloss or "
            "its class may be wrong"
        )
    return out
